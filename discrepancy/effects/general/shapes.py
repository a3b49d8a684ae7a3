"""Errors of a measured column that are a simple function of another column: its powers, |u|, its sign, saturation.

Each is a function of u over its largest |u|, so the coefficient is the error there, in the unit of the measurement. A
machine that enters the powers gets one effect for each, and no `polynomial`, which has them all. A square may be about
an unknown centre, as for a length that is right at one temperature.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from calibench.discrepancy.effects.general.columns import measured_columns
from calibench.discrepancy.effects.general.recipe import Built, Recipe, recipe, unit_of
from calibench.discrepancy.model.effect import NotTestable
from calibench.discrepancy.model.family import EffectFamily, needs
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.model.roles import roles_of
from calibench.problems.base import Array

Shape = Callable[[Array], Array]  # of u / max|u|
_SQUARED = " squared"
_CENTRES = 10  # penalty of a free centre, as if so many were tried: a line alone is no parabola
_POWERS: dict[str, Shape] = {"": lambda s: s, _SQUARED: lambda s: s**2, " cubed": lambda s: s**3}
_LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9)  # of the readings that lie within the level from which a column saturates


def _targets(words: tuple[str, ...], formulation: Formulation) -> Mapping[str, tuple[str, str, str]]:
    """Return target -> (words behind the column, measured column, the column it follows).

    Functions of time are left out: a line, a parabola and a cubic are a drift.
    """
    measured, roles = measured_columns(formulation), roles_of(formulation)
    return {
        f"{column}{word}" + f" in {one}" * (len(measured) > 1): (word, one, column)
        for column in roles.columns
        if column != roles.time
        for one in measured
        for word in words
    }


def _shaped(
    family: EffectFamily, formulation: Formulation, target: str, measured: str, column: str, shapes: tuple[Shape, ...]
) -> tuple[LinearEffect, ...]:
    """Return an effect for each shape of the column, each a form of one name."""
    largest = float(np.max(np.abs(formulation.data[column])))

    def form(shape: Shape) -> LinearEffect:
        def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
            return {measured: -shape(np.asarray(data[column], dtype=float) / largest)[:, None]}

        unit = unit_of(formulation, measured)
        return LinearEffect(
            family.name, target, family.formula, "prediction", (column,), ("c",), (unit,), unit, changes,
            positions=len(shapes),
        )  # fmt: skip

    return tuple(form(shape) for shape in shapes)


def _power(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    word, measured, column = _targets((*_POWERS,), formulation)[target]
    needs(formulation.data, column)
    _varied(formulation.data, column, [*_POWERS].index(word) + 2)
    plain = _shaped(family, formulation, target, measured, column, (_POWERS[word],))
    return (*plain, _off_centre(family, formulation, target, measured, column)) if word == _SQUARED else plain


def _off_centre(
    family: EffectFamily, formulation: Formulation, target: str, measured: str, column: str
) -> LinearEffect:
    """Return the square about an unknown centre: with a line beside it; the square's own coefficient is reported."""
    largest, unit = float(np.max(np.abs(formulation.data[column]))), unit_of(formulation, measured)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        s = np.asarray(data[column], dtype=float) / largest
        return {measured: -np.stack([s**2, s], axis=-1)}

    return LinearEffect(
        family.name, target, family.formula, "prediction", (column,), ("c", "line"), (unit,) * 2, unit, changes,
        measure=_first, positions=_CENTRES,
    )  # fmt: skip


def _first(c: Array) -> float:
    return float(c[0])


def _of_sign(shape: Shape) -> Callable[[EffectFamily, Formulation, str], Built]:
    def build(family: EffectFamily, formulation: Formulation, target: str) -> Built:
        _, measured, column = _targets(("",), formulation)[target]
        needs(formulation.data, column)
        if not np.min(formulation.data[column]) < 0 < np.max(formulation.data[column]):
            raise NotTestable(f"column {column} never changes its sign", (column,))
        _varied(formulation.data, column, 3)
        return _shaped(family, formulation, target, measured, column, (shape,))

    return build


def _saturation(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    _, measured, column = _targets(("",), formulation)[target]
    needs(formulation.data, column)
    _varied(formulation.data, column, 3)
    u = np.asarray(formulation.data[column], dtype=float)
    far = np.max(np.abs(u))

    def beyond(level: float) -> Shape:
        return lambda s: np.sign(s) * np.maximum(np.abs(s) - level, 0.0)

    levels = np.unique(np.quantile(np.abs(u) / far, _LEVELS))
    levels = levels[(levels > 0) & (levels < 1)]
    if not len(levels):
        raise NotTestable(f"column {column} has no values between its middle and its ends", (column,))
    return _shaped(family, formulation, target, measured, column, tuple(beyond(float(level)) for level in levels))


def _varied(data: MeasuredData, column: str, values: int) -> None:
    """Raise `NotTestable` for a column of too few values to tell a shape of it from its lower powers."""
    there = len(np.unique(data[column]))
    if there < values:
        raise NotTestable(f"column {column} has {there} values: a simpler term of it is the same", (column,))


def _names(*words: str) -> Callable[[Formulation], tuple[str, ...]]:
    return lambda formulation: (*_targets(words, formulation),)


def _recipe(
    name: str, cause: str, formula: str, label: str, words: tuple[str, ...],
    make: Callable[[EffectFamily, Formulation, str], Built],
) -> Recipe:  # fmt: skip
    return recipe(
        name, cause, formula, "prediction", ("the column",), "that of the measurement", "each further column",
        _names(*words), make, label=label,
    )  # fmt: skip


power = _recipe(
    "power", "What is measured has a term in a column, its square, or its cube",
    "measured -= c s^k, k 1 to 3, or c s^2 + line s, a square about s = -line / (2 c); s = u / max|u|",
    "term", (*_POWERS,), _power,
)  # fmt: skip
magnitude = _recipe(
    "magnitude", "What is measured follows the size of a column, whatever its sign", "measured -= c |u| / max|u|",
    "size", ("",), _of_sign(np.abs),
)  # fmt: skip
sign = _recipe(
    "sign", "What is measured jumps where a column changes its sign", "measured -= c sign(u)",
    "jump with the sign", ("",), _of_sign(np.sign),
)  # fmt: skip
saturation = _recipe(
    "saturation", "What is measured answers otherwise where a column is large",
    "measured -= c sign(u) (|u| - s) / max|u| where |u| > s", "saturation", ("",), _saturation,
)  # fmt: skip
