"""When each run reached each target, problem by problem, as arrays: what ERT and runtime ECDF are computed from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, final, get_args

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from calibench.bench.statistics.cells import PROBLEM
from calibench.bench.statistics.fixed_target.instances import pooled
from calibench.bench.store.arrays import index_in
from calibench.core.options import suggest

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Currency = Literal["charged", "evaluations"]
TARGET = ["quantity", "target"]


@final
@dataclass(frozen=True)
class Runtimes:
    """The runs of one problem against its targets, as arrays.

    `all_runs` are those of all problems that have a hit, rows of runs with a column `instance`, and `all_targets` have
    the columns quantity, target; `at`, shape (runs,), and `level`, shape (targets,), are the places in them of those of
    this problem. `spent`, shape (runs,), is what each run was charged; `asked`, shape (runs, targets), tells which
    target is one of the run's; `time` and `earliest`, shape (runs, targets),
    are counts at which a target was surely reached and at which it may have been (a trace is thinned), infinite where
    it never was.
    """

    all_runs: pd.DataFrame
    all_targets: pd.DataFrame
    at: Counts
    level: Counts
    spent: Array
    asked: NDArray[np.bool_]
    time: Array
    earliest: Array

    @property
    def runs(self) -> pd.DataFrame:
        """Return the rows of the runs of this problem."""
        return self.all_runs.iloc[self.at].reset_index(drop=True)

    @property
    def targets(self) -> pd.DataFrame:
        """Return its targets."""
        return self.all_targets.iloc[self.level].reset_index(drop=True)

    @property
    def paid(self) -> Array:
        """Return what each run spent until each of its targets, or in vain, shape (runs, targets)."""
        return np.where(np.isfinite(self.time), self.time, np.where(self.asked, self.spent[:, None], 0.0))

    def cells(self, number: Counts) -> int:
        """Return how many cells there are here, by the `number` of the cell of each of all runs."""
        return len(set(number[self.at].tolist()))


def runtimes(
    hits: pd.DataFrame, runs: pd.DataFrame, currency: Currency = "charged", instances: Sequence[str] = ()
) -> Iterator[Runtimes]:
    """Yield the `Runtimes` of each problem in `runs`, in their order; runs without any target are left out.

    `hits` are rows of ``hits.parquet`` (or some of its targets), `runs` of ``runs.parquet``. Problems that differ only
    in the options `instances` (and their data) are one problem; its runs have a column `instance`. Raises `ValueError`
    for a currency that is none, and an option that no problem has.
    """
    if currency not in get_args(Currency):
        raise ValueError(f"there is no currency {currency!r}; {suggest(currency, get_args(Currency))}")
    rows = pooled(runs, instances)
    where = index_in(pa.array(hits["run_id"], pa.string()), pa.array(rows["run_id"], pa.string())).to_numpy(
        zero_copy_only=False
    )
    known = ~np.isnan(where.astype(float))
    seen, row = np.unique(where[known].astype(np.int64), return_inverse=True)
    rows = rows.iloc[seen].reset_index(drop=True)
    targets, code = _codes(hits.loc[known, TARGET])
    time = hits[currency].to_numpy(dtype=float, na_value=np.nan)[known]
    after = hits[f"{currency}_after"].to_numpy(dtype=float, na_value=np.nan)[known]
    spent = rows[currency].to_numpy(dtype=float)
    problem = rows.groupby(PROBLEM, sort=False, dropna=False).ngroup().to_numpy()
    order = np.argsort(problem[row], kind="stable")
    ends = np.searchsorted(problem[row][order], np.arange(problem.max() + 2 if len(problem) else 1))
    for low, high in pairwise(ends.tolist()):
        mine = order[low:high]
        at, place = np.unique(row[mine], return_inverse=True)
        level, column = np.unique(code[mine], return_inverse=True)
        sizes = len(at), len(level)
        table, early = np.full(sizes, np.nan), np.full(sizes, np.nan)
        table[place, column], early[place, column] = time[mine], after[mine] + 1
        asked = np.zeros(sizes, dtype=bool)
        asked[place, column] = True
        yield Runtimes(
            all_runs=rows,
            all_targets=targets,
            at=at,
            level=level,
            spent=spent[at],
            asked=asked,
            time=np.where(np.isnan(table), np.inf, table),
            earliest=np.where(np.isnan(early), np.inf, early),
        )


def _codes(pairs: pd.DataFrame) -> tuple[pd.DataFrame, NDArray[np.int64]]:
    """Return the different (quantity, target), in the order in which they come, and the number of each row's."""
    q, different_names = pd.factorize(pairs["quantity"])
    names = list(different_names)
    level, values = pd.factorize(pairs["target"].to_numpy(dtype=float))
    code, different = pd.factorize(q.astype(np.int64) * max(len(values), 1) + level)
    told = pd.DataFrame(
        {
            "quantity": [names[i // max(len(values), 1)] for i in different],
            "target": values[different % max(len(values), 1)] if len(values) else [],
        }
    )
    return told, code.astype(np.int64)
