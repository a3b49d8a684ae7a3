"""Ranking of methods: their places within the tasks, with ties, and their mean. Unsolved tasks count.

Medians of different problems have no common scale, and a sum over solved problems would favour a method that solves
few; places have neither fault. Values at the floor are tied, because below it they differ by rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from calibench.bench.statistics.by_cell import by_number
from calibench.bench.statistics.cells import METHOD, TASK
from calibench.bench.statistics.names.labels import in_order
from calibench.bench.statistics.summary import alike
from calibench.bench.store.columns import Array, Columns, Counts, floats, numbered, plain

if TYPE_CHECKING:
    import pandas as pd


def places(cells: Columns) -> Array:
    """Return the place of each cell on its task, shape (cells,): 1 is best, ties share their mean.

    A cell is a row of `bench.statistics.summary.summary`. The order is by the share of runs at the goal, then the cost
    to get there, then the median value, as far as the floor and to nine digits.
    """
    success, cost = floats(cells["success"]), floats(cells["charged_to_target"])
    keys = np.column_stack(
        [
            np.where(np.isnan(success), 0.0, -success),
            np.where(np.isnan(cost), np.inf, cost),
            np.maximum(floats(cells["best_median"]), floats(cells["floor"])),
        ]
    )
    tasks, found = by_number(_tasks(cells)), np.empty(len(keys))
    for task in range(len(tasks.count)):
        mine = tasks.rows(task)
        keys[mine, 2] = alike(keys[mine, 2])
        _, place, ties = np.unique(keys[mine], axis=0, return_inverse=True, return_counts=True)
        found[mine] = (np.cumsum(ties) - (ties - 1) / 2)[place.ravel()]
    return found


def best_first(cells: pd.DataFrame) -> pd.DataFrame:
    """Return cells with a column `method` (its name), best first (`order_of`), and their `place`."""
    return cells.assign(place=places(cells)).iloc[order_of(cells)].reset_index(drop=True)


def order_of(cells: Columns) -> Counts:
    """Return the order of cells with a column `method`: best first on each task; ties by failed runs, then by name.

    Problems stand by name, then by their options, numbers as numbers.
    """
    pairs = list(zip(plain(cells["problem"]), plain(cells["problem_options"]), strict=True))
    keys = [
        _ranks(pairs, lambda pair: [in_order(text) for text in pair]),
        _ranks(plain(cells["start"]), lambda start: (start is None, start)),  # published runs tell none
        floats(cells["budget"]),
        -floats(cells["goal"]),
        places(cells),
        floats(cells["failed"]),
        _ranks(plain(cells["method"])),
    ]
    return np.lexsort(keys[::-1])  # what is NaN stands last


def _ranks(values: Sequence[Any], key: Callable[[Any], Any] | None = None) -> Counts:
    """Return the place of each value among those that differ."""
    place = {value: i for i, value in enumerate(sorted(set(values), key=key))}
    return np.array([place[value] for value in values], dtype=np.int64)


def methods(cells: pd.DataFrame) -> pd.DataFrame:
    """Return a row a method (columns optimizer, optimizer_options), best first, over all tasks of `cells`.

    rank (ties share the lowest), solved (mean share of runs at the goal) and place (mean), both over the tasks on which
    it was run; tasks (how many these are), of_tasks. A method that was run on fewer tasks stands behind those that were
    run on more: what was not run is not known.
    """
    import pandas as pd

    placed = cells.assign(place=places(cells), task=_tasks(cells))
    total = placed["task"].nunique()
    rows = []
    for pair, own in placed.groupby(METHOD, sort=False):
        place, solved = _means(own, "place"), _means(own[own["goal"].notna()], "success")
        rows.append(
            dict(zip(METHOD, pair, strict=True))
            | {
                "solved": sum(solved.values()) / len(solved) if solved else np.nan,
                "place": sum(place.values()) / len(place),
                "tasks": len(place),
                "of_tasks": total,
            }
        )
    order = ["tasks", "solved", "place"]
    found = pd.DataFrame(rows).sort_values(order, ascending=[False, False, True], kind="stable")
    alike = found[order].fillna(0.0).round(12).apply(tuple, axis=1).tolist()
    found.insert(0, "rank", [1 + alike.index(triple) for triple in alike])  # in order: the first of those alike
    return found.reset_index(drop=True)


def _means(cells: pd.DataFrame, column: str) -> dict[int, float]:
    """Return task -> the mean of its values."""
    import pandas as pd

    values: dict[int, list[float]] = {}
    for task, value in zip(cells["task"].tolist(), cells[column].tolist(), strict=True):
        values.setdefault(task, []).append(value)
    return {task: found[0] if len(found) == 1 else float(pd.Series(found).mean()) for task, found in values.items()}


def _tasks(cells: Columns) -> Counts:
    """Return the number of each cell's task."""
    return numbered(cells[name] for name in TASK)
