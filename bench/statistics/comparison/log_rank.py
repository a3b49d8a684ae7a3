"""Hits that not all runs had, compared as lifetimes: the log-rank test of the costs to one target.

A run that the budget, the time limit or its own target ended is censored at what it was charged: it might have arrived
later. A run that stopped by its own test or failed would never have arrived: it stays at risk beyond all others.
Source: `scipy.stats.logrank` and its references.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench.bench.gate.stop_reason import BY_GATE

Array = NDArray[np.float64]


def log_rank(first: tuple[Array, Array], second: tuple[Array, Array]) -> tuple[float, float]:
    """Return statistic (above 0: the first arrives sooner) and two-sided p of two methods' costs to one target.

    Each is (time, censored), shapes (runs,): `time` is infinite where the target was not reached, and `censored` is how
    long the run was at risk then (`at_risk`). NaN where neither ever reached it, or where no run of one side was at
    risk when runs of the other reached it.
    """
    from scipy.stats import CensoredData, logrank

    if not any(np.isfinite(time).any() for time, _ in (first, second)):
        return float("nan"), float("nan")
    beyond = 1 + max(float(values[np.isfinite(values)].max(initial=0.0)) for pair in (first, second) for values in pair)

    def lifetimes(time: Array, risk: Array) -> CensoredData:
        reached = np.isfinite(time)
        return CensoredData(uncensored=time[reached], right=np.minimum(risk[~reached], beyond))

    with np.errstate(invalid="ignore", divide="ignore"):
        found = logrank(lifetimes(*first), lifetimes(*second))
    return float(found.statistic), float(found.pvalue)


def at_risk(runs: pd.DataFrame) -> Array:
    """Return how long each run could have reached a target, shape (runs,): its charge, or infinite.

    It is infinite where the run had ended by itself.
    """
    goes_on = runs["stop_reason"].isin(BY_GATE).to_numpy()
    risk: Array = np.where(goes_on, runs["charged"].to_numpy(dtype=float), np.inf)
    return risk
