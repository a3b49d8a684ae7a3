"""A serial arm from its URDF or its table; a tracker sees its target, or its ball sits in sockets."""

from calibench.discrepancy.machines.arm import effects as effects
from calibench.discrepancy.machines.arm.formulation import Arm

__all__ = ["Arm"]
