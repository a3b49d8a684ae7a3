"""Numbers far from what the model can give: metres for millimetres, degrees for radians, a sign, a zero far off.

At the start values the constraints are compared with those of shuffled readings, which fit no machine. Where the model
is hardly nearer to the readings than to shuffled ones, but much nearer after one factor or one shift, the message names
that factor or shift. Where none helps, the start is poor or the model is wrong: the fit may still succeed. Rows of
different kinds, such as heights and distances, are compared and shuffled separately. Of a machine that computes its
constraints from a table (`read_from`) the table is changed, and what calibration leaves is compared.

Readings that no calibration can explain (a lost target, a pose that was not reached) are left out, with a note: after a
fit with smaller weights for readings far out, a row is wild if what is left of it is `_FAR_OUT` times the middle one.
Many of them are no accidents, and all are kept. `isolated` rows stand alone, so few times the middle one is enough.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import combinations
from math import pi

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from calibench.core.notes import Code
from calibench.core.tables import mistakes
from calibench.core.tables.cells import factors_near
from calibench.core.tables.columns import Quantity
from calibench.core.tables.mistakes import Kind, Mistake
from calibench.core.words import plain
from calibench.discrepancy.model.formulations import Predicted
from calibench.discrepancy.model.machine import Formulation, Machine, Numbers
from calibench.discrepancy.model.measured import DataError, MeasuredData, MisfitError, kinds_of
from calibench.discrepancy.model.model import Model, weighted_fit
from calibench.discrepancy.model.roles import inputs_of, roles_of, unknown_noise_of
from calibench.discrepancy.registries import description_of
from calibench.problems.base import Array

_FAR_OUT = 12.0  # times the middle size of what is left
_BESIDE, _OF_TREND = 2, 0.3  # rows on either side, and part of how far a row lies out
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
    fitted = data.fitted
    model = Model(formulation)
    start = np.asarray(model.residuals(model.start))
    if fitted.sum() * start.shape[1] < _LEAST_SHARE * len(formulation.parameters) or not np.isfinite(start).all():
        return data
    noise, made_of = _noise(formulation)
    left = np.asarray(model.residuals(robust(Model(formulation.on(data.rows(fitted))), noise[fitted])))
    size = np.abs(left) / noise
    middle = np.median(size[fitted], axis=0)
    if not (np.isfinite(left).all() and (middle > _EXACT * np.median(made_of / noise, axis=0)).all()):
        return data
    size /= middle
    far = size.max(axis=1)
    # an end of a trend lies far out with the rows beside it, and is none
    first = np.clip(np.arange(len(far)) - _BESIDE, 0, max(len(far) - 2 * _BESIDE - 1, 0))
    beside = np.median(far[np.minimum(first[:, None] + np.arange(2 * _BESIDE + 1), len(far) - 1)], axis=1)
    wild = (far > _FAR_OUT) & (beside < _OF_TREND * far)
    if isolated:  # far out, and twice as far as all others; what the machine does twice is no accident
        order = np.sort(far)[::-1]
        after = np.flatnonzero((order[:-1] > _ALONE) & (order[:-1] > _TWICE * order[1:]))
        alone = far >= order[after[-1]] if len(after) else np.zeros(len(far), dtype=bool)
        if data.has("pose_id"):
            pose = np.unique(data["pose_id"], return_inverse=True)[1]
            alone &= ~(wild & (np.bincount(pose, weights=wild)[pose] > 1))
        wild = np.asarray(alone)
    if not wild.any() or wild.mean() > _MOST:
        return data
    count, worst = int(wild.sum()), int(np.argmax(far))
    how, others = ("twice", "any other") if isolated else (f"{_FAR_OUT:g} times", "the middle one")
    many, at = count > 1, data.rows_named(np.array([worst]))
    left_out = f"{count} wild readings are left out ({data.rows_named(wild)})" if many else "1 wild reading is left out"
    # what the worst row reads: what was measured and how far off it is, or the columns of a closure
    if isinstance(formulation, Predicted):
        k = int(np.argmax(size[worst]))
        name, off = tuple(formulation.measured)[k], float(left[worst, k])
        where = [f"{n} {plain(float(data[n][worst]), 5)}" for n in formulation.inputs if n in data][:_COLUMNS]
        reads = f"{name} = {float(data[name][worst]):.6g}, {plain(abs(off), 3)} too {'large' if off > 0 else 'small'}"
        reads += f" (at {', '.join(where)})" if where else ""
    else:
        names = dict.fromkeys((*inputs_of(formulation), *formulation.readings))
        reads = ", ".join([f"{n} {plain(float(data[n][worst]), 5)}" for n in names if n in data][: 2 * _COLUMNS])
    text = (
        f"{left_out}, more than {how} as far from the calibrated {machine} as {others}: "
        f"{'the worst is ' if many else ''}{at}, {reads}"
    )
    return data.rows(~wild).with_note(Code.ROWS_WILD, text, rows=data.labels(wild))


def _noise(formulation: Formulation) -> tuple[Array, Array]:
    """Return the deviation of each constraint by its readings' noise, and the sum of its parts' moduli, (n, c) each."""
    q = Model(formulation).quantities()[0]
    slopes = formulation.slopes(q)
    sizes = {name: np.abs(np.asarray(q[name], dtype=float))[..., None] for name in slopes}
    made_of = np.asarray(sum(np.abs(slope) * sizes[name] for name, slope in slopes.items()))
    sigma = {name: np.asarray(formulation.sigma[name], dtype=float)[..., None] for name in formulation.readings}
    noise = np.sqrt(sum((slopes[name] * sigma[name]) ** 2 for name in formulation.readings))
    return np.maximum(noise, np.finfo(float).eps * np.maximum(made_of, 1e-300)), made_of


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


# parts of the misfit of shuffled readings: before a cure, after it; and the least improvement
FAR, _NEAR, _BETTER = 0.4, 0.2, 4.0
_OF_ALL = 0.9  # of the rows have to be near where a part of them is cured
_ROWS = 300  # most rows that are compared
_LEAST = 8  # rows that are needed at least
_TURN = 72  # places of a zero that are tried
_ALIKE = 2.0  # times the best misfit: a cure within this is as good, as nominal parameters are not the true ones
_OUT = 10.0  # times the largest misfit of shuffled readings: no reading of this machine
_EXACT = 1e-10  # times the misfit of shuffled readings, or the numbers of a row: nearer to the model is rounding alone
_LARGEST = 4.0  # times the noise: the largest misfit of some hundred shuffled readings of noise alone
_MOST_OUT = 0.05  # part of the rows that may be so far off
_BESIDE_START = 0.08  # of the misfit of shuffled readings: where a machine finds its start, sound ones have .05
_LOW = 0.25  # of the stated noise: if calibration leaves less, numbers are in another unit than it
_LITTLE = 0.5  # the same where a search found no name for it
_FALLS = 2.0  # times less than what is left, or by one mistake less: what a model lacks may do less
_PAIRED = ("rad", "deg", "h", "mm", "m", "cm", "inch")  # units in which tables of whole machines are written
_USUAL = (*_PAIRED, "rev", "gon", "")
_CALM = 1.3  # times the noise: where calibration leaves less, no mistake is looked for
_OF_FEW = 20.0  # constraints: of so few what is left falls twice as far by chance
_ROWS_A_PARAMETER = 4.0  # at least: of fewer a fit is near to any table
_FEW = 60  # rows of a table that is formulated many times
_SHIFTS = 13  # of a zero that are tried over the range of a column on either side
_TINY = 1e-12  # of a constraint
_UNKNOWN = {"m": 1000.0, "um": 1e-3, "deg": pi / 180, "rad": 180 / pi}  # units that numbers may be in if none is stated


def refuse_wild(formulation: Formulation) -> None:
    """Raise `DataError` for readings that a mistake less brings near to the model; the message names it.

    What is wrong in a part of the rows is looked for before what is wrong in all of them, and that before two units.
    """
    for kind in (kind for _, kind in _kinds(formulation)):
        n = len(kind.data)
        if n < _LEAST or getattr(kind, "of_rows", None) is not None:  # a simulator: hundreds of calls
            continue
        few = kind.on(kind.data.rows(np.unique(np.linspace(0, n - 1, min(n, _ROWS)).astype(int))))
        q = Model(few).quantities()[0]
        _refuse_part(kind)
        misfit = _misfit(few, q)
        for cures_of in (_cures, _two_units) if misfit > FAR else ():
            _refuse("the readings", kind, misfit, cures_of(few, q, kind))


def _refuse(readings: str, kind: Formulation, misfit: float, cures: Iterable[tuple[float, str]]) -> None:
    """Raise `DataError` where one of some cures, each with what it leaves, brings readings near to the model."""
    best, words = mistakes.likely(cures, _ALIKE)
    if best < min(_NEAR, misfit / _BETTER):
        raise DataError(
            f"{kind.data.name}: {readings} are as far from the model as shuffled ones ({plain(misfit, 2)} of their "
            f"misfit), and near to it ({plain(best, 2)}) {mistakes.OR_AS_NEAR.join(words)}"
        )


def _refuse_part(whole: Formulation) -> None:
    """Raise `DataError` where many rows are far from the model, and near to it without a mistake in these alone."""
    misfit = _misfit(whole, Model(whole).quantities()[0], _OF_ALL)
    if misfit > FAR:
        _refuse("many readings", whole, misfit, _in_part(whole))


def as_far_as_shuffled(formulation: Formulation, x: Array) -> bool:
    """Return whether a model, calibrated to parameters x, is hardly nearer to its readings than to shuffled ones."""
    kinds = [kind for rows, kind in _kinds(formulation) if len(rows) >= _LEAST]
    return any(_misfit(kind, Model(kind).quantities(x)[0]) > FAR for kind in kinds)


def wild_rows(formulation: Formulation) -> NDArray[np.bool_]:
    """Return which rows no machine of this kind can give, (n,): a lost comma, another unit, a code for no value.

    Raises `DataError` where they are too many to be accidents.
    """
    found = np.zeros(len(formulation.data), dtype=bool)
    for rows, kind in _kinds(formulation):
        n, q = len(rows), Model(kind).quantities()[0]
        if n < _LEAST:
            continue
        size = np.abs(kind.constraints(q)).max(axis=1)
        if not np.isfinite(size).all():
            continue
        # of numbers of this size a small part is rounding: heights that are all 0 are the same when they are shuffled
        slopes, parts = kind.slopes(q), np.zeros((n, 1))
        for name, slope in slopes.items():
            parts = parts + np.abs(slope) * np.abs(np.asarray(q[name], dtype=float))[..., None]
        exact = np.maximum(_EXACT * _shuffled(kind, q, np.full(n, True)), _EXACT * np.asarray(parts.max(axis=1)))
        sound = size <= np.maximum(_OUT * np.median(size), exact)
        if sound.all() or sound.sum() < _LEAST:
            continue
        most = _shuffled(kind, q, sound)
        if not np.isfinite(most):
            continue
        # of readings without noise all but a few may meet the model to rounding, and these few are none too far off
        variance = np.zeros((n, 1))
        for name in (name for name in kind.readings if name not in unknown_noise_of(kind)):
            variance = variance + (slopes[name] * np.asarray(kind.sigma[name])[..., None]) ** 2
        wild = size > _OUT * np.maximum(most, _LARGEST * np.asarray(np.sqrt(variance.max(axis=1))))
        if wild.mean() > _MOST_OUT:
            raise DataError(
                f"{kind.data.name}: {int(wild.sum())} of {n} rows lie more than {_OUT:g} times further from the "
                f"model than any shuffled reading: {_worst(kind, wild)}; correct them, or mark them valid=0"
            )
        found[rows] = wild
    return found


def _shuffled(formulation: Formulation, q: Mapping[str, Numbers], rows: NDArray[np.bool_]) -> float:
    """Return the largest misfit of some rows, each of whose readings is of another one of them."""
    order = np.random.default_rng(0)
    mixed = {name: order.permutation(value[rows]) if np.ndim(value) else value for name, value in q.items()}
    return float(np.abs(formulation.on(formulation.data.rows(rows)).constraints(mixed)).max())


def _worst(formulation: Formulation, wild: NDArray[np.bool_]) -> str:
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


def formulated(machine: Machine, data: MeasuredData, unnamed: bool = False) -> Formulation:
    """Return `machine.formulate(data)`; raise `DataError` for a table that fits far better without a mistake, or two.

    What a machine makes its constraints of (`read_from`) may be in another unit, of another sign, or exchanged. Tables
    without such a mistake are formulated and calibrated, and what is left is compared in the units of the file. As the
    fits take time, a table whose rest is no larger than what a model may lack is looked at only if a search found it
    `unnamed`.
    """
    made: Formulation | None = None
    refused: MisfitError | None = None
    try:
        made = machine.formulate(data)
    except MisfitError as error:
        refused = error
    if refused is None and getattr(made, "constraints", None) is None:
        raise DataError(
            f"{machine.name}: formulate(data) returned {type(made).__name__}; Predicted(...), Constraints(...) or "
            "Blocks(...) is needed"
        )
    known = description_of(machine.name)
    read = [column for column in known.columns if column.name in known.read_from and column.name in data]
    as_read = made is not None and {column.name for column in read} <= {*made.readings, *inputs_of(made)}
    if read and (as_read or made is None):
        _refuse_start(machine, data, made, read, str(refused or ""))
    if made is not None and as_read:
        return made  # `refuse_wild` looks at these
    off = 0.0  # what calibration leaves, in deviations of the noise, rms
    if made is not None:
        noise, _ = _noise(made)
        off = float(np.sqrt(np.mean((Model(made).residuals(robust(Model(made), noise)) / noise) ** 2)))
    if made is not None and (_LITTLE < off < _CALM if unnamed else _LOW < off < _FAR_OUT):
        return made
    times, ways_out = _cures_of_table(machine, data, made, read, off, shifts=unnamed and off > _FAR_OUT)
    if ways_out:
        said = f"{refused}; the readings fit it" if refused else f"{data.name}: calibration leaves {times} times less"
        raise DataError(f"{said} {mistakes.OR_AS_NEAR.join(ways_out)}")
    if made is None:
        raise DataError(str(refused))
    return made


def _mistakes_of_table(
    machine: Machine, data: MeasuredData, read: Sequence[Quantity]
) -> tuple[list[Mistake], list[tuple[str, ...]]]:
    """Return what may be wrong in the columns `read`, and these by what they have in common."""
    table = {column.name: data[column.name] for column in read if data[column.name].dtype.kind in "iuf"}
    unit_of = {column.name: column.unit for column in read if column.name in table}
    parts = {part: None for name in table for part in name.split("_")}
    groups = [tuple(name for name in table if part in name.split("_")) for part in parts]
    groups += [tuple(n for n in table if unit_of[n] == unit) for unit in dict.fromkeys(unit_of.values())]
    groups = [*dict.fromkeys(groups)]
    together = [*dict.fromkeys((*groups, *((name,) for name in table)))]
    found = [one for one in _mistakes(table, unit_of, together, groups, data) if one.unit in _USUAL]
    some = (names for names in together if len(names) < len(table))
    return found + [mistakes.a_row_off(table, names, rows) for names in some for rows in (-1, 1)], groups


def _refuse_start(
    machine: Machine, data: MeasuredData, made: Formulation | None, read: Sequence[Quantity], refused: str
) -> None:
    """Raise `DataError` for a table of which the machine finds a start that is far nearer to it without a mistake.

    `made` is what it makes of the table as it stands, None where it `refused`. The likelier mistakes come first.
    """

    def misfit(one: Mistake, rows: int = _ROWS) -> float:
        few = np.unique(np.linspace(1, len(data) - 2, min(len(data), rows)).astype(int))
        try:
            there = machine.formulate(data.with_columns(one.columns).rows(few))
            return _misfit(there, Model(there).quantities()[0])
        except DataError:
            return np.inf

    now = np.inf if made is None else _misfit(made, Model(made).quantities()[0])
    if not now > _BESIDE_START:
        return
    third = len(data) // 3
    for rows in np.split(np.arange(len(data)), (third, -third))[::2] if third >= _LEAST else ():
        with suppress(MisfitError):  # a part of the rows that is sound tells the machine by which others are judged
            there = machine.formulate(data.rows(rows))
            if {column.name for column in read} <= {*there.readings, *inputs_of(there)}:
                _refuse_part(there.on(data))
    found = _mistakes_of_table(machine, data, read)[0]
    first = [one for one in found if len(one.columns) > 1 and one.kind is not Kind.ROWS]
    for some in (first, [one for one in found if one not in first]):
        near = [one for one in some if misfit(one, _FEW) < _ALIKE * _NEAR]
        best, cures = mistakes.likely(((misfit(one), one) for one in near), _ALIKE)
        if best < min(_NEAR, now / _BETTER):
            far = f"{data.name}: the readings are far from the model ({plain(now, 2)} of the misfit of shuffled ones)"
            said = f"{refused}; the readings are" if refused else f"{far}, and"
            raise DataError(
                f"{said} near to it ({plain(best, 2)}) {mistakes.OR_AS_NEAR.join(_words(one, data) for one in cures)}"
            )


def _cures_of_table(
    machine: Machine, data: MeasuredData, made: Formulation | None, read: Sequence[Quantity], off: float, shifts: bool
) -> tuple[str, list[str]]:
    """Return how many times less calibration leaves of the columns `read` without a mistake or two, and these in words.

    `made` is what the machine makes of the table as it stands, None where it refuses, and `off` what that leaves.
    `shifts`: zeros that are off are looked for too, where no other mistake is found.
    """
    found, groups = _mistakes_of_table(machine, data, read)
    left = partial(_left, machine, data, stands=made is not None)
    now = np.inf if made is None else left(())
    count = np.inf if made is None else Model(made).residuals(Model(made).start).size
    falls = _FALLS * (1 + _OF_FEW / count)

    def among(some: Iterable[Sequence[Mistake]]) -> tuple[float, list[Sequence[Mistake]]]:
        return mistakes.likely(((left(one), one) for one in some), _ALIKE)

    def enough(best: float) -> bool:
        return best < now / falls and not off * best / now > _FAR_OUT

    # where the machine refuses the table no single one brings it near: the start was looked at
    best, cures = among([one] for one in found if made is not None)
    if made is None or off > _FALLS:
        units = [one for one in found if one.unit in _PAIRED and tuple(one.columns) in groups]
        units = [one for one in units if made is not None or len(one.columns) > 1]
        two = among(pair for pair in combinations(units, 2) if not {*pair[0].columns} & {*pair[1].columns})
        best, cures = two if two[0] < best / falls else (best, cures)
    if made is not None and shifts and not enough(best):
        others = [name for one in found for name in one.columns if name not in made.readings]
        others = [name for name in dict.fromkeys(others) if np.isfinite(data[name]).any()]
        best, cures = among([_zero_off(name, data[name], left)] for name in others)
    if not enough(best):
        return "", []
    # so it is in some rows; now in all of them, the wild ones with small weights
    now = np.inf if made is None else left((), surely=True)
    sure = [(rest, one) for one in cures if (rest := left(one, surely=True)) < now / falls]
    times = plain(now / min((rest for rest, _ in sure), default=now), 2) if made is not None else ""
    return times, [", and ".join(_words(one, data) for one in cure) for _, cure in sure]


def _zero_off(name: str, column: Numbers, left: Callable[[Sequence[Mistake]], float]) -> Mistake:
    """Return the best shift of a column of a table: calibration leaves least with it."""

    def rest(by: float) -> float:
        return left([mistakes.moved({name: column}, name, by)])

    places = (np.nanmax(column) - np.nanmin(column)) * np.linspace(-1.0, 1.0, _SHIFTS)
    best = int(np.argmin([rest(by) for by in places]))
    bounds = places[max(best - 1, 0)], places[min(best + 1, _SHIFTS - 1)]
    xatol = 1e-4 * float(places[1] - places[0])
    return mistakes.moved({name: column}, name, float(minimize_scalar(rest, bounds=bounds, options={"xatol": xatol}).x))


def _left(
    machine: Machine, data: MeasuredData, changes: Sequence[Mistake], *, stands: bool, surely: bool = False
) -> float:  # fmt: skip
    """Return what calibration leaves of a table without mistakes, in the units of the table as it stands.

    Where that one `stands` by itself, any may be nearer; else infinity is returned of one that is far from the machine.
    """
    known = description_of(machine.name)
    noise = {one.key: 1.0 for one in known.stated or () if one.key.startswith("sigma")}
    most = _ROWS if surely else _FEW
    few = np.unique(np.linspace(1, len(data) - 2, min(len(data), most)).astype(int))  # of the ends a row may be missing
    changed = {name: column for one in changes for name, column in one.columns.items()}
    data = replace(data.with_columns(changed).rows(few), metadata={**noise, **data.metadata})
    try:
        made = machine.formulate(data)
        with np.errstate(all="ignore"):
            model = Model(made)
            even = np.ones(np.shape(model.residuals(model.start)))
            x = robust(model, even) if surely else weighted_fit(model, model.start, even)
            left = np.asarray(model.residuals(x))
            if left.size < _ROWS_A_PARAMETER * model.size:
                return np.inf
            if not stands and not _misfit(made, model.quantities(x)[0]) < _NEAR:
                return np.inf
    except (DataError, np.linalg.LinAlgError):
        return np.inf
    kinds = [left[rows] for rows, _ in _kinds(made)]
    total = sum(len(one) * np.log(np.maximum(np.median(np.abs(one), axis=0), _TINY)).sum() for one in kinds)
    reads = getattr(made, "reads", None)
    measured = {*known.read_from} & {*made.readings} or {*known.read_from} - {*inputs_of(made)}
    for one in changes:  # what is read and what it is read over are in another unit: so is what is left
        both = one.kind is Kind.UNIT and {*one.columns} - measured
        for name in measured & {*one.columns} if both else ():
            total -= np.log(one.by) * (len(left) if reads is None else reads(name).sum())
    return float(np.exp(total / left.size)) if np.isfinite(total) else np.inf


def _kinds(formulation: Formulation) -> list[tuple[NDArray[np.int_], Formulation]]:
    """Return the rows of each kind, all those in which the same columns are read, and the formulation over them."""
    reads = getattr(formulation, "reads", None)
    if reads is None:
        return [(np.arange(len(formulation.data)), formulation)]
    read = np.stack([reads(name) for name in formulation.readings], axis=-1)
    kinds, of = np.unique(read, axis=0, return_inverse=True)
    rows = [np.flatnonzero(np.ravel(of) == k) for k in range(len(kinds))]
    if len(rows) == 1:
        return [(rows[0], formulation)]
    return [(own, formulation.on(formulation.data.rows(own))) for own in rows]


def _misfit(formulation: Formulation, q: Mapping[str, Numbers], part: float = 0.5) -> float:
    """Return the constraint at `q` that a `part` of the rows keeps, relative to that of shuffled ones, the worst."""
    order = np.random.default_rng(0)
    mixed = {name: order.permutation(value) if np.ndim(value) else value for name, value in q.items()}
    with np.errstate(all="ignore"):
        here, there = (np.quantile(np.abs(formulation.constraints(at)), part, axis=0) for at in (q, mixed))
        shares = np.where((there > 0) & np.isfinite(here) & np.isfinite(there), here / there, 1.0)
    return float(np.max(shares))


def _cures(formulation: Formulation, q: Mapping[str, Numbers], whole: Formulation) -> Iterator[tuple[float, str]]:
    """Yield what is left without each mistake, and it in words."""
    found, unit_of = _mistakes_of(formulation, q)
    for one in found:
        yield _misfit(formulation, {**q, **one.columns}), _words(one, formulation.data)
    own_units = description_of(formulation.data.machine).own_units
    for name, unit in unit_of.items():
        if unit in ("rad", ""):
            yield _shifted(formulation, q, name, "" if own_units and not unit else " rad")
    first = whole.on(whole.data.rows(np.arange(min(len(whole.data), _ROWS))))
    at = Model(first).quantities()[0]
    for one in _rows_off(first, at):
        yield _misfit(first, {**at, **one.columns}), _words(one, first.data)


def _in_part(whole: Formulation) -> Iterator[tuple[float, str]]:
    """Yield the same of mistakes of the first rows or the last: units, and rows that are off after one was lost."""
    q, order = Model(whole).quantities()[0], np.random.default_rng(0)
    mixed = {name: order.permutation(value) if np.ndim(value) else value for name, value in q.items()}

    def off(columns: Mapping[str, Numbers]) -> Array:
        with np.errstate(all="ignore"):
            return np.asarray(np.abs(whole.constraints({**q, **columns})))

    size = np.nanmedian(off(mixed), axis=0) + _TINY

    def left(columns: Mapping[str, Numbers]) -> Array:
        return np.asarray(np.nan_to_num(np.minimum(off(columns) / size, 1.0), nan=1.0).sum(axis=1))

    as_read = left({})
    for one in [one for one in _mistakes_of(whole, q)[0] if one.kind is Kind.UNIT] + _rows_off(whole, q):
        cured = left(one.columns)
        for part in (part for first in (False, True) for part in mistakes.in_part(one, q, as_read, cured, first)):
            yield _misfit(whole, {**q, **part.columns}, _OF_ALL), _words(part, whole.data)


def _two_units(few: Formulation, q: Mapping[str, Numbers], _whole: Formulation) -> Iterator[tuple[float, str]]:
    """Yield the same of two units of two kinds of columns."""
    units = [one for one in _mistakes_of(few, q)[0] if one.kind is Kind.UNIT and one.unit in _USUAL]
    for pair in combinations(units, 2):
        if not {*pair[0].columns} & {*pair[1].columns}:
            columns = {**pair[0].columns, **pair[1].columns}
            yield _misfit(few, {**q, **columns}), ", and ".join(_words(one, few.data) for one in pair)


def _mistakes_of(formulation: Formulation, q: Mapping[str, Numbers]) -> tuple[list[Mistake], dict[str, str]]:
    """Return what may be wrong in all rows of what is read and of inputs, and the units of these."""
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
    stated = formulation.data.units
    unstated = [names for group in by_unit if (names := tuple(n for n in group if n not in stated))]
    together = [*dict.fromkeys((*groups, *by_unit, *unstated, *((name,) for name in unit_of)))]
    return [*_mistakes(q, unit_of, together, groups, formulation.data)], unit_of


def _rows_off(formulation: Formulation, q: Mapping[str, Numbers]) -> list[Mistake]:
    """Return one kind of column shifted by a row: two files that were put side by side."""
    inputs, alike = inputs_of(formulation), kinds_of(formulation.sensors)
    sides = [tuple(inputs)] if inputs else [tuple(sensor.column for sensor in kind) for kind in alike]
    some = sides if inputs or len(sides) > 1 else []
    return [mistakes.a_row_off(q, names, rows) for names in some for rows in (-1, 1)]


def _mistakes(
    columns: Mapping[str, Numbers], unit_of: Mapping[str, str], together: Sequence[tuple[str, ...]],
    alike: Sequence[tuple[str, ...]], data: MeasuredData,
) -> Iterator[Mistake]:  # fmt: skip
    """Yield mistakes of `columns`: units and signs of what is read `together`, two exchanged of what is `alike`."""
    stated = _stated(data)
    for names in together:
        unit = stated.get(names[0]) or unit_of[names[0]]
        yield from mistakes.in_units(columns, names, (factors_near(unit) if unit else _UNKNOWN).items())
        yield mistakes.reversed_in(columns, names)
    for both in dict.fromkeys(pair for names in alike for pair in combinations(names, 2)):
        yield mistakes.exchanged(columns, *both)
    for three in dict.fromkeys(names for names in alike if len(names) == 3):
        yield mistakes.exchanged(columns, *three)
        yield mistakes.exchanged(columns, *reversed(three))


def _stated(data: MeasuredData) -> dict[str, str]:
    """Return the units that the file states, also of columns that were turned from them."""
    turned = (note for note in data.notes if note.code is Code.UNIT_TURNED)
    return {**data.units, **{name: note.values.get("stated", "") for note in turned for name in note.columns}}


def _words(mistake: Mistake, data: MeasuredData) -> str:
    """Return how a mistake of these data is cured, as the end of "the readings are near to the model ..."."""
    names, by = [*mistake.columns], mistake.by
    listed, one = ", ".join(names), len(names) == 1
    are, they = ("is", "it") if one else ("are", "they")
    where = ""
    if mistake.rows:
        first, end = mistake.rows
        row = data.rows_named(np.array([first or end - 1]))
        where = f" from {row} on" if first else f" up to {row}"
    if mistake.kind is Kind.EXCHANGED:
        if len(names) > 2:
            return f"if {', '.join(f'{a} is called {b}' for a, b in zip(names[1:] + names[:1], names))}"
        return f"if {names[0]} and {names[1]} are exchanged: each may stand under the name of the other"
    if mistake.kind is Kind.ROWS:
        after, late = ("after", "late") if by < 0 else ("before", "early")
        why = "there one is missing, or one too many" if where else f"{they} {'comes' if one else 'come'} a row {late}"
        return f"if {listed} {are} taken from the row {after}{where}: {why}"
    if mistake.kind is Kind.ZERO:
        return f"if {plain(by, 3, '+')}{mistake.unit} is added to {listed}: its zero is that far off"
    if mistake.kind is Kind.SIGN:
        return f"if {listed} {are} multiplied by -1: {they} {'counts' if one else 'count'} the other way round"
    if where:
        other = f"{they} {'looks' if one else 'look'} like {mistake.unit} there"
        return f"if {listed} {are} multiplied by {by:.6g}{where}: {other}; bring all rows to one unit"
    missing = json.dumps(dict.fromkeys(names, mistake.unit), ensure_ascii=False)
    way_out = f"{'looks' if one else 'look'} like {mistake.unit}; state the unit of the column: units={missing}"
    if description_of(data.machine).own_units:  # stating a unit changes nothing
        both = "file and model are in units that differ by this factor"
        way_out = f"{both}; write one of them in those of the other"
    elif {*names} & {*_stated(data)}:
        way_out = f"the unit that is stated is wrong by this factor; units={missing} states another"
    return f"if {listed} {are} multiplied by {by:.6g}: {way_out}"


def _shifted(formulation: Formulation, q: Mapping[str, Numbers], name: str, unit: str) -> tuple[float, str]:
    """Return the best shift of an angle; one that a parameter makes within its bounds is no cure."""

    def misfit(shift: float) -> float:
        return _misfit(formulation, {**q, name: np.asarray(q[name]) + shift})

    places = np.linspace(-pi, pi, _TURN, endpoint=False)
    best = float(min(places, key=misfit))
    width = 2 * pi / _TURN
    best = float(min(np.linspace(best - width, best + width, 41), key=misfit))
    words = _words(replace(mistakes.moved(q, name, best), unit=unit), formulation.data)
    slopes = formulation.slopes(q)
    for p in formulation.parameters:
        same, mirrored = (np.allclose(slopes[p.name], sign * slopes[name], rtol=1e-6) for sign in (1.0, -1.0))
        if same or mirrored:
            there = p.start + (best if same else -best)
            more = f" or start {p.name} at {plain(there, 3)}, outside its bounds {p.lower:g} to {p.upper:g}"
            return np.inf if p.lower <= there <= p.upper else misfit(best), f"{words}; add it{more}"
    return misfit(best), words
