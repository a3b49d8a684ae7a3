"""The calibration of robot arms: descriptions (URDF, tables of joints), kinematics, readings, fits, poses, hand-eye.

It knows NumPy, SciPy and numba alone, and takes numbers: `bench` turns files into columns, and words into options. The
functions for users are `calibench.calibrate`, `design`, `hand_eye` (`api`).
"""

from typing import TYPE_CHECKING

from calibench.core.lazy import loader, public_names

if TYPE_CHECKING:
    from calibench.calibration.arm import Arm, read_arm
    from calibench.calibration.calibrate import Calibration
    from calibench.calibration.dh import DhRow, DhTable, read_dh
    from calibench.calibration.kinematics import Chain, ChainError, ChainJoint, Mimic
    from calibench.calibration.urdf import Robot, UrdfError, parse_urdf, read_urdf

_HOMES = {
    **dict.fromkeys(("Arm", "read_arm"), "arm"),
    "Calibration": "calibrate",
    **dict.fromkeys(("DhRow", "DhTable", "read_dh"), "dh"),
    **dict.fromkeys(("Chain", "ChainError", "ChainJoint", "Mimic"), "kinematics"),
    **dict.fromkeys(("Robot", "UrdfError", "parse_urdf", "read_urdf"), "urdf"),
}
__all__ = [
    "Arm", "Calibration", "Chain", "ChainError", "ChainJoint", "DhRow", "DhTable", "Mimic", "Robot", "UrdfError",
    "parse_urdf", "read_arm", "read_dh", "read_urdf",
]  # fmt: skip

__getattr__ = loader(__name__, _HOMES)
__dir__ = public_names(__all__)
if __name__ == "calibration":  # a short name, in a checkout: public names only, as a module has its whole name alone
    __path__ = []
