"""The tables of all studies below a folder as one: by Arrow, lazily, and in SQL by DuckDB.

A study joins where its file has our mark and is as it was written; columns that an older file has not are null. What
cannot be read is left out and told. SQL is one SELECT that may read these files, and nothing else of this machine.
"""

import os
import stat
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, final, get_args, get_origin

import pyarrow as pa
import pyarrow.parquet as pq

from calibench.bench.discovery.store import FINDINGS_SCHEMA, GAPS_SCHEMA
from calibench.bench.store.arrays import HITS_SCHEMA, RUNS_SCHEMA, TRACES_SCHEMA, cast_table
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.tables import is_whole, parquet_file, unreadable
from calibench.bench.tracking.catalogue import CALIBRATION, HAND_EYE, Entry, catalogue
from calibench.core.options import suggest
from calibench.core.plain import json_of
from calibench.core.tables.data_file import read_whole

if TYPE_CHECKING:
    import pyarrow.dataset as ds

TableName = Literal["runs", "traces", "hits", "findings", "gaps"]
Groups = Mapping[str, Sequence[Sequence[Path]]]  # the files of each table, those with the same columns together
_TEXT, _REAL = pa.string(), pa.float64()
SCHEMAS: dict[str, pa.Schema] = {
    "runs": RUNS_SCHEMA, "traces": TRACES_SCHEMA, "hits": HITS_SCHEMA, "findings": FINDINGS_SCHEMA, "gaps": GAPS_SCHEMA,
}  # fmt: skip
CALIBRATIONS_SCHEMA = pa.schema(
    [
        ("folder", _TEXT), ("kind", _TEXT), ("case", _TEXT), ("machine", _TEXT), ("level", _TEXT),
        ("poses", pa.int64()), ("before", _REAL), ("after", _REAL), ("started_at", pa.timestamp("us", tz="UTC")),
        ("git_commit", _TEXT), ("git_dirty", pa.bool_()), ("command", _TEXT),
    ]
)  # fmt: skip
_SEALED = ("runs", "traces")
_MARK = b"calibench"
_LARGEST_ROWS = 50_000_000
_LARGEST_FOOTER = 64_000_000  # bytes
_LARGEST_JSON = 50_000_000


@final
@dataclass(frozen=True)
class LeftOut:
    """A file that is no part of the tables, and why."""

    path: Path
    why: str


def rows_in(folder: Path, name: TableName, columns: Sequence[str]) -> pa.Table:
    """Return columns of one of the tables in a folder; no rows where there is none. Raises `StoreError`.

    The seal is checked, as the store does; unlike there, a column that an older file has not is null.
    """
    schema = pa.schema([SCHEMAS[name].field(column) for column in columns])
    path = folder / f"{name}.parquet"
    if not path.exists():
        return schema.empty_table()
    file = check_table(path, sealed=name in _SEALED)
    try:
        if file.metadata.num_rows > _LARGEST_ROWS:
            raise StoreError(f"{path.name}: states {file.metadata.num_rows} rows; at most {_LARGEST_ROWS} are read")
        known = set(file.schema_arrow.names)
        there = [column for column in columns if column in known]
        table = file.read(columns=there, use_threads=False)
        for column in columns:
            if column not in there:
                table = table.append_column(column, pa.nulls(len(table), schema.field(column).type))
        return cast_table(table.select(list(columns)), schema)
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        raise unreadable(path.name, error) from None


def check_table(path: Path, *, sealed: bool) -> pq.ParquetFile:
    """Return a table as a file. Raises `StoreError` for one that is not ours, or a sealed one that was changed."""
    try:
        found = os.stat(path)
        if not stat.S_ISREG(found.st_mode):
            raise StoreError(f"{path.name}: is no regular file")
        with open(path, "rb") as file:  # a footer of gigabytes is refused before Arrow makes room for it
            end = file.seek(0, os.SEEK_END)
            file.seek(max(0, end - 8))
            if int.from_bytes(file.read(4), "little") > min(_LARGEST_FOOTER, end):
                raise StoreError(f"{path.name}: its footer is damaged")
        table = parquet_file(path)
        if _MARK not in (table.metadata.metadata or {}):
            raise StoreError(f"{path.name}: has not the mark of bench, so another program has written it")
        if sealed and not is_whole(path, table.metadata):
            raise StoreError(f"{path.name}: has not its seal: it was changed, or a version without seals wrote it")
        return table
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        raise unreadable(path.name, error) from None


def calibration_in(folder: Path) -> dict[str, Any] | None:
    """Return the row of a calibration, None where its file is none of ours. Raises `ValueError` for a damaged one."""
    arm = (folder / CALIBRATION).exists()
    path = folder / (CALIBRATION if arm else HAND_EYE)
    found = json_of(read_whole(path, _LARGEST_JSON))
    if not isinstance(found, dict) or "schema_version" not in found or not isinstance(found.get("case"), str):
        return None
    if arm:
        machine = Path(str(found.get("urdf") or found.get("dh") or "arm")).name
        level, before, after = found.get("chosen"), _number(found.get("before")), _number(found.get("after"))
    else:
        machine, level, before = "camera", found.get("hand_eye"), None
        after = _number((found.get("unseen") or {}).get("position") if isinstance(found.get("unseen"), dict) else None)
    poses, made = found.get("poses" if arm else "pairs"), found.get("provenance")
    made = made if isinstance(made, dict) else {}
    began = os.stat(path).st_mtime
    with suppress(ValueError):
        began = datetime.fromisoformat(str(made.get("started_at"))).timestamp()
    return {
        "folder": "", "kind": "arm" if arm else "camera", "case": found["case"], "machine": machine,
        "level": str(level), "poses": poses if isinstance(poses, int) else None, "before": before, "after": after,
        "started_at": datetime.fromtimestamp(began, UTC), "git_commit": str(made.get("git_commit") or ""),
        "git_dirty": bool(made.get("git_dirty")), "command": str(made.get("command") or ""),
    }  # fmt: skip


def _number(value: Any) -> float | None:
    """Return a number, that of its rms where it is an error; None for anything else."""
    value = value.get("rms", value.get("position")) if isinstance(value, dict) else value
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def dataset(results: str | Path = "results", table: TableName = "runs", *words: str) -> "ds.Dataset":
    """Return a table of all studies below `results` as one dataset of Arrow, of which nothing is read yet.

    `table` is runs, traces, hits, findings or gaps; `words` are filters of ``bench studies``. ``.to_table(columns=...,
    filter=...).to_pandas()`` reads what is asked for; polars takes it by ``scan_pyarrow_dataset``, duckdb as a table.
    Of thousands of studies give ``cache_metadata=False`` as well: Arrow keeps 0.2 MB a file else.
    """
    import pyarrow.dataset as ds
    from pyarrow.fs import LocalFileSystem

    if table not in SCHEMAS:
        raise ValueError(f"table={table}: {suggest(table, SCHEMAS)}")
    paths, _ = files_of(Path(results), catalogue(results, words), table)
    return ds.dataset([str(path) for path in paths], SCHEMAS[table], "parquet", filesystem=LocalFileSystem())


def files_of(results: Path, found: Sequence[Entry], table: str) -> tuple[list[Path], list[LeftOut]]:
    """Return the files of a table in these studies, and what is left out because it cannot be read."""
    paths, left_out = [], []
    for entry in found:
        path = folder_of(results, entry) / f"{table}.parquet"
        if entry.status == "damaged":
            if table == "runs" or (table == "gaps" and entry.kind == "discovery"):
                left_out.append(LeftOut(path.parent, entry.headline))
        elif path.is_file():
            paths.append(path.absolute())
    return paths, left_out


def folder_of(results: Path, entry: Entry) -> Path:
    """Return where an entry stands: below `results`, or `results` itself where that is the study."""
    return results / entry.study if (results / entry.study).is_dir() else results


# whether a run reached its goal: its own target, or else the last of its problem; null where there is none
_REACHED = (
    "case when coalesce(target, targets[-1]) is not null then status <> 'failed' and "
    "hits_charged[list_position(targets, coalesce(target, targets[-1]))] is not null end"
)


def query(results: Path, text: str) -> tuple[list[str], list[tuple[Any, ...]], list[LeftOut]]:
    """Return names and rows of one SELECT over the views studies, runs, traces, hits, findings, gaps, calibrations.

    Raises `ValueError`, in one line, for anything that is no SELECT, and for what DuckDB does not take.
    """
    try:
        import duckdb
    except ImportError:
        raise ValueError("sql: needs duckdb; pip install 'calibench[sql]'") from None
    found = catalogue(results)
    files: dict[str, list[Path]] = {}
    left_out: list[LeftOut] = []
    for name in SCHEMAS:  # nothing is looked for of a table whose name does not stand in the text
        files[name], missing = files_of(results, found, name) if name in text.lower() else ([], [])
        left_out += missing
    texts = {one.study: one.study.encode(errors="replace").decode() for one in found}  # a file system takes any bytes
    rows = [asdict(one) | {"study": texts[one.study]} for one in found]
    in_memory = {"studies": pa.Table.from_pylist(rows, _STUDIES)}
    if "calibrations" in text.lower():
        arms = []
        for entry in found:
            if entry.kind == "calibration" and entry.status != "damaged":
                row = calibration_in(folder_of(results, entry))
                if row is not None:
                    arms.append(row | {"folder": texts[entry.study]})
        in_memory["calibrations"] = pa.Table.from_pylist(arms, CALIBRATIONS_SCHEMA)
    groups, damaged = _by_columns(files)
    try:
        answer = _answer(text, groups, in_memory)
    except duckdb.Error as error:
        raise ValueError(f"sql: {' '.join(str(error).split())[:600]}") from None
    return *answer, [*left_out, *damaged]


def _by_columns(files: Mapping[str, Sequence[Path]]) -> tuple[Groups, list[LeftOut]]:
    """Return of each table its files in groups with the same columns, and what is left out: DuckDB checks no bytes."""
    groups: dict[str, dict[frozenset[str], list[Path]]] = {name: {} for name in files}
    left_out = []
    for name, paths in files.items():
        for path in paths:
            try:
                columns = frozenset(check_table(path, sealed=name in _SEALED).schema_arrow.names)
                groups[name].setdefault(columns, []).append(path)
            except StoreError as error:
                left_out.append(LeftOut(path.parent, str(error)))
    return {name: [*of_one.values()] for name, of_one in groups.items()}, left_out


def _answer(text: str, groups: Groups, in_memory: Mapping[str, pa.Table]) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Return names and rows of a SELECT. Each group of files has the columns of its first one; DuckDB reads them."""
    import duckdb

    base: dict[str, str | bool | int | float | list[str]] = {
        "autoinstall_known_extensions": "false",
        "autoload_known_extensions": "false",
    }
    with duckdb.connect(":memory:", config=base) as engine:
        asked = engine.extract_statements(text)
        if len(asked) != 1 or asked[0].type != duckdb.StatementType.SELECT:
            raise ValueError("sql: one SELECT is needed; nothing is written by SQL")
        quoted = {  # in the words of SQL
            name: [", ".join("'" + str(path).replace("'", "''") + "'" for path in paths) for paths in of_one if paths]
            for name, of_one in groups.items()
        }
        engine.execute(f"set allowed_paths = [{', '.join(part for parts in quoted.values() for part in parts)}]")
        engine.execute("set enable_external_access = false")
        engine.execute("set python_enable_replacements = false")
        engine.execute("set lock_configuration = true")
        for name, parts in quoted.items():
            engine.register(f"no_{name}", SCHEMAS[name].empty_table())
            views = [f"from no_{name}", *(f"from read_parquet([{part}])" for part in parts)]
            more = f", {_REACHED} as reached" if name == "runs" else ""
            engine.execute(f"create view {name} as select *{more} from ({' union all by name '.join(views)})")
        for name, table in in_memory.items():
            engine.register(name, table)
        rows = engine.execute(text)
        return [column[0] for column in rows.description or ()], rows.fetchall()


_ARROW: dict[Any, pa.DataType] = {int: pa.int64(), bool: pa.bool_()}  # any other is text


_STUDIES = pa.schema(
    (one.name, pa.list_(_ARROW.get(get_args(one.type)[0], _TEXT)))
    if get_origin(one.type) is tuple
    else (one.name, _ARROW.get(one.type, _TEXT))
    for one in fields(Entry)
)
