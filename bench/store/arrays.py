"""Arrow's arrays from the values of Python and NumPy and back, and functions of them, without what slows a start down.

`pa.array` and `pa.scalar` ask of whatever they are given whether it is pandas', `to_numpy` shares its code with
`to_pandas`, and all of them load pandas for that: half the time of a small run. Here values are laid out as Arrow's
columnar format says, and numbers handed to NumPy by DLPack, as both libraries document. What is not exactly of a
column's type is left to `pa.array`, which converts or refuses it.

`pyarrow.compute` writes the help of some 300 functions as it is imported: 40 ms, some 3 % of a small run. What it
has are calls of `call_function`, of the compiled module beside it. So are the functions here, of the same names and
meaning.

A column of lists as flat numbers: thousands of short lists are read at once, not one by one as Python's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, chain
from typing import TYPE_CHECKING, Any, final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow._compute import ArraySortOptions, CastOptions, SetLookupOptions, SortOptions, call_function

if TYPE_CHECKING:
    import pandas as pd

_NUMBERS: dict[pa.DataType, tuple[type, Any]] = {
    pa.int32(): (int, np.int32),
    pa.int64(): (int, np.int64),
    pa.float64(): (float, np.float64),
    pa.timestamp("us", tz="UTC"): (int, np.int64),
}


def array_of(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
    """Return what ``pa.array(values, kind)`` returns, and raise what it raises; None is null.

    >>> array_of([[1.0, None], None], pa.list_(pa.float64())).to_pylist()
    [[1.0, None], None]
    """
    if pa.types.is_list(kind) and _are(values, list):
        return _lists(values, kind)
    if pa.types.is_string(kind) and _are(values, str):
        return _texts(values)
    if pa.types.is_boolean(kind) and _are(values, bool):
        return pa.Array.from_buffers(kind, len(values), [_valid(values), _bits([value is True for value in values])])
    if kind in _NUMBERS and _are(values, _NUMBERS[kind][0]):
        found = np.array([0 if value is None else value for value in values], dtype=_NUMBERS[kind][1])
        return pa.Array.from_buffers(kind, len(values), [_valid(values), pa.py_buffer(found)])
    return pa.array(values, kind)


def scalar_of(value: Any, kind: pa.DataType) -> pa.Scalar:
    """Return what ``pa.scalar(value, kind)`` returns."""
    return array_of([value], kind)[0]


def indices(numbers: Any) -> pa.Array:
    """Return whole numbers, none of them missing, as Arrow's."""
    found = np.ascontiguousarray(numbers, dtype=np.int64)
    return pa.Array.from_buffers(pa.int64(), len(found), [None, pa.py_buffer(found)])


def mask_of(flags: NDArray[np.bool_]) -> pa.Array:
    """Return flags, none of them missing, as Arrow's."""
    return pa.Array.from_buffers(pa.bool_(), len(flags), [None, _bits(flags)])


def numbers(column: pa.Array | pa.ChunkedArray, missing: float = 0) -> NDArray[Any]:
    """Return a column of numbers as NumPy has them, `missing` for null."""
    array = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    filled = fill_null(array, scalar_of(missing, array.type)) if array.null_count else array
    return np.from_dlpack(filled)


def empty_table(schema: pa.Schema) -> pa.Table:
    """Return a table without rows."""
    return pa.Table.from_arrays([pa.nulls(0, field.type) for field in schema], schema=schema)


def fill_null(values: pa.Array, by: pa.Scalar) -> pa.Array:
    """Return `values` with `by`, of their type, in the place of null."""
    return call_function("coalesce", [values, by])


def index_in(values: Any, value_set: pa.Array) -> Any:
    """Return for each of `values` its first place in `value_set`, null for what is not there."""
    return call_function("index_in", [values], SetLookupOptions(value_set=value_set))


def is_in(values: Any, value_set: pa.Array) -> Any:
    """Return for each of `values` whether `value_set` has it."""
    return call_function("is_in", [values], SetLookupOptions(value_set=value_set))


def count_distinct(values: Any) -> int:
    """Return how many different values there are but null."""
    return int(call_function("count_distinct", [values]).as_py())


def all_true(flags: Any) -> bool:
    """Return whether no flag is false."""
    return call_function("all", [flags]).as_py() is not False


def sort_indices(values: pa.Array) -> pa.Array:
    """Return the places of values in ascending order; texts are compared by their bytes."""
    return call_function("array_sort_indices", [values], ArraySortOptions())


def take(rows: Any, places: Any) -> Any:
    """Return the rows of a table, or the values of a column, at `places`."""
    return call_function("take", [rows, places])


def kept(rows: Any, flags: Any) -> Any:
    """Return the rows of a table, or the values of a column, whose flag is true (`filter`)."""
    return call_function("filter", [rows, flags])


def in_ascending_order(rows: pa.Table, columns: Sequence[str]) -> pa.Table:
    """Return a table sorted by some of its columns (`sort_by`)."""
    order = SortOptions(sort_keys=[(name, "ascending") for name in columns])
    return take(rows, call_function("sort_indices", [rows], order))


def unique(values: Any) -> pa.Array:
    """Return the different values in the order in which they come."""
    return call_function("unique", [values])


def dictionary_encode(values: Any) -> Any:
    """Return the values with each different one kept once."""
    return call_function("dictionary_encode", [values])


def cast(values: Any, kind: pa.DataType, safe: bool = True) -> Any:
    """Return the values as another type; `ArrowInvalid` for what it cannot hold, unless not `safe`."""
    if values.type == kind:
        return values
    return call_function("cast", [values], CastOptions.safe(kind) if safe else CastOptions.unsafe(kind))


def cast_table(rows: pa.Table, schema: pa.Schema) -> pa.Table:
    """Return a table whose columns are those of `schema` by name, with its types."""
    return pa.Table.from_arrays(
        [cast(column, field.type) for column, field in zip(rows.columns, schema, strict=True)], schema=schema
    )


def not_equal(values: Any, other: Any) -> Any:
    """Return for each of `values` whether it is not `other`, null for null."""
    return call_function("not_equal", [values, other])


def list_value_length(lists: pa.Array) -> pa.Array:
    """Return the length of each list, null for null."""
    return call_function("list_value_length", [lists])


def list_flatten(lists: pa.Array) -> pa.Array:
    """Return what is in the lists, one after the other."""
    return call_function("list_flatten", [lists])


def list_parent_indices(lists: pa.Array) -> pa.Array:
    """Return for each value of `list_flatten` the place of the list that has it."""
    return call_function("list_parent_indices", [lists])


def _are(values: Sequence[Any], kind: type) -> bool:
    return all(value is None or type(value) is kind for value in values)


def _valid(values: Sequence[Any]) -> pa.Buffer | None:
    """Return the bits that tell where there is a value; None where there is one everywhere."""
    return _bits([value is not None for value in values]) if None in values else None


def _bits(flags: Any) -> pa.Buffer:
    return pa.py_buffer(np.packbits(np.asarray(flags, dtype=bool), bitorder="little"))


def _offsets(lengths: Sequence[int]) -> pa.Buffer:
    return pa.py_buffer(np.array([*accumulate(lengths, initial=0)], dtype=np.int32))


def _texts(values: Sequence[str | None]) -> pa.Array:
    encoded = [b"" if value is None else value.encode() for value in values]
    buffers = [_valid(values), _offsets([*map(len, encoded)]), pa.py_buffer(b"".join(encoded))]
    return pa.Array.from_buffers(pa.string(), len(values), buffers)


def _lists(values: Sequence[list[Any] | None], kind: pa.DataType) -> pa.Array:
    items = array_of([*chain.from_iterable(value or [] for value in values)], kind.value_type)
    buffers = [_valid(values), _offsets([len(value or []) for value in values])]
    return pa.Array.from_buffers(kind, len(values), buffers, children=[items])


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
