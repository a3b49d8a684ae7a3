"""The two tables of a study, ``runs.parquet`` and ``traces.parquet``: read with care, written whole, sealed.

Read is only what this store wrote for this study; anything else is refused, named by row and column where a value is
one that no run can have (`bench.store.damage`), and left alone. The tables are replaced one after the other; a kill in
between leaves them unlike, which the mark that both hold tells. A seal is a digest of all bytes before the footer, kept
in the footer, so that an edit with whatever tool is noticed. It guards against accidents, not against who forges it.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
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
from calibench.bench.store.arrays import RUNS_SCHEMA, TRACES_SCHEMA, cast_table, compute, empty_table, in_schema
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.store.manifest import StoreError
from calibench.core.words import shortened

RUNS, TRACES, HITS = "runs.parquet", "traces.parquet", "hits.parquet"
_SCHEMAS = {RUNS: RUNS_SCHEMA, TRACES: TRACES_SCHEMA}
_TEXTS = {  # of runs all but the id, which no two of them share
    RUNS: [field.name for field in RUNS_SCHEMA if field.type == pa.string() and field.name != "run_id"],
    TRACES: ["run_id"],
}
ORDER = ("problem", "problem_options", "optimizer", "optimizer_options", "start", "budget", "repetition", "run_id")
_KEY = b"calibench"  # of the metadata
_READ_ALWAYS = ("run_id", "study", "schema_version", "evaluations")
_LEFT = "it is left alone: put back a copy, or delete both tables and run again"
_CHECKED: dict[Path, list[tuple[int, int, int] | None]] = {}  # folders whose tables were found right, and their files


def parquet_file(path: Path, as_codes: Sequence[str] = ()) -> pq.ParquetFile:
    """Return the Parquet file of that name on this machine: ``lab:1`` and ``s3://x`` are folders, no addresses.

    Columns of text in `as_codes` are read as dictionaries.
    """
    # read_table loads pyarrow.dataset
    return pq.ParquetFile(path.absolute(), filesystem=LocalFileSystem(), read_dictionary=[*as_codes], pre_buffer=False)


def unreadable(file: str | Path, error: Exception, advice: str = "") -> StoreError:
    first = str(error).splitlines()[0] if str(error) else type(error).__name__
    return StoreError(f"{file}: cannot be read ({first}){advice}")


@final
@dataclass(frozen=True)
class Tables:
    """The tables in `folder`, of the study that its manifest names."""

    folder: Path
    study: str

    def runs(self, columns: Sequence[str] | None = None, coded: bool = False) -> pa.Table:
        """Return the rows (of `columns`), checked; none where there is no table. `coded`: texts as dictionaries."""
        wanted = None if columns is None else list(dict.fromkeys([*columns, *_READ_ALWAYS]))
        table = self._content(RUNS, self.open(RUNS, coded), wanted)
        self._check(table)
        return table if columns is None else table.select(list(columns))

    def traces(self, columns: Sequence[str] | None = None, coded: bool = False) -> pa.Table:
        """Return the points of all traces (`columns` of them); none where there is no table."""
        return self._content(TRACES, self.open(TRACES, coded), columns)

    def complete(self) -> set[str]:
        """Return the ids of the runs whose row and trace are both there."""
        rows = self.runs(_READ_ALWAYS)
        ids = rows["run_id"].to_pylist()
        if not ids or self.are_one_pair():
            return set(ids)
        file = self.open(TRACES)
        traced = set() if file is None else set(compute("unique", file.read(columns=["run_id"])["run_id"]).to_pylist())
        evaluations = rows["evaluations"].to_pylist()
        return {run_id for run_id, n in zip(ids, evaluations, strict=True) if run_id in traced or not n}

    def are_one_pair(self) -> bool:
        """Tell whether both tables were written by the same collection, which makes them whole."""
        marks = []
        for file in (self.open(RUNS), self.open(TRACES)):
            try:
                origin = None if file is None else json.loads(file.schema_arrow.metadata[_KEY])
            except ValueError:  # its metadata was damaged
                origin = None
            marks.append(origin.get("pair") if isinstance(origin, dict) else None)
        return marks[0] is not None and marks[0] == marks[1]

    def open(self, name: str, coded: bool = False) -> pq.ParquetFile | None:
        """Return a table as a file; None where it is missing. Both tables are checked: one is not read without both."""
        files: dict[str, pq.ParquetFile] = {}
        for each, schema in _SCHEMAS.items():
            path = self.folder / each
            if not path.exists():
                continue
            try:
                files[each] = parquet_file(path)
            except (OSError, pa.ArrowException) as error:
                raise unreadable(path, error, f"; {_LEFT}") from None
            found = files[each].schema_arrow
            if not set(schema.names) <= set(found.names):
                raise StoreError(
                    f"{path}: has not our columns; is it from another program or version? It is left alone"
                )
            if _KEY not in (found.metadata or {}):
                raise StoreError(
                    f"{path}: has our columns and not the mark of bench, so another program has written it; {_LEFT}"
                )
            for field in schema:
                kind, wanted = found.field(field.name).type, field.type
                if pa.types.is_list(kind) and pa.types.is_list(wanted):  # the items of a file's lists have another name
                    kind, wanted = kind.value_type, wanted.value_type
                if kind != wanted and not (pa.types.is_timestamp(kind) and pa.types.is_timestamp(wanted)):
                    kind = found.field(field.name).type
                    raise StoreError(f"{path}: column {field.name} is {kind}, not {field.type}; it is left alone")
        paths = [self.folder / each for each in _SCHEMAS]
        status = [path.stat() if path.exists() else None for path in paths]
        # by what the two files, once they were checked, are known again
        state = [None if one is None else (one.st_ino, one.st_size, one.st_mtime_ns) for one in status]
        place = self.folder.absolute()
        if _CHECKED.get(place) != state:
            changed = [each for each in files if not is_whole(self.folder / each)]
            if changed:  # say what is wrong in a table that is not as it was written
                rows, traces = (self._content(each, files.get(each)) for each in _SCHEMAS)
                self._check(rows)
                from calibench.bench.store.damage import first_damage  # of no use for tables that are whole

                damage = first_damage(rows, traces)
                if damage is None:
                    raise StoreError(f"{self.folder / changed[0]}: was changed after bench wrote it; {_LEFT}")
                where = f"row {damage.row} (run {damage.run}), column {damage.column}"
                value = shortened(json.dumps(damage.value, default=str))
                path = self.folder / (TRACES if damage.in_traces else RUNS)
                raise StoreError(f"{path}: {where}: {value} {damage.rule}; {_LEFT}")
            _CHECKED[place] = state
        return parquet_file(self.folder / name, _TEXTS[name]) if coded and name in files else files.get(name)

    def _content(self, name: str, file: pq.ParquetFile | None, columns: Sequence[str] | None = None) -> pa.Table:
        schema = _SCHEMAS[name]
        if file is None:
            return empty_table(schema if columns is None else pa.schema([schema.field(column) for column in columns]))
        try:
            names = list(columns or schema.names)  # in groups: all at once take thrice the memory
            groups = [file.read_row_group(i, names, use_threads=False) for i in range(file.num_row_groups)]
            table = pa.concat_tables(groups or [file.read(names)])
            stored = file.schema_arrow  # made anew by each look
            for i, field in enumerate(schema):
                if pa.types.is_dictionary(stored.field(field.name).type):
                    schema = schema.set(i, stored.field(field.name))
            return in_schema(table, schema, columns)
        except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
            raise unreadable(self.folder / name, error, f"; {_LEFT}") from None

    def _check(self, rows: pa.Table) -> None:
        path, ids = self.folder / RUNS, rows["run_id"]
        if ids.null_count:
            raise StoreError(f"{path}: {ids.null_count} rows have no run_id; it is left alone")
        if (double := len(ids) - compute("count_distinct", ids).as_py()) > 0:
            raise StoreError(f"{path}: {double} rows have a run_id that another row has; it is left alone")
        others = sorted({str(name) for name in compute("unique", rows["study"]).to_pylist()} - {self.study})
        if others:
            raise StoreError(
                f"{path}: has rows of study {others[0]!r}, this folder is study {self.study!r}; it is left alone "
                "(`bench merge A B --to C` joins studies)"
            )
        versions = {*compute("unique", rows["schema_version"]).to_pylist()} - {SCHEMA_VERSION}
        if versions:
            raise StoreError(f"{path}: has rows of schema {versions.pop()}, this version reads {SCHEMA_VERSION}")


def write_tables(tables: Iterable[pa.Table], schema: pa.Schema, path: Path) -> Path:
    """Write tables one after the other as one file, whole, with where it comes from as metadata; return its path."""
    schema = schema.with_metadata(metadata())

    def write(file: BinaryIO) -> None:
        with sealed_writer(file, schema) as out:
            for table in tables:
                out.write_table(cast_table(table, schema))

    return write_whole(path, write)


def metadata(pair: str | None = None) -> dict[str, str]:
    """Return the metadata of a table; tables of one collection hold the same `pair`."""
    origin: dict[str, Any] = provenance() | {"schema_version": SCHEMA_VERSION, "pair": pair}
    return {_KEY.decode(): json.dumps(origin)}


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


def is_whole(path: Path, footer: pq.FileMetaData | None = None) -> bool:
    """Tell whether a file is as it was written; its `footer` may be read already. Raises `OSError`, Arrow's errors."""
    with open(path, "rb") as file:  # one file, though another gets its name meanwhile
        digest = ((pq.read_metadata(file) if footer is None else footer).metadata or {}).get(_DIGEST)
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
        self._file, self.digest = file, blake2b(digest_size=16)
        self.tell, self.flush = file.tell, file.flush

    def write(self, data: bytes) -> int:
        self.digest.update(data)
        return self._file.write(data)

    def close(self) -> None:
        pass
