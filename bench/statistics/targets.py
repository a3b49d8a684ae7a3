"""The targets by which a study is read (docs/statistics.md): in the value, above the best, in noise, of the answer.

A problem that declares no target is given one by `with_lowest_seen`: the lowest value seen, as far as rounding can tell
(3e-30 is no better than 2e-28 where f began at 4). That is `EPS` times the median size of the first value of a run, or
a `SAME` part of itself, above the declared minimum, or else above the lowest value that any run found inside the box,
where half of the runs of some method come that far, and two runs at least; their cost is read off the traces.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from calibench.bench.execution.answer import PREFIX
from calibench.bench.statistics.cells import METHOD, PROBLEM, answers, by_cell, judged
from calibench.bench.statistics.summary import SAME, goals_of, lowest_below
from calibench.bench.statistics.tables import problem_of
from calibench.bench.store.columns import floats
from calibench.bench.store.hits import declared_levels
from calibench.core.options import suggest
from calibench.problems.base import extra_of
from calibench.problems.suites.black_box import COCO_GAPS

EPS = float(np.finfo(float).eps)
_SHARE = 0.5  # of the runs of some method, that come to the floor
COLUMN = "goal_is_lowest_seen"
LEVELS = [*PROBLEM, "quantity", "target", "level", "inside"]
_MM = (1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6)
_RAD = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
OF_THE_ANSWER: Mapping[str, tuple[float, ...]] = {
    "parameter_error_mm": _MM,
    "parameter_error_rad": _RAD,
    "parameter_error_mm_aligned": _MM,
    "parameter_error_rad_aligned": _RAD,
    "kmrmse": _MM,
    "kmrmse_aligned": _MM,
}  # what one would ask of a calibrated machine, and far below it


def levels_of(runs: pd.DataFrame, wanted: Mapping[str, Sequence[float]] | None = None) -> pd.DataFrame:
    """Return the targets of each problem in `runs`, a row each (columns `LEVELS`), the largest of a quantity first.

    `level` is the value that reaches the target, NaN of a quantity of the answer; `inside`: only an answer in the box
    can. `wanted` is {quantity: targets} in place of the defaults; `ValueError` for a quantity that the runs lack.
    """
    names = ["value", "gap", "noise", *OF_THE_ANSWER]
    figures = [str(name) for name in runs.columns if str(name).startswith(PREFIX)]
    for quantity in wanted or ():
        unread = quantity.startswith(PREFIX) and not figures and "merit" not in runs
        if quantity not in names and quantity not in runs and not unread:
            near = suggest(quantity, [*figures, *names])
            raise ValueError(f"there is no quantity {quantity!r} to set targets in; {near}")
        if quantity in figures and runs[quantity].dtype.kind not in "fiub":
            raise ValueError(f"{quantity} is text: a target is a number")
    asked: Mapping[str, Sequence[float] | None] = dict.fromkeys(names) if wanted is None else wanted
    least = references(runs).itertuples(index=False) if "gap" in asked else ()
    known = {tuple(row[:3]): (float(row[3]), bool(row[4])) for row in least}
    declared_of: dict[tuple[Any, ...], set[float]] = {}
    for *problem, level in declared_levels(runs)[[*PROBLEM, "target"]].itertuples(index=False):
        declared_of.setdefault(tuple(problem), set()).add(float(level))
    cells = by_cell(runs, PROBLEM)
    measured = {name: cells.sums(runs[name].notna()) > 0 for name in asked if name in runs}

    levels = []
    for i, key in enumerate(runs[PROBLEM].iloc[cells.first].itertuples(index=False, name=None)):
        reference, declared = known.get(key, (float("nan"), True))
        defaults = {**OF_THE_ANSWER, "value": declared_of.get(key, ()), "gap": COCO_GAPS, "noise": (1.0,)}
        for quantity, given in asked.items():
            targets = sorted(map(float, defaults[quantity] if given is None else given), reverse=True)
            if quantity == "value":
                rows = [(target, target) for target in dict.fromkeys(targets)]
            elif quantity == "noise":
                noise = _noise_level(dict(zip(PROBLEM, key, strict=True)))
                rows = [(target, target * noise) for target in targets if noise == noise]
            elif quantity == "gap":
                rows = [(target, reference + target) for target in targets if reference == reference]
            else:
                absent = given is None and not (quantity in measured and measured[quantity][i])
                rows = [] if absent else [(target, float("nan")) for target in targets]
            inside = quantity == "gap" and not declared
            levels += [(*key, quantity, target, level, inside) for target, level in rows]
    return pd.DataFrame(levels, columns=LEVELS).astype({"target": float, "level": float, "inside": bool})


def references(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the best value known of each problem: PROBLEM, reference, declared.

    That is the declared minimum, where no run fell below it, else the lowest value (judged, of noisy ones) in the box.
    """
    cells = by_cell(runs, PROBLEM)
    minimum = floats(runs["minimum"].iloc[cells.last])
    inside = runs["inside_box"].fillna(False).astype(bool).to_numpy()
    seen, values = floats(runs["best_value"]), answers(runs)
    declared = minimum == minimum
    below = cells.over(np.fmin, np.where(inside & np.isfinite(seen), seen, np.nan)) < minimum
    for i in np.flatnonzero(below).tolist():
        declared[i] = lowest_below(runs, float(minimum[i]), cells.rows(i)) is None
    lowest = cells.over(np.fmin, np.where(inside & np.isfinite(values), values, np.nan))
    problems = runs[PROBLEM].iloc[cells.first].reset_index(drop=True)
    return problems.assign(reference=np.where(declared, minimum, lowest), declared=declared)


def _noise_level(row: Mapping[str, Any]) -> float:
    """Return the value that the noise of the readings alone would leave, of the problem of a row; NaN: unknown.

    It is what the problem says itself, else the expectation of ``r @ r`` at the true parameters, by its declared noise.
    """
    try:
        problem = problem_of(row, "the level of its noise")
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


def with_lowest_seen(runs: pd.DataFrame, traces: pd.DataFrame) -> pd.DataFrame:
    """Return the runs with targets and hits where their problem has none, and the column `goal_is_lowest_seen`."""
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
