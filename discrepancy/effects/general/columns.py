"""Errors of a measured column over another column, and errors that change during the run.

Over a column they are a polynomial, its powers, |u|, its sign, saturation, or waves of unknown period. Of a wave the
period is a fitted coefficient: candidates start at all periods that the length of the column can tell apart, and the
search keeps the best one, with a penalty for their number. Waves come one after another. A function of u is over its
largest |u|, so the coefficient is the error there. During the run a joint's zero drifts or slips, and an instrument's
frame moves evenly or once; one of two or three coordinates may turn as it moves, about the middle of what it measured.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import final

import numpy as np

from calibench.discrepancy.effects.general.joints import largest_error, told_in
from calibench.discrepancy.effects.general.recipe import Built, clock_of, named, of_columns, of_joints, unit_of
from calibench.discrepancy.model.effect import Effect, EffectFamily, LinearEffect, NotTestable, needs
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.roles import roles_of
from calibench.problems.base import Array

_DEGREES = ("line", "bend", "turn")
_EVEN = np.linspace(-1.0, 1.0, 65)  # places over a range
ORDINALS = ("", "second ", "third ", "fourth ")
_ANY = float(np.finfo(float).max)  # the largest finite size
_PER_WIDTH = 2  # periods tried for each one that the run can resolve
_MOST = 400  # periods tried
LONGEST = 0.5  # of the range: a period must be seen twice; anything longer is a bend, which powers describe
_FINER = 6  # periods tried to either side of the best


@final
@dataclass(frozen=True, eq=False)
class Cycle:
    """An `Effect`: a wave of free period in a column, a cos + b sin of 2 pi (1 / start + f / reach) (u - middle).

    It is added to `quantity`, times `factor`: one of `unit` in the unit of the quantity, negative where the wave is
    subtracted. `f` is the number of waves over the run, `reach`, above that at `start`. No period may be above
    `longest`. `period_unit` is the unit of the column, "" where nobody states it.
    """

    family: str
    target: str
    formula: str
    channel: str
    column: str
    columns: tuple[str, ...]
    quantity: str
    unit: str
    units: tuple[str, ...]
    start: float
    middle: float
    reach: float
    positions: int
    factor: float = 1.0
    after: str = ""
    twins: tuple[str, ...] = ()
    coefficients: tuple[str, ...] = ("a", "b", "f")
    largest: float = _ANY
    longest: float = np.inf
    period_unit: str = ""

    def period(self, c: Array) -> float:
        frequency = 1 / self.start + c[2] / self.reach
        return float(1 / frequency) if frequency > 0 else np.inf

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        wave, _ = self._wave(q, data, c)
        return {self.quantity: self.factor * (wave @ c[:2])}

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return the derivative of `shift`, (n, 3); that in the frequency is 0 while the wave has no height."""
        wave, u = self._wave(q, data, c)
        moved = 2 * np.pi * u / self.reach * (wave @ np.array([c[1], -c[0]]))
        return {self.quantity: self.factor * np.column_stack([wave, moved])}

    def amplitude(self, c: Array) -> float:
        """Return the height of the wave; infinite where its period is above `longest`, which no machine has."""
        return float(np.hypot(c[0], c[1])) if 0 < self.period(c) <= self.longest else np.inf

    @cached_property
    def nearer(self) -> tuple[Effect, ...]:
        """Return the same wave started from periods between those of its neighbours."""
        steps = (k / (_FINER * _PER_WIDTH * self.reach) for k in range(1 - _FINER, _FINER) if k)
        starts = (1 / self.start + step for step in steps)
        return tuple(replace(self, start=1 / start) for start in starts if start > 0)

    def _wave(self, q: Quantities, data: MeasuredData, c: Array) -> tuple[Array, Array]:
        u = np.asarray(q[self.column] if self.column in q else data[self.column], dtype=float)
        phase = 2 * np.pi * (1 / self.start + c[2] / self.reach) * (u - self.middle)
        return np.stack([np.cos(phase), np.sin(phase)], axis=-1), u - self.middle


def _cycles(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    known = _targets(formulation, ORDINALS, timed=True)
    ordinal, measured, column = known[target]
    needs(formulation.data, column)
    names, stated = [*known], formulation.data.units.get(column, "")
    return scanned(
        family, formulation.data, target, (column, measured), ("prediction", unit_of(formulation, measured)),
        factor=-1.0, after=f"{family.name} {names[names.index(target) - 1]}" if ordinal else "",
        period_unit="" if stated == "1" else stated,
    )  # fmt: skip


def scanned(
    family: EffectFamily, data: MeasuredData, target: str, along: tuple[str, str], reported: tuple[str, str], *,
    factor: float = 1.0, after: str = "", longest: float = np.inf, shortest: float = 0.0,
    largest: float = _ANY, period_unit: str = "",
) -> tuple[Cycle, ...]:  # fmt: skip
    """Return the wave at each period that is tried: from half the range of the column down to two readings a wave.

    `along` is the column it follows and the quantity it changes, `reported` the channel and the unit.
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
            family.name, target, family.formula, channel=channel, column=column, columns=(column,),
            quantity=quantity, unit=unit, units=(unit, unit, "1"), start=float(1 / frequency), middle=middle,
            reach=span, positions=count, factor=factor, after=after, largest=largest, longest=longest,
            period_unit=period_unit,
        )
        for frequency in np.linspace(low, min(high, low + count / (span * _PER_WIDTH)), count)
    )  # fmt: skip


def _polynomial(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    _, measured, column = _targets(formulation, timed=True)[target]
    needs(formulation.data, column)
    u = np.asarray(formulation.data[column], dtype=float)
    middle, half, unit = float((u.max() + u.min()) / 2), float(np.ptp(u) / 2), unit_of(formulation, measured)

    def terms(s: Array, degree: int) -> Array:
        return np.stack([s, 2 * s**2 - 1, 4 * s**3 - 3 * s], axis=-1)[:, :degree]

    def changes(degree: int, q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {measured: -terms((np.asarray(data[column], float) - middle) / half, degree)}

    units = [dict.fromkeys(_DEGREES[:degree], unit) for degree in (1, 2, 3)]
    return tuple(
        family.linear(
            target, (column,), each, partial(changes, len(each)),
            # the rise of a line with its sign, the range of a curve over the run
            measure=lambda c: 2 * float(c[0]) if len(c) == 1 else float(np.ptp(terms(_EVEN, len(c)) @ c)),
        )
        for each in units
    )  # fmt: skip


def _targets(
    formulation: Formulation, before: tuple[str, ...] = ("",), after: tuple[str, ...] = ("",), timed: bool = False
) -> Mapping[str, tuple[int, str, str]]:
    """Return target -> (which of the words beside the column, measured column, the column it follows)."""
    measured, roles = measured_columns(formulation), roles_of(formulation)
    return {
        f"{one}{column}{other}" + f" in {name}" * (len(measured) > 1): (k, name, column)
        for column in roles.columns if timed or column != roles.time
        for name in measured for k, (one, other) in enumerate(product(before, after))
    }  # fmt: skip


def measured_columns(formulation: Formulation) -> tuple[str, ...]:
    """Return the measured columns: those of the instruments, or all readings that belong to no joint."""
    roles = roles_of(formulation)
    columns = tuple(dict.fromkeys(name for one in roles.instruments for name in one.columns))
    joints = {joint.reading for joint in roles.joints}
    return columns or tuple(name for name in formulation.readings if name not in joints)


polynomial = of_columns(
    "polynomial", "What is measured follows a further column", "measured -= a line, a parabola, a cubic in the column",
    make=_polynomial, targets_in=lambda formulation: tuple(_targets(formulation, timed=True)), label="trend",
)  # fmt: skip
cycle = of_columns(
    "cycle", "What is measured repeats with a period of a further column that nobody knows",
    "measured -= a cos(2 pi u / P) + b sin(2 pi u / P), u the column, P fitted", make=_cycles,
    targets="each further column, up to four cycles each",
    targets_in=lambda formulation: tuple(_targets(formulation, ORDINALS, timed=True)),
)  # fmt: skip


Shape = Callable[[Array], Array]  # of u / max|u|
_CENTRES = 10  # penalty of a free centre, as if so many were tried: a line alone is no parabola
_POWERS = ("", " squared", " cubed")
_LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9)  # of the readings that lie within the level from which a column saturates


def _shaped(
    family: EffectFamily, formulation: Formulation, target: str, measured: str, column: str,
    shapes: Mapping[float, Shape],
) -> tuple[LinearEffect, ...]:  # fmt: skip
    """Return an effect for each shape of the column, each a form of one name."""
    largest, unit = float(np.max(np.abs(formulation.data[column]))), unit_of(formulation, measured)

    def form(begins: float, shape: Shape) -> LinearEffect:
        return family.linear(
            target, (column,), {"c": unit}, positions=len(shapes), begins=begins * largest,
            changes=lambda q, data: {measured: -shape(np.asarray(data[column], dtype=float) / largest)[:, None]},
            begins_unit=formulation.data.units.get(column, ""),
        )  # fmt: skip

    return tuple(form(begins, shape) for begins, shape in shapes.items())


def _power(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    k, measured, column = _targets(formulation, after=_POWERS)[target]
    needs(formulation.data, column)
    _varied(formulation.data, column, k + 2)
    plain = _shaped(family, formulation, target, measured, column, {np.nan: lambda s: s ** (k + 1)})
    if k != 1:
        return plain
    # the square about an unknown centre: with a line beside it; the square's own coefficient is reported
    largest, unit = float(np.max(np.abs(formulation.data[column]))), unit_of(formulation, measured)

    off_centre = family.linear(
        target, (column,), dict.fromkeys(("c", "line"), unit), measure=lambda c: float(c[0]), positions=_CENTRES,
        changes=lambda q, data: {
            measured: -np.stack([(s := np.asarray(data[column], dtype=float) / largest) ** 2, s], axis=-1)
        },
    )  # fmt: skip
    return (*plain, off_centre)


def _of_sign(shape: Shape, family: EffectFamily, formulation: Formulation, target: str) -> Built:
    _, measured, column = _targets(formulation)[target]
    needs(formulation.data, column)
    if not np.min(formulation.data[column]) < 0 < np.max(formulation.data[column]):
        raise NotTestable(f"column {column} never changes its sign", (column,))
    _varied(formulation.data, column, 3)
    return _shaped(family, formulation, target, measured, column, {np.nan: shape})


def _saturation(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    _, measured, column = _targets(formulation)[target]
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


power = of_columns(
    "power", "What is measured has a term in a column, its square, or its cube",
    "measured -= c s^k, k 1 to 3, or c s^2 + line s, a square about s = -line / (2 c); s = u / max|u|", make=_power,
    targets_in=lambda formulation: tuple(_targets(formulation, after=_POWERS)), label="term",
)  # fmt: skip
_of_shape = partial(of_columns, targets_in=lambda formulation: tuple(_targets(formulation)))
magnitude = _of_shape(
    "magnitude", "What is measured follows the size of a column, whatever its sign", "measured -= c |u| / max|u|",
    make=partial(_of_sign, np.abs), label="size",
)  # fmt: skip
sign = _of_shape(
    "sign", "What is measured jumps where a column changes its sign", "measured -= c sign(u)",
    make=partial(_of_sign, np.sign), label="jump with the sign",
)  # fmt: skip
saturation = _of_shape(
    "saturation", "What is measured answers otherwise where a column is large",
    "measured -= c sign(u) (|u| - s) / max|u| where |u| > s", make=_saturation, label="saturation",
)  # fmt: skip


_TERMS = ("even", "bend", "turn")
_AXES = {2: ("turn",), 3: ("turn x", "turn y", "turn z")}  # turns of a frame, by its number of coordinates


def run_terms(s: Array) -> Array:
    """Return the terms at the part s of the run, (n, 3): a line, a parabola and a cubic, none above 1."""
    return np.stack([s, 4 * s * (1 - s), 6 * np.sqrt(3) * s * (1 - s) * (1 - 2 * s)], axis=-1)


_COURSE = run_terms(np.linspace(0.0, 1.0, 65))


def _drift(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = named(roles_of(formulation).joints, target)
    clock = clock_of(formulation)
    origin, span = float(formulation.data[clock].min()), float(np.ptp(formulation.data[clock]))
    unit, one = told_in(joint)

    def changes(count: int, q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {joint.reading: one * run_terms((data[clock] - origin) / span)[:, :count]}

    units, largest = [dict.fromkeys(_TERMS[:k], unit) for k in (1, 2, 3)], largest_error(joint) / one
    return tuple(
        family.linear(
            target, (clock,), each, partial(changes, len(each)), largest=largest,
            # the range over the run, with the sign of its end where it is even
            measure=lambda c: float(c[0]) if len(c) == 1 else float(np.ptp(_COURSE[:, : len(c)] @ c)),
        )
        for each in units
    )  # fmt: skip


def _frame_drift(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    clock = clock_of(formulation)
    [instrument] = named(roles_of(formulation).instruments, target)
    columns = instrument.columns
    unit = unit_of(formulation, *columns)
    t = formulation.data[clock]
    origin, span = float(t.min()), float(np.ptp(t))
    middle = np.array([float(np.mean(formulation.data[name])) for name in columns])
    reach = np.stack([formulation.data[name] for name in columns], axis=-1) - middle

    def changes(turns: bool, q: Quantities, data: MeasuredData) -> dict[str, Array]:
        part = ((data[clock] - origin) / span)[:, None]
        apart = np.stack([np.asarray(q[name], dtype=float) for name in columns], axis=-1) - middle
        return {name: -part * moved for name, moved in zip(columns, _motion(apart, turns))}

    units = {f"d{name}": unit for name in columns}
    even = family.linear(target, (clock, *columns), units, partial(changes, False), unit=unit)
    if len(columns) not in _AXES:
        return even
    moved = _motion(reach, True)
    units |= dict.fromkeys(_AXES[len(columns)], "rad")
    turning = family.linear(
        target, (clock, *columns), units, partial(changes, True), unit=unit,
        # how far the reading that moves most has moved at the end of the run
        measure=lambda c: float(np.max(np.linalg.norm(np.stack([one @ c for one in moved], axis=-1), axis=-1))),
    )  # fmt: skip
    return even, turning


def _motion(apart: Array, turns: bool) -> list[Array]:
    """Return the displacement of points by a unit of each coefficient, for each coordinate."""
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


def _slip(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = named(roles_of(formulation).joints, target)
    (unit, one), clock = told_in(joint), clock_of(formulation)
    t, most = formulation.data[clock], largest_error(joint) / one
    return family.steps(target, clock, t, {joint.reading: ("step", unit, one)}, most)


def _frame_shift(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [instrument] = named(roles_of(formulation).instruments, target)
    unit, clock = unit_of(formulation, *instrument.columns), clock_of(formulation)
    changes = {name: (f"d{name}", unit, 1.0) for name in instrument.columns}
    return family.steps(target, clock, formulation.data[clock], changes)


drift = of_joints(
    "drift", "The zero of a joint drifts during the run",
    "reading_i += even s, + bend 4 s (1 - s), + turn 10.4 s (1 - s) (1 - 2 s); s from 0 to 1 over the run",
    columns=("the time",), make=_drift, bounds=("largest_angle",),
)  # fmt: skip
slip = of_joints(
    "slip", "The reading of a joint slips once during the run", "reading_i += step from a time on",
    columns=("the time",), make=_slip, bounds=("largest_angle",),
)  # fmt: skip
_of_frame = partial(
    of_columns, columns=("the time",), targets="each instrument with a frame",
    targets_in=lambda formulation: tuple(one.name for one in roles_of(formulation).instruments if one.frame),
)  # fmt: skip
frame_drift = _of_frame(
    "frame_drift", "The frame of an instrument moves evenly during the run, and may turn",
    "measured -= d s, or (d + w x (measured - middle)) s; s from 0 to 1 over the run", make=_frame_drift,
    label="moving frame",
)  # fmt: skip
frame_shift = _of_frame(
    "frame_shift", "An instrument, or the machine, is displaced once during the run", "measured += d from a time on",
    make=_frame_shift, label="displaced frame",
)  # fmt: skip
