"""Errors of any member: growth with temperature, compliance under the force along it, play along it; held numbers.

A number that is held may have another value than the stated one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calibench.discrepancy.effects.general.recipe import (
    Built,
    declared,
    each_length,
    each_length_and_all,
    lengths_of,
    recipe,
)
from calibench.discrepancy.effects.general.reference import reference_of
from calibench.discrepancy.effects.general.warmth import time_constants, warmth
from calibench.discrepancy.model.effect import Effect, NotTestable
from calibench.discrepancy.model.family import EffectFamily, needs
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.model.roles import roles_of
from calibench.problems.base import Array

NOWHERE: Mapping[str, float] = {}


def _growth(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    lengths = lengths_of(formulation, target)
    roles = roles_of(formulation)
    heat = {one.quantity: declared(one.temperature or roles.temperature, one.name, "temperature") for one in lengths}
    needs(formulation.data, *dict.fromkeys(heat.values()))
    own_at = {name: reference_of(formulation, column, name) for name, column in heat.items()}
    return grown(family, target, heat, formulation.data, roles.time, own_at)


def grown(
    family: EffectFamily, target: str, heat: dict[str, str], run: MeasuredData, clock: str,
    own_at: Mapping[str, float] = NOWHERE,
) -> tuple[Effect, ...]:  # fmt: skip
    """Return the growth of quantities with the temperature in their columns, `heat`, over `run`: one form for each lag.

    `own_at` is the temperature at which a quantity has its nominal length, 0 where it is not stated.
    """

    def form(late: float) -> LinearEffect:
        def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
            warm = {column: warmth(data, late, column, clock, run) for column in dict.fromkeys(heat.values())}
            return {name: (q[name] * (warm[column] - own_at.get(name, 0.0)))[:, None] for name, column in heat.items()}

        columns = tuple(dict.fromkeys(heat.values()))
        return LinearEffect(family.name, target, family.formula, "link", columns, ("alpha",), ("1/K",), "1/K", changes)

    return tuple(form(late) for late in time_constants(run, clock))


def _stretch(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [length] = lengths_of(formulation, target)
    force = declared(length.force, length.name, "force")
    needs(formulation.data, force)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {length.quantity: data[force][:, None]}

    unit = f"{length.unit}/N"
    return (LinearEffect(family.name, target, family.formula, "link", (force,), ("k",), (unit,), unit, changes),)


def _clearance(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [length] = lengths_of(formulation, target)
    force = declared(length.force, length.name, "force")
    needs(formulation.data, force)
    if not np.ptp(np.sign(formulation.data[force])) > 0:
        raise NotTestable(f"column {force} never changes its sign", (force,))

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {length.quantity: 0.5 * np.sign(data[force])[:, None]}

    unit = length.unit
    return (LinearEffect(family.name, target, family.formula, "link", (force,), ("play",), (unit,), unit, changes),)


def _freed(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    units = {one.quantity: one.unit for one in roles_of(formulation).lengths}
    return (freed(family, target, (target,), units.get(target, "")),)


def freed(family: EffectFamily, target: str, names: tuple[str, ...], unit: str) -> LinearEffect:
    """Return held numbers as coefficients: the difference of each from the number it is held at."""

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        each = np.eye(len(names))
        return {name: np.tile(each[k], (len(data), 1)) for k, name in enumerate(names)}

    return LinearEffect(
        family.name, target, family.formula, family.channel, (), names, (unit,) * len(names), unit, changes
    )


growth = recipe(
    "thermal_length", "A member, or all of them, grow with temperature", "length_i *= 1 + alpha T, T follows the "
    "temperature", "link", ("the temperature",), "1/K", "each length, all", each_length_and_all, _growth,
    label="thermal growth", label_of_all="thermal growth of all members",
)  # fmt: skip
stretch = recipe(
    "axial_compliance", "A member gives way to the force along it", "length_i += k force_i", "link", ("the force",),
    "mm/N", "each length", each_length, _stretch,
)  # fmt: skip
clearance = recipe(
    "clearance", "The joints of a member have play along it", "length_i += play / 2 * sign(force_i)", "link",
    ("the force",), "mm", "each length", each_length, _clearance,
)  # fmt: skip
free_number = recipe(
    "free_number", "A number that is held is not the stated one", "number += c", "link", (), "that of the number",
    "each held number", lambda formulation: tuple(formulation.fixed), _freed, label="another value",
)  # fmt: skip
