"""The ledger as Parquet, with an explicit schema, and as CSV with the same columns; where one is kept for good."""

from __future__ import annotations

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
_TEXT, _INT, _REAL, _BOOL = pa.string(), pa.int64(), pa.float64(), pa.bool_()
LEDGER_SCHEMA = pa.schema(
    [
        ("paper", _TEXT), ("key", _TEXT), ("kind", _TEXT), ("about", _TEXT), ("place", _TEXT), ("quantity", _TEXT),
        ("unit", _TEXT), ("printed", _REAL), ("read", _REAL), ("ours_median", _REAL), ("ours_q1", _REAL),
        ("ours_q3", _REAL), ("n", _INT), ("judged", _REAL), ("rule", _TEXT), ("tolerance", _REAL),
        ("tolerance_in_kind", _REAL), ("tolerance_in_decades", _BOOL), ("tolerance_origin", _REAL),
        ("share", _REAL), ("why_tolerance", _TEXT), ("verdict", _TEXT), ("reason", _TEXT), ("differs", _TEXT),
        ("method", _TEXT), ("schema_version", _INT),
    ]
)  # fmt: skip


def to_table(rows: Sequence[Row]) -> pa.Table:
    """Return the rows as an Arrow table; a number that there is not (NaN) is null."""
    lines = [asdict(row) | {"schema_version": SCHEMA_VERSION} for row in rows]
    return pa.Table.from_pylist([{k: None if v != v else v for k, v in line.items()} for line in lines], LEDGER_SCHEMA)


def write_parquet(rows: Sequence[Row], path: Path) -> Path:
    """Write the ledger whole, with versions and commit in the file's metadata, and return the path."""
    metadata = {"calibench": json.dumps(provenance() | {"schema_version": SCHEMA_VERSION})}
    path.parent.mkdir(parents=True, exist_ok=True)
    table = to_table(rows).replace_schema_metadata(metadata)
    return write_whole(path, lambda file: pq.write_table(table, file, compression="zstd"))


def write_csv(rows: Sequence[Row], path: Path) -> Path:
    """Write the ledger as CSV, empty where there is no number, and return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_whole(path, lambda file: pyarrow.csv.write_csv(to_table(rows), file))


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a ledger written by `write_parquet`; a number that there is not is NaN."""
    names = [field.name for field in fields(Row)]
    numbers = {name for name in names if pa.types.is_floating(LEDGER_SCHEMA.field(name).type)}
    lines: list[dict[str, Any]] = pq.read_table(path, columns=names).to_pylist()
    for line in lines:
        line.update({name: nan for name in numbers if line[name] is None})
    return [Row(**line) for line in lines]


def kept(name: str) -> Path | None:
    """Return a file or folder of the reference, the kept run at the papers' own budget; None where it is not here.

    It lies in the repository and in no wheel.
    """
    path = Path(__file__).resolve().parents[2] / "results" / "reference" / name
    return path if path.exists() else None
