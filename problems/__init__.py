"""Calibration problems with their mathematics and data. They know no optimiser.

>>> from calibench import problems
>>> p = problems.make("full12", error="J3")
>>> p.lower.shape, len(p.parameters), bool(p(p.truth) < 1e-18)
((12,), 12, True)
"""

from typing import TYPE_CHECKING

from calibench.core.lazy import loader, public_names
from calibench.problems.arm import arm, arm_panda, arm_ur10  # at once: a function and its module share a name
from calibench.problems.base import Calibration, Parameter, Problem, registry

if TYPE_CHECKING:
    from calibench.problems.arm import ArmCalibration
    from calibench.problems.delta import DeltaProbing, delta9
    from calibench.problems.fitting import fit
    from calibench.problems.identifiability import (
        Estimate,
        FTest,
        Identifiability,
        LeaveOneOut,
        estimate,
        f_test,
        identify,
        leave_one_out,
    )
    from calibench.problems.orthoglide import Orthoglide, orthoglide6
    from calibench.problems.planar import Planar, Tracking, full11, full12, link_length, sensor_zero, tracking_zero
    from calibench.problems.suites.black_box import bbob, ioh
    from calibench.problems.suites.nist import nist

_PLANAR = ("sensor_zero", "link_length", "full11", "full12", "tracking_zero")
registry.promise("calibench.problems.planar", *_PLANAR)
registry.promise("calibench.problems.orthoglide", "orthoglide6")
registry.promise("calibench.problems.delta", "delta9")
registry.promise("calibench.problems.arm", "arm_ur10", "arm_panda", "arm")
registry.promise("calibench.problems.suites.black_box", "bbob", "ioh")
registry.promise("calibench.problems.suites.nist", "nist")

make = registry.make
names = registry.names

__all__ = [
    "ArmCalibration", "Calibration", "DeltaProbing", "Estimate", "FTest", "Identifiability", "LeaveOneOut",
    "Orthoglide", "Parameter", "Planar", "Problem", "Tracking", "arm", "arm_panda", "arm_ur10", "bbob", "delta9",
    "estimate", "f_test", "fit", "full11", "full12", "identify", "ioh", "leave_one_out", "link_length", "make",
    "names", "nist", "orthoglide6", "registry", "sensor_zero", "tracking_zero",
]  # fmt: skip

_HOMES = {
    **dict.fromkeys(("Estimate", "FTest", "LeaveOneOut", "estimate", "f_test", "leave_one_out"), "identifiability"),
    **dict.fromkeys(("Identifiability", "identify"), "identifiability"),
    **dict.fromkeys(("Planar", "Tracking", *_PLANAR), "planar"),
    **dict.fromkeys(("Orthoglide", "orthoglide6"), "orthoglide"),
    **dict.fromkeys(("DeltaProbing", "delta9"), "delta"),
    **dict.fromkeys(("bbob", "ioh"), "suites.black_box"),
    "nist": "suites.nist",
    "ArmCalibration": "arm",
    "fit": "fitting",
}
_MODULES = ("delta", "fitting", "identifiability", "orthoglide", "planar", "suites")
__getattr__ = loader("calibench.problems", _HOMES, _MODULES)  # a start loads the problems that it asks for


__dir__ = public_names(__all__)
if __name__ == "problems":  # a short name, in a checkout: public names only, as a module has its whole name alone
    __path__ = []
