"""The two tables of a study, ``runs.parquet`` and ``traces.parquet``: read with care, written whole, sealed.

Read is only what this store wrote for this study: our columns with their types, each run once, all of one study and
schema. Anything else is refused, named by row and column where a value is one that no run can have
(`bench.store.damage`), and left alone. The tables are replaced one after the other; a kill in between leaves them
unlike, which the mark that both hold tells.

A seal is a digest of all bytes before the footer, kept in the footer, so that an edit with whatever tool is noticed:
what rewrites a table leaves the digest out, or keeps it beside other bytes. In a manifest beside the table, a kill
between the two would leave a table that nobody reads again. It guards against accidents, not against who forges it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any, BinaryIO, final

import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow.fs import LocalFileSystem

from calibench.bench.execution.run_row import SCHEMA_VERSION
from calibench.bench.provenance.environment import provenance
from calibench.bench.store.arrays import count_distinct, empty_table, unique
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.schema import RUNS_SCHEMA, TRACES_SCHEMA, in_schema
from calibench.core.words import shortened

RUNS, TRACES, HITS = "runs.parquet", "traces.parquet", "hits.parquet"
_PIECE = 1 << 18  # points of traces that are read at a time
ORDER = ("problem", "problem_options", "optimizer", "optimizer_options", "start", "budget", "repetition", "run_id")
_KEY = b"calibench"  # of the metadata
_READ_ALWAYS = ("run_id", "study", "schema_version", "evaluations")
_LEFT = "it is left alone: put back a copy, or delete both tables and run again"
_CHECKED: dict[Path, list[tuple[int, int, int] | None]] = {}  # folders whose tables were found right, and their files


def parquet_file(path: Path) -> pq.ParquetFile:
    """Return the Parquet file of that name on this machine: ``lab:1`` and ``s3://x`` are folders, no addresses."""
    return pq.ParquetFile(
        path.absolute(), filesystem=LocalFileSystem()
    )  # and not read_table, which loads pyarrow.dataset


@final
@dataclass(frozen=True)
class Tables:
    """The tables in `folder`, of the study that its manifest names."""

    folder: Path
    study: str

    def runs(self, columns: Sequence[str] | None = None) -> pa.Table:
        """Return the rows (of `columns`), checked; none where there is no table."""
        wanted = None if columns is None else list(dict.fromkeys([*columns, *_READ_ALWAYS]))
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
            yield in_schema(pa.Table.from_batches([batch]), TRACES_SCHEMA)

    def complete(self) -> set[str]:
        """Return the ids of the runs whose row and trace are both there."""
        rows = self.runs(_READ_ALWAYS)
        ids = rows["run_id"].to_pylist()
        if not ids or self.are_one_pair():
            return set(ids)
        file = self.open(TRACES)
        traced = set() if file is None else set(unique(file.read(columns=["run_id"])["run_id"]).to_pylist())
        evaluations = rows["evaluations"].to_pylist()
        return {run_id for run_id, n in zip(ids, evaluations, strict=True) if run_id in traced or not n}

    def are_one_pair(self) -> bool:
        """Tell whether both tables were written by the same collection, which makes them whole."""
        files = [self.open(name) for name in (RUNS, TRACES)]
        marks = [None if file is None else _statements(file).get("pair") for file in files]
        return marks[0] is not None and marks[0] == marks[1]

    def open(self, name: str) -> pq.ParquetFile | None:
        """Return a table as a file; None where it is missing. Both tables are checked: one is not read without both."""
        files = {each: self._opened(each) for each in (RUNS, TRACES)}
        paths = [self.folder / each for each in (RUNS, TRACES)]
        status = [path.stat() if path.exists() else None for path in paths]
        # by what the two files, once they were checked, are known again
        state = [None if one is None else (one.st_ino, one.st_size, one.st_mtime_ns) for one in status]
        place = self.folder.absolute()
        if _CHECKED.get(place) != state:
            self._check_whole(files)
            _CHECKED[place] = state
        return files[name]

    def _check_whole(self, files: Mapping[str, pq.ParquetFile | None]) -> None:
        """Refuse a table that is not as it was written."""
        there = {name: file for name, file in files.items() if file is not None}
        changed = [name for name in there if not is_whole(self.folder / name)]
        if not changed:
            return
        tables = {RUNS: empty_table(RUNS_SCHEMA), TRACES: empty_table(TRACES_SCHEMA)}
        for name, file in there.items():
            tables[name] = self._content(name, file, tables[name].schema)
        self._check(tables[RUNS])
        from calibench.bench.store.damage import first_damage  # of no use for tables that are whole

        found = first_damage(tables[RUNS], tables[TRACES])
        if found is not None:
            where = f"row {found.row} (run {found.run}), column {found.column}"
            value = shortened(json.dumps(found.value, default=str))
            raise StoreError(
                f"{self.folder / (TRACES if found.in_traces else RUNS)}: {where}: {value} {found.rule}; {_LEFT}"
            )
        raise StoreError(f"{self.folder / changed[0]}: was changed after bench wrote it; {_LEFT}")

    def _opened(self, name: str) -> pq.ParquetFile | None:
        path = self.folder / name
        if not path.exists():
            return None
        try:
            file = parquet_file(path)
        except (OSError, pa.ArrowException) as error:
            raise self._unreadable(path, error) from None
        self._check_columns(path, file.schema_arrow, RUNS_SCHEMA if name == RUNS else TRACES_SCHEMA)
        return file

    def _read(self, name: str, schema: pa.Schema, columns: Sequence[str] | None) -> pa.Table:
        file = self.open(name)
        if file is None:
            chosen = schema if columns is None else pa.schema([schema.field(column) for column in columns])
            return empty_table(chosen)
        return self._content(name, file, schema, columns)

    def _content(
        self, name: str, file: pq.ParquetFile, schema: pa.Schema, columns: Sequence[str] | None = None
    ) -> pa.Table:
        try:
            return in_schema(file.read(columns=list(columns or schema.names)), schema, columns)
        except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
            raise self._unreadable(self.folder / name, error) from None

    def _check_columns(self, path: Path, found: pa.Schema, schema: pa.Schema) -> None:
        if not set(schema.names) <= set(found.names):
            raise StoreError(f"{path}: has not our columns; is it from another program or version? It is left alone")
        if _KEY not in (found.metadata or {}):
            raise StoreError(
                f"{path}: has our columns and not the mark of bench, so another program has written it; {_LEFT}"
            )
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
        versions = {version for version in unique(table["schema_version"]).to_pylist()} - {SCHEMA_VERSION}
        if versions:
            raise StoreError(f"{path}: has rows of schema {versions.pop()}, this version reads {SCHEMA_VERSION}")

    def _unreadable(self, path: Path, error: Exception) -> StoreError:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        return StoreError(f"{path}: cannot be read ({first}); {_LEFT}")


def write_table(table: pa.Table, path: Path, pair: str | None = None) -> None:
    """Write a table whole, with where it comes from as metadata."""
    origin = metadata(pair)

    def write(file: BinaryIO) -> None:
        with sealed_writer(file, table.schema.with_metadata(origin)) as out:
            out.write_table(table.replace_schema_metadata(origin))

    write_whole(path, write)


def metadata(pair: str | None = None) -> dict[str, str]:
    """Return the metadata of a table; tables of one collection hold the same `pair`."""
    origin: dict[str, Any] = provenance() | {"schema_version": SCHEMA_VERSION, "pair": pair}
    return {_KEY.decode(): json.dumps(origin)}


def _statements(file: pq.ParquetFile) -> dict[str, Any]:
    """Return what a table of ours says of itself in its metadata; nothing where that was damaged."""
    try:
        origin = json.loads(file.schema_arrow.metadata[_KEY])
    except ValueError:
        origin = None
    return origin if isinstance(origin, dict) else {}


def _fits(found: pa.DataType, wanted: pa.DataType) -> bool:
    """Tell whether a column is of the type wanted, but for the name that a list's items have in a file."""
    if pa.types.is_list(found) and pa.types.is_list(wanted):
        return _fits(found.value_type, wanted.value_type)
    return bool(found == wanted) or (pa.types.is_timestamp(found) and pa.types.is_timestamp(wanted))


_DIGEST = b"calibench_digest"
_TAIL = 8  # bytes after the footer: its length, and Parquet's mark
_READ = 1 << 20


@contextmanager
def sealed_writer(file: BinaryIO, schema: pa.Schema) -> Iterator[pq.ParquetWriter]:
    """Yield a writer of the Parquet file that `file` becomes; it is sealed as the context ends."""
    digested = _Digested(file)
    with pq.ParquetWriter(digested, schema, compression="zstd") as writer:
        yield writer
        writer.add_key_value_metadata({_DIGEST.decode(): digested.digest.hexdigest()})


def is_whole(path: Path) -> bool:
    """Tell whether a file is as it was written. Raises `OSError` and Arrow's exceptions."""
    with open(path, "rb") as file:  # one file, though another gets its name meanwhile
        digest = (pq.read_metadata(file).metadata or {}).get(_DIGEST)
        if digest is None:
            return False
        end = file.seek(-_TAIL, 2)
        remaining = end - int.from_bytes(file.read(4), "little")  # the bytes before the footer
        mine = blake2b(digest_size=16)
        file.seek(0)
        while remaining > 0 and (some := file.read(min(remaining, _READ))):
            mine.update(some)
            remaining -= len(some)
        return bool(digest == mine.hexdigest().encode())


@final
class _Digested:
    """A file that is written through, with the digest of what was written; who opened it closes it."""

    closed = False

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._written, self.digest = file, 0, blake2b(digest_size=16)

    def write(self, data: bytes) -> int:
        self.digest.update(data)
        self._written += len(data)
        return self._file.write(data)

    def tell(self) -> int:
        return self._written

    def flush(self) -> None:
        self._file.flush()

    def close(self) -> None:
        pass
