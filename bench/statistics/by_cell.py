"""Numbers of every cell at once: a study of thousands of cells is sorted once, not sliced cell by cell.

A cell here is any group of rows. Each statistic is computed from the rows of its own cell alone, and is the same to the
last bit whatever other cells there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from calibench.bench.statistics.cells import CELL
from calibench.bench.store.columns import Array, Columns, Counts, numbered


@final
@dataclass(frozen=True)
class ByCell:
    """Rows grouped by their cell: `order`, shape (rows,), lists the rows cell by cell.

    `begins` and `count`, shapes (cells,), say where in it a cell begins, and how many rows it has.
    """

    order: Counts
    begins: Counts
    count: Counts

    @property
    def number(self) -> Counts:
        """Return the number of each row's cell, shape (rows,), in the order of the rows."""
        found = np.empty(len(self.order), dtype=np.int64)
        found[self.order] = np.repeat(np.arange(len(self.count)), self.count)
        return found

    @property
    def first(self) -> Counts:
        """Return the first row of each cell."""
        found: Counts = self.order[self.begins]
        return found

    @property
    def last(self) -> Counts:
        """Return the last row of each cell."""
        found: Counts = self.order[self.begins + self.count - 1]
        return found

    def rows(self, cell: int) -> Counts:
        """Return the rows of one cell."""
        return self.order[self.begins[cell] : self.begins[cell] + self.count[cell]]

    def sums(self, values: Any) -> Counts:
        """Return the sum of whole numbers, or how many are true, in each cell."""
        found: Counts = self._reduced(np.add, np.asarray(values).astype(np.int64))
        return found

    def least(self, values: Array) -> Array:
        """Return the least of each cell's values, those that are NaN left out; NaN of none."""
        found: Array = self._reduced(np.fmin, values)
        return found

    def most(self, values: Array) -> Array:
        """Return the largest of each cell's values, those that are NaN left out; NaN of none."""
        found: Array = self._reduced(np.fmax, values)
        return found

    def spreads(self, values: Array) -> Array:
        """Return the largest minus the least of each cell's values, those that are NaN left out; NaN of none."""
        with np.errstate(invalid="ignore"):
            return self.most(values) - self.least(values)

    def quantiles(self, values: Array, at: Sequence[float]) -> Array:
        """Return the quantiles `at` of each cell, shape (at, cells): those of `bench.statistics.summary.quantiles`.

        A value that is NaN is worse than all; a quantile on or beside it is infinite.
        """
        ordered = self._sorted(np.where(np.isnan(values), np.inf, values))
        found = np.empty((len(at), len(self.begins)))
        for i, q in enumerate(at):
            place = q * (self.count - 1)
            below = place.astype(np.int64)
            share = place - below
            low = ordered[self.begins + below]
            high = ordered[self.begins + np.minimum(below + 1, self.count - 1)]
            with np.errstate(invalid="ignore"):
                between = np.where(share == 0, low, (1 - share) * low + share * high)
            found[i] = np.clip(between, low, high)
        return found

    def medians(self, values: Array) -> Array:
        """Return the median of each cell's values, those that are NaN left out; NaN of none."""
        known = self.count - self.sums(np.isnan(values))
        ordered = self._sorted(values)  # NaN last
        low = ordered[self.begins + np.maximum(known - 1, 0) // 2]
        high = ordered[self.begins + np.minimum(known // 2, self.count - 1)]
        with np.errstate(invalid="ignore"):
            between = np.where(known % 2 == 1, low, (low + high) / 2)
        return np.where(known == 0, np.nan, between)

    def _sorted(self, values: Array) -> Array:
        """Return values cell by cell, in a cell in order, NaN last."""
        found: Array = values[self.order]
        return found[np.lexsort([found, np.repeat(np.arange(len(self.count)), self.count)])]

    def _reduced(self, how: np.ufunc, values: Any) -> Any:
        return how.reduceat(values[self.order], self.begins) if len(self.begins) else values[:0]


def by_cell(runs: Columns, columns: Sequence[str] = CELL) -> ByCell:
    """Return rows by what they have in `columns`; of two that are NaN it is the same."""
    return by_number(numbered(runs[name] for name in columns))


def by_number(cell: Counts) -> ByCell:
    """Return rows by the numbers of their cells, all from 0 to the largest."""
    order = np.argsort(cell, kind="stable").astype(np.int64)
    begins = np.flatnonzero(np.diff(cell[order], prepend=-1)).astype(np.int64)
    return ByCell(order, begins, np.diff(begins, append=len(order)).astype(np.int64))
