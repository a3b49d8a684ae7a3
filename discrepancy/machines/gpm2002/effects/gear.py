"""Scale of an encoder, or a gear ratio that is not the stated one: the joint turns by (1 + k) times what is read.

The scale is about the reading zero; about any other reading it is the same with another offset z.
"""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.model.data import MeasuredData
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.family import EffectFamily, needs, number
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.problems.base import Array

LONGER_ARC = "readings over a longer arc of {target}"  # what tells smooth errors of one encoder apart


def _build(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    encoder = f"enc_{number(target)}"
    needs(formulation.data, encoder)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {encoder: np.asarray(q[encoder])[:, None]}

    return (LinearEffect("gear", target, gear.formula, "reading", (encoder,), ("k",), ("1",), "1", changes),)


gear = EffectFamily(
    "gear", "gpm2002", "A gear ratio, or the scale of an encoder, is not the stated one", "enc_i += k enc_i",
    "reading", ("enc_{i}",), "1", ("joint 1", "joint 2", "joint 3"), _build,
    label="gear-ratio error", resolved_by=LONGER_ARC,
).enter()  # fmt: skip
