"""Results on disk: one part a run, written whole; parts collected into ``runs.parquet`` and ``traces.parquet``.

A part is a Parquet file of one row, named by its run id, that appears by a rename: it is there whole or not at all.
What has a part, or a row in the collected table, has been done. A part that cannot be read is set aside, never deleted.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterable, Mapping, Set
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, final

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from calibench.bench.execution.merit import offered
from calibench.bench.execution.provenance import provenance
from calibench.bench.execution.run import Run
from calibench.bench.execution.run_id import UNSEEN
from calibench.bench.store.atomic_file import sweep_up, write_whole
from calibench.bench.store.lock import HOLDER, LOCK, SOFT_LOCK, locked

SCHEMA_VERSION = 2
_READABLE = (1, SCHEMA_VERSION)
_KIND = "calibench study"
DISCOVERY = "calibench discovery"  # the kind of the studies of `bench discover`, which `bench.discovery.store` keeps
_MAGIC = b"PAR1"
_BEGUN = {"parts", LOCK, SOFT_LOCK, HOLDER}  # what a kill at the very start leaves
_ORDER = ["problem", "problem_options", "optimizer", "optimizer_options", "start", "budget", "repetition", "run_id"]

_TEXT, _INT, _REAL, _BOOL = pa.string(), pa.int64(), pa.float64(), pa.bool_()
RUNS_SCHEMA = pa.schema(
    [
        ("run_id", _TEXT), ("study", _TEXT), ("problem", _TEXT), ("problem_options", _TEXT), ("data_id", _TEXT),
        ("dimension", _INT), ("optimizer", _TEXT), ("optimizer_options", _TEXT), ("library", _TEXT),
        ("library_version", _TEXT), ("repetition", _INT), ("seed", _TEXT), ("start", _TEXT), ("budget", _INT),
        ("target", _REAL),
        ("evaluations", _INT), ("jacobian_evaluations", _INT), ("charged", _INT), ("non_finite", _INT),
        ("batch_evaluations", _INT), ("residual_evaluations", _INT),
        ("restarts", _INT), ("status", _TEXT), ("stop_reason", _TEXT), ("error_type", _TEXT), ("error", _TEXT),
        ("best_value", _REAL), ("best_evaluation", _INT), ("best_x", pa.list_(_REAL)), ("inside_box", _BOOL),
        ("at_bound", pa.list_(_TEXT)), ("parameter_names", pa.list_(_TEXT)), ("parameter_values", pa.list_(_REAL)),
        ("gauge_phi", _REAL), ("kmrmse", _REAL), ("kmrmse_aligned", _REAL), ("parameter_error_mm", _REAL),
        ("parameter_error_rad", _REAL), ("parameter_error_mm_aligned", _REAL), ("parameter_error_rad_aligned", _REAL),
        ("targets", pa.list_(_REAL)), ("hits", pa.list_(_INT)), ("hits_charged", pa.list_(_INT)), ("wall_s", _REAL),
        ("cpu_s", _REAL), ("git_commit", _TEXT), ("git_dirty", _BOOL), ("versions", _TEXT), ("platform", _TEXT),
        ("started_at", pa.timestamp("us", tz="UTC")), ("schema_version", _INT),
        ("code_digest", _TEXT), ("traceback", _TEXT),
        ("merit", _TEXT), ("unit", _TEXT), ("minimum", _REAL), ("judged_value", _REAL), ("judged_evaluations", _INT),
    ]
)  # fmt: skip
# columns that came later, each with null for what was written before
_ADDED = frozenset(
    {
        "batch_evaluations", "residual_evaluations", "code_digest", "traceback", "merit", "unit", "minimum",
        "judged_value", "judged_evaluations",
    }
)  # fmt: skip
TRACES_SCHEMA = pa.schema(
    [("run_id", _TEXT), ("evaluations", _INT), ("charged", _INT), ("best_value", _REAL), ("restart", _INT)]
)
_TRACE = "trace"
_PART_SCHEMA = RUNS_SCHEMA.append(
    pa.field(_TRACE, pa.list_(pa.struct([(f.name, f.type) for f in TRACES_SCHEMA if f.name != "run_id"])))
)


class StoreError(ValueError):
    """A results folder that is not ours, cannot be read, or holds a damaged file."""


@final
class ResultStore:
    """The folder of one study, or to read from, the folder of many. Writing creates it.

    >>> ResultStore("results/none").runs()
    Traceback (most recent call last):
    calibench.bench.store.runs.StoreError: results/none: there is no such study folder
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    @property
    def study(self) -> str:
        """Return the study's name, which is its folder's."""
        return self.folder.resolve().name

    def runs(self) -> pd.DataFrame:
        """Return all finished runs, a row each, collected or not (columns: `RUNS_SCHEMA`, and ``merit.KEY``)."""
        return offered(to_pandas(pa.concat_tables([store._gathered()[0] for store in self._studies()])))

    def traces(self) -> pd.DataFrame:
        """Return the traces of all finished runs: run_id, evaluations, charged, best_value, restart."""
        return to_pandas(pa.concat_tables([store._gathered()[1] for store in self._studies()]))

    def open(self) -> None:
        """Create the folder for writing. Raises `StoreError` where something else stands there."""
        if self.folder.exists() and not self.folder.is_dir():
            raise StoreError(f"{self.folder}: is a file, a folder for results is needed")
        try:
            if self.folder.is_dir() and any(path.name not in _BEGUN for path in self.folder.iterdir()):
                self.manifest()
                return
            self._parts.mkdir(parents=True, exist_ok=True)
            with self._lock():
                if not (self.folder / "manifest.json").exists():
                    kind = {"kind": _KIND, "schema_version": SCHEMA_VERSION, "study": self.study, "planned": {}}
                    self._write_manifest(kind)
        except OSError as error:
            raise StoreError(f"{self.folder}: cannot be written: {error.strerror}") from None

    def manifest(self) -> dict[str, Any]:
        """Return the manifest. Raises `StoreError` where the folder is missing or not a study of ours."""
        if not self.folder.is_dir():
            raise StoreError(f"{self.folder}: there is no such study folder")
        try:
            manifest = json.loads((self.folder / "manifest.json").read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise StoreError(
                f"{self.folder}: has no manifest.json, so it is no study of ours; take another folder"
            ) from None
        except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
            raise StoreError(f"{self.folder}/manifest.json: cannot be read: {error}") from None
        if is_discovery(self.folder):
            raise StoreError(
                f"{self.folder}: is a study of bench discover; read CASE/report.html, findings.parquet and gaps.parquet"
            )
        if not isinstance(manifest, dict) or manifest.get("kind") != _KIND:
            raise StoreError(f"{self.folder}/manifest.json: is not a manifest of ours; take another folder")
        if manifest.get("schema_version") not in _READABLE:
            raise StoreError(
                f"{self.folder}: schema {manifest.get('schema_version')}, this version reads {SCHEMA_VERSION}"
            )
        if not isinstance(manifest.get("planned"), dict):
            raise StoreError(f"{self.folder}/manifest.json: its list of planned runs is damaged")
        found: dict[str, Any] = manifest
        return found

    def plan(self, labels: Mapping[str, str], command: str = "", files: Mapping[str, str] | None = None) -> None:
        """Note which runs are intended: {run_id: label}, and by which command. `status` tells what is left of them.

        `files` are those of a user's own classes, {name in the rows: absolute path}.
        """
        with self._lock():
            manifest = self.manifest()
            files = {**manifest.get("files", {}), **(files or {})}
            outdated = manifest["schema_version"] != SCHEMA_VERSION  # programs that know less must not write here
            new = set(labels) - set(manifest["planned"])
            if new or outdated or manifest.get("files", {}) != files:
                manifest |= {"schema_version": SCHEMA_VERSION, "planned": manifest["planned"] | labels, "files": files}
                manifest["commands"] = [*manifest.get("commands", []), *([command] if command and new else [])]
                self._write_manifest(manifest)

    def note_costs(self, costs: Iterable[Mapping[str, Any]]) -> None:
        """Keep what a call of each problem costs (`bench.sweep.costs`) in the manifest."""
        with self._lock():
            manifest = self.manifest()
            if new := list(costs):
                manifest["costs"] = [*manifest.get("costs", []), *new]
                self._write_manifest(manifest)

    def finished(self) -> set[str]:
        """Return the ids of the runs that are done and can be read."""
        known = self.collected()
        return known | {part["run_id"][0].as_py() for part in self._new_parts(known)[0]}

    def collected(self) -> set[str]:
        """Return the ids in ``runs.parquet``."""
        runs = self._read_table("runs.parquet", RUNS_SCHEMA, columns=["run_id", "evaluations"])
        traces = self._read_table("traces.parquet", TRACES_SCHEMA, columns=["run_id"])
        return self._complete(runs, traces)

    def damaged(self) -> list[Path]:
        """Return the parts that cannot be read, whether their run was collected before or not."""
        return self._new_parts(self.collected())[1]

    def write(self, run: Run) -> None:
        """Write a run's part: whole, or not at all.

        Warns of an object whose parameters cannot be seen: another of the same box would have the same run id.
        """
        for kind in ("problem", "optimizer"):
            if UNSEEN in str(run.row[f"{kind}_options"]):
                _warn_of_unseen(str(run.row[kind]), json.loads(run.row[f"{kind}_options"]))
        row = {name: run.row.get(name) for name in RUNS_SCHEMA.names}
        row |= {"study": self.study, "schema_version": SCHEMA_VERSION}
        keys = ("evaluations", "charged", "best_value", "restart")
        row[_TRACE] = [dict(zip(keys, point, strict=True)) for point in run.points]
        self._parts.mkdir(exist_ok=True)
        part = pa.Table.from_pylist([row], _PART_SCHEMA)
        # one row in fifty columns: as pages without compression it is read four times faster, and checked as well
        plain = {"compression": "none", "use_dictionary": False, "write_statistics": False, "write_page_checksum": True}
        _write_table(part, self._parts / f"{run.run_id}.parquet", **plain)

    def fill(self, runs: pd.DataFrame, traces: pd.DataFrame) -> list[Path]:
        """Make this the folder of just these runs, collected, in place of what it had; return the three files.

        Columns as `runs` and `traces` of a store return them. There is no part of any.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        paths = [self.folder / name for name in ("manifest.json", "traces.parquet", "runs.parquet")]
        self._write_manifest({"kind": _KIND, "schema_version": SCHEMA_VERSION, "study": self.study, "planned": {}})
        _write_table(pa.Table.from_pandas(traces, TRACES_SCHEMA, preserve_index=False), paths[1])
        _write_table(pa.Table.from_pandas(runs, RUNS_SCHEMA, preserve_index=False), paths[2])
        return paths

    def forget(self, run_ids: Iterable[str]) -> None:
        """Take failed runs out, so that they are done again."""
        gone = set(run_ids)
        with self._lock():
            runs, traces, _ = self._gathered()
            for table, name in ((runs, "runs.parquet"), (traces, "traces.parquet")):
                kept = pc.invert(pc.is_in(table["run_id"], pa.array(list(gone), _TEXT)))
                _write_table(table.filter(kept), self.folder / name)
            for run_id in gone:
                (self._parts / f"{run_id}.parquet").unlink(missing_ok=True)

    def collect(self) -> list[Path]:
        """Fold all parts into ``runs.parquet`` and ``traces.parquet``; return where damaged parts were set aside.

        The tables are sorted by what a run is, so that they do not depend on who finished first.
        """
        self.manifest()
        with self._lock():
            sweep_up(self._parts)
            sweep_up(self.folder)
            runs, traces, damaged = self._gathered()
            aside = [self._set_aside(path) for path in damaged]
            if aside:
                runs, traces, _ = self._gathered()
            _write_table(traces, self.folder / "traces.parquet")
            _write_table(runs, self.folder / "runs.parquet")
        return aside

    def _set_aside(self, path: Path) -> Path:
        where = self.folder / "quarantine" / path.name
        where.parent.mkdir(exist_ok=True)
        os.replace(path, where)
        return where

    def _studies(self) -> list[ResultStore]:
        """Return the stores to read: this one, or those of the studies in this folder of studies."""
        if (self.folder / "manifest.json").exists():
            return [self]
        return [ResultStore(folder) for folder in studies_in(self.folder)] or [self]

    def _gathered(self) -> tuple[pa.Table, pa.Table, list[Path]]:
        """Return the collected tables with the parts that are not in them yet, and what parts are damaged."""
        self.manifest()
        runs = self._read_table("runs.parquet", RUNS_SCHEMA)
        traces = self._read_table("traces.parquet", TRACES_SCHEMA)
        known = self._complete(runs, traces)
        runs, traces = (t.filter(pc.is_in(t["run_id"], pa.array(list(known), _TEXT))) for t in (runs, traces))
        parts, damaged = self._new_parts(known)
        if parts:
            new = pa.concat_tables(parts).combine_chunks()
            runs = pa.concat_tables([runs, new.select(RUNS_SCHEMA.names)])
            traces = pa.concat_tables([traces, _points(new)])
        runs = runs.sort_by([(name, "ascending") for name in _ORDER])
        order = pc.index_in(traces["run_id"], value_set=runs["run_id"].combine_chunks())
        by_run = traces.append_column("_order", order)
        traces = by_run.sort_by([("_order", "ascending"), ("evaluations", "ascending")]).drop_columns(["_order"])
        return runs, traces, damaged

    def _new_parts(self, known: Set[str]) -> tuple[list[pa.Table], list[Path]]:
        """Return the parts of runs that are not `known`, and the paths of all damaged parts.

        Of a known one, which nobody needs, only the end is looked at: a truncated part has another.
        """
        parts, damaged = [], []
        for path in self._part_paths():
            part = None if path.stem in known else _read_part(path)
            if part is not None:
                parts.append(part)
            elif path.stem not in known or not _ends_well(path):
                damaged.append(path)
        return parts, damaged

    def _complete(self, runs: pa.Table, traces: pa.Table) -> set[str]:
        """Return the runs that need no part: they are in both tables, or have no trace, or no part is left of them.

        The two tables are replaced one after the other; a kill in between leaves them unlike.
        """
        traced, parts = set(traces["run_id"].unique().to_pylist()), {path.stem for path in self._part_paths()}
        rows = zip(runs["run_id"].to_pylist(), runs["evaluations"].to_pylist(), strict=True)
        return {run_id for run_id, n in rows if run_id in traced or not n or run_id not in parts}

    def _read_table(self, name: str, schema: pa.Schema, columns: list[str] | None = None) -> pa.Table:
        path = self.folder / name
        if not path.exists():
            return schema.empty_table()
        try:
            file = pq.ParquetFile(path)  # and not read_table, which loads pyarrow.dataset
            found = file.schema_arrow
            if not set(schema.names) - _ADDED <= set(found.names):
                raise StoreError(f"{path}: has not our columns; is it from another program or version?")
            wanted = [name for name in columns or schema.names if name in found.names]
            return _with_all(file.read(columns=wanted), schema, columns)
        except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
            raise StoreError(f"{path}: cannot be read ({_first_line(error)}); `bench collect` cannot mend it") from None

    @property
    def _parts(self) -> Path:
        return self.folder / "parts"

    def _part_paths(self) -> list[Path]:
        return sorted(self._parts.glob("*.parquet"))

    def _write_manifest(self, manifest: Mapping[str, Any]) -> None:
        text = json.dumps(manifest, indent=1).encode()
        write_whole(self.folder / "manifest.json", lambda file: file.write(text))

    def _lock(self) -> AbstractContextManager[None]:
        """Let one process at a time rewrite the tables."""
        return locked(self.folder)


def studies_in(parent: Path) -> list[Path]:
    """Return the folders of the studies under `parent` that hold runs, by name; those of `bench discover` do not."""
    folders = [path.parent for path in sorted(parent.glob("*/manifest.json"))]
    return [folder for folder in folders if not is_discovery(folder)]


def is_discovery(folder: Path) -> bool:
    """Tell whether `folder` holds a study of `bench discover`."""
    try:
        manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(manifest, dict) and manifest.get("kind") == DISCOVERY


def _warn_of_unseen(name: str, options: Mapping[str, Any]) -> None:
    hidden = [key for key, value in options.items() if str(value).startswith(UNSEEN)]
    if hidden:
        warnings.warn(
            f"{name}: {', '.join(hidden)} cannot be seen on the object, so that objects which differ in it alone have "
            f"one run id; keep it as an attribute (self.{hidden[0]}), or give the object `options`",
            stacklevel=3,
        )


def _ends_well(path: Path) -> bool:
    """Tell whether the file ends as a Parquet file does."""
    try:
        with open(path, "rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(-8, os.SEEK_END)
            footer, magic = int.from_bytes(file.read(4), "little"), file.read()
            return magic == _MAGIC and footer + 12 <= size
    except OSError:
        return False


def _read_part(path: Path) -> pa.Table | None:
    """Return the part, or None where it is damaged or not ours."""
    try:
        file = pq.ParquetFile(pa.BufferReader(path.read_bytes()), page_checksum_verification=True, pre_buffer=False)
        table = file.read(use_threads=False)
        if set(_PART_SCHEMA.names) - _ADDED - set(table.schema.names) or table["run_id"].to_pylist() != [path.stem]:
            return None
        table = _with_all(table, _PART_SCHEMA)
        return table if table.schema.equals(_PART_SCHEMA) else table.cast(_PART_SCHEMA)
    except (OSError, pa.ArrowException, UnicodeDecodeError):
        return None


def _with_all(table: pa.Table, schema: pa.Schema, columns: list[str] | None = None) -> pa.Table:
    """Return the table with all columns (of `columns`) of the schema in its order, null where it has none of a name."""
    wanted = [field for field in schema if columns is None or field.name in columns]
    found = [
        table[field.name] if field.name in table.schema.names else pa.nulls(len(table), field.type) for field in wanted
    ]
    return pa.table(found, names=[field.name for field in wanted])


def _points(parts: pa.Table) -> pa.Table:
    """Return the traces of parts as a table of points."""
    traces = parts[_TRACE].combine_chunks()
    of_run = parts["run_id"].combine_chunks().take(pc.list_parent_indices(traces))
    return pa.Table.from_arrays([of_run, *pc.list_flatten(traces).flatten()], schema=TRACES_SCHEMA)


def _write_table(table: pa.Table, path: Path, **options: Any) -> None:
    told = {"calibench": json.dumps(provenance() | {"schema_version": SCHEMA_VERSION})}
    chosen = {"compression": "zstd"} | options
    write_whole(path, lambda file: pq.write_table(table.replace_schema_metadata(told), file, **chosen))


def to_pandas(table: pa.Table) -> pd.DataFrame:
    """Return pandas with lists as Arrow lists and flags as nullable booleans: no column of Python objects."""

    def column_type(arrow: pa.DataType) -> Any:
        if pa.types.is_list(arrow):
            return pd.ArrowDtype(arrow)
        return pd.BooleanDtype() if pa.types.is_boolean(arrow) else None

    frame: pd.DataFrame = table.to_pandas(types_mapper=column_type)
    return frame


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
