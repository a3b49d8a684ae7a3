"""A column of lists as flat numbers: thousands of short lists are read at once, not one by one as Python's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from calibench.bench.store.arrays import cast, list_flatten, list_value_length, numbers

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
Counts = NDArray[np.int64]


@final
@dataclass(frozen=True)
class Lists:
    """Lists one after the other: `flat`, shape (numbers,), NaN for null; `begins` and `count`, shapes (lists,)."""

    flat: Array
    begins: Counts
    count: Counts

    @property
    def row(self) -> Counts:
        """Return the list that each number is of, shape (numbers,)."""
        return np.repeat(np.arange(len(self.count)), self.count)

    @property
    def last(self) -> Array:
        """Return the last number of each list, shape (lists,); NaN of an empty one."""
        found = np.full(len(self.count), np.nan)
        some = self.count > 0
        found[some] = self.flat[(self.begins + self.count - 1)[some]]
        return found

    def table(self, rows: Counts) -> Array:
        """Return some lists of one length as rows of a table, shape (rows, numbers)."""
        length = int(self.count[rows[0]]) if len(rows) else 0
        found: Array = self.flat[self.begins[rows, None] + np.arange(length)]
        return found

    def alike(self, rows: Counts) -> Iterator[tuple[Array, Counts]]:
        """Yield each different list among `rows`, with those places in `rows` that have it."""
        where: dict[bytes, list[int]] = {}
        for i, (begin, count) in enumerate(zip(self.begins[rows].tolist(), self.count[rows].tolist(), strict=True)):
            where.setdefault(self.flat[begin : begin + count].tobytes(), []).append(i)
        for listed, at in where.items():
            yield np.frombuffer(listed), np.array(at, dtype=np.int64)


def lists_of(column: pd.Series | pa.ChunkedArray) -> Lists:
    """Return the lists of a column of numbers; of one that is missing an empty one."""
    known: Any = column if isinstance(column, pa.ChunkedArray) else pa.array(column, from_pandas=True)
    if isinstance(known, pa.ChunkedArray):
        known = known.combine_chunks()
    if not pa.types.is_list(known.type):  # none has a number, and Arrow knows no type of it
        known = cast(known, pa.list_(pa.float64()))
    count = numbers(list_value_length(known)).astype(np.int64)
    flat = numbers(cast(list_flatten(known), pa.float64()), np.nan)
    return Lists(flat, np.cumsum(count) - count, count)
