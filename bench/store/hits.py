"""The long table of targets, ``hits.parquet``: a row a run and target, null where it was never reached.

A target is of the *value* (`level` is the value that reaches it), or of what only the answer tells (`level` is NaN, and
the row's column named `quantity` is compared with `target`): an error in mm or rad, or a figure of merit. The table is
made from runs and traces some thousand runs at a time. Which targets there are is said by a table of levels, a row
each: problem, problem_options, data_id, quantity, target, level (`bench.statistics.targets`). Where it has a column
`inside` that is true, a run whose answer lies outside the box reaches none of these.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from calibench.bench.execution.merit import PREFIX, offered
from calibench.bench.store.crossings import (
    NEVER,
    Counts,
    Crossings,
    Points,
    by_the_answer,
    crossings,
    joined,
    tightened,
)
from calibench.bench.store.schema import HITS_SCHEMA, to_pandas

Array = NDArray[np.float64]
PROBLEM = ["problem", "problem_options", "data_id"]
NEEDED = (
    "run_id", *PROBLEM, "status", "stop_reason", "best_value", "best_evaluation", "evaluations",
    "jacobian_evaluations", "charged", "targets", "hits", "hits_charged", "wall_s", "code_digest", "judged_value",
    "judged_evaluations", "inside_box",
)  # fmt: skip  # columns of runs besides those that quantities name
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
    rows: dict[tuple[Any, ...], set[float]] = {}
    for *key, listed, own in zip(*(runs[name] for name in (*PROBLEM, "targets", "target")), strict=True):
        levels = rows.setdefault(tuple(key), set())
        levels.update(float(level) for level in listed)
        if own is not None and own == own:
            levels.add(float(own))
    told = [
        dict(zip(PROBLEM, key, strict=True)) | {"quantity": "value", "target": level, "level": level}
        for key, levels in rows.items()
        for level in sorted(levels, reverse=True)
    ]
    return pd.DataFrame(told, columns=[*PROBLEM, "quantity", "target", "level"])


def hit_tables(rows: pa.Table, traces: Iterable[pa.Table], levels: pd.DataFrame) -> Iterator[pa.Table]:
    """Yield tables of `HITS_SCHEMA` for `rows` (columns of `columns_for`), whose traces stand in the same order.

    A run's rows stand together, its targets in the order of `levels`.
    """
    by_problem = {key: mine for key, mine in levels.groupby(PROBLEM, sort=False, dropna=False)}
    for chunk, points in _chunks(rows, traces):
        frame = offered(to_pandas(chunk)) if "merit" in chunk.column_names else to_pandas(chunk)
        yield _hits(frame.reset_index(drop=True), points, by_problem)


def _hits(runs: pd.DataFrame, points: Points, by_problem: Mapping[Any, pd.DataFrame]) -> pa.Table:
    tables = []
    keys = runs.groupby(PROBLEM, sort=False, dropna=False).ngroup().to_numpy()
    first = points.first
    for number in dict.fromkeys(keys.tolist()):
        at = np.flatnonzero(keys == number)
        mine = runs.iloc[at].reset_index(drop=True)
        levels = by_problem.get(tuple(mine[PROBLEM].iloc[0]))
        if levels is None or levels.empty:
            continue
        counts = points.counts[at]
        where = np.repeat(first[at] - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())
        some = Points(points.evaluations[where], points.charged[where], points.values[where], counts)
        tables.append((at, mine, levels, _crossed(mine, some, levels)))
    return _in_run_order(tables)


def _crossed(runs: pd.DataFrame, points: Points, levels: pd.DataFrame) -> Crossings:
    """Return the crossings of the runs of one problem, shape (runs, levels)."""
    best_evaluation = runs["best_evaluation"].to_numpy(dtype=np.int64)
    noisy = runs["judged_evaluations"].notna().to_numpy()
    ours = runs["code_digest"].notna().to_numpy()
    parts = []
    for _, some in levels.groupby((levels["quantity"] != levels["quantity"].shift()).cumsum(), sort=False):
        name, level = str(some["quantity"].iloc[0]), some["level"].to_numpy(dtype=float)
        if np.isfinite(level).all():
            found = _by_value(runs, points, level, ours, best_evaluation)
            if noisy.any():  # a lucky value reaches nothing: the answer as it was judged does
                judged = runs["judged_value"].to_numpy(dtype=float)[:, None] <= level
                found = _where(noisy, by_the_answer(points, best_evaluation, judged), found)
            if "inside" in some and bool(some["inside"].iloc[0]):
                outside = ~runs["inside_box"].fillna(False).to_numpy(dtype=bool)
                found = _where(outside, Crossings.none(len(runs), len(some)), found)
        else:
            told = runs[name].to_numpy(dtype=float) if name in runs else np.full(len(runs), np.nan)
            with np.errstate(invalid="ignore"):
                reached = np.abs(told)[:, None] <= some["target"].to_numpy(dtype=float)
            found = by_the_answer(points, best_evaluation, reached & (best_evaluation > 0)[:, None])
        parts.append(found)
    found = joined(parts)
    lost = (runs["status"] == "failed").to_numpy()  # it has no answer that was judged, whatever it passed
    return _where(lost, Crossings.none(len(runs), len(levels)), found)


def _by_value(runs: pd.DataFrame, points: Points, level: Array, ours: Any, best_evaluation: Counts) -> Crossings:
    found = crossings(points, level, ours)
    for listed, at in _alike(runs["targets"]):
        declared = np.array(listed, dtype=float)
        hits, charged = (
            np.array([[NEVER if v is None else v for v in lists[i]] for i in at], dtype=np.int64)
            for lists in (runs[name].tolist() for name in ("hits", "hits_charged"))  # one by one each is a new array
        )
        mine = Crossings(*(getattr(found, name)[at] for name in Crossings.__annotations__))
        better = tightened(mine, level, declared, hits.reshape(len(at), -1), charged.reshape(len(at), -1))
        for name in Crossings.__annotations__:
            getattr(found, name)[at] = getattr(better, name)
    last = best_evaluation[:, None]  # the answer itself, whose evaluation is known exactly
    is_last = (runs["best_value"].to_numpy(dtype=float)[:, None] <= level) & (found.evaluations > last) & (last > 0)
    found.evaluations[is_last] = np.broadcast_to(last, is_last.shape)[is_last]
    found.evaluations_after[is_last] = np.minimum(found.evaluations_after, last - 1)[is_last]
    plain = is_last & (runs["jacobian_evaluations"].to_numpy() == 0)[:, None]  # with Jacobians their share is unknown
    found.charged[plain] = np.broadcast_to(last, is_last.shape)[plain]
    found.charged_after[plain] = np.minimum(found.charged_after, last - 1)[plain]
    return found


def _alike(targets: pd.Series) -> Iterator[tuple[list[float], Counts]]:
    """Yield each list of declared levels with the places of the runs that have it."""
    where: dict[tuple[float, ...], list[int]] = {}
    for i, listed in enumerate(targets):
        where.setdefault(tuple(listed), []).append(i)
    for listed, at in where.items():
        yield list(listed), np.array(at, dtype=np.int64)


def _where(runs: Any, these: Crossings, others: Crossings) -> Crossings:
    chosen = np.asarray(runs)[:, None]
    return Crossings(
        *(np.where(chosen, getattr(these, name), getattr(others, name)) for name in Crossings.__annotations__)
    )


def _in_run_order(tables: list[tuple[Any, pd.DataFrame, pd.DataFrame, Crossings]]) -> pa.Table:
    """Return the rows of all problems as one table, in the order of the runs."""
    if not tables:
        return HITS_SCHEMA.empty_table()
    made, order = [], []
    for at, runs, levels, found in tables:
        n, m = found.evaluations.shape
        counts = {name: getattr(found, name).ravel() for name in Crossings.__annotations__}
        never = counts["evaluations"] == NEVER
        ended = np.repeat(runs["evaluations"].to_numpy(), m)
        exact = counts["evaluations"] - counts["evaluations_after"] == 1
        seconds = np.repeat(runs["wall_s"].to_numpy(dtype=float), m)
        columns = {
            "run_id": pa.array(runs["run_id"], pa.string()).take(pa.array(np.repeat(np.arange(n), m))),
            "quantity": pa.array(levels["quantity"], pa.string()).take(pa.array(np.tile(np.arange(m), n))),
            "target": pa.array(np.tile(levels["target"].to_numpy(dtype=float), n)),
            "seconds": pa.array(seconds, mask=never | ~exact | (counts["evaluations"] != ended)),
        } | {name: pa.array(values, mask=never) for name, values in counts.items()}
        made.append(pa.table([columns[name] for name in HITS_SCHEMA.names], schema=HITS_SCHEMA))
        order.append(np.repeat(at, m))
    whole = pa.concat_tables(made)
    if len(made) == 1:
        return whole
    return whole.take(pa.array(np.argsort(np.concatenate(order), kind="stable")))


def _chunks(rows: pa.Table, traces: Iterable[pa.Table]) -> Iterator[tuple[pa.Table, Points]]:
    """Yield rows, some thousand at a time, with their points."""
    ids = rows["run_id"].combine_chunks()
    held: list[pa.Table] = []
    begin = 0
    for batch in traces:
        place = pc.index_in(batch["run_id"], value_set=ids)
        known = batch.append_column("_row", place).filter(pc.is_valid(place))
        if len(known):
            held.append(known)
            end = int(known["_row"][-1].as_py())  # of this run there may be more to come
            if end - begin >= _CHUNK // 4:
                whole = pa.concat_tables(held)
                done = pc.less(whole["_row"], end)
                yield from _cut(rows, whole.filter(done), begin, end)
                held, begin = [whole.filter(pc.invert(done))], end
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
