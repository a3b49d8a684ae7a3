"""Columns of finished runs, read in one way whether pandas, Arrow or a list holds them.

So what is computed of them is written once, and a small sweep that is only told on a terminal does not load pandas.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from calibench.bench.store.arrays import cast, dictionary_encode, numbers

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Columns(Protocol):
    """Columns of one length by name: a `pandas.DataFrame`, or a dictionary of Arrow's columns or of lists."""

    def __getitem__(self, name: str, /) -> Any:
        """Return a column."""
        ...

    def __contains__(self, name: object, /) -> bool:
        """Tell whether there is a column of this name."""
        ...


def columns_of(table: pa.Table) -> dict[str, pa.ChunkedArray]:
    """Return the columns of a table by name."""
    return dict(zip(table.column_names, table.columns, strict=True))


def floats(column: Any) -> Array:
    """Return a column as numbers, NaN where it has none."""
    if isinstance(column, pa.ChunkedArray):
        return numbers(cast(column, pa.float64(), safe=False), np.nan)
    if isinstance(column, list | np.ndarray):
        return np.asarray(column, dtype=float)
    found: Array = column.to_numpy(dtype=float, na_value=np.nan)
    return found


def plain(column: Any) -> list[Any]:
    """Return a column as Python has it, None where it has nothing; NaN is nothing."""
    if isinstance(column, pa.ChunkedArray) and pa.types.is_string(column.type):
        coded = dictionary_encode(column.combine_chunks())  # each text is kept once, however many rows have it
        texts = [*coded.dictionary.to_pylist(), None]
        return [texts[place] for place in numbers(coded.indices, -1).tolist()]
    if isinstance(column, pa.ChunkedArray):
        values = column.to_pylist()
    elif isinstance(column, list | np.ndarray):
        values = [*column]
    else:
        values = column.to_numpy(dtype=object, na_value=None).tolist()
    return [None if isinstance(value, float) and value != value else value for value in values]


def known(column: Any) -> Flags:
    """Tell where a column has something."""
    return np.array([value is not None for value in plain(column)], dtype=bool)


def true(column: Any) -> Flags:
    """Tell where a column of flags has a true one."""
    return np.array([bool(value) for value in plain(column)], dtype=bool)


def numbered(columns: Iterable[Any]) -> Counts:
    """Return for each row the number, from 0, of what it has in `columns`; what comes first has the lowest.

    >>> numbered([["a", "b", "a", "a"], [1.0, float("nan"), 1.0, float("nan")]]).tolist()
    [0, 1, 0, 2]
    """
    seen: dict[tuple[Any, ...], int] = {}
    rows = zip(*map(plain, columns), strict=True)
    return np.array([seen.setdefault(row, len(seen)) for row in rows], dtype=np.int64)
