"""The Arrow schemas of results: a run (`bench.execution.run_row`), a point of a trace, both in one, a target's hit.

A schema is explicit, so that a column of nulls keeps its type.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from calibench.bench.execution.run_row import COLUMNS
from calibench.bench.store.arrays import cast_table, compute, numbers

if TYPE_CHECKING:
    import pandas as pd

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


def to_pandas(table: pa.Table) -> pd.DataFrame:
    """Return pandas with lists as Arrow lists, flags as nullable booleans and text as pandas' `str`, held by reference.

    Equal texts are one: a slice or loop of some thousand rows takes a tenth of the time that Arrow's text takes.
    """
    import pandas as pd

    texts = {}
    for field in table.schema:
        if pa.types.is_string(field.type):
            coded = compute("dictionary_encode", table[field.name]).combine_chunks()
            different = np.array([*coded.dictionary.to_pylist(), np.nan], dtype=object)  # the last stands for null
            text = different[numbers(coded.indices, len(different) - 1)]
            texts[field.name] = pd.array(text, dtype=pd.StringDtype("python", na_value=np.nan))
    kinds: dict[pa.DataType, Any] = {kind: pd.ArrowDtype(kind) for kind in table.schema.types if pa.types.is_list(kind)}
    kinds[pa.bool_()] = pd.BooleanDtype()
    others = table.drop_columns(list(texts)).to_pandas(types_mapper=kinds.get)
    columns = {name: texts[name] if name in texts else others[name] for name in table.schema.names}
    return pd.DataFrame(columns, index=range(len(table)), copy=False)
