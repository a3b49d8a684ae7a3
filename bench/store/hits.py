"""The long table of targets, ``hits.parquet``: a row a run and target, null where it was never reached.

A target is of the *value* (`level` is the value that reaches it), or of what only the answer tells (`level` is NaN, and
the row's column named `quantity` is compared with `target`). Which there are says a table of levels
(`bench.statistics.targets`); where its column `inside` is true, a run whose answer lies outside the box reaches none.

A trace is thinned (`bench.gate.evaluator`): a crossing is known exactly among the first evaluations and where the level
lies more than a tenth below the point before; else it lies between two points, and nothing is interpolated. Crossings,
shape (4, runs, levels), are `_COUNTS`: when the level was surely reached, and until when it surely was not; or `NEVER`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from calibench.bench.execution.answer import PREFIX, offered
from calibench.bench.store import arrays
from calibench.bench.store.arrays import Array, Counts, Flags, Lists
from calibench.bench.store.columns import columns_of, floats, known, numbered, plain, true

if TYPE_CHECKING:
    import pandas as pd

NEVER = -1
_ALL_UNTIL, _GAIN = 64, 0.1  # as the gate records: every improvement until, later ones that gain this share
PROBLEM = ["problem", "problem_options", "data_id"]
NEEDED = (
    "run_id", *PROBLEM, "status", "stop_reason", "best_value", "best_evaluation", "evaluations",
    "jacobian_evaluations", "charged", "targets", "hits", "hits_charged", "wall_s", "code_digest", "judged_value",
    "judged_evaluations", "inside_box",
)  # fmt: skip  # columns of runs besides those that quantities name
_LISTS = ("targets", "hits", "hits_charged")
_CHUNK = 1_000  # runs at a time, of which there may be a hundred times as many rows
_COUNTS = ("evaluations", "charged", "evaluations_after", "charged_after")  # of crossings, along their first axis


@final
@dataclass(frozen=True)
class Points:
    """The traces of some runs, one after the other: each array of shape (points,), `counts` of shape (runs,)."""

    evaluations: Counts
    charged: Counts
    values: Array
    counts: Counts


def crossings(points: Points, levels: Array, thinned_as_ours: Flags) -> Counts:
    """Return when each run first had a value at or below each of `levels`, shape (levels,), by its trace alone.

    `thinned_as_ours`, shape (runs,): whose trace was thinned by the rule above; else nothing between points is known.
    """
    found = np.full((4, len(points.counts), len(levels)), NEVER, dtype=np.int64)
    if not len(points.values) or not len(levels):
        return found
    order = np.argsort(-levels, kind="stable")  # the easiest first
    values = np.where(np.isnan(points.values), np.inf, points.values)
    reached = len(levels) - np.searchsorted(np.sort(levels), values, side="left")  # how many levels are at or above
    run = np.repeat(np.arange(len(points.counts)), points.counts)
    begins = np.diff(run, prepend=-1) > 0
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
    for k, count in enumerate((points.evaluations, points.charged)):
        found[k, row, level] = count[at]
        found[k + 2, row, level] = np.where(exact, count[at] - 1, np.where(begins[at], 0, count[last]))
    return found


def _by_the_answer(points: Points, best_evaluation: Counts, reached: Flags) -> Counts:
    """Return crossings of what only the answer tells: where it was `reached`, at the evaluation that proposed it.

    Charged are the evaluations until then and the Jacobians until the next point of the trace: at most so many.
    """
    charged = best_evaluation.copy()
    run = np.repeat(np.arange(len(points.counts)), points.counts)
    behind = np.flatnonzero(points.evaluations >= best_evaluation[run])
    rows, first = np.unique(run[behind], return_index=True)
    at = behind[first]
    charged[rows] += points.charged[at] - points.evaluations[at]
    counts = np.stack([best_evaluation, charged, np.zeros_like(charged), np.zeros_like(charged)])
    return np.where(reached, counts[:, :, None], NEVER)


def columns_for(quantities: Iterable[str]) -> list[str]:
    """Return the columns of runs that hits of these quantities are made from."""
    columns = ["merit" if name.startswith(PREFIX) else name for name in quantities]
    return list(dict.fromkeys([*NEEDED, *(name for name in columns if name in arrays.RUNS_SCHEMA.names)]))


def declared_levels(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the levels that the runs themselves name: their problem's targets and the value that ends the run."""
    import pandas as pd

    number, targets = numbered(runs[name] for name in PROBLEM), arrays.lists_of(runs["targets"])
    place, different = pd.factorize(np.concatenate([targets.flat, floats(runs["target"])]))  # NaN is -1
    problem = np.concatenate([number[targets.row], number])
    keys = [*runs[PROBLEM].iloc[np.unique(number, return_index=True)[1]].itertuples(index=False, name=None)]
    known: dict[tuple[Any, ...], set[float]] = {key: set() for key in keys}
    for pair in pd.unique(problem[place >= 0] * len(different) + place[place >= 0]).tolist():
        known[keys[pair // len(different)]].add(float(different[pair % len(different)]))
    rows = [(*key, "value", level, level) for key, levels in known.items() for level in sorted(levels, reverse=True)]
    return pd.DataFrame(rows, columns=[*PROBLEM, "quantity", "target", "level"])


def hit_tables(rows: pa.Table, traces: Iterable[pa.Table], levels: pd.DataFrame) -> Iterator[pa.Table]:
    """Yield tables of `HITS_SCHEMA` for `rows` (columns of `columns_for`), whose traces stand in the same order."""
    # the levels of each problem, those of a quantity that stand together as one
    by_problem: dict[tuple[Any, ...], list[_Quantity]] = {}
    if not levels.empty:
        problem = levels.groupby(PROBLEM, sort=False, dropna=False).ngroup().to_numpy()
        order = np.argsort(problem, kind="stable")
        named = levels.iloc[order]
        names = named["quantity"].to_numpy(dtype=object)
        target, level = (named[name].to_numpy(dtype=float) for name in ("target", "level"))
        inside = named["inside"].to_numpy(dtype=bool) if "inside" in named else np.zeros(len(named), dtype=bool)
        new = (names[1:] != names[:-1]) | (np.diff(problem[order]) != 0)
        begins = np.flatnonzero(np.concatenate([[True], new]))
        keys = zip(*(plain(named[name].iloc[begins]) for name in PROBLEM), strict=True)
        for key, low, high in zip(keys, begins.tolist(), [*begins[1:].tolist(), len(named)], strict=True):
            one = _Quantity(str(names[low]), target[low:high], level[low:high], bool(inside[low]))
            by_problem.setdefault(key, []).append(one)

    ids = rows["run_id"].combine_chunks()
    held: list[pa.Table] = []
    begin = 0
    for batch in traces:
        place = arrays.index_in(batch["run_id"], ids)
        here = batch.append_column("_row", place).filter(place.is_valid())
        if not len(here):
            continue
        held.append(here)
        end = int(here["_row"][-1].as_py())  # of this run there may be more to come
        if end - begin >= _CHUNK:
            whole = pa.concat_tables(held)
            done = arrays.numbers(whole["_row"]) < end
            for chunk, points in _cut(rows, whole.filter(arrays.mask_of(done)), begin, end):
                yield _hits(chunk, points, by_problem)
            held, begin = [whole.filter(arrays.mask_of(~done))], end
    rest = pa.concat_tables(held) if held else None
    for chunk, points in _cut(rows, rest, begin, len(rows)):
        yield _hits(chunk, points, by_problem)


@final
@dataclass(frozen=True)
class _Quantity:
    """The levels of one quantity on one problem; `inside`: only an answer inside the box can reach them."""

    name: str
    target: Array
    level: Array
    inside: bool


_Runs = Mapping[str, NDArray[Any]]  # columns of some runs as arrays: those of a problem are cut at little cost


def _hits(chunk: pa.Table, points: Points, by_problem: Mapping[Any, Sequence[_Quantity]]) -> pa.Table:
    """Return the rows of all problems as one table, in the order of the runs."""
    quantities = {one.name for levels in by_problem.values() for one in levels}
    figures: Any = offered(arrays.to_pandas(chunk.select(["merit"]))) if "merit" in chunk.column_names else {}
    columns = {**columns_of(chunk), **{name: figures[name] for name in figures if name in quantities}}
    measured = {name for name in ("best_value", "judged_value", "wall_s", *quantities) if name in columns}
    runs: _Runs = {
        **{name: floats(columns[name]) for name in measured},
        **{name: arrays.numbers(columns[name]) for name in ("best_evaluation", "evaluations")},
        "noisy": known(columns["judged_evaluations"]),
        "ours": known(columns["code_digest"]),
        "outside": ~true(columns["inside_box"]),
        "lost": np.array([status == "failed" for status in plain(columns["status"])], dtype=bool),
        "derivatives": arrays.numbers(columns["jacobian_evaluations"]) != 0,  # imported rows do not say
    }
    lists = [arrays.lists_of(chunk[name]) for name in _LISTS]
    problem = numbered(columns[name] for name in PROBLEM)
    order = np.argsort(problem, kind="stable")
    begins = np.flatnonzero(np.diff(problem[order], prepend=-1))
    keys = zip(*(plain(columns[name].take(pa.array(order[begins]))) for name in PROBLEM), strict=True)
    first = np.cumsum(points.counts) - points.counts
    parts = []  # of each problem and quantity: the runs, targets, places of the names, and crossings
    names: dict[str, int] = {}
    for key, at in zip(keys, np.split(order, begins[1:]), strict=True):
        levels = by_problem.get(key)
        if not levels:
            continue
        counts = points.counts[at]
        where = np.repeat(first[at] - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())
        some = Points(points.evaluations[where], points.charged[where], points.values[where], counts)
        found = _crossed({name: values[at] for name, values in runs.items()}, some, levels, lists, at)
        target = np.concatenate([one.target for one in levels])
        named = np.repeat(
            [names.setdefault(one.name, len(names)) for one in levels], [len(one.target) for one in levels]
        )
        parts.append(
            (np.repeat(at, len(target)), np.tile(target, len(at)), np.tile(named, len(at)), found.reshape(4, -1))
        )
    if not parts:
        return arrays.HITS_SCHEMA.empty_table()
    run, target, quantity, counts = (np.concatenate(values, axis=-1) for values in zip(*parts, strict=True))
    if len(parts) > 1:
        order = np.argsort(run, kind="stable")
        run, target, quantity, counts = run[order], target[order], quantity[order], counts[:, order]
    never = counts[0] == NEVER
    at_the_end = ~never & (counts[0] - counts[2] == 1) & (counts[0] == runs["evaluations"][run])
    filled = {
        "run_id": chunk["run_id"].combine_chunks().take(pa.array(run)),
        "quantity": pa.array(list(names), pa.string()).take(pa.array(quantity)),
        "target": pa.array(target),
        "seconds": pa.array(runs["wall_s"][run], mask=~at_the_end),
    } | {name: pa.array(values, mask=never) for name, values in zip(_COUNTS, counts, strict=True)}
    return pa.table([filled[name] for name in arrays.HITS_SCHEMA.names], schema=arrays.HITS_SCHEMA)


def _crossed(runs: _Runs, points: Points, levels: Sequence[_Quantity], lists: Sequence[Lists], at: Counts) -> Counts:
    """Return the crossings of the runs of one problem; `at` are their places in `lists`."""
    parts = []
    answer = runs["best_evaluation"]
    declared, *counted = lists
    watched = []  # of runs with the same declared levels: these, places of the runs, and when each was reached
    for listed, places in declared.alike(at):
        tables = [each.flat[each.begins[at[places], None] + np.arange(len(listed))] for each in counted]
        if len(listed):
            watched.append((listed, places, [np.where(np.isnan(t), NEVER, t).astype(np.int64) for t in tables]))
    for one in levels:
        if not np.isfinite(one.level).all():
            values = runs.get(one.name, np.full(len(at), np.nan))
            with np.errstate(invalid="ignore"):
                reached = np.abs(values)[:, None] <= one.target
            parts.append(_by_the_answer(points, answer, reached & (answer > 0)[:, None]))
            continue
        found = crossings(points, one.level, runs["ours"])
        for listed, places, hits in watched:
            # by what the gate watched, the exact hits of declared levels, largest first: the one next to each level
            some = found[:, places]
            easier, harder = listed >= one.level[:, None], listed <= one.level[:, None]  # (levels, declared)
            next_harder = np.argmax(harder, axis=1), harder.any(axis=1)  # which, and whether there is one
            next_easier = len(listed) - 1 - np.argmax(easier[:, ::-1], axis=1), easier.any(axis=1)
            for time, after, hit in zip(some[:2], some[2:], hits, strict=True):
                of_harder, of_easier = (np.where(yes, hit[:, k], NEVER) for k, yes in (next_harder, next_easier))
                sooner = (of_harder != NEVER) & ((time == NEVER) | (of_harder < time))
                time[sooner] = of_harder[sooner]
                after[sooner] = np.minimum(np.where(after[sooner] == NEVER, 0, after[sooner]), of_harder[sooner] - 1)
                later = (of_easier != NEVER) & (time != NEVER) & (of_easier - 1 > after)
                after[later] = np.minimum(of_easier[later], time[later]) - 1
            found[:, places] = some
        last = answer[:, None]  # the answer itself, whose evaluation is known exactly
        is_last = (runs["best_value"][:, None] <= one.level) & (found[0] > last) & (last > 0)
        plain = is_last & ~runs["derivatives"][:, None]  # with Jacobians their share is unknown
        for k, flags in ((0, is_last), (1, plain)):
            found[k] = np.where(flags, last, found[k])
            found[k + 2] = np.where(flags, np.minimum(found[k + 2], last - 1), found[k + 2])
        if runs["noisy"].any():  # a lucky value reaches nothing: the answer as it was judged does
            judged = _by_the_answer(points, answer, runs["judged_value"][:, None] <= one.level)
            found = np.where(runs["noisy"][:, None], judged, found)
        parts.append(np.where(runs["outside"][:, None], NEVER, found) if one.inside else found)
    return np.where(runs["lost"][:, None], NEVER, np.concatenate(parts, axis=2))  # lost: no answer, whatever it passed


def _cut(rows: pa.Table, points: pa.Table | None, begin: int, end: int) -> Iterator[tuple[pa.Table, Points]]:
    names = ("_row", "evaluations", "charged", "best_value")
    row, *columns = (np.empty(0) if points is None else points[name].to_numpy() for name in names)
    row = row.astype(np.int64)
    for low in range(begin, end, _CHUNK):
        high = min(low + _CHUNK, end)
        span = slice(*np.searchsorted(row, [low, high]))
        evaluations, charged, values = (column[span] for column in columns)
        counts = np.bincount(row[span] - low, minlength=high - low).astype(np.int64)
        yield (
            rows.slice(low, high - low),
            Points(evaluations.astype(np.int64), charged.astype(np.int64), values.astype(float), counts),
        )
