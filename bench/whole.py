"""Files that are there whole or not at all, tables with explicit schemas among them; and one writer at a time."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from bench.provenance import provenance


def write_whole(table: pa.Table, path: Path, schema_version: int) -> None:
    """Write `table` as Parquet, with versions, commit and `schema_version` in its metadata."""
    table = table.replace_schema_metadata({"calibench": json.dumps(provenance() | {"schema_version": schema_version})})
    temporary = path.with_suffix(f".{os.getpid()}.tmp")
    with open(temporary, "wb") as file:
        pq.write_table(table, file, compression="zstd")
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def write_text_whole(text: str, path: Path) -> None:
    """Write `text` to `path`."""
    temporary = path.with_suffix(f".{os.getpid()}.tmp")
    with open(temporary, "w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Let one process at a time rewrite the tables of `folder` (where the system has `flock`)."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with open(folder / ".lock", "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def to_pandas(table: pa.Table) -> pd.DataFrame:
    """Return pandas with lists as Arrow lists and flags as nullable booleans: no column of Python objects."""

    def column_type(arrow: pa.DataType) -> Any:
        if pa.types.is_list(arrow):
            return pd.ArrowDtype(arrow)
        return pd.BooleanDtype() if pa.types.is_boolean(arrow) else None

    frame: pd.DataFrame = table.to_pandas(types_mapper=column_type)
    return frame
