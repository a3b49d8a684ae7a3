"""Calibration problems with their mathematics and data. They know no optimiser.

>>> from calibench import problems
>>> p = problems.make("full12", error="J3")
>>> p.lower.shape, len(p.parameters), bool(p(p.truth) < 1e-18)
((12,), 12, True)
"""

from typing import TYPE_CHECKING

from calibench._checkout import one_module
from calibench.core.lazy import loader
from calibench.problems.base import Calibration, Parameter, Problem, registry
from calibench.problems.covariance import Estimate, FTest, LeaveOneOut, estimate, f_test, leave_one_out
from calibench.problems.fitting import fit
from calibench.problems.identifiability import Identifiability, identify
from calibench.problems.planar import Planar, Tracking, full11, full12, link_length, sensor_zero, tracking_zero

# isort: split
from calibench.problems.orthoglide import Orthoglide, orthoglide6  # last: names are listed in the order of entry

# isort: split
from calibench.problems.delta import DeltaProbing, delta9

# isort: split
from calibench.problems.arm import arm, arm_panda, arm_ur10

# isort: split
from calibench.problems.suites.bbob import bbob
from calibench.problems.suites.ioh import ioh
from calibench.problems.suites.nist import nist

if TYPE_CHECKING:
    from calibench.problems.arm import ArmCalibration

make = registry.make
names = registry.names

__all__ = [
    "ArmCalibration",
    "Calibration",
    "DeltaProbing",
    "Estimate",
    "FTest",
    "Identifiability",
    "LeaveOneOut",
    "Orthoglide",
    "Parameter",
    "Planar",
    "Problem",
    "Tracking",
    "arm",
    "arm_panda",
    "arm_ur10",
    "bbob",
    "delta9",
    "estimate",
    "f_test",
    "fit",
    "full11",
    "full12",
    "identify",
    "ioh",
    "leave_one_out",
    "link_length",
    "make",
    "names",
    "nist",
    "orthoglide6",
    "registry",
    "sensor_zero",
    "tracking_zero",
]

__getattr__ = loader(__name__, {"ArmCalibration": "arm.calibration"})  # as every start lists all problems


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


one_module(__name__)
