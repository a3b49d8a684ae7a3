"""A part: how earlier versions kept a run, a Parquet file of one row with its trace. Parts are read, never written."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from calibench.bench.store.schema import PART_SCHEMA, is_ours, with_all


def parts_in(folder: Path) -> list[Path]:
    """Return the parts of the study in `folder`, by name."""
    return sorted((folder / "parts").glob("*.parquet"))


def read_part(path: Path) -> pa.Table | None:
    """Return the part, a table of `PART_SCHEMA`; None where it is damaged or not ours."""
    try:
        file = pq.ParquetFile(pa.BufferReader(path.read_bytes()), page_checksum_verification=True, pre_buffer=False)
        table = file.read(use_threads=False)
        if not is_ours(table.schema, PART_SCHEMA) or table["run_id"].to_pylist() != [path.stem]:
            return None
        return with_all(table, PART_SCHEMA)
    except (OSError, pa.ArrowException, UnicodeDecodeError):
        return None
