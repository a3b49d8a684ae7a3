"""A serial arm from its URDF, whose target a tracker sees or whose ball sits in sockets.

`geometry` is the arm with its imperfections, `start` finds base and tool, `rank` says what the readings determine,
`loads` what gravity asks, `turns` are measured orientations, `sockets` places without a tracker, `validate` checks
files, `wild` leaves out what was no reading, `formulation` states what is measured and predicted, `effects` is what an
arm has beside the general families, `description` declares columns, units and words.
"""

from __future__ import annotations

from calibench.discrepancy.machines.arm import description as description
from calibench.discrepancy.machines.arm import effects as effects
from calibench.discrepancy.machines.arm.formulation import Arm

__all__ = ["Arm"]
