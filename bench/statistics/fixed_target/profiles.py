"""Profiles: the share of problems that a method solves within so many times the best, or so many simplex gradients.

A performance profile (Dolan and More, 2002) counts tasks whose ERT is within `ratio` times the least ERT of any method;
a data profile (More and Wild, 2009) those whose ERT is within `groups` of dimension + 1 evaluations. A task is a
problem under one start, budget and target; one that no method reached counts in the whole, as solved by none. Counted
are the tasks on which all methods were run, and where there is none, of each method its own.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from calibench.bench.statistics.cells import METHOD, PROBLEM

_TASK = [*PROBLEM, "start", "budget", "target_value", "quantity", "target"]


def performance_profile(table: pd.DataFrame) -> pd.DataFrame:
    """Return the steps of each method's profile: optimizer, optimizer_options, ratio (>= 1), share, tasks, of_tasks.

    `table` is what `runtime.ert` returns, best of one quantity. From `ratio` on the method has solved `share` of the
    `tasks` within it.
    """
    cost = table["ert"].astype(float)  # of a table without rows it is none
    best = cost.groupby([table[key] for key in _TASK], dropna=False).transform("min")
    with np.errstate(invalid="ignore"):
        ratio = np.where(np.isfinite(cost), cost / best, np.inf)
    return _steps(table.assign(ratio=ratio), "ratio")


def data_profile(table: pd.DataFrame) -> pd.DataFrame:
    """Return the steps of each method's data profile: optimizer, optimizer_options, groups, share, tasks, of_tasks.

    `groups` is ERT / (dimension + 1): how many simplex gradients it could have paid.
    """
    return _steps(table.assign(groups=table["ert"] / (table["dimension"] + 1)), "groups")


def _steps(table: pd.DataFrame, by: str) -> pd.DataFrame:
    table = table.assign(task=table.groupby(_TASK, dropna=False, sort=False).ngroup())
    tasks_of = {key: set(own["task"]) for key, own in table.groupby(METHOD, sort=False)}
    shared = set.intersection(*tasks_of.values()) if tasks_of else set()
    found = []
    for key, own in table.groupby(METHOD, sort=False):
        over = shared or tasks_of[key]
        costs = np.sort(own.loc[own["task"].isin(over), by].to_numpy(dtype=float))
        at, counts = np.unique(costs[np.isfinite(costs)], return_counts=True)
        share = np.cumsum(counts) / len(over)
        steps = pd.DataFrame({by: at, "share": share}) if len(at) else pd.DataFrame({by: [np.inf], "share": [0.0]})
        named = pd.DataFrame([key] * len(steps), columns=METHOD)
        found.append(pd.concat([named, steps.assign(tasks=len(over), of_tasks=table["task"].nunique())], axis=1))
    columns = [*METHOD, by, "share", "tasks", "of_tasks"]
    return pd.concat(found, ignore_index=True)[columns] if found else pd.DataFrame(columns=columns)
