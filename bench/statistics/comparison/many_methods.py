"""Many methods on many problems: Friedman's test, and whose mean ranks differ (Nemenyi, or Holm against the best).

A block is a task: a problem (with its instance) under one start, budget and goal. Repetitions are never blocks: they
tell nothing of other problems, so a block has the median over them of each run's rank among all runs of the task.
Below `FEWEST` blocks there is no test, and it says why not.

Source: Demsar, J. Machine Learning Research 7 (2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench.bench.statistics.by_cell import by_cell, by_number
from calibench.bench.statistics.cells import TASK
from calibench.bench.statistics.comparison.holm import holm
from calibench.bench.statistics.comparison.score import By, order_of, scores
from calibench.bench.statistics.summary import goals_of, method_names

Array = NDArray[np.float64]
FEWEST = 10  # blocks, below which chi squared is far from Friedman's statistic and ranks say little


@final
@dataclass(frozen=True)
class Blocks:
    """What each method did in each block: `medians`, shape (blocks, methods), the smaller the better.

    `methods` are their names; `left_out` says what was left out, '' where nothing was.
    """

    methods: tuple[str, ...]
    medians: Array
    left_out: str = ""

    @property
    def ranks(self) -> Array:
        """Return the ranks within each block, shape (blocks, methods): 1 is best, ties share their mean."""
        from scipy.stats import rankdata

        found: Array = rankdata(self.medians, axis=1)
        return found


@final
@dataclass(frozen=True)
class Ranked:
    """Friedman's test of some methods, and their mean ranks, best first.

    `refused` says why there is no test ('' where there is one): then the numbers are NaN. `critical_difference` is
    Nemenyi's: mean ranks further apart differ at `level`. `nemenyi`, shape (methods, methods), and `against_best`,
    shape (methods,), are p-values; the second by Holm, NaN of the best itself.
    """

    methods: tuple[str, ...]
    mean_ranks: Array
    blocks: int
    statistic: float
    p: float
    critical_difference: float
    nemenyi: Array
    against_best: Array
    level: float
    refused: str
    left_out: str

    def groups(self) -> list[tuple[int, int]]:
        """Return the longest spans (first, last) of methods whose mean ranks differ by less than the difference."""
        found: list[tuple[int, int]] = []
        for i, rank in enumerate(self.mean_ranks):
            last = int(np.flatnonzero(self.mean_ranks - rank < self.critical_difference).max(initial=i))
            if last > i and (not found or last > found[-1][1]):
                found.append((i, last))
        return found


def blocks_of(runs: pd.DataFrame, by: By = "goal") -> Blocks:
    """Return the blocks of `runs` in which every method was run, with the median rank of each method in each."""
    rows = runs.reset_index(drop=True).assign(goal=goals_of(runs))
    rows["_method"], score = method_names(rows), scores(rows, by)
    number, listed = pd.factorize(rows["_method"])
    names = tuple(str(name) for name in listed)
    found, incomplete = [], 0
    tasks = by_cell(rows, TASK)
    for task in range(len(tasks.count)):
        at = tasks.rows(task)
        if len(np.unique(number[at])) == len(names):
            found.append(by_number(number[at].astype(np.int64)).medians(np.asarray(order_of(score[at]), dtype=float)))
        else:
            incomplete += 1
    told = f"{incomplete} tasks, on which not all {len(names)} methods were run, are left out" if incomplete else ""
    return Blocks(names, np.array(found, dtype=np.float64).reshape(len(found), len(names)), told)


def friedman(blocks: Blocks, level: float = 0.05) -> Ranked:
    """Return Friedman's test of the methods in `blocks`, with Nemenyi's and Holm's comparisons."""
    n, k = blocks.medians.shape
    mean = blocks.ranks.mean(axis=0) if n else np.full(k, np.nan)
    order = np.argsort(mean, kind="stable")
    methods, mean = tuple(blocks.methods[i] for i in order), mean[order]
    refused = ""
    if k < 3:
        refused = f"Friedman's test needs three methods, and there are {k}: compare the two by `bench compare`"
    elif n < FEWEST:
        refused = (
            f"Friedman's test needs {FEWEST} blocks (a problem with its instance; repetitions are none), and there are "
            f"{n}{': ' + blocks.left_out if blocks.left_out else ''}"
        )
    if refused:
        nothing = float("nan")
        table, row = np.full((k, k), nothing), np.full(k, nothing)
        return Ranked(methods, mean, n, nothing, nothing, nothing, table, row, level, refused, blocks.left_out)
    from scipy.stats import friedmanchisquare, norm, studentized_range  # half a second: only where there is a test

    if (blocks.ranks == blocks.ranks[:, :1]).all():  # alike everywhere
        statistic, p = 0.0, 1.0
    else:
        found = friedmanchisquare(*blocks.medians.T)
        statistic, p = float(found.statistic), float(found.pvalue)
    error = np.sqrt(k * (k + 1) / (6 * n))
    apart = np.abs(mean[:, None] - mean[None, :]) / error
    nemenyi = np.asarray(studentized_range.sf(apart * np.sqrt(2), k, np.inf), dtype=float)
    np.fill_diagonal(nemenyi, 1.0)
    against = np.full(k, np.nan)
    against[1:] = holm(2 * norm.sf(apart[0, 1:]))
    difference = float(studentized_range.ppf(1 - level, k, np.inf)) / np.sqrt(2) * error
    return Ranked(methods, mean, n, statistic, p, float(difference), nemenyi, against, level, "", blocks.left_out)
