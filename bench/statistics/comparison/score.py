"""The order of runs: first those that reached the goal, then those that paid less, then those with the lower value.

All tests compare runs by this order alone, so no scale is needed, and no cost must be invented for a run that never
reached the goal. The goal is that of `bench.statistics.summary.goal`; without one, runs are ordered by value.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench.bench.statistics.answers import answers
from calibench.bench.statistics.summary import alike, goal_hits

Array = NDArray[np.float64]
By = Literal["goal", "value", "charged"]


def scores(runs: pd.DataFrame, by: By = "goal") -> Array:
    """Return for each run a pair of numbers, shape (runs, 2): smaller is better, the first decides.

    ``by="goal"``: (charged at the goal, 0) for a run that reached it, (infinite, value) for another; ``"value"``: only
    the value of the answer, infinite where there is none; ``"charged"``: only the total charge of the run, infinite
    where it failed or ran out of time.
    """
    values = answers(runs)
    values = np.where(np.isnan(values), np.inf, values)
    zeros = np.zeros(len(runs))
    if by == "charged":
        ended = (runs["status"] == "ok").to_numpy()  # a run that crashed at its second call is not the cheapest
        return np.column_stack([np.where(ended, runs["charged"].to_numpy(dtype=float), np.inf), zeros])
    if by == "value":
        return np.column_stack([zeros, values])
    hits = goal_hits(runs)
    reached = np.isfinite(hits)
    return np.column_stack([np.where(reached, hits, np.inf), np.where(reached, 0.0, values)])


def order_of(pairs: Array) -> Array:
    """Return the ranks of scores, shape (n, 2) -> (n,): 1 is best, those that are alike share their mean rank.

    Values that agree to nine digits are alike (`bench.statistics.summary.alike`).

    >>> order_of(np.array([[np.inf, 3.0], [20.0, 0.0], [np.inf, 1.0], [20.0, 0.0]])).tolist()
    [4.0, 1.5, 3.0, 1.5]
    """
    from scipy.stats import rankdata

    pairs = np.column_stack([pairs[:, 0], alike(pairs[:, 1])])
    different = np.unique(pairs, axis=0, return_inverse=True)[1].ravel()
    ranks: Array = rankdata(different)
    return ranks
