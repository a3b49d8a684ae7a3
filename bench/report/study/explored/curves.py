"""Convergence of every cell of a study at once: quartiles of the best value over charged evaluations.

The same numbers as `bench.statistics.summary.convergence`, which takes one cell at a time: here the runs of a problem
are read off in one search, so that ten thousand runs take a second.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from calibench.bench.statistics.summary import QUARTILES, quantiles
from calibench.bench.store.arrays import index_in

Array = NDArray[np.float64]


def bands(runs: pd.DataFrame, traces: pd.DataFrame, at: Array) -> Mapping[int, Array]:
    """Return for each number in the column `cell` of `runs` an array of shape (3, counts): q1, median, q3.

    They are the best values after `at` charged evaluations, shape (counts,). A run that has ended keeps its last value;
    before all runs of a cell have begun the quartiles are NaN; where too few of them have a value, infinite.
    """
    ids = pa.array(runs["run_id"], pa.string())
    row = index_in(pa.array(traces["run_id"], pa.string()), ids).to_numpy(zero_copy_only=False)
    known = ~np.isnan(row.astype(float))
    row, charged = row[known].astype(np.int64), traces["charged"].to_numpy(dtype=np.int64)[known]
    values = traces["best_value"].to_numpy(dtype=float)[known]
    order = np.lexsort((np.arange(len(row)), row))  # a trace keeps the order in which it was written
    row, charged, values = row[order], charged[order], values[order]
    most = max(int(charged.max(initial=0)), int(at.max(initial=0))) + 1
    key = row * most + charged
    begins = np.searchsorted(row, np.arange(len(runs) + 1))
    found = {}
    cells = runs["cell"].to_numpy()
    for cell in dict.fromkeys(cells.tolist()):
        mine = np.flatnonzero(cells == cell)
        last = np.searchsorted(key, mine[:, None] * most + at.astype(np.int64)[None, :], side="right") - 1
        begun = last >= begins[mine][:, None]
        stack = np.where(begun, values[np.maximum(last, 0)] if len(values) else np.nan, np.nan)
        stack[begins[mine] == begins[mine + 1]] = np.inf  # it ended before its first evaluation
        band = np.full((3, len(at)), np.nan)
        whole = ~np.isnan(stack).any(axis=0)
        if whole.any():
            band[:, whole] = quantiles(stack[:, whole], QUARTILES)
        found[int(cell)] = band
    return found
