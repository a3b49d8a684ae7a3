"""Arrow's arrays from the values of Python and NumPy and back, functions of them, and the schemas of results.

`pa.array`, `pa.scalar` and `to_numpy` load pandas: half the time of a small run. Here values are laid out as Arrow's
columnar format says, and numbers handed to NumPy by DLPack. `pyarrow.compute` takes 40 ms to be imported: what it has
are calls of `call_function`, of the compiled module beside it, as is `compute` here. A schema is explicit, so that a
column of nulls keeps its type: a run (`bench.execution.run_row`), a point of a trace, both in one, a target's hit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, chain
from types import NoneType
from typing import TYPE_CHECKING, Any, final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow._compute import CastOptions, SetLookupOptions, call_function

from calibench.bench.execution.run_row import COLUMNS

if TYPE_CHECKING:
    import pandas as pd


Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]
_PYTHON: dict[pa.DataType, tuple[type, Any]] = {
    pa.string(): (str, None),
    pa.bool_(): (bool, None),
    pa.int32(): (int, np.int32),
    pa.int64(): (int, np.int64),
    pa.float64(): (float, np.float64),
    pa.timestamp("us", tz="UTC"): (int, np.int64),
}


def array_of(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
    """Return what ``pa.array(values, kind)`` returns, and raise what it raises; None is null."""
    python, number = (list, None) if pa.types.is_list(kind) else _PYTHON.get(kind, (None, None))
    types = set(map(type, values))
    if pa.types.is_struct(kind) and types <= {dict}:
        fields = [array_of([value.get(field.name) for value in values], field.type) for field in kind]
        return pa.StructArray.from_arrays(fields, fields=[*kind])
    if python is None or not types <= {python, NoneType}:
        return pa.array(values, kind)
    valid = None
    if NoneType in types:
        valid = _bits([value is not None for value in values])
        values = [python() if value is None else value for value in values]
    if number is not None:
        found = np.array(values, dtype=number)
        return pa.Array.from_buffers(kind, len(values), [valid, pa.py_buffer(found)])
    if python is bool:
        return pa.Array.from_buffers(kind, len(values), [valid, _bits(values)])
    parts: Sequence[Any] = [value.encode() for value in values] if python is str else values
    offsets = pa.py_buffer(np.array([*accumulate(map(len, parts), initial=0)], dtype=np.int32))
    if python is str:
        return pa.Array.from_buffers(kind, len(values), [valid, offsets, pa.py_buffer(b"".join(parts))])
    items = array_of([*chain.from_iterable(parts)], kind.value_type)
    return pa.Array.from_buffers(kind, len(values), [valid, offsets], children=[items])


def _bits(flags: Any) -> pa.Buffer:
    return pa.py_buffer(np.packbits(np.asarray(flags, dtype=bool), bitorder="little"))


def indices(numbers: Any) -> pa.Array:
    """Return whole numbers, none of them missing, as Arrow's."""
    found = np.ascontiguousarray(numbers, dtype=np.int64)
    return pa.Array.from_buffers(pa.int64(), len(found), [None, pa.py_buffer(found)])


def mask_of(flags: Flags) -> pa.Array:
    """Return flags, none of them missing, as Arrow's."""
    return pa.Array.from_buffers(pa.bool_(), len(flags), [None, _bits(flags)])


def numbers(column: pa.Array | pa.ChunkedArray, missing: float = 0) -> NDArray[Any]:
    """Return a column of numbers as NumPy has them, `missing` for null."""
    array = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    if array.null_count:
        array = compute("coalesce", array, array_of([missing], array.type)[0])
    return np.from_dlpack(array)


def give_back() -> None:
    """Give the system what is free of the heap: of tables that were read and cut it is tens of megabytes."""
    pa.default_memory_pool().release_unused()


def empty_table(schema: pa.Schema) -> pa.Table:
    """Return a table without rows."""
    return pa.Table.from_arrays([pa.nulls(0, field.type) for field in schema], schema=schema)


def compute(name: str, *values: Any, options: Any = None) -> Any:
    """Return what the function of this name in `pyarrow.compute` makes of the values."""
    return call_function(name, list(values), options)


def dictionary(column: pa.ChunkedArray, missing: int = 0) -> tuple[pa.Array, Counts]:
    """Return the different values of a column, and the place of each row's among them, `missing` of null."""
    coded = column if pa.types.is_dictionary(column.type) else compute("dictionary_encode", column)
    whole = coded.unify_dictionaries().combine_chunks()
    whole = whole.chunk(0) if isinstance(whole, pa.ChunkedArray) else whole
    return whole.dictionary, numbers(whole.indices, missing).astype(np.int64)


def index_in(values: Any, value_set: pa.Array) -> Any:
    """Return for each of `values` its first place in `value_set`, null for what is not there."""
    return compute("index_in", values, options=SetLookupOptions(value_set=value_set))


def places(column: pd.Series, among: pd.Series) -> NDArray[np.int32]:
    """Return for each text of a column its first place in another, -1 of none; of a category each is looked up once."""
    import pandas as pd

    ids = pa.array(among, pa.string())
    if not isinstance(column.dtype, pd.CategoricalDtype):
        return numbers(index_in(pa.array(column, pa.string()), ids), -1)
    place = numbers(index_in(pa.array(column.cat.categories, pa.string()), ids), -1)
    return np.asarray(place[column.cat.codes.to_numpy()])


def is_in(values: Any, value_set: pa.Array) -> Any:
    """Return for each of `values` whether `value_set` has it."""
    return compute("is_in", values, options=SetLookupOptions(value_set=value_set))


def kept(rows: Any, flags: Any) -> Any:
    """Return the rows of a table, or the values of a column, whose flag is true (`filter`)."""
    return compute("filter", rows, flags)


def cast(values: Any, kind: pa.DataType, safe: bool = True) -> Any:
    """Return the values as another type; `ArrowInvalid` for what it cannot hold, unless not `safe`."""
    if values.type == kind:
        return values
    return compute("cast", values, options=CastOptions.safe(kind) if safe else CastOptions.unsafe(kind))


def cast_table(rows: pa.Table, schema: pa.Schema) -> pa.Table:
    """Return a table whose columns are those of `schema` by name, with its types."""
    return pa.Table.from_arrays(
        [cast(column, field.type) for column, field in zip(rows.columns, schema, strict=True)], schema=schema
    )


@final
@dataclass(frozen=True)
class Lists:
    """Lists one after the other: `flat` and `row`, shapes (numbers,); `begins`, `count` and `last`, shapes (lists,)."""

    flat: Array  # NaN for null
    begins: Counts
    count: Counts
    last: Array  # number of each list, NaN of an empty one

    @property
    def row(self) -> Counts:
        """Return the list that each number is of."""
        return np.repeat(np.arange(len(self.count)), self.count)

    def table(self, rows: Counts) -> Array:
        """Return the lists of `rows`, all of one length, shape (rows, numbers)."""
        return self.flat[self.begins[rows][:, None] + np.arange(self.count[rows][0])]

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
    count = numbers(compute("list_value_length", known)).astype(np.int64)
    flat = numbers(cast(compute("list_flatten", known), pa.float64()), np.nan)
    last, some = np.full(len(count), np.nan), count > 0
    last[some] = flat[(np.cumsum(count) - 1)[some]]
    return Lists(flat, np.cumsum(count) - count, count, last)


_TYPES = {
    "string": pa.string(), "int64": pa.int64(), "double": pa.float64(), "bool": pa.bool_(),
    "timestamp[us, tz=UTC]": pa.timestamp("us", tz="UTC"),
}  # fmt: skip
TRACE = "trace"  # the column that holds the points where a run and its trace are one row
_TYPES |= {f"list<{name}>": pa.list_(kind) for name, kind in _TYPES.items()}
RUNS_SCHEMA = pa.schema([(column.name, _TYPES[column.parquet]) for column in COLUMNS])
TRACES_SCHEMA = pa.schema(
    [
        ("run_id", pa.string()), ("evaluations", pa.int64()), ("charged", pa.int64()), ("best_value", pa.float64()),
        ("restart", pa.int64()),
    ]
)  # fmt: skip
HITS_SCHEMA = pa.schema(
    [
        ("run_id", pa.string()), ("quantity", pa.string()), ("target", pa.float64()), ("evaluations", pa.int64()),
        ("charged", pa.int64()), ("evaluations_after", pa.int64()), ("charged_after", pa.int64()),
        ("seconds", pa.float64()),
    ]
)  # fmt: skip  # a row a run and target, null: never reached (`bench.store.hits`)
POINT = tuple(name for name in TRACES_SCHEMA.names if name != "run_id")
PART_SCHEMA = RUNS_SCHEMA.append(
    pa.field(TRACE, pa.list_(pa.struct([(name, TRACES_SCHEMA.field(name).type) for name in POINT])))
)


def in_schema(table: pa.Table, schema: pa.Schema, columns: Sequence[str] | None = None) -> pa.Table:
    """Return the columns of the schema (or those of `columns`) in its order and of its types."""
    wanted = pa.schema([field for field in schema if columns is None or field.name in columns])
    return cast_table(table.select(wanted.names), wanted)


def joined(tables: Sequence[pa.Table]) -> pa.Table:
    """Return tables of the same columns as one; a text is a dictionary where it is one in each of them."""
    if len({table.schema for table in tables}) > 1:
        plain = [pa.field(f.name, pa.string() if pa.types.is_dictionary(f.type) else f.type) for f in tables[0].schema]
        tables = [cast_table(table, pa.schema(plain)) for table in tables]
    return pa.concat_tables(tables)


def to_pandas(table: pa.Table, category: str = "") -> pd.DataFrame:
    """Return pandas with lists as Arrow lists, flags as nullable booleans and text as pandas' `str`, held by reference.

    Equal texts are one: a slice or loop of some thousand rows takes a tenth of the time that Arrow's text takes. The
    column `category` is one of pandas' own.
    """
    import pandas as pd

    texts: dict[str, Any] = {}
    for field in table.schema:
        if pa.types.is_string(field.type) or pa.types.is_dictionary(field.type):
            values, place = dictionary(table[field.name], missing=-1)
            if field.name == category:
                texts[category] = pd.Categorical.from_codes(place, values.to_pylist())
                continue
            text = np.array([*values.to_pylist(), np.nan], dtype=object)[place]  # the last stands for null
            texts[field.name] = pd.array(text, dtype=pd.StringDtype("python", na_value=np.nan))
    kinds: dict[pa.DataType, Any] = {kind: pd.ArrowDtype(kind) for kind in table.schema.types if pa.types.is_list(kind)}
    kinds[pa.bool_()] = pd.BooleanDtype()
    others = table.drop_columns(list(texts)).to_pandas(types_mapper=kinds.get)
    columns = {name: texts[name] if name in texts else others[name] for name in table.schema.names}
    return pd.DataFrame(columns, index=range(len(table)), copy=False)
