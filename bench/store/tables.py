"""The two tables of a study, ``runs.parquet`` and ``traces.parquet``: read with care, written whole.

Read is only what this store wrote for this study: our columns with their types, each run once, all of one study and of
a version that is known. Anything else is refused, named and left alone. The tables are replaced one after the other; a
kill in between leaves them unlike, which the mark that both hold tells.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import pyarrow as pa
import pyarrow.parquet as pq

from calibench.bench.execution.run_row import SCHEMA_VERSION
from calibench.bench.provenance.environment import provenance
from calibench.bench.store.arrays import array_of, count_distinct, empty_table, unique
from calibench.bench.store.files.atomic_file import write_whole
from calibench.bench.store.manifest import READABLE, StoreError
from calibench.bench.store.schema import RUNS_SCHEMA, TRACES_SCHEMA, is_ours, with_all

RUNS, TRACES, HITS = "runs.parquet", "traces.parquet", "hits.parquet"
_PIECE = 1 << 18  # points of traces that are read at a time
ORDER = ("problem", "problem_options", "optimizer", "optimizer_options", "start", "budget", "repetition", "run_id")
_KEY = b"calibench"  # of the metadata
_CHECKED = ("run_id", "study", "schema_version", "evaluations")


@final
@dataclass(frozen=True)
class Tables:
    """The tables in `folder`, of the study that its manifest names."""

    folder: Path
    study: str

    def runs(self, columns: Sequence[str] | None = None) -> pa.Table:
        """Return the rows (of `columns`), checked; none where there is no table."""
        wanted = None if columns is None else list(dict.fromkeys([*columns, *_CHECKED]))
        table = self._read(RUNS, RUNS_SCHEMA, wanted)
        self._check(table)
        return table if columns is None else table.select(list(columns))

    def traces(self, columns: Sequence[str] | None = None) -> pa.Table:
        """Return the points of all traces; none where there is no table."""
        return self._read(TRACES, TRACES_SCHEMA, columns)

    def points_in_pieces(self) -> Iterator[pa.Table]:
        """Yield the points of all traces, in the order of the runs, some hundred thousand at a time."""
        file = self.open(TRACES)
        for batch in () if file is None else file.iter_batches(batch_size=_PIECE, use_threads=False):
            yield with_all(pa.Table.from_batches([batch]), TRACES_SCHEMA)

    def complete(self) -> set[str]:
        """Return the ids of the runs whose row and trace are both there."""
        rows = self.runs(_CHECKED)
        ids = rows["run_id"].to_pylist()
        if not ids or self.are_one_pair():
            return set(ids)
        traced = set(self._trace_ids().to_pylist())
        evaluations = rows["evaluations"].to_pylist()
        return {run_id for run_id, n in zip(ids, evaluations, strict=True) if run_id in traced or not n}

    def are_one_pair(self) -> bool:
        """Tell whether both tables were written by the same collection, which makes them whole."""
        marks = [self._mark(name) for name in (RUNS, TRACES)]
        return marks[0] is not None and marks[0] == marks[1]

    def open(self, name: str) -> pq.ParquetFile | None:
        """Return a table as a file, its columns checked; None where it is missing."""
        path = self.folder / name
        if not path.exists():
            return None
        try:
            file = pq.ParquetFile(path)  # and not read_table, which loads pyarrow.dataset
        except (OSError, pa.ArrowException) as error:
            raise self._unreadable(path, error) from None
        self._check_columns(path, file.schema_arrow, RUNS_SCHEMA if name == RUNS else TRACES_SCHEMA)
        return file

    def _read(self, name: str, schema: pa.Schema, columns: Sequence[str] | None) -> pa.Table:
        file = self.open(name)
        if file is None:
            chosen = schema if columns is None else pa.schema([schema.field(column) for column in columns])
            return empty_table(chosen)
        try:
            found = file.schema_arrow
            wanted = [column for column in columns or schema.names if column in found.names]
            return with_all(file.read(columns=wanted), schema, None if columns is None else list(columns))
        except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
            raise self._unreadable(self.folder / name, error) from None

    def _trace_ids(self) -> pa.Array:
        file = self.open(TRACES)
        return array_of([], pa.string()) if file is None else unique(file.read(columns=["run_id"])["run_id"])

    def _mark(self, name: str) -> str | None:
        file = self.open(name)
        told = (file.schema_arrow.metadata or {}).get(_KEY) if file is not None else None
        return None if told is None else json.loads(told).get("pair")

    def _check_columns(self, path: Path, found: pa.Schema, schema: pa.Schema) -> None:
        if not is_ours(found, schema) or _KEY not in (found.metadata or {}):
            raise StoreError(f"{path}: has not our columns; is it from another program or version? It is left alone")
        for field in schema:
            if field.name in found.names and not _fits(found.field(field.name).type, field.type):
                kind = found.field(field.name).type
                raise StoreError(f"{path}: column {field.name} is {kind}, not {field.type}; it is left alone")

    def _check(self, table: pa.Table) -> None:
        path, ids = self.folder / RUNS, table["run_id"]
        if ids.null_count:
            raise StoreError(f"{path}: {ids.null_count} rows have no run_id; it is left alone")
        if (double := len(ids) - count_distinct(ids)) > 0:
            raise StoreError(f"{path}: {double} rows have a run_id that another row has; it is left alone")
        others = sorted({str(name) for name in unique(table["study"]).to_pylist()} - {self.study})
        if others:
            raise StoreError(
                f"{path}: has rows of study {others[0]!r}, this folder is study {self.study!r}; it is left alone "
                "(`bench merge A B --to C` joins studies)"
            )
        versions = {version for version in unique(table["schema_version"]).to_pylist()} - set(READABLE)
        if versions:
            raise StoreError(f"{path}: has rows of schema {versions.pop()}, this version reads {READABLE}")

    def _unreadable(self, path: Path, error: Exception) -> StoreError:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        return StoreError(f"{path}: cannot be read ({first}); `bench collect` cannot mend it")


def write_table(table: pa.Table, path: Path, pair: str | None = None) -> None:
    """Write a table whole, with where it comes from as metadata."""
    told = metadata(pair)
    write_whole(path, lambda file: pq.write_table(table.replace_schema_metadata(told), file, compression="zstd"))


def metadata(pair: str | None = None) -> dict[str, str]:
    """Return the metadata of a table; tables of one collection hold the same `pair`."""
    told: dict[str, Any] = provenance() | {"schema_version": SCHEMA_VERSION, "pair": pair}
    return {_KEY.decode(): json.dumps(told)}


def _fits(found: pa.DataType, wanted: pa.DataType) -> bool:
    """Tell whether a column is of the type wanted, but for the name that a list's items have in a file."""
    if pa.types.is_list(found) and pa.types.is_list(wanted):
        return _fits(found.value_type, wanted.value_type)
    return bool(found == wanted) or (pa.types.is_timestamp(found) and pa.types.is_timestamp(wanted))
