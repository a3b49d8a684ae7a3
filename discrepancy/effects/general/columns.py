"""Errors of a measured column over another column: a polynomial, or waves of unknown period.

The period of a wave is a fitted coefficient. Candidates start at all periods that the length of the column can tell
apart; the search keeps the best one, with a penalty for their number, and fits the period from there. Waves come one
after another: the second is tried once the first is found.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from calibench.discrepancy.effects.general.recipe import Built, recipe, unit_of
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.family import EffectFamily, needs
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.model.roles import roles_of
from calibench.problems.base import Array

_DEGREES = ("line", "bend", "turn")
_ORDINALS = ("", "second ", "third ", "fourth ")
_ANY = float(np.finfo(float).max)  # the largest finite size
_PER_WIDTH = 2  # periods tried for each one that the run can resolve
_MOST = 400  # periods tried
LONGEST = 0.5  # of the range: a period must be seen twice; anything longer is a bend, which powers describe
_FINER = 6  # periods tried to either side of the best


@final
@dataclass(frozen=True, eq=False)
class Cycle:
    """An `Effect`: a wave of free period in a column, a cos + b sin of 2 pi (1 / start + f / span) (u - middle).

    It is added to `quantity`, times `factor`: one of `unit` in the unit of the quantity, negative where the wave is
    subtracted. `f` is the number of waves over the run, `span`, above that at `start`. No period may be above
    `longest`. `period_unit` is the unit of the column, "" where nobody states it.
    """

    family: str
    target: str
    formula: str
    channel: str
    column: str
    quantity: str
    unit: str
    start: float
    middle: float
    span: float
    positions: int
    factor: float = 1.0
    after: str = ""
    twins: tuple[str, ...] = ()
    coefficients: tuple[str, ...] = ("a", "b", "f")
    largest: float = _ANY
    longest: float = np.inf
    period_unit: str = ""

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the column it follows."""
        return (self.column,)

    @property
    def units(self) -> tuple[str, ...]:
        """Return the unit of each coefficient."""
        return (self.unit, self.unit, "1")

    def period(self, c: Array) -> float:
        """Return the period at coefficients c, in the unit of the column."""
        frequency = 1 / self.start + c[2] / self.span
        return float(1 / frequency) if frequency > 0 else np.inf

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n,): the wave."""
        wave, _ = self._wave(q, data, c)
        return {self.quantity: self.factor * (wave @ c[:2])}

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return its derivative, (n, 3); that in the frequency is 0 while the wave has no height."""
        wave, u = self._wave(q, data, c)
        moved = 2 * np.pi * u / self.span * (wave @ np.array([c[1], -c[0]]))
        return {self.quantity: self.factor * np.column_stack([wave, moved])}

    def amplitude(self, c: Array) -> float:
        """Return the height of the wave; infinite where its period is above `longest`, which no machine has."""
        return float(np.hypot(c[0], c[1])) if 0 < self.period(c) <= self.longest else np.inf

    def nearer(self, data: MeasuredData) -> tuple[Effect, ...]:
        """Return the same wave started from periods between those of its neighbours, the same values at each call."""
        return self._between

    @cached_property
    def _between(self) -> tuple[Effect, ...]:
        steps = (k / (_FINER * _PER_WIDTH * self.span) for k in range(1 - _FINER, _FINER) if k)
        return tuple(replace(self, start=1 / (1 / self.start + step)) for step in steps if 1 / self.start + step > 0)

    def _wave(self, q: Quantities, data: MeasuredData, c: Array) -> tuple[Array, Array]:
        u = np.asarray(q[self.column] if self.column in q else data[self.column], dtype=float)
        phase = 2 * np.pi * (1 / self.start + c[2] / self.span) * (u - self.middle)
        return np.stack([np.cos(phase), np.sin(phase)], axis=-1), u - self.middle


def _cycles(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    ordinal, measured, column = _parts(formulation)[target]
    needs(formulation.data, column)
    after = "" if not ordinal else f"{family.name} {_target(formulation, _ORDINALS[ordinal - 1], measured, column)}"
    along, told = (column, measured), ("prediction", unit_of(formulation, measured))
    stated = formulation.data.units.get(column, "")
    return scanned(
        family, formulation.data, target, along, told, factor=-1.0, after=after,
        period_unit="" if stated == "1" else stated,
    )  # fmt: skip


def scanned(
    family: EffectFamily, data: MeasuredData, target: str, along: tuple[str, str], told: tuple[str, str], *,
    factor: float = 1.0, after: str = "", longest: float = np.inf, shortest: float = 0.0,
    largest: float = _ANY, period_unit: str = "",
) -> tuple[Cycle, ...]:  # fmt: skip
    """Return the wave at each period that is tried: from half the range of the column down to two readings a wave.

    `along` is the column it follows and the quantity it changes, `told` the channel and the unit. No period is above
    `longest` or below `shortest`, no wave higher than `largest`. Periods are given in `period_unit`.
    """
    (column, quantity), (channel, unit) = along, told
    largest = min(largest, _ANY)  # a slide may err by any length, but an infinite wave is none
    u = np.asarray(data[column], dtype=float)
    span, different = float(np.ptp(u)), len(np.unique(u))
    longest = min(longest, LONGEST * span)
    low, high = 1 / longest, max((different - 1) / 2, 1.0) / span
    high = min(high, 1 / shortest) if shortest else high
    if high < low:
        return ()
    count = int(min(max((high - low) * span * _PER_WIDTH, 1), _MOST)) + 1
    middle = float(u.min() + span / 2)
    return tuple(
        Cycle(
            family.name, target, family.formula, channel, column, quantity, unit, float(1 / frequency), middle, span,
            count, factor, after, largest=largest, longest=longest, period_unit=period_unit,
        )
        for frequency in np.linspace(low, min(high, low + count / (span * _PER_WIDTH)), count)
    )  # fmt: skip


def _polynomial(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    _, measured, column = _parts(formulation)[target]
    needs(formulation.data, column)
    u = np.asarray(formulation.data[column], dtype=float)
    middle, half, unit = float((u.max() + u.min()) / 2), float(np.ptp(u) / 2), unit_of(formulation, measured)

    def form(degree: int) -> LinearEffect:
        def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
            s = (np.asarray(data[column], dtype=float) - middle) / half
            terms = np.stack([s, 2 * s**2 - 1, 4 * s**3 - 3 * s], axis=-1)
            return {measured: -terms[:, :degree]}

        names = _DEGREES[:degree]
        return LinearEffect(
            family.name, target, family.formula, "prediction", (column,), names, (unit,) * degree, unit, changes,
            measure=_range if degree > 1 else _whole,
        )  # fmt: skip

    return tuple(form(degree) for degree in (1, 2, 3))


def _range(c: Array) -> float:
    """Return the range of a polynomial over the run."""
    s = np.linspace(-1, 1, 65)
    return float(np.ptp(np.stack([s, 2 * s**2 - 1, 4 * s**3 - 3 * s], axis=-1)[:, : len(c)] @ c))


def _whole(c: Array) -> float:
    """Return the rise of a line over the run, with its sign."""
    return 2 * float(c[0])


def _parts(formulation: Formulation) -> Mapping[str, tuple[int, str, str]]:
    """Return target -> (number of the wave, measured column, the column it follows)."""
    return {
        _target(formulation, words, measured, column): (k, measured, column)
        for column in roles_of(formulation).columns
        for measured in measured_columns(formulation)
        for k, words in enumerate(_ORDINALS)
    }


def _target(formulation: Formulation, words: str, measured: str, column: str) -> str:
    return f"{words}{column}" if len(measured_columns(formulation)) == 1 else f"{words}{column} in {measured}"


def measured_columns(formulation: Formulation) -> tuple[str, ...]:
    """Return the measured columns: those of the instruments, or all readings that belong to no joint."""
    roles = roles_of(formulation)
    told = tuple(dict.fromkeys(name for one in roles.instruments for name in one.columns))
    joints = {joint.reading for joint in roles.joints}
    return told or tuple(name for name in formulation.readings if name not in joints)


def _firsts(formulation: Formulation) -> tuple[str, ...]:
    return tuple(target for target, (k, _, _) in _parts(formulation).items() if not k)


polynomial = recipe(
    "polynomial", "What is measured follows a further column", "measured -= a line, a parabola, a cubic in the column",
    "prediction", ("the column",), "that of the measurement", "each further column", _firsts, _polynomial,
    label="trend",
)  # fmt: skip
cycle = recipe(
    "cycle", "What is measured repeats with a period of a further column that nobody knows",
    "measured -= a cos(2 pi u / P) + b sin(2 pi u / P), u the column, P fitted", "prediction", ("the column",),
    "that of the measurement", "each further column, up to four cycles each", lambda f: tuple(_parts(f)), _cycles,
)  # fmt: skip
