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
from calibench.bench.execution.run import Run
from calibench.bench.execution.run_row import SCHEMA_VERSION
from calibench.bench.provenance.run_id import UNSEEN
from calibench.bench.store.atomic_file import sweep_up
from calibench.bench.store.lock import HOLDER, LOCK, SOFT_LOCK, locked
from calibench.bench.store.manifest import StoreError, new_manifest, read_manifest, studies_in, write_manifest
from calibench.bench.store.part import ends_well, points_of, read_part, write_part, write_table
from calibench.bench.store.schema import RUNS_SCHEMA, TRACES_SCHEMA, is_ours, to_pandas, with_all

_BEGUN = {"parts", LOCK, SOFT_LOCK, HOLDER}  # what a kill at the very start leaves
_ORDER = ["problem", "problem_options", "optimizer", "optimizer_options", "start", "budget", "repetition", "run_id"]


@final
class ResultStore:
    """The folder of one study, or to read from, the folder of many. Writing creates it.

    >>> ResultStore("results/none").runs()
    Traceback (most recent call last):
    calibench.bench.store.manifest.StoreError: results/none: there is no such study folder
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
                    write_manifest(self.folder, new_manifest(self.study))
        except OSError as error:
            raise StoreError(f"{self.folder}: cannot be written: {error.strerror}") from None

    def manifest(self) -> dict[str, Any]:
        """Return the manifest. Raises `StoreError` where the folder is missing or not a study of ours."""
        return read_manifest(self.folder)

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
                write_manifest(self.folder, manifest)

    def note_costs(self, costs: Iterable[Mapping[str, Any]]) -> None:
        """Keep what a call of each problem costs (`bench.sweep.costs`) in the manifest."""
        with self._lock():
            manifest = self.manifest()
            if new := list(costs):
                manifest["costs"] = [*manifest.get("costs", []), *new]
                write_manifest(self.folder, manifest)

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
        record = run.record
        for name, options in (
            (record.problem, record.problem_options), (record.optimizer, record.optimizer_options),
        ):  # fmt: skip
            if UNSEEN in options:
                _warn_of_unseen(name, json.loads(options))
        self._parts.mkdir(exist_ok=True)
        write_part(run, self.study, self._parts)

    def fill(self, runs: pd.DataFrame, traces: pd.DataFrame) -> list[Path]:
        """Make this the folder of just these runs, collected, in place of what it had; return the three files.

        Columns as `runs` and `traces` of a store return them. There is no part of any.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        paths = [self.folder / name for name in ("manifest.json", "traces.parquet", "runs.parquet")]
        write_manifest(self.folder, new_manifest(self.study))
        write_table(pa.Table.from_pandas(traces, TRACES_SCHEMA, preserve_index=False), paths[1])
        write_table(pa.Table.from_pandas(runs, RUNS_SCHEMA, preserve_index=False), paths[2])
        return paths

    def forget(self, run_ids: Iterable[str]) -> None:
        """Take failed runs out, so that they are done again."""
        gone = set(run_ids)
        with self._lock():
            runs, traces, _ = self._gathered()
            for table, name in ((runs, "runs.parquet"), (traces, "traces.parquet")):
                kept = pc.invert(pc.is_in(table["run_id"], pa.array(list(gone), pa.string())))
                write_table(table.filter(kept), self.folder / name)
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
            write_table(traces, self.folder / "traces.parquet")
            write_table(runs, self.folder / "runs.parquet")
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
        runs, traces = (t.filter(pc.is_in(t["run_id"], pa.array(list(known), pa.string()))) for t in (runs, traces))
        parts, damaged = self._new_parts(known)
        if parts:
            new = pa.concat_tables(parts).combine_chunks()
            runs = pa.concat_tables([runs, new.select(RUNS_SCHEMA.names)])
            traces = pa.concat_tables([traces, points_of(new)])
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
            part = None if path.stem in known else read_part(path)
            if part is not None:
                parts.append(part)
            elif path.stem not in known or not ends_well(path):
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
            if not is_ours(found, schema):
                raise StoreError(f"{path}: has not our columns; is it from another program or version?")
            wanted = [name for name in columns or schema.names if name in found.names]
            return with_all(file.read(columns=wanted), schema, columns)
        except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
            raise StoreError(f"{path}: cannot be read ({_first_line(error)}); `bench collect` cannot mend it") from None

    @property
    def _parts(self) -> Path:
        return self.folder / "parts"

    def _part_paths(self) -> list[Path]:
        return sorted(self._parts.glob("*.parquet"))

    def _lock(self) -> AbstractContextManager[None]:
        """Let one process at a time rewrite the tables."""
        return locked(self.folder)


def _warn_of_unseen(name: str, options: Mapping[str, Any]) -> None:
    hidden = [key for key, value in options.items() if str(value).startswith(UNSEEN)]
    if hidden:
        warnings.warn(
            f"{name}: {', '.join(hidden)} cannot be seen on the object, so that objects which differ in it alone have "
            f"one run id; keep it as an attribute (self.{hidden[0]}), or give the object `options`",
            stacklevel=3,
        )


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
