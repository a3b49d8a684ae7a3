"""Serial arms: read from a URDF or a table of joints, their kinematics, and their calibration on measured postures."""

from typing import TYPE_CHECKING

from calibench.core.lazy import loader
from calibench.problems.arm.families import arm, arm_panda, arm_ur10

if TYPE_CHECKING:
    from calibench.problems.arm.calibration import ArmCalibration
    from calibench.problems.arm.chains.chain import Chain, ChainError, ChainJoint, Mimic
    from calibench.problems.arm.chains.urdf import Robot, UrdfError, parse_urdf, read_urdf

__all__ = [
    "ArmCalibration",
    "Chain",
    "ChainError",
    "ChainJoint",
    "Mimic",
    "Robot",
    "UrdfError",
    "arm",
    "arm_panda",
    "arm_ur10",
    "parse_urdf",
    "read_urdf",
]

_HOMES = {
    "ArmCalibration": "calibration",
    **dict.fromkeys(("Chain", "ChainError", "ChainJoint", "Mimic"), "chains.chain"),
    **dict.fromkeys(("Robot", "UrdfError", "parse_urdf", "read_urdf"), "chains.urdf"),
}
__getattr__ = loader(__name__, _HOMES)  # as every start lists the names of all that there is


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
