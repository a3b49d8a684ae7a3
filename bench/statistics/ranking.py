"""Which method is best: its places within the tasks, with ties, and their mean. Tasks that it did not solve count, too.

Medians of different problems have no common scale, and a sum over solved problems would favour a method that solves
few; places have neither fault. Values at the floor are tied, because below it they differ by rounding.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from calibench.bench.statistics.cells import METHOD, TASK
from calibench.bench.statistics.names.labels import in_order


def places(cells: pd.DataFrame) -> pd.Series:
    """Return the place of each cell (a row of `bench.statistics.summary.summary`) on its task: 1 is best, ties share
    their mean.

    By the share of runs at the goal, then what it cost to get there, then the median value, as far as the floor.
    """
    keys = np.column_stack(
        [
            -cells["success"].fillna(0.0).to_numpy(dtype=float),
            cells["charged_to_target"].fillna(np.inf).to_numpy(dtype=float),
            np.maximum(cells["best_median"].to_numpy(dtype=float), cells["floor"].to_numpy(dtype=float)),
        ]
    )
    order = pd.Series(np.unique(keys, axis=0, return_inverse=True)[1].ravel(), index=cells.index)
    return order.groupby(_tasks(cells)).rank()


def best_first(cells: pd.DataFrame) -> pd.DataFrame:
    """Return cells with a column `method` (its name), task by task, the best first; ties by failed runs, then by name.

    Problems stand by name, then by their options, numbers as numbers.
    """
    pairs = set(zip(cells["problem"], cells["problem_options"], strict=True))
    tasks = sorted(pairs, key=lambda pair: [in_order(text) for text in pair])
    number = {pair: i for i, pair in enumerate(tasks)}
    problem = [number[pair] for pair in zip(cells["problem"], cells["problem_options"], strict=True)]
    order = ["_problem", "start", "budget", "goal", "place", "failed", "method"]
    return (
        cells.assign(place=places(cells), _problem=problem)
        .sort_values(order, ascending=[name != "goal" for name in order], kind="stable", na_position="last")
        .drop(columns="_problem")
        .reset_index(drop=True)
    )


def methods(cells: pd.DataFrame) -> pd.DataFrame:
    """Return a row a method (columns optimizer, optimizer_options), best first, over all tasks of `cells`.

    rank (ties share the lowest), solved (mean share of runs at the goal over the tasks that have one), place (mean),
    tasks (on how many it was run), of_tasks. On a task where it was not run a method has solved nothing and stands
    behind all that were.
    """
    placed = cells.assign(place=places(cells), task=_tasks(cells))
    goals = set(placed.loc[placed["goal"].notna(), "task"])
    total = len(cells[METHOD].drop_duplicates())
    listed = placed["task"].value_counts()
    tried = placed[["task", *METHOD]].drop_duplicates()["task"].value_counts()
    behind = {  # the mean of the places after the last, which those share that were not run
        task: int(listed[task]) + (total - int(tried[task]) + 1) / 2 for task in sorted(listed.index)
    }
    rows = []
    for pair, mine in placed.groupby(METHOD, sort=False):
        place, solved = _means(mine, "place"), _means(mine, "success")
        rows.append(
            dict(zip(METHOD, pair, strict=True))
            | {
                "solved": sum(solved.get(task, 0.0) for task in goals) / len(goals) if goals else np.nan,
                "place": sum(place.get(task, last) for task, last in behind.items()) / len(behind),
                "tasks": len(place),
                "of_tasks": len(behind),
            }
        )
    found = pd.DataFrame(rows).sort_values(["solved", "place"], ascending=[False, True], kind="stable")
    alike = list(zip(-found["solved"].fillna(0.0).round(12), found["place"].round(12), strict=True))
    found.insert(0, "rank", [1 + alike.index(pair) for pair in alike])  # in order: the first of those that are alike
    return found.reset_index(drop=True)


def _means(cells: pd.DataFrame, column: str) -> dict[int, float]:
    """Return task -> the mean of its values."""
    values: dict[int, list[float]] = {}
    for task, value in zip(cells["task"].tolist(), cells[column].tolist(), strict=True):
        values.setdefault(task, []).append(value)
    return {task: found[0] if len(found) == 1 else float(pd.Series(found).mean()) for task, found in values.items()}


def _tasks(cells: pd.DataFrame) -> pd.Series:
    """Return the number of each cell's task."""
    numbers: pd.Series = cells.groupby(TASK, sort=False, dropna=False).ngroup()
    return numbers
