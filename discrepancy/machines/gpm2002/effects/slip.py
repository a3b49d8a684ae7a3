"""An encoder slips on its shaft, once, at a time that is searched for: its offset changes by a step."""

from __future__ import annotations

from calibench.discrepancy.model.change_point import ChangePoint, change_times
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.family import EffectFamily, needs, number
from calibench.discrepancy.model.machine import Formulation


def _build(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "t_s")
    times = change_times(formulation.data["t_s"])
    encoder = f"enc_{number(target)}"
    return tuple(
        ChangePoint("slip", target, slip.formula, "reading", (encoder,), ("step",), "rad", float(at), len(times))
        for at in times
    )


slip = EffectFamily(
    "slip", "gpm2002", "An encoder slips on its shaft once during the run", "enc_i += step from a time on", "reading",
    ("t_s",), "rad", ("joint 1", "joint 2", "joint 3"), _build, label="encoder slip",
).enter()  # fmt: skip
