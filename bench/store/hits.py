"""The long table of targets, ``hits.parquet``: a row a run and target, null where it was never reached.

A target is of the *value* (`level` is the value that reaches it), or of what only the answer tells (`level` is NaN, and
the row's column named `quantity` is compared with `target`): an error in mm or rad, or a figure of merit. The table is
made from runs and traces some thousand runs at a time. Which targets there are is said by a table of levels, a row
each: problem, problem_options, data_id, quantity, target, level (`bench.statistics.targets`). Where it has a column
`inside` that is true, a run whose answer lies outside the box reaches none of these.

A trace is thinned (`bench.gate.evaluator`): it holds every improvement among the first 64 evaluations, later ones that
gain more than a tenth on the point before, and 16 marks a decade. So a crossing is known exactly where the level lies
more than that tenth below the point before; else it lies between two points, and nothing is interpolated. `evaluations`
and `charged` of a `Crossings` are the earliest counts at which the level was surely reached, `evaluations_after` and
`charged_after` the latest at which it surely was not. A level that the problem declares is exact, as the gate watched
it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from calibench.bench.execution.answer import PREFIX, offered
from calibench.bench.store.arrays import Lists, index_in, lists_of, mask_of, numbers
from calibench.bench.store.schema import HITS_SCHEMA, to_pandas

if TYPE_CHECKING:
    import pandas as pd

Counts = NDArray[np.int64]
NEVER = -1
_ALL_UNTIL, _GAIN = 64, 0.1  # as the gate records: every improvement until, later ones that gain this share


@final
@dataclass(frozen=True)
class Points:
    """The traces of some runs, one after the other: each array of shape (points,), `counts` of shape (runs,)."""

    evaluations: Counts
    charged: Counts
    values: Array
    counts: Counts

    @property
    def first(self) -> Counts:
        """Return where each run's points begin, shape (runs,)."""
        return np.concatenate([[0], np.cumsum(self.counts)[:-1]]).astype(np.int64)


@final
@dataclass(frozen=True)
class Crossings:
    """Counts of shape (runs, levels), `NEVER` where a level was not reached."""

    evaluations: Counts
    charged: Counts
    evaluations_after: Counts
    charged_after: Counts

    @classmethod
    def none(cls, runs: int, levels: int) -> Crossings:
        """Return crossings of which none happened."""
        return cls(*(np.full((runs, levels), NEVER, dtype=np.int64) for _ in range(4)))


def crossings(points: Points, levels: Array, thinned_as_ours: NDArray[np.bool_]) -> Crossings:
    """Return when each run first had a value at or below each of `levels`, shape (levels,), by its trace alone.

    `thinned_as_ours`, shape (runs,), tells whose trace was thinned by the rule above; of another nothing between two
    points is known.
    """
    found = Crossings.none(len(points.counts), len(levels))
    if not len(points.values) or not len(levels):
        return found
    order = np.argsort(-levels, kind="stable")  # the easiest first
    values = np.where(np.isnan(points.values), np.inf, points.values)
    reached = len(levels) - np.searchsorted(np.sort(levels), values, side="left")  # how many levels are at or above
    run = np.repeat(np.arange(len(points.counts)), points.counts)
    begins = np.zeros(len(run), dtype=bool)
    begins[points.first[points.counts > 0]] = True
    before = np.where(begins, 0, np.concatenate([[0], reached[:-1]]))
    new = np.maximum(reached - before, 0)
    at = np.repeat(np.arange(len(run)), new)  # the point of each crossing
    within = np.arange(len(at)) - np.repeat(np.cumsum(new) - new, new)
    level = order[before[at] + within]
    row, last = run[at], np.where(begins[at], at, at - 1)
    value_before = np.where(begins[at], np.inf, values[last])
    with np.errstate(invalid="ignore"):
        surely = levels[level] < value_before - _GAIN * np.abs(value_before)
    exact = ((points.evaluations[at] <= _ALL_UNTIL) | surely | ~np.isfinite(value_before)) & thinned_as_ours[row]
    for kind in ("evaluations", "charged"):
        count: Counts = getattr(points, kind)
        getattr(found, kind)[row, level] = count[at]
        between = np.where(begins[at], 0, count[last])
        getattr(found, f"{kind}_after")[row, level] = np.where(exact, count[at] - 1, between)
    return found


def tightened(found: Crossings, levels: Array, declared: Array, hits: Counts, hits_charged: Counts) -> Crossings:
    """Return crossings of `levels`, shape (levels,), by what the gate watched: the exact hits of `declared` levels.

    `declared` of shape (declared,), largest first; hits of shape (runs, declared), `NEVER` where there was none.
    """
    if not len(declared):
        return found
    columns = {name: getattr(found, name).copy() for name in Crossings.__annotations__}
    easier, harder = declared >= levels[:, None], declared <= levels[:, None]  # (levels, declared)
    nearest = {  # the declared level next to each, and whether there is one
        "harder": (np.argmax(harder, axis=1), harder.any(axis=1)),
        "easier": (len(declared) - 1 - np.argmax(easier[:, ::-1], axis=1), easier.any(axis=1)),
    }
    for kind, known in (("evaluations", hits), ("charged", hits_charged)):
        time, after = columns[kind], columns[f"{kind}_after"]
        of_harder, of_easier = (np.where(there, known[:, at], NEVER) for at, there in nearest.values())
        sooner = (of_harder != NEVER) & ((time == NEVER) | (of_harder < time))
        time[sooner] = of_harder[sooner]
        after[sooner] = np.minimum(np.where(after[sooner] == NEVER, 0, after[sooner]), of_harder[sooner] - 1)
        later = (of_easier != NEVER) & (time != NEVER) & (of_easier - 1 > after)
        after[later] = np.minimum(of_easier[later], time[later]) - 1
    return Crossings(**columns)


def by_the_answer(points: Points, best_evaluation: Counts, reached: NDArray[np.bool_]) -> Crossings:
    """Return crossings of what only the answer tells, such as its parameter error: where it was `reached`,
    shape (runs, levels), at the evaluation that proposed the answer; what earlier points were is not known.

    Charged are the evaluations until then and the Jacobians until the next point of the trace: at most so many.
    """
    charged = best_evaluation.copy()
    run = np.repeat(np.arange(len(points.counts)), points.counts)
    behind = np.flatnonzero(points.evaluations >= best_evaluation[run])
    rows, first = np.unique(run[behind], return_index=True)
    at = behind[first]
    charged[rows] += points.charged[at] - points.evaluations[at]

    def where(counts: Any) -> Counts:
        return np.where(reached, counts, NEVER).astype(np.int64)

    none = np.zeros((len(charged), 1), dtype=np.int64)
    return Crossings(where(best_evaluation[:, None]), where(charged[:, None]), where(none), where(none))


def joined(parts: Sequence[Crossings]) -> Crossings:
    """Return crossings of the levels of all parts, side by side."""
    return Crossings(
        **{name: np.concatenate([getattr(part, name) for part in parts], axis=1) for name in Crossings.__annotations__}
    )


Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
PROBLEM = ["problem", "problem_options", "data_id"]
NEEDED = (
    "run_id", *PROBLEM, "status", "stop_reason", "best_value", "best_evaluation", "evaluations",
    "jacobian_evaluations", "charged", "targets", "hits", "hits_charged", "wall_s", "code_digest", "judged_value",
    "judged_evaluations", "inside_box",
)  # fmt: skip  # columns of runs besides those that quantities name
_LISTS = ("targets", "hits", "hits_charged")
_CHUNK = 10_000  # runs at a time


def columns_for(quantities: Iterable[str]) -> list[str]:
    """Return the columns of runs that hits of these quantities are made from."""
    from calibench.bench.store.schema import RUNS_SCHEMA

    found = list(NEEDED)
    for quantity in quantities:
        if quantity.startswith(PREFIX):
            found.append("merit")
        elif quantity in RUNS_SCHEMA.names:
            found.append(quantity)
    return list(dict.fromkeys(found))


def declared_levels(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the levels that the runs themselves name: their problem's targets and the value that ends the run."""
    import pandas as pd

    known: dict[tuple[Any, ...], set[float]] = {}
    for *key, listed, own in zip(*(runs[name] for name in (*PROBLEM, "targets", "target")), strict=True):
        levels = known.setdefault(tuple(key), set())
        levels.update(float(level) for level in listed)
        if own is not None and own == own:
            levels.add(float(own))
    rows = [
        dict(zip(PROBLEM, key, strict=True)) | {"quantity": "value", "target": level, "level": level}
        for key, levels in known.items()
        for level in sorted(levels, reverse=True)
    ]
    return pd.DataFrame(rows, columns=[*PROBLEM, "quantity", "target", "level"])


def hit_tables(rows: pa.Table, traces: Iterable[pa.Table], levels: pd.DataFrame) -> Iterator[pa.Table]:
    """Yield tables of `HITS_SCHEMA` for `rows` (columns of `columns_for`), whose traces stand in the same order.

    A run's rows stand together, its targets in the order of `levels`.
    """
    by_problem = _by_problem(levels)
    for chunk, points in _chunks(rows, traces):
        yield _hits(chunk, points, by_problem)


@final
@dataclass(frozen=True)
class _Quantity:
    """The levels of one quantity on one problem: `target` and `level`, shapes (levels,).

    `inside` tells that only an answer inside the box can reach them.
    """

    name: str
    target: Array
    level: Array
    inside: bool


@final
@dataclass(frozen=True)
class _Runs:
    """Columns of some runs as arrays, of which those of a problem are cut at little cost; `told` are by quantity."""

    run_id: NDArray[np.object_]
    best_value: Array
    best_evaluation: Counts
    evaluations: Counts
    judged: Array
    seconds: Array
    noisy: Flags
    ours: Flags
    outside: Flags
    lost: Flags
    derivatives: Flags
    quantities: Mapping[str, Array]

    def some(self, at: Counts) -> _Runs:
        """Return the runs at these places."""
        cut = {name: getattr(self, name)[at] for name in _Runs.__annotations__ if name != "quantities"}
        return _Runs(**cut, quantities={name: values[at] for name, values in self.quantities.items()})


def _runs_of(frame: pd.DataFrame, quantities: Iterable[str]) -> _Runs:
    def counts(name: str) -> Counts:
        return frame[name].to_numpy(dtype=np.int64)

    def numbers(name: str) -> Array:
        return frame[name].to_numpy(dtype=float, na_value=np.nan)

    return _Runs(
        run_id=frame["run_id"].to_numpy(dtype=object),
        best_value=numbers("best_value"),
        best_evaluation=counts("best_evaluation"),
        evaluations=counts("evaluations"),
        judged=numbers("judged_value"),
        seconds=numbers("wall_s"),
        noisy=frame["judged_evaluations"].notna().to_numpy(),
        ours=frame["code_digest"].notna().to_numpy(),
        outside=~frame["inside_box"].fillna(False).to_numpy(dtype=bool),
        lost=(frame["status"] == "failed").to_numpy(dtype=bool),
        derivatives=frame["jacobian_evaluations"].fillna(0).to_numpy() != 0,  # imported rows do not say
        quantities={name: numbers(name) for name in quantities if name in frame},
    )


def _by_problem(levels: pd.DataFrame) -> dict[tuple[Any, ...], list[_Quantity]]:
    """Return the levels of each problem, those of a quantity that stand together as one."""
    found: dict[tuple[Any, ...], list[_Quantity]] = {}
    if levels.empty:
        return found
    problem = levels.groupby(PROBLEM, sort=False, dropna=False).ngroup().to_numpy()
    order = np.argsort(problem, kind="stable")
    rows = levels.iloc[order]
    names = rows["quantity"].to_numpy(dtype=object)
    target, level = (rows[name].to_numpy(dtype=float) for name in ("target", "level"))
    inside = rows["inside"].to_numpy(dtype=bool) if "inside" in rows else np.zeros(len(rows), dtype=bool)
    new = (names[1:] != names[:-1]) | (np.diff(problem[order]) != 0)
    begins = np.flatnonzero(np.concatenate([[True], new]))
    keys = rows[PROBLEM].iloc[begins].itertuples(index=False, name=None)
    for key, low, high in zip(keys, begins.tolist(), [*begins[1:].tolist(), len(rows)], strict=True):
        one = _Quantity(str(names[low]), target[low:high], level[low:high], bool(inside[low]))
        found.setdefault(key, []).append(one)
    return found


def _hits(chunk: pa.Table, points: Points, by_problem: Mapping[Any, Sequence[_Quantity]]) -> pa.Table:
    frame = to_pandas(chunk.drop_columns(list(_LISTS)))
    frame = offered(frame) if "merit" in frame else frame
    runs = _runs_of(frame, {one.name for levels in by_problem.values() for one in levels})
    lists = [lists_of(chunk[name]) for name in _LISTS]
    problem = frame.groupby(PROBLEM, sort=False, dropna=False).ngroup().to_numpy()
    order = np.argsort(problem, kind="stable")
    begins = np.flatnonzero(np.diff(problem[order], prepend=-1))
    keys = frame[PROBLEM].iloc[order[begins]].itertuples(index=False, name=None)
    tables = []
    first = points.first
    for key, at in zip(keys, np.split(order, begins[1:]), strict=True):
        levels = by_problem.get(key)
        if not levels:
            continue
        counts = points.counts[at]
        where = np.repeat(first[at] - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())
        some = Points(points.evaluations[where], points.charged[where], points.values[where], counts)
        mine = runs.some(at)
        tables.append((at, levels, _crossed(mine, some, levels, lists, at)))
    return _table(tables, runs)


def _crossed(runs: _Runs, points: Points, levels: Sequence[_Quantity], lists: Sequence[Lists], at: Counts) -> Crossings:
    """Return the crossings of the runs of one problem, shape (runs, levels); `at` are their places in `lists`."""
    parts = []
    for one in levels:
        if np.isfinite(one.level).all():
            found = _by_value(runs, points, one.level, lists, at)
            if runs.noisy.any():  # a lucky value reaches nothing: the answer as it was judged does
                judged = runs.judged[:, None] <= one.level
                found = _where(runs.noisy, by_the_answer(points, runs.best_evaluation, judged), found)
            if one.inside and runs.outside.any():
                found = _where(runs.outside, Crossings.none(len(at), len(one.level)), found)
        else:
            values = runs.quantities.get(one.name, np.full(len(at), np.nan))
            with np.errstate(invalid="ignore"):
                reached = np.abs(values)[:, None] <= one.target
            found = by_the_answer(points, runs.best_evaluation, reached & (runs.best_evaluation > 0)[:, None])
        parts.append(found)
    found = joined(parts)
    if not runs.lost.any():
        return found
    none = Crossings.none(*found.evaluations.shape)
    return _where(runs.lost, none, found)  # it has no answer that was judged, whatever it passed


def _by_value(runs: _Runs, points: Points, level: Array, lists: Sequence[Lists], at: Counts) -> Crossings:
    found = crossings(points, level, runs.ours)
    declared, *watched = lists
    for listed, places in declared.alike(at):
        hits, charged = (_counts(one.table(at[places])) for one in watched)
        mine = Crossings(*(getattr(found, name)[places] for name in Crossings.__annotations__))
        better = tightened(mine, level, listed, hits, charged)
        for name in Crossings.__annotations__:
            getattr(found, name)[places] = getattr(better, name)
    last = runs.best_evaluation[:, None]  # the answer itself, whose evaluation is known exactly
    is_last = (runs.best_value[:, None] <= level) & (found.evaluations > last) & (last > 0)
    if not is_last.any():
        return found
    found.evaluations[is_last] = np.broadcast_to(last, is_last.shape)[is_last]
    found.evaluations_after[is_last] = np.minimum(found.evaluations_after, last - 1)[is_last]
    plain = is_last & ~runs.derivatives[:, None]  # with Jacobians their share is unknown
    found.charged[plain] = np.broadcast_to(last, is_last.shape)[plain]
    found.charged_after[plain] = np.minimum(found.charged_after, last - 1)[plain]
    return found


def _counts(table: Array) -> Counts:
    return np.where(np.isnan(table), NEVER, table).astype(np.int64)


def _where(runs: Any, these: Crossings, others: Crossings) -> Crossings:
    chosen = np.asarray(runs)[:, None]
    return Crossings(
        *(np.where(chosen, getattr(these, name), getattr(others, name)) for name in Crossings.__annotations__)
    )


def _table(tables: Sequence[tuple[Counts, Sequence[_Quantity], Crossings]], runs: _Runs) -> pa.Table:
    """Return the rows of all problems as one table, in the order of the runs."""
    if not tables:
        return HITS_SCHEMA.empty_table()
    counts = {
        name: np.concatenate([getattr(found, name).ravel() for _, _, found in tables])
        for name in Crossings.__annotations__
    }
    sizes = [sum(len(one.target) for one in levels) for _, levels, _ in tables]
    run = np.concatenate([np.repeat(at, size) for (at, _, _), size in zip(tables, sizes, strict=True)])
    names = list(dict.fromkeys(one.name for _, levels, _ in tables for one in levels))
    target, quantity = (
        np.concatenate([np.tile(np.concatenate(one), len(at)) for (at, _, _), one in zip(tables, by, strict=True)])
        for by in (
            [[one.target for one in levels] for _, levels, _ in tables],
            [[np.full(len(one.target), names.index(one.name)) for one in levels] for _, levels, _ in tables],
        )
    )
    order = np.argsort(run, kind="stable")
    counts = {name: values[order] for name, values in counts.items()}
    run, target, quantity = run[order], target[order], quantity[order]
    never = counts["evaluations"] == NEVER
    exact = counts["evaluations"] - counts["evaluations_after"] == 1
    at_the_end = ~never & exact & (counts["evaluations"] == runs.evaluations[run])
    columns = {
        "run_id": pa.array(runs.run_id, pa.string()).take(pa.array(run)),
        "quantity": pa.array(names, pa.string()).take(pa.array(quantity)),
        "target": pa.array(target),
        "seconds": pa.array(runs.seconds[run], mask=~at_the_end),
    } | {name: pa.array(values, mask=never) for name, values in counts.items()}
    return pa.table([columns[name] for name in HITS_SCHEMA.names], schema=HITS_SCHEMA)


def _chunks(rows: pa.Table, traces: Iterable[pa.Table]) -> Iterator[tuple[pa.Table, Points]]:
    """Yield rows, some thousand at a time, with their points."""
    ids = rows["run_id"].combine_chunks()
    held: list[pa.Table] = []
    begin = 0
    for batch in traces:
        place = index_in(batch["run_id"], ids)
        known = batch.append_column("_row", place).filter(place.is_valid())
        if len(known):
            held.append(known)
            end = int(known["_row"][-1].as_py())  # of this run there may be more to come
            if end - begin >= _CHUNK // 4:
                whole = pa.concat_tables(held)
                done = numbers(whole["_row"]) < end
                yield from _cut(rows, whole.filter(mask_of(done)), begin, end)
                held, begin = [whole.filter(mask_of(~done))], end
    rest = pa.concat_tables(held) if held else None
    yield from _cut(rows, rest, begin, len(rows))


def _cut(rows: pa.Table, points: pa.Table | None, begin: int, end: int) -> Iterator[tuple[pa.Table, Points]]:
    empty = np.empty(0, dtype=np.int64)
    row = empty if points is None else points["_row"].to_numpy().astype(np.int64)
    columns = [
        np.empty(0) if points is None else points[name].to_numpy() for name in ("evaluations", "charged", "best_value")
    ]
    for low in range(begin, end, _CHUNK):
        high = min(low + _CHUNK, end)
        span = slice(*np.searchsorted(row, [low, high]))
        evaluations, charged, values = (column[span] for column in columns)
        counts = np.bincount(row[span] - low, minlength=high - low).astype(np.int64)
        yield (
            rows.slice(low, high - low),
            Points(evaluations.astype(np.int64), charged.astype(np.int64), values.astype(float), counts),
        )
