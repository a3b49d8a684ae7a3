"""Scale of an encoder, or a gear ratio that is not the stated one: the joint turns by (1 + k) times what is read."""

from __future__ import annotations

from calibench.discrepancy.effects.general import joints
from calibench.discrepancy.machines.gpm2002.roles import JOINTS

gear = joints.scale.enter(
    "gpm2002", JOINTS, cause="A gear ratio, or the scale of an encoder, is not the stated one",
    formula="enc_i += k enc_i", columns=("enc_{i}",), label="gear-ratio error",
)  # fmt: skip
