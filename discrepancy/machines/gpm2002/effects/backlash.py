"""Play in a drive: the joint trails its encoder by half the play, on the side it was approached from."""

from __future__ import annotations

from calibench.discrepancy.effects.general import joints
from calibench.discrepancy.machines.gpm2002.roles import JOINTS

backlash = joints.backlash.enter(
    "gpm2002", JOINTS, formula="enc_i -= play / 2 * dir_i", columns=("dir_{i}",), unit="rad"
)
