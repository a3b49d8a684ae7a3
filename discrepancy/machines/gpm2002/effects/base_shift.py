"""A base is knocked out of its place, once, at a time that is searched for."""

from __future__ import annotations

from calibench.discrepancy.model.change_point import ChangePoint, change_times
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.family import EffectFamily, needs, number
from calibench.discrepancy.model.machine import Formulation


def _build(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "t_s")
    times = change_times(formulation.data["t_s"])
    i = number(target)
    moved, names = (f"xa{i}", f"ya{i}"), ("dx", "dy")
    return tuple(
        ChangePoint("base_shift", target, base_shift.formula, "base", moved, names, "mm", float(at), len(times))
        for at in times
    )


base_shift = EffectFamily(
    "base_shift", "gpm2002", "A base is displaced once during the run", "A_i += (dx, dy) from a time on", "base",
    ("t_s",), "mm", ("base 1", "base 2", "base 3"), _build,
).enter()  # fmt: skip
