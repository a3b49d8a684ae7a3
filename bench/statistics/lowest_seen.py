"""The goal of a problem that declares none: the lowest value that was seen, as far as rounding can tell.

Of a problem without targets nobody knows when it is solved, and of values at the rounding floor the order is chance:
3e-30 is no better than 2e-28 where f began at 4. So a value is at the floor where it is at most `EPS` times f's own
scale above the declared minimum, or else above the lowest value that any run found inside the box; the scale is the
median size of the first value of a run. Where half of the runs of some method come that far, arriving there is the
goal, and its cost is read off the traces: at the first point of the trace, which may be up to a seventh too late.
Where none does, values differ by more than rounding, and they alone are compared.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from calibench.bench.statistics.answers import judged
from calibench.bench.statistics.cells import METHOD, PROBLEM
from calibench.bench.statistics.summary import goals_of

EPS = float(np.finfo(float).eps)
_SHARE = 0.5  # of the runs of some method, that come to the floor
COLUMN = "goal_is_lowest_seen"


def with_lowest_seen(runs: pd.DataFrame, traces: pd.DataFrame) -> pd.DataFrame:
    """Return the runs with targets and hits where their problem has none, and the column `goal_is_lowest_seen`."""
    runs = runs.assign(**{COLUMN: False})
    open_ = np.isnan(goals_of(runs)) & ~judged(runs)
    if not open_.any():
        return runs
    begun = traces.drop_duplicates("run_id").set_index("run_id")["best_value"]  # traces stand in order
    lists = {name: runs[name].to_list() for name in ("targets", "hits_charged")}
    for _, problem in runs[open_].groupby([*PROBLEM, "budget"], sort=False, dropna=False):
        found = (problem["status"] != "failed") & np.isfinite(problem["best_value"])
        inside = problem.loc[problem["inside_box"] & found, "best_value"]
        scale = begun.reindex(problem["run_id"]).abs()
        scale = scale[np.isfinite(scale)].median()
        if inside.empty or not scale > 0:
            continue
        declared = problem["minimum"].iloc[0]
        level = (inside.min() if pd.isna(declared) else float(declared)) + EPS * scale
        reached = found & (problem["best_value"] <= level)
        if reached.groupby([problem[name] for name in METHOD]).mean().max() < _SHARE:
            continue
        mine = traces[traces["run_id"].isin(problem["run_id"]) & (traces["best_value"] <= level)]
        first = mine.drop_duplicates("run_id").set_index("run_id")["charged"]
        for place, run_id in zip(runs.index.get_indexer(problem.index), problem["run_id"], strict=True):
            lists["targets"][place] = [level]
            lists["hits_charged"][place] = [first.get(run_id)]
        runs.loc[problem.index, COLUMN] = True
    return runs.assign(**{name: pd.Series(values, index=runs.index, dtype=object) for name, values in lists.items()})
