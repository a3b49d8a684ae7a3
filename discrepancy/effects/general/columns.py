"""Errors of a measured column over another column: a polynomial, or waves of unknown period.

The period of a wave is a fitted coefficient. Candidates start at all periods that the length of the column can tell
apart; the search keeps the best one, with a penalty for their number, and fits the period from there. Waves come one
after another: the second is tried once the first is found.

Errors of a measured column that are a simple function of another column: its powers, |u|, its sign, saturation.

Each is a function of u over its largest |u|, so the coefficient is the error there, in the unit of the measurement. A
machine that enters the powers gets one effect for each, and no `polynomial`, which has them all. A square may be about
an unknown centre, as for a length that is right at one temperature.

Errors that change during the run: a joint's zero drifts or slips, an instrument's frame moves evenly or once.

A drift is linear, along a curve, or along a curve that settles (forms of one name). A frame of two or three coordinates
may turn as it moves, about the middle of what it measured: an example is a stand that sinks on one foot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from calibench.discrepancy.effects.general.joints import largest_error, told_in
from calibench.discrepancy.effects.general.recipe import (
    Built,
    Recipe,
    declared,
    each_instrument,
    each_joint,
    instrument_of,
    joints_of,
    recipe,
    unit_of,
)
from calibench.discrepancy.model.effect import (
    ChangePoint,
    Effect,
    EffectFamily,
    LinearEffect,
    NotTestable,
    change_times,
    needs,
    size,
)
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.roles import Joint, roles_of
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
    along, channel = (column, measured), ("prediction", unit_of(formulation, measured))
    stated = formulation.data.units.get(column, "")
    return scanned(
        family, formulation.data, target, along, channel, factor=-1.0, after=after,
        period_unit="" if stated == "1" else stated,
    )  # fmt: skip


def scanned(
    family: EffectFamily, data: MeasuredData, target: str, along: tuple[str, str], reported: tuple[str, str], *,
    factor: float = 1.0, after: str = "", longest: float = np.inf, shortest: float = 0.0,
    largest: float = _ANY, period_unit: str = "",
) -> tuple[Cycle, ...]:  # fmt: skip
    """Return the wave at each period that is tried: from half the range of the column down to two readings a wave.

    `along` is the column it follows and the quantity it changes, `told` the channel and the unit. No period is above
    `longest` or below `shortest`, no wave higher than `largest`. Periods are given in `period_unit`.
    """
    (column, quantity), (channel, unit) = along, reported
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
            family.name, target, family.formula, channel=channel, column=column, quantity=quantity, unit=unit,
            start=float(1 / frequency), middle=middle, span=span, positions=count, factor=factor, after=after,
            largest=largest, longest=longest, period_unit=period_unit,
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
        return family.linear(
            target, (column,), dict.fromkeys(names, unit), changes, measure=_range if degree > 1 else _whole
        )

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
    columns = tuple(dict.fromkeys(name for one in roles.instruments for name in one.columns))
    joints = {joint.reading for joint in roles.joints}
    return columns or tuple(name for name in formulation.readings if name not in joints)


def _firsts(formulation: Formulation) -> tuple[str, ...]:
    return tuple(target for target, (k, _, _) in _parts(formulation).items() if not k)


polynomial = recipe(
    "polynomial", "What is measured follows a further column",
    "measured -= a line, a parabola, a cubic in the column", channel="prediction", columns=("the column",),
    unit="that of the measurement", targets="each further column", targets_in=_firsts, make=_polynomial,
    label="trend",
)  # fmt: skip
cycle = recipe(
    "cycle", "What is measured repeats with a period of a further column that nobody knows",
    "measured -= a cos(2 pi u / P) + b sin(2 pi u / P), u the column, P fitted", channel="prediction",
    columns=("the column",), unit="that of the measurement", targets="each further column, up to four cycles each",
    targets_in=lambda f: tuple(_parts(f)), make=_cycles,
)  # fmt: skip


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
    family: EffectFamily, formulation: Formulation, target: str, measured: str, column: str,
    shapes: Mapping[float, Shape],
) -> tuple[LinearEffect, ...]:  # fmt: skip
    """Return an effect for each shape of the column, each a form of one name.

    The key of a shape is where it begins, as a part of the largest |u|.
    """
    largest = float(np.max(np.abs(formulation.data[column])))

    def form(begins: float, shape: Shape) -> LinearEffect:
        def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
            return {measured: -shape(np.asarray(data[column], dtype=float) / largest)[:, None]}

        unit = unit_of(formulation, measured)
        return family.linear(
            target,
            (column,),
            {"c": unit},
            changes,
            positions=len(shapes),
            begins=begins * largest,
            begins_unit=formulation.data.units.get(column, ""),
        )

    return tuple(form(begins, shape) for begins, shape in shapes.items())


def _power(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    word, measured, column = _targets((*_POWERS,), formulation)[target]
    needs(formulation.data, column)
    _varied(formulation.data, column, [*_POWERS].index(word) + 2)
    plain = _shaped(family, formulation, target, measured, column, {np.nan: _POWERS[word]})
    return (*plain, _off_centre(family, formulation, target, measured, column)) if word == _SQUARED else plain


def _off_centre(
    family: EffectFamily, formulation: Formulation, target: str, measured: str, column: str
) -> LinearEffect:
    """Return the square about an unknown centre: with a line beside it; the square's own coefficient is reported."""
    largest, unit = float(np.max(np.abs(formulation.data[column]))), unit_of(formulation, measured)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        s = np.asarray(data[column], dtype=float) / largest
        return {measured: -np.stack([s**2, s], axis=-1)}

    return family.linear(
        target, (column,), dict.fromkeys(("c", "line"), unit), changes, measure=_first, positions=_CENTRES
    )


def _first(c: Array) -> float:
    return float(c[0])


def _of_sign(shape: Shape) -> Callable[[EffectFamily, Formulation, str], Built]:
    def build(family: EffectFamily, formulation: Formulation, target: str) -> Built:
        _, measured, column = _targets(("",), formulation)[target]
        needs(formulation.data, column)
        if not np.min(formulation.data[column]) < 0 < np.max(formulation.data[column]):
            raise NotTestable(f"column {column} never changes its sign", (column,))
        _varied(formulation.data, column, 3)
        return _shaped(family, formulation, target, measured, column, {np.nan: shape})

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
    return _shaped(family, formulation, target, measured, column, {float(s): beyond(float(s)) for s in levels})


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
        name, cause, formula, channel="prediction", columns=("the column",), unit="that of the measurement",
        targets="each further column", targets_in=_names(*words), make=make, label=label,
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


_TERMS = ("even", "bend", "turn")
_AXES = {2: ("turn",), 3: ("turn x", "turn y", "turn z")}  # turns of a frame, by its number of coordinates


def run_terms(s: Array) -> Array:
    """Return the terms at the part s of the run, (n, 3): a line, a parabola and a cubic, none above 1."""
    return np.stack([s, 4 * s * (1 - s), 6 * np.sqrt(3) * s * (1 - s) * (1 - 2 * s)], axis=-1)


def _drift(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = joints_of(formulation, target)
    clock = _clock(formulation)
    t = formulation.data[clock]
    return tuple(
        _drift_of(family, target, joint, clock, float(t.min()), float(np.ptp(t)), _TERMS[:k]) for k in (1, 2, 3)
    )


def _drift_of(
    family: EffectFamily, target: str, joint: Joint, clock: str, origin: float, span: float, names: tuple[str, ...]
) -> LinearEffect:
    """Return the drift over the run that began at `origin` and took `span` [s]; other rows share that clock."""
    unit, one = told_in(joint)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {joint.reading: one * run_terms((data[clock] - origin) / span)[:, : len(names)]}

    def largest(c: Array) -> float:
        """Return the range of the drift over the run, with the sign of its end where it is even."""
        if len(c) == 1:
            return float(c[0])
        return float(np.ptp(run_terms(np.linspace(0, 1, 65))[:, : len(c)] @ c))

    return family.linear(
        target, (clock,), dict.fromkeys(names, unit), changes, measure=largest, largest=largest_error(joint) / one
    )


def _slip(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = joints_of(formulation, target)
    unit, one = told_in(joint)
    most = largest_error(joint) / one
    return _steps(
        family,
        formulation,
        target,
        channel="reading",
        quantities=(joint.reading,),
        names=("step",),
        unit=unit,
        most=most,
        one=one,
    )


def _frame_drift(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    clock = _clock(formulation)
    columns = instrument_of(formulation, target).columns
    unit = unit_of(formulation, *columns)
    t = formulation.data[clock]
    origin, span = float(t.min()), float(np.ptp(t))
    middle = np.array([float(np.mean(formulation.data[name])) for name in columns])
    reach = np.stack([formulation.data[name] for name in columns], axis=-1) - middle

    def form(turns: bool) -> LinearEffect:
        def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
            part = ((data[clock] - origin) / span)[:, None]
            apart = np.stack([np.asarray(q[name], dtype=float) for name in columns], axis=-1) - middle
            return {name: -part * moved for name, moved in zip(columns, _motion(apart, turns))}

        def farthest(c: Array) -> float:
            """Return how far the reading that moves most has moved at the end of the run."""
            moved = np.stack([one @ c for one in _motion(reach, turns)], axis=-1)
            return float(np.max(np.linalg.norm(moved, axis=-1)))

        names = (*(f"d{name}" for name in columns), *(_AXES[len(columns)] if turns else ()))
        units = (unit,) * len(columns) + ("rad",) * (len(names) - len(columns))
        return family.linear(
            target,
            (clock, *columns),
            dict(zip(names, units, strict=True)),
            changes,
            unit=unit,
            measure=farthest if turns else size,
        )

    return (form(False), form(True)) if len(columns) in _AXES else (form(False),)


def _motion(apart: Array, turns: bool) -> list[Array]:
    """Return the displacement of points by a unit of each coefficient, for each coordinate.

    `apart` (n, m) is from the middle. Shapes (n, k): k is m shifts and, where the frame `turns`, one turn in the plane
    or three in space [rad].
    """
    n, m = apart.shape
    shifts = [np.tile(np.eye(m)[k], (n, 1)) for k in range(m)]
    if not turns:
        return shifts
    zero = np.zeros(n)
    if m == 2:
        turned = [-apart[:, 1:2], apart[:, 0:1]]
    else:
        x, y, z = apart.T  # columns of w x apart for w along x, y, z
        turned = [np.stack(row, axis=-1) for row in ((zero, z, -y), (-z, zero, x), (y, -x, zero))]
    return [np.concatenate(pair, axis=1) for pair in zip(shifts, turned)]


def _frame_shift(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    columns = instrument_of(formulation, target).columns
    names = tuple(f"d{name}" for name in columns)
    unit = unit_of(formulation, *columns)
    return _steps(
        family, formulation, target, channel="prediction", quantities=columns, names=names, unit=unit, most=np.inf
    )


def _steps(
    family: EffectFamily, formulation: Formulation, target: str, channel: str, quantities: tuple[str, ...],
    names: tuple[str, ...], unit: str, most: float, one: float = 1.0,
) -> Built:  # fmt: skip
    """Return a step of the quantities, `one` for a coefficient of 1, at each time at which a step is tried."""
    clock = _clock(formulation)
    times = change_times(formulation.data[clock])
    return tuple(
        ChangePoint(
            family.name, target, family.formula, channel=channel, quantities=quantities, coefficients=names,
            unit=unit, at=float(at), positions=len(times), columns=(clock,), twins=(), largest=most, clock=clock,
            one=one,
        )
        for at in times
    )  # fmt: skip


def _clock(formulation: Formulation) -> str:
    clock = declared(roles_of(formulation).time, "the machine", "time")
    needs(formulation.data, clock)
    return clock


def _frames(formulation: Formulation) -> tuple[str, ...]:
    return tuple(name for name in each_instrument(formulation) if instrument_of(formulation, name).frame)


drift = recipe(
    "drift", "The zero of a joint drifts during the run",
    "reading_i += even s, + bend 4 s (1 - s), + turn 10.4 s (1 - s) (1 - 2 s); s from 0 to 1 over the run",
    channel="reading", columns=("the time",), unit="that of the joint", targets="each joint", targets_in=each_joint,
    make=_drift,
)  # fmt: skip
slip = recipe(
    "slip", "The reading of a joint slips once during the run", "reading_i += step from a time on", channel="reading",
    columns=("the time",), unit="that of the joint", targets="each joint", targets_in=each_joint, make=_slip,
)  # fmt: skip
frame_drift = recipe(
    "frame_drift", "The frame of an instrument moves evenly during the run, and may turn",
    "measured -= d s, or (d + w x (measured - middle)) s; s from 0 to 1 over the run", channel="prediction",
    columns=("the time",), unit="that of the measurement", targets="each instrument with a frame", targets_in=_frames,
    make=_frame_drift, label="moving frame",
)  # fmt: skip
frame_shift = recipe(
    "frame_shift", "An instrument, or the machine, is displaced once during the run", "measured += d from a time on",
    channel="prediction", columns=("the time",), unit="that of the measurement",
    targets="each instrument with a frame", targets_in=_frames, make=_frame_shift, label="displaced frame",
)  # fmt: skip
