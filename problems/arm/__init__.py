"""Serial arms: read from a URDF or a table of joints, their kinematics, and their calibration on measured poses."""

from calibench.problems.arm.chain import Chain, ChainError, ChainJoint, Mimic
from calibench.problems.arm.urdf import Robot, UrdfError, parse_urdf, read_urdf

__all__ = ["Chain", "ChainError", "ChainJoint", "Mimic", "Robot", "UrdfError", "parse_urdf", "read_urdf"]
