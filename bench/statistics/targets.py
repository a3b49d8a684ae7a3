"""The targets by which a study is read: in the value, above the best, in the user's quantities, in reading noise.

Quantities, and what reaches a target of each:

- ``value``: the best value is at or below the target [the problem's unit]; by default the levels that the problem and
  the runs declare.
- ``gap``: the value is at most the target above the `reference`: the declared minimum, else the lowest value that any
  run of the study found inside the box; then a run whose answer lies outside reaches none. By default 51 levels.
- ``noise``: the value is at most the target times what the noise of the readings alone would leave at the true
  parameters, the sum of the variances of the residuals; only of problems that declare their noise, their truth and how
  it enters a residual. By default 1: as good as the noise.
- ``parameter_error_mm`` and the like, ``kmrmse``, ``merit.KEY``: the size of that column of the run's *answer*. It is
  known of no earlier point, so a hit stands at the evaluation that proposed the answer: the target was reached then,
  perhaps also before, and a run that passed it on the way to a worse answer has not reached it.

A run that failed reached nothing. Of noisy values the answer as judged counts, as for the quantities of the answer.

A problem that declares no target has none by which it is solved, and of values at the rounding floor the order is
chance: 3e-30 is no better than 2e-28 where f began at 4. `with_lowest_seen` gives it the lowest value seen as its goal,
as far as rounding can tell: at most `EPS` times f's own scale, the median size of the first value of a run, or a
`SAME` part of itself, above the declared minimum, or else above the lowest value that any run found inside the box; a
run whose answer lies outside does not reach it. It does so where half of the runs of some method come that far, and two
runs at least; their cost is read off the traces, at the first point of the trace, which may be up to a seventh too
late. Where none does, values differ by more than rounding, and they alone are compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from calibench.bench.execution.answer import PREFIX, offered
from calibench.bench.statistics.cells import METHOD, PROBLEM, answers, by_cell, judged
from calibench.bench.statistics.summary import SAME, goals_of, lowest_below
from calibench.bench.statistics.tables import problem_of
from calibench.bench.store.columns import floats
from calibench.bench.store.hits import columns_for, declared_levels
from calibench.bench.store.runs import ResultStore
from calibench.core.options import suggest
from calibench.problems.base import extra_of
from calibench.problems.suites.black_box import COCO_GAPS

EPS = float(np.finfo(float).eps)
_SHARE = 0.5  # of the runs of some method, that come to the floor
COLUMN = "goal_is_lowest_seen"
LEVELS = [*PROBLEM, "quantity", "target", "level", "inside"]
OF_THE_ANSWER: Mapping[str, tuple[float, ...]] = {
    "parameter_error_mm": (1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6),
    "parameter_error_rad": (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8),
    "parameter_error_mm_aligned": (1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6),
    "parameter_error_rad_aligned": (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8),
    "kmrmse": (1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6),
    "kmrmse_aligned": (1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6),
}  # [mm, rad]: what one would ask of a calibrated machine, and far below it
_NEEDED = [
    *PROBLEM, "targets", "target", "status", "best_value", "inside_box", "minimum", "judged_value",
    "judged_evaluations", "tampering",
]  # fmt: skip


def hits_of(store: ResultStore, levels: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the hits of a study for `levels`, by default all of `levels_of`, a row for each run and target.

    The columns are those of `HITS_SCHEMA`.
    """
    return store.hits(levels_of_study(store) if levels is None else levels)


def levels_of_study(store: ResultStore, wanted: Mapping[str, Sequence[float]] | None = None) -> pd.DataFrame:
    """Return `levels_of` the finished runs of a study, or of all studies of a folder."""
    return levels_of(store.runs(columns_for([*OF_THE_ANSWER, *(wanted or {}), *_NEEDED])), wanted)


def levels_of(runs: pd.DataFrame, wanted: Mapping[str, Sequence[float]] | None = None) -> pd.DataFrame:
    """Return the targets of each problem in `runs`, a row each: problem, problem_options, data_id, quantity, target,
    level, inside.

    `level` is the value that reaches the target, NaN of a quantity of the answer; `inside` tells that only a run whose
    answer lies in the box can reach it. `wanted` is {quantity: targets} in place of the defaults. The largest target
    stands first. Raises `ValueError` for a quantity that the runs do not have.
    """
    unread = "merit" in runs and any(name.startswith(PREFIX) and name not in runs for name in wanted or ())
    merits = offered(runs[["merit"]]) if unread else runs
    for quantity in wanted or ():
        _check_quantity(quantity, runs if quantity in runs else merits)
    levels = []
    asked: Mapping[str, Sequence[float] | None] = dict.fromkeys(["value", "gap", "noise", *OF_THE_ANSWER])
    asked = asked if wanted is None else wanted
    least = references(runs).itertuples(index=False) if "gap" in asked else ()
    known = {tuple(row[:3]): (float(row[3]), bool(row[4])) for row in least}
    declared_of: dict[tuple[Any, ...], list[float]] = {}
    for *names, level in declared_levels(runs)[[*PROBLEM, "target"]].itertuples(index=False):
        declared_of.setdefault(tuple(names), []).append(float(level))
    cells = by_cell(runs, PROBLEM)
    measured = {name: cells.sums(runs[name].notna()) > 0 for name in asked if name in runs}
    for i, key in enumerate(runs[PROBLEM].iloc[cells.first].itertuples(index=False, name=None)):
        reference, declared = known.get(key, (float("nan"), True))
        for quantity, targets in asked.items():
            if quantity == "value":
                values = declared_of.get(key, []) if targets is None else targets
                rows = [(float(t), float(t)) for t in sorted(set(values), reverse=True)]
            elif targets is None and quantity in OF_THE_ANSWER and not (quantity in measured and measured[quantity][i]):
                rows = []
            else:
                rows = _levels(quantity, targets, dict(zip(PROBLEM, key, strict=True)), reference)
            inside = quantity == "gap" and not declared
            levels += [(*key, quantity, target, level, inside) for target, level in rows]
    return pd.DataFrame(levels, columns=LEVELS).astype({"target": float, "level": float, "inside": bool})


def _check_quantity(quantity: str, runs: pd.DataFrame) -> None:
    known = ["value", "gap", "noise", *OF_THE_ANSWER]
    figures = [str(name) for name in runs.columns if str(name).startswith(PREFIX)]
    unread = quantity.startswith(PREFIX) and not figures and "merit" not in runs
    if quantity not in known and quantity not in runs and not unread:
        near = suggest(quantity, [*figures, *known])
        raise ValueError(f"there is no quantity {quantity!r} to set targets in; {near}")
    if quantity in figures and runs[quantity].dtype.kind not in "fiub":
        raise ValueError(f"{quantity} is text: a target is a number")


def references(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the best value known of each problem, a row each: problem, problem_options, data_id, reference, declared.

    It is the minimum that the problem declares, where no run fell below it, else the lowest value found by any run
    inside the box (of noisy values the lowest judged answer); `declared` tells which. NaN where no run found any.
    """
    cells = by_cell(runs, PROBLEM)
    minimum = floats(runs["minimum"].iloc[cells.last])
    inside = runs["inside_box"].fillna(False).astype(bool).to_numpy()
    seen, values = floats(runs["best_value"]), answers(runs)
    declared = minimum == minimum
    below = cells.least(np.where(inside & np.isfinite(seen), seen, np.nan)) < minimum
    for i in np.flatnonzero(below).tolist():
        declared[i] = lowest_below(runs.iloc[cells.rows(i)], float(minimum[i])) is None
    lowest = cells.least(np.where(inside & np.isfinite(values), values, np.nan))
    problems = runs[PROBLEM].iloc[cells.first].reset_index(drop=True)
    return problems.assign(reference=np.where(declared, minimum, lowest), declared=declared)


def _noise_level(row: Mapping[str, Any] | pd.Series) -> float:
    """Return the value that the noise of the readings alone would leave, of the problem of a row; NaN: unknown.

    It is what the problem says itself (`as_good_as_noise`), else the expectation of ``r @ r`` at the true parameters:
    the declared noise squared times the trace of the covariance of the residuals for noise of 1. A fit of p parameters
    is expected to end about p/m of it lower.
    """
    try:
        problem = problem_of(row, "the level that its noise leaves, where it has a truth and a noise")
    except ValueError:  # a user's own, that is not here any more
        return float("nan")
    if getattr(problem, "as_good_as_noise", None) is not None:  # an instance: the value at its truth, not the mean
        return float(problem.as_good_as_noise)
    truth = getattr(problem, "truth", None)
    noise = extra_of(problem, "options", {}).get("noise", getattr(problem, "noise", None))
    if truth is None or not isinstance(noise, int | float) or not noise > 0:
        return float("nan")
    if getattr(problem, "residual_covariance", None) is not None:
        return noise**2 * float(np.trace(problem.residual_covariance(truth)))
    if getattr(problem, "residual_noise", None) is not None:
        return noise**2 * float(np.sum(np.asarray(problem.residual_noise(truth)) ** 2))
    return float("nan")


def _levels(
    quantity: str, targets: Sequence[float] | None, problem: Mapping[str, Any], reference: float
) -> list[tuple[float, float]]:
    """Return (target, level) of one problem, the largest first."""
    if quantity == "noise":
        level = _noise_level(problem)
        listed = sorted((1.0,) if targets is None else targets, reverse=True)
        return [(float(t), float(t) * level) for t in listed] if level == level else []
    if quantity == "gap":
        if reference != reference:
            return []
        listed = sorted(COCO_GAPS if targets is None else targets, reverse=True)
        return [(float(t), reference + float(t)) for t in listed]
    wanted = OF_THE_ANSWER[quantity] if targets is None else targets
    return [(float(t), float("nan")) for t in sorted(wanted, reverse=True)]


def with_lowest_seen(runs: pd.DataFrame, traces: pd.DataFrame) -> pd.DataFrame:
    """Return the runs with targets and hits where their problem has none, and the column `goal_is_lowest_seen`.

    Runs that have that column already are returned as they are.
    """
    if COLUMN in runs:
        return runs
    runs = runs.assign(**{COLUMN: False})
    open_ = np.isnan(goals_of(runs)) & ~judged(runs)
    if not open_.any():
        return runs
    begun = traces.drop_duplicates("run_id").set_index("run_id")["best_value"]  # traces stand in order
    lists = {name: runs[name].to_list() for name in ("targets", "hits_charged")}
    for _, problem in runs[open_].groupby([*PROBLEM, "budget"], sort=False, dropna=False):
        answered = (problem["status"] != "failed") & np.isfinite(problem["best_value"])
        inside = problem.loc[problem["inside_box"] & answered, "best_value"]
        scale = begun.reindex(problem["run_id"]).abs()
        scale = scale[np.isfinite(scale)].median()
        if inside.empty or not scale > 0:
            continue
        declared = problem["minimum"].iloc[0]
        lowest = inside.min() if pd.isna(declared) else float(declared)
        level = lowest + max(EPS * scale, SAME * abs(lowest))
        reached = answered & problem["inside_box"] & (problem["best_value"] <= level)
        if reached.sum() < 2 or reached.groupby([problem[name] for name in METHOD]).mean().max() < _SHARE:
            continue
        mine = traces[traces["run_id"].isin(problem.loc[reached, "run_id"]) & (traces["best_value"] <= level)]
        first = mine.drop_duplicates("run_id").set_index("run_id")["charged"]
        for place, run_id in zip(runs.index.get_indexer(problem.index), problem["run_id"], strict=True):
            lists["targets"][place] = [level]
            lists["hits_charged"][place] = [first.get(run_id)]
        runs.loc[problem.index, COLUMN] = True
    return runs.assign(**{name: pd.Series(values, index=runs.index, dtype=object) for name, values in lists.items()})
