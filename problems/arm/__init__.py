"""Serial arms: read from a URDF or a table of joints, their kinematics, and their calibration on measured postures."""

from calibench.problems.arm.calibration import ArmCalibration
from calibench.problems.arm.chains.chain import Chain, ChainError, ChainJoint, Mimic
from calibench.problems.arm.chains.urdf import Robot, UrdfError, parse_urdf, read_urdf
from calibench.problems.arm.families import arm, arm_panda, arm_ur10

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
