"""Play in a drive: the joint trails its encoder by half the play, on the side it was approached from."""

from __future__ import annotations

from calibench.discrepancy.model.data import MeasuredData
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.family import EffectFamily, needs, number
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.problems.base import Array


def _build(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    i = number(target)
    direction = f"dir_{i}"
    needs(formulation.data, direction)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {f"enc_{i}": -0.5 * data[direction][:, None]}

    return (
        LinearEffect(
            "backlash", target, backlash.formula, "reading", (direction,), ("play",), ("rad",), "rad", changes
        ),
    )


backlash = EffectFamily(
    "backlash", "gpm2002", "A drive has play", "enc_i -= play / 2 * dir_i", "reading", ("dir_{i}",), "rad",
    ("joint 1", "joint 2", "joint 3"), _build,
).enter()  # fmt: skip
