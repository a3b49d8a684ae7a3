"""A serial arm from its URDF or its table; a tracker sees its target, or its ball sits in sockets.

`readings` reads what was measured and computes the moments of gravity, `formulation` states what is predicted, and
declares columns, units and words, `sockets` does so without a tracker, `effects` has the arm's own effects.
"""

from calibench.discrepancy.machines.arm import effects as effects
from calibench.discrepancy.machines.arm.formulation import Arm

__all__ = ["Arm"]
