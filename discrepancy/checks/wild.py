"""Numbers far from what the model can give: metres for millimetres, degrees for radians, a sign, a zero far off.

At the start values the constraints are compared with those of shuffled readings, which fit no machine. Where the model
is hardly nearer to the readings than to shuffled ones, but much nearer after one factor or one shift, the message names
that factor or shift. Where none helps, the start is poor or the model is wrong: the fit may still succeed. Rows of
different kinds, such as heights and distances, are compared and shuffled separately.

Readings that no calibration can explain (a lost target, a pose that was not reached) are left out, with a note: after a
fit with smaller weights for readings far out, a row is wild if what is left of it is `_FAR_OUT` times the middle one.
Many of them are no accidents, and all are kept. `isolated` rows stand alone, so few times the middle one is enough.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from math import pi
from typing import final

import numpy as np
from numpy.typing import NDArray

from calibench.core.notes import Code
from calibench.core.tables.cells import factors_near
from calibench.core.words import plain
from calibench.discrepancy.model.formulations import Predicted
from calibench.discrepancy.model.learned_noise import weighted_fit
from calibench.discrepancy.model.machine import Formulation, Machine, Numbers
from calibench.discrepancy.model.measured import DataError, MeasuredData, MisfitError
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import inputs_of, roles_of, unknown_noise_of
from calibench.discrepancy.registries import description_of
from calibench.problems.base import Array

_FAR_OUT = 12.0  # times the middle size of what is left
_MOST = 0.03  # of the readings
_ALONE, _TWICE = 3.0, 2.0  # times the middle one, and times what is left of any other row, of a row that stands alone
_ROUNDS = 6
_HUBER = 2.0  # robust deviations
_MEDIAN = 0.6745
_LEAST_SHARE = 2.0  # readings for each parameter
_COLUMNS = 4  # by which a row is told


def without_wild(formulation: Formulation, machine: str = "machine", isolated: bool = False) -> MeasuredData:
    """Return the data of a formulation without wild rows, with a note that tells them, of the `machine`."""
    data = formulation.data
    fitted = np.asarray(data["split"]) != "hold" if "split" in data else np.ones(len(data), dtype=bool)
    model = Model(formulation)
    start = np.asarray(model.residuals(model.start))
    if fitted.sum() * start.shape[1] < _LEAST_SHARE * len(formulation.parameters) or not np.isfinite(start).all():
        return data
    noise, made_of = _noise_and_parts(model)
    left = np.asarray(model.residuals(robust(Model(formulation.on(data.rows(fitted))), noise[fitted])))
    size = np.abs(left) / noise
    middle = np.median(size[fitted], axis=0)
    if not (np.isfinite(left).all() and (middle > _EXACT * np.median(made_of / noise, axis=0)).all()):
        return data
    size /= middle
    wild = size.max(axis=1) > _FAR_OUT
    if isolated:
        wild = _alone(size.max(axis=1)) & ~_repeated(formulation, wild)
    if not wild.any() or wild.mean() > _MOST:
        return data
    count, worst = int(wild.sum()), int(np.argmax(size.max(axis=1)))
    how, others = ("twice", "any other") if isolated else (f"{_FAR_OUT:g} times", "the middle one")
    many, at = count > 1, data.rows_named(np.array([worst]))
    left_out = f"{count} wild readings are left out ({data.rows_named(wild)})" if many else "1 wild reading is left out"
    text = (
        f"{left_out}, more than {how} as far from the calibrated {machine} as {others}: "
        f"{'the worst is ' if many else ''}{at}, {_row_in_words(formulation, left, size, worst)}"
    )
    return data.rows(~wild).with_note(Code.ROWS_WILD, text, rows=data.labels(wild))


def _alone(size: Array) -> NDArray[np.bool_]:
    """Return which rows are far out, and twice as far as all others, from the `size` of what is left, (n,)."""
    order = np.sort(size)[::-1]
    after = np.flatnonzero((order[:-1] > _ALONE) & (order[:-1] > _TWICE * order[1:]))
    return np.asarray(size >= order[after[-1]] if len(after) else np.zeros(len(size), dtype=bool))


def _repeated(formulation: Formulation, wild: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the wild rows whose repeats are wild too, (n,): what the machine does twice is no accident."""
    if not formulation.data.has("pose_id"):
        return np.zeros(len(wild), dtype=bool)
    _, pose = np.unique(formulation.data["pose_id"], return_inverse=True)
    return np.asarray(wild & (np.bincount(pose, weights=wild)[pose] > 1))


def robust(model: Model, noise: Array) -> Array:
    """Return the parameters of a fit in which readings far out, relative to their noise (n, c), have small weight."""
    x = model.start
    weight = 1 / noise
    for _ in range(_ROUNDS):
        x = weighted_fit(model, x, weight)
        left = np.abs(np.asarray(model.residuals(x))) / noise
        spread = np.maximum(np.median(left, axis=0) / _MEDIAN, 1e-12)
        weight = np.sqrt(np.minimum(1.0, _HUBER * spread / np.maximum(left, 1e-300))) / spread / noise
    return np.asarray(x)


def _noise_and_parts(model: Model) -> tuple[Array, Array]:
    """Return the deviation of each constraint by its readings' noise, (n, c), and the sum of its parts' moduli."""
    formulation, q = model.formulation, model.quantities(model.start)[0]
    slopes = formulation.slopes(q)
    sizes = {name: np.abs(np.asarray(q[name], dtype=float))[..., None] for name in slopes}
    parts = np.asarray(sum(np.abs(slope) * sizes[name] for name, slope in slopes.items()))
    sigma = {name: np.asarray(formulation.sigma[name], dtype=float)[..., None] for name in formulation.readings}
    noise = np.sqrt(sum((slopes[name] * sigma[name]) ** 2 for name in formulation.readings))
    return np.maximum(noise, np.finfo(float).eps * np.maximum(parts, 1e-300)), parts


def _row_in_words(formulation: Formulation, left: Array, size: Array, row: int) -> str:
    """Return what a row reads: what was measured and how far off it is, or the columns of a closure."""
    data, k = formulation.data, int(np.argmax(size[row]))
    if isinstance(formulation, Predicted):
        name = tuple(formulation.measured)[k]
        off = float(left[row, k])
        where = [f"{n} {plain(float(data[n][row]), 5)}" for n in formulation.inputs if n in data][:_COLUMNS]
        at = f" (at {', '.join(where)})" if where else ""
        return f"{name} = {float(data[name][row]):.6g}, {plain(abs(off), 3)} too {'large' if off > 0 else 'small'}{at}"
    names = dict.fromkeys((*inputs_of(formulation), *formulation.readings))
    return ", ".join([f"{n} {plain(float(data[n][row]), 5)}" for n in names if n in data][: 2 * _COLUMNS])


# parts of the misfit of shuffled readings: before a cure, after it; and the least improvement
_FAR, _NEAR, _BETTER = 0.4, 0.2, 4.0
_ROWS = 300  # most rows that are compared
_LEAST = 8  # rows that are needed at least
_TURN = 72  # places of a zero that are tried
_ALIKE = 1.02  # times the best misfit: a cure within this is as good
_CURES = 2  # cures that a message names
_OUT = 10.0  # times the largest misfit of shuffled readings: no reading of this machine
_EXACT = 1e-10  # times the misfit of shuffled readings, or the numbers of a row: nearer to the model is rounding alone
_LARGEST = 4.0  # times the noise: the largest misfit of some hundred shuffled readings of noise alone
_MOST_OUT = 0.05  # part of the rows that may be so far off
_UNKNOWN = {"m": 1000.0, "um": 1e-3, "deg": pi / 180, "rad": 180 / pi}  # units that numbers may be in if none is stated


@final
@dataclass(frozen=True)
class Cure:
    """A change that brings the readings to the model, in `words`.

    `misfit` after the change is relative to that of shuffled readings.
    """

    words: str
    misfit: float


def refuse_wild(formulation: Formulation) -> None:
    """Raise `DataError` for readings that one factor or one shift brings near to the model; the message names it."""
    for rows in _alike(formulation):
        _refuse_wild(formulation if len(rows) == len(formulation.data) else formulation.on(formulation.data.rows(rows)))


def _refuse_wild(formulation: Formulation) -> None:
    n = len(formulation.data)
    if n < _LEAST:
        return
    few = formulation.on(formulation.data.rows(np.unique(np.linspace(0, n - 1, min(n, _ROWS)).astype(int))))
    q = _start(few)
    misfit = _misfit(few, q)
    if not misfit > _FAR:
        return
    cures = [cure for cure in (*_cures(few, q), *_moved(formulation)) if cure.misfit < min(_NEAR, misfit / _BETTER)]
    if not cures:
        return
    best = min(cure.misfit for cure in cures)
    alike = [cure.words for cure in cures if cure.misfit <= _ALIKE * best][:_CURES]
    raise DataError(
        f"{formulation.data.name}: the readings are as far from the model as shuffled ones ({plain(misfit, 2)} of "
        f"their misfit), and near to it ({plain(best, 2)}) {'; or as near '.join(alike)}"
    )


def as_far_as_shuffled(formulation: Formulation, x: Array) -> bool:
    """Return whether a model, calibrated to parameters x, is hardly nearer to its readings than to shuffled ones."""
    kinds = [formulation.on(formulation.data.rows(rows)) for rows in _alike(formulation) if len(rows) >= _LEAST]
    return any(_misfit(few, Model(few).quantities(x)[0]) > _FAR for few in kinds)


def wild_rows(formulation: Formulation) -> NDArray[np.bool_]:
    """Return which rows no machine of this kind can give, (n,): a lost comma, another unit, a code for no value.

    Raises `DataError` where they are too many to be accidents.
    """
    kinds = _alike(formulation)
    if len(kinds) == 1:
        return _wild_rows(formulation)
    wild = np.zeros(len(formulation.data), dtype=bool)
    for rows in kinds:
        wild[rows] = _wild_rows(formulation.on(formulation.data.rows(rows)))
    return wild


def _wild_rows(formulation: Formulation) -> NDArray[np.bool_]:
    n = len(formulation.data)
    wild = np.zeros(n, dtype=bool)
    if n < _LEAST:
        return wild
    q = _start(formulation)
    size = np.abs(formulation.constraints(q)).max(axis=1)
    if not np.isfinite(size).all():
        return wild
    exact = np.maximum(_EXACT * _shuffled(formulation, q, np.full(n, True)), _rounding(formulation, q))
    sound = size <= np.maximum(_OUT * np.median(size), exact)
    if sound.all() or sound.sum() < _LEAST:
        return wild
    most = _shuffled(formulation, q, sound)
    wild = size > _OUT * np.maximum(most, _LARGEST * _stated(formulation, q)) if np.isfinite(most) else wild
    if wild.mean() > _MOST_OUT:
        raise DataError(
            f"{formulation.data.name}: {int(wild.sum())} of {n} rows lie more than {_OUT:g} times further from the "
            f"model than any shuffled reading: {_worst(formulation, wild)}; correct them, or mark them valid=0"
        )
    return wild


def _stated(formulation: Formulation, q: Mapping[str, Numbers]) -> Array:
    """Return the standard deviation of the misfit of each row by the stated noise, (n,); 0 where nobody stated one.

    Of readings without noise all but a few may meet the model to rounding, and these few are none too far off.
    """
    slopes, unknown = formulation.slopes(q), unknown_noise_of(formulation)
    variance = np.zeros((len(formulation.data), 1))
    for name in formulation.readings:
        if name not in unknown:
            variance = variance + (slopes[name] * np.asarray(formulation.sigma[name])[..., None]) ** 2
    return np.asarray(np.sqrt(variance.max(axis=1)))


def _rounding(formulation: Formulation, q: Mapping[str, Numbers]) -> Array:
    """Return the misfit of each row that is rounding alone, (n,): of numbers of this size a part of `_EXACT`.

    Heights that are all 0 are the same when they are shuffled, so the size of shuffled misfits does not tell it.
    """
    parts = np.zeros((len(formulation.data), 1))
    for name, slope in formulation.slopes(q).items():
        parts = parts + np.abs(slope) * np.abs(np.asarray(q[name], dtype=float))[..., None]
    return _EXACT * np.asarray(parts.max(axis=1))


def _shuffled(formulation: Formulation, q: Mapping[str, Numbers], rows: NDArray[np.bool_]) -> float:
    """Return the largest misfit of some rows, each of whose readings is of another one of them."""
    order = np.random.default_rng(0)
    mixed = {name: order.permutation(value[rows]) if np.ndim(value) else value for name, value in q.items()}
    return float(np.abs(formulation.on(formulation.data.rows(rows)).constraints(mixed)).max())


def _worst(formulation: Formulation, wild: NDArray[np.bool_]) -> str:
    """Return the reading that is furthest from the rest of its column, in words."""
    worst = ("", 0.0, 0.0)
    reads = getattr(formulation, "reads", None)
    for name in formulation.readings:
        if reads is not None and not reads(name)[wild].any():
            continue
        column = np.asarray(formulation.data[name], dtype=float)
        middle = float(np.median(column))
        spread = float(np.median(np.abs(column - middle))) or 1.0
        far = np.abs(column[wild] - middle) / spread
        if far.max() > worst[1]:
            worst = (name, float(far.max()), float(column[wild][far.argmax()]))
    return f"{worst[0]} is {worst[2]:.6g}{' in one of them' if wild.sum() > 1 else ''}"


def without_wild_rows(formulation: Formulation) -> Formulation:
    """Return the formulation without the rows that no machine of its kind can give, and a note on them."""
    wild = wild_rows(formulation)
    if not wild.any():
        return formulation
    data, them = formulation.data, "them" if wild.sum() > 1 else "it"
    text = (
        f"{data.rows_named(wild)} left out, for no reading of this machine lies there: "
        f"{_worst(formulation, wild)}; correct {them}, or mark {them} valid=0"
    )
    return formulation.on(data.rows(~wild).with_note(Code.ROWS_WILD, text, rows=data.labels(wild)))


def formulated(machine: Machine, data: MeasuredData) -> Formulation:
    """Return `machine.formulate(data)`; a `MisfitError` gets the factor that corrects the data, where one is found."""
    try:
        made = machine.formulate(data)
    except MisfitError as error:
        cure = _cure_of(machine, data)
        raise DataError(f"{error}{cure}") from None
    if getattr(made, "constraints", None) is None:
        raise DataError(
            f"{machine.name}: formulate(data) returned {type(made).__name__}; Predicted(...), Constraints(...) or "
            "Blocks(...) is needed"
        )
    return made


def _cure_of(machine: Machine, data: MeasuredData) -> str:
    by_unit: dict[str, list[str]] = {}
    for column in description_of(machine.name).columns:
        if column.name in data and factors_near(column.unit) and column.unit in ("mm", "rad"):
            by_unit.setdefault(column.unit, []).append(column.name)
    best = ("", np.inf)
    for unit, columns in by_unit.items():
        for other, factor in factors_near(unit).items():
            scaled = data.with_columns({name: np.asarray(data[name], dtype=float) * factor for name in columns})
            try:
                formulation = machine.formulate(scaled)
            except DataError:
                continue
            misfit = _misfit(formulation, _start(formulation))
            if misfit < best[1]:
                words = f"; {', '.join(columns)} look like {other}: multiply by {factor:.6g}, or state the unit {other}"
                best = (words, misfit)
    return best[0]


def _alike(formulation: Formulation) -> list[NDArray[np.int_]]:
    """Return the rows of each kind: all those in which the same columns are read."""
    reads = getattr(formulation, "reads", None)
    if reads is None:
        return [np.arange(len(formulation.data))]
    read = np.stack([reads(name) for name in formulation.readings], axis=-1)
    kinds, of = np.unique(read, axis=0, return_inverse=True)
    return [np.flatnonzero(np.ravel(of) == k) for k in range(len(kinds))]


def _start(formulation: Formulation) -> dict[str, Numbers]:
    model = Model(formulation)
    return model.quantities(model.start)[0]


def _misfit(formulation: Formulation, q: Mapping[str, Numbers]) -> float:
    """Return the median constraint at `q` relative to that of shuffled readings, of the worst kind of rows.

    It is 1 where that is undefined.
    """
    order = np.random.default_rng(0)
    mixed = {name: order.permutation(value) if np.ndim(value) else value for name, value in q.items()}
    with np.errstate(all="ignore"):
        here, there = (np.median(np.abs(formulation.constraints(at)), axis=0) for at in (q, mixed))
        shares = np.where((there > 0) & np.isfinite(here) & np.isfinite(there), here / there, 1.0)
    return float(np.max(shares))


def _cures(formulation: Formulation, q: Mapping[str, Numbers]) -> Iterator[Cure]:
    kinds: dict[tuple[str, str], list[str]] = {}
    for sensor in formulation.sensors:
        unit = sensor.unit or formulation.data.units.get(sensor.column, "")
        kinds.setdefault((sensor.kind, unit), []).append(sensor.column)
    joints = {joint.reading: joint.unit for joint in roles_of(formulation).joints}
    for name in inputs_of(formulation):
        kinds.setdefault(("input", joints.get(name, formulation.data.units.get(name, ""))), []).append(name)
    unit_of = {name: unit for (_, unit), names in kinds.items() for name in names}
    groups = [tuple(names) for names in kinds.values()]
    by_unit = [tuple(n for n in unit_of if unit_of[n] == unit) for unit in dict.fromkeys(unit_of.values())]
    single = [(name,) for name in unit_of]
    said = formulation.data.units
    own_units = description_of(formulation.data.machine).own_units
    unsaid = [names for group in by_unit if (names := tuple(n for n in group if n not in said))]
    for names in dict.fromkeys((*groups, *by_unit, *unsaid, *single)):
        for other, factor in _factors(unit_of[names[0]]).items():
            misfit = _changed(formulation, q, names, partial(np.multiply, factor))
            verb = "looks" if len(names) == 1 else "look"
            words = f"if {', '.join(names)} {'is' if len(names) == 1 else 'are'} multiplied by {factor:.6g}: "
            way_out = _way_out(names, f"{verb} like {other}", other, said, own_units)
            yield Cure(f"{words}{way_out}", misfit)
        if len(names) == 1:
            misfit = _changed(formulation, q, names, lambda value: -value)
            yield Cure(f"if {names[0]} is multiplied by -1: it counts the other way round", misfit)
    for names in groups:
        for one, other in combinations(names, 2):
            misfit = _misfit(formulation, {**q, one: q[other], other: q[one]})
            yield Cure(f"if {one} and {other} are exchanged: each may stand under the name of the other", misfit)
    for name, unit in unit_of.items():
        if unit in ("rad", ""):
            yield from _shifted(formulation, q, name, "" if own_units and not unit else " rad")


def _moved(formulation: Formulation) -> Iterator[Cure]:
    """Yield the changes in which one kind of column is shifted by a row: two files that were put side by side."""
    n = min(len(formulation.data), _ROWS)
    few = formulation.on(formulation.data.rows(np.arange(n)))
    q = _start(few)
    inputs = inputs_of(few)
    kinds = [[s.column for s in few.sensors if s.kind == kind] for kind in dict.fromkeys(s.kind for s in few.sensors)]
    for names in [list(inputs)] if inputs else kinds if len(kinds) > 1 else []:
        for rows, said in ((1, "late"), (-1, "early")):
            misfit = _misfit(few, {**q, **{name: np.roll(q[name], -rows) for name in names}})
            yield Cure(f"if {', '.join(names)} are taken from the row {'after' if rows > 0 else 'before'}: they come a "
                       f"row {said}", misfit)  # fmt: skip


def _way_out(names: tuple[str, ...], look: str, other: str, said: Mapping[str, str], own_units: bool) -> str:
    """Return what the user may write: the missing unit.

    A unit that was stated is wrong, and only the user can correct it. Where a machine takes the file's `own_units`,
    stating a unit changes nothing, so the text does not propose it.
    """
    if own_units:
        return "file and model are in units that differ by this factor; write one of them in those of the other"
    if any(name in said for name in names):
        return "the unit that is stated is wrong by this factor"
    return f"{look}; state the unit of the column: units={json.dumps(dict.fromkeys(names, other), ensure_ascii=False)}"


def _factors(unit: str) -> Mapping[str, float]:
    return factors_near(unit) if unit else _UNKNOWN


def _changed(
    formulation: Formulation, q: Mapping[str, Numbers], names: tuple[str, ...], change: Callable[[Numbers], Numbers]
) -> float:
    return _misfit(formulation, {**q, **{name: change(np.asarray(q[name])) for name in names}})


def _shifted(formulation: Formulation, q: Mapping[str, Numbers], name: str, unit: str) -> Iterator[Cure]:
    """Yield the best shift of an angle, in ` rad` or without a `unit`.

    A shift that a parameter makes within its bounds is left out.
    """

    def misfit(shift: float) -> float:
        return _changed(formulation, q, (name,), lambda value: value + shift)

    places = np.linspace(-pi, pi, _TURN, endpoint=False)
    best = float(min(places, key=misfit))
    width = 2 * pi / _TURN
    best = float(min(np.linspace(best - width, best + width, 41), key=misfit))
    slopes = formulation.slopes(q)
    for p in formulation.parameters:
        same, mirrored = (np.allclose(slopes[p.name], sign * slopes[name], rtol=1e-6) for sign in (1.0, -1.0))
        if same or mirrored:
            there = p.start + (best if same else -best)
            if p.lower <= there <= p.upper:
                return
            more = f" or start {p.name} at {plain(there, 3)}, outside its bounds {p.lower:g} to {p.upper:g}"
            yield Cure(
                f"if {plain(best, 3, '+')}{unit} is added to {name}: its zero is that far off; add it{more}",
                misfit(best),
            )
            return
    yield Cure(f"if {plain(best, 3, '+')}{unit} is added to {name}: its zero is that far off", misfit(best))
