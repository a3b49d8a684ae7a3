"""A part: a Parquet file of one row that holds a run with its trace, named by the run id, whole or not there at all.

A part that is damaged is told from a good one by the checksums of its pages, or by its end alone, which costs nothing.
"""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from calibench.bench.execution.run import Run
from calibench.bench.execution.run_row import SCHEMA_VERSION
from calibench.bench.provenance.environment import provenance
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.store.schema import PART_SCHEMA, POINT, TRACE, TRACES_SCHEMA, is_ours, with_all

_MAGIC = b"PAR1"


def write_part(run: Run, study: str, folder: Path) -> None:
    """Write the part of `run` into `folder`, as one of `study`."""
    row = vars(replace(run.record, study=study))
    points = [dict(zip(POINT, point, strict=True)) for point in run.points]
    part = pa.Table.from_pylist([{**row, TRACE: points}], PART_SCHEMA)
    # one row in fifty columns: as pages without compression it is read four times faster, and checked as well
    plain = {"compression": "none", "use_dictionary": False, "write_statistics": False, "write_page_checksum": True}
    write_table(part, folder / f"{run.run_id}.parquet", **plain)


def read_part(path: Path) -> pa.Table | None:
    """Return the part, or None where it is damaged or not ours."""
    try:
        file = pq.ParquetFile(pa.BufferReader(path.read_bytes()), page_checksum_verification=True, pre_buffer=False)
        table = file.read(use_threads=False)
        if not is_ours(table.schema, PART_SCHEMA) or table["run_id"].to_pylist() != [path.stem]:
            return None
        table = with_all(table, PART_SCHEMA)
        return table if table.schema.equals(PART_SCHEMA) else table.cast(PART_SCHEMA)
    except (OSError, pa.ArrowException, UnicodeDecodeError):
        return None


def ends_well(path: Path) -> bool:
    """Tell whether the file ends as a Parquet file does."""
    try:
        with open(path, "rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(-8, os.SEEK_END)
            footer, magic = int.from_bytes(file.read(4), "little"), file.read()
            return magic == _MAGIC and footer + 12 <= size
    except OSError:
        return False


def points_of(parts: pa.Table) -> pa.Table:
    """Return the traces of parts as a table of points."""
    traces = parts[TRACE].combine_chunks()
    of_run = parts["run_id"].combine_chunks().take(pc.list_parent_indices(traces))
    return pa.Table.from_arrays([of_run, *pc.list_flatten(traces).flatten()], schema=TRACES_SCHEMA)


def write_table(table: pa.Table, path: Path, **options: Any) -> None:
    """Write a table whole, with where it comes from as metadata; `options` are those of `pq.write_table`."""
    told = {"calibench": json.dumps(provenance() | {"schema_version": SCHEMA_VERSION})}
    chosen = {"compression": "zstd"} | options
    write_whole(path, lambda file: pq.write_table(table.replace_schema_metadata(told), file, **chosen))
