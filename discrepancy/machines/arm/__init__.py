"""A serial arm from its URDF; a tracker sees its target, or its ball sits in sockets.

`geometry` is the arm with its imperfections, `start` finds base and tool, `rank` finds which parameters the readings
determine, `loads` computes the moments of gravity, `turns` handles measured orientations, `sockets` measurements
without a tracker, `validate` checks files, `wild` leaves out unusable readings, `formulation` states what is measured
and predicted, `effects` has the arm's own effects, `description` declares columns, units and words.
"""

from __future__ import annotations

from calibench.discrepancy.machines.arm import description as description
from calibench.discrepancy.machines.arm import effects as effects
from calibench.discrepancy.machines.arm.formulation import Arm

__all__ = ["Arm"]
