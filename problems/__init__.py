"""What is to be found: calibration problems with their mathematics and data, and nothing about searching.

>>> import problems
>>> p = problems.make("full12", error="J3")
>>> p.lower.shape, len(p.parameters), bool(p(p.truth) < 1e-18)
((12,), 12, True)
"""

from problems.base import Calibration, Parameter, Problem, registry
from problems.closed_loop import Planar
from problems.identifiability import Identifiability, identify
from problems.planar import full11, full12, link_length, sensor_zero
from problems.tracking import Tracking, tracking_zero

make = registry.make
names = registry.names

__all__ = [
    "Calibration",
    "Identifiability",
    "Parameter",
    "Planar",
    "Problem",
    "Tracking",
    "full11",
    "full12",
    "identify",
    "link_length",
    "make",
    "names",
    "registry",
    "sensor_zero",
    "tracking_zero",
]
