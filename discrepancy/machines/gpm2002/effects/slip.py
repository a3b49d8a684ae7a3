"""An encoder slips on its shaft, once, at a time that is searched for: its offset changes by a step."""

from __future__ import annotations

from calibench.discrepancy.effects.general import changes
from calibench.discrepancy.machines.gpm2002.roles import JOINTS

slip = changes.slip.enter(
    "gpm2002", JOINTS, cause="An encoder slips on its shaft once during the run",
    formula="enc_i += step from a time on", columns=("t_s",), unit="rad", label="encoder slip",
)  # fmt: skip
