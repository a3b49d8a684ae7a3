"""Errors of a printer that stay constant during the measurement: a constant added to the quantities of each target."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calibench.discrepancy.model.effect import Effect, NotTestable
from calibench.discrepancy.model.family import EffectFamily
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.problems.base import Array

Spread = Mapping[str, Mapping[str, float]]  # coefficient -> quantity -> how much of it
TOWERS = ("a", "b", "c")
SIZE = ("delta_radius", "rod_length", "belt_scale", "bed_dome")  # all four bow the probed bed alike
OBJECT = "a printed object: distances measured by caliper, which DELTA_ANALYZE takes in"


def each_tower(quantity: str) -> dict[str, Spread]:
    """Return the targets `tower a` to `tower c`, one coefficient each."""
    return {f"tower {t}": {f"{quantity}_{t}": {f"{quantity}_{t}": 1.0}} for t in TOWERS}


def constant(
    name: str, cause: str, formula: str, channel: str, unit: str, spread: Mapping[str, Spread], *,
    of: str = "", twins: str = "", same: Mapping[str, tuple[str, ...]] | None = None,
    same_by_heights: tuple[str, ...] = (), parted_by: str = "", label: str = "",
    label_of_all: str = "",
) -> EffectFamily:  # fmt: skip
    """Enter the family whose targets are `spread`; `of` is the kind of row that it needs, "" for either.

    `same` are the declared twins of a target, `same_by_heights` those of the target `all` where only heights were
    measured.
    """

    def build(formulation: Formulation, target: str) -> tuple[Effect, ...]:
        if of and not (np.asarray(formulation.data["kind"]) == of).any():
            raise NotTestable(f"needs rows of kind {of}", ("kind",))
        coefficients = spread[target]
        quantities = sorted({q for shares in coefficients.values() for q in shares})

        def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
            return {
                quantity: np.tile([shares.get(quantity, 0.0) for shares in coefficients.values()], (len(data), 1))
                for quantity in quantities
            }

        twins_of = (same or {}).get(target, ())
        if target == "all" and same_by_heights and not (np.asarray(formulation.data["kind"]) == "distance").any():
            twins_of = tuple(f"{twin} all" for twin in same_by_heights if twin != name)
        units = (unit,) * len(coefficients)
        return (LinearEffect(name, target, formula, channel, (), tuple(coefficients), units, unit, changes, twins_of),)

    return EffectFamily(
        name, "delta", cause, formula, channel, (), unit, tuple(spread), build, twins, label, label_of_all, parted_by
    ).enter()
