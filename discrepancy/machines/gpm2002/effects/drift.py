"""An encoder's zero drifts during the run: evenly, along a curve, or along one that settles (forms of one name)."""

from __future__ import annotations

from calibench.discrepancy.effects.general import changes
from calibench.discrepancy.machines.gpm2002.roles import JOINTS

drift = changes.drift.enter(
    "gpm2002", JOINTS, cause="The zero of an encoder drifts during the run",
    formula="enc_i += even s, + bend 4 s (1 - s), + turn 10.4 s (1 - s) (1 - 2 s); s from 0 to 1 over the run",
    columns=("t_s",), unit="rad",
)  # fmt: skip
