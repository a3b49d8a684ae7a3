"""The ledger as Parquet, with an explicit schema, and as CSV with the same columns; where one is kept for good."""

import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from math import nan
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from calibench.bench.papers.row import Row
from calibench.bench.provenance.environment import provenance
from calibench.bench.store.atomic_file import write_whole

SCHEMA_VERSION = 3
_TYPES = {"int": pa.int64(), "float": pa.float64(), "bool": pa.bool_()}
LEDGER_SCHEMA = pa.schema(
    [*((field.name, _TYPES.get(str(field.type), pa.string())) for field in fields(Row)), ("schema_version", pa.int64())]
)


def to_table(rows: Sequence[Row]) -> pa.Table:
    """Return the rows as an Arrow table; a number that there is not (NaN) is null."""
    lines = [asdict(row) | {"schema_version": SCHEMA_VERSION} for row in rows]
    return pa.Table.from_pylist([{k: None if v != v else v for k, v in line.items()} for line in lines], LEDGER_SCHEMA)


def write_ledger(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write ``ledger.parquet``, with versions and commit in its metadata, and ``ledger.csv``; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    metadata = {"calibench": json.dumps(provenance() | {"schema_version": SCHEMA_VERSION})}
    table = to_table(rows)
    known = table.replace_schema_metadata(metadata)
    return [
        write_whole(folder / "ledger.parquet", lambda file: pq.write_table(known, file, compression="zstd")),
        write_whole(folder / "ledger.csv", lambda file: pyarrow.csv.write_csv(table, file)),
    ]


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a ledger written by `write_ledger`; a number that there is not is NaN."""
    names = [field.name for field in fields(Row)]
    numbers = {name for name in names if pa.types.is_floating(LEDGER_SCHEMA.field(name).type)}
    lines: list[dict[str, Any]] = pq.read_table(path, columns=names).to_pylist()
    for line in lines:
        line.update({name: nan for name in numbers if line[name] is None})
    return [Row(**line) for line in lines]


def kept(name: str) -> Path | None:
    """Return a file or folder of the reference, the kept run at the papers' own budget; None outside the repository."""
    path = Path(__file__).resolve().parents[2] / "results" / "reference" / name
    return path if path.exists() else None
