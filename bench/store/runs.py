"""Results on disk: each writer appends to a journal of its own; journals are collected into the two Parquet tables.

A run is finished when it stands in a journal, or in both tables. Any processes on any machines share a folder, and
may be killed at any moment. They keep to this; no clock, age of a file or live process decides:

- **The lock** (``.lock``, never deleted) is the system's, and ends with its holder. Who holds it alone makes and
  rewrites the manifest and the tables, claims journals, deletes them, and what only it writes.
- **Creation**: whoever comes first makes the folder, takes the lock, and writes the manifest, whole. A folder without
  one holds somebody else's files. **The plan** is a union.
- **Journals** are appended to by their writer alone, without the lock (`bench.store.journal`).
- **Collecting**, under the lock: claim all journals, also of writers that live; write the traces, then the rows; only
  then delete what was claimed, or set it aside where lines are damaged. A kill leaves claimed journals to the next.
- **Reading** takes no lock and changes nothing: journals first, then the tables; of a pair of tables that is just being
  replaced, the runs are taken that are whole in both.
"""

from __future__ import annotations

import errno
import getpass
import itertools
import json
import logging
import os
import platform
import shutil
import time
import warnings
from collections import deque
from collections.abc import Collection, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import pyarrow as pa
from filelock import BaseFileLock, FileLock, SoftFileLock, Timeout

from calibench.bench.execution.answer import offered
from calibench.bench.execution.run import Run
from calibench.bench.execution.run_row import COLUMNS
from calibench.bench.gate.processes import is_gone
from calibench.bench.provenance.run_id import UNSEEN
from calibench.bench.store import arrays, manifest as manifests
from calibench.bench.store.atomic_file import TEMPORARY
from calibench.bench.store.collection import PIECE, collect_into, in_journals, in_order, nested, part_table, points_of
from calibench.bench.store.columns import OF_OPTIONS, with_options
from calibench.bench.store.hits import PROBLEM, columns_for, declared_levels, hit_tables
from calibench.bench.store.journal import ENDING, FOLDER, Journal, Record, State, claim, journals_in
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.tables import HITS, RUNS, TRACES, Tables, write_tables
from calibench.core.words import counted, html_table

if TYPE_CHECKING:
    import pandas as pd

LOCK, SOFT_LOCK, HOLDER = ".lock", ".lock.soft", ".lock.holder"  # what stands in the folder of a study
_SOON = 5.0  # seconds after which a wait is logged
_AT_MOST = 600.0  # seconds; the tables of a hundred thousand runs are folded in less
_NO_LOCKS = {errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOLCK}  # what a file system without locks answers

_log = logging.getLogger(__name__)


class LockHeldError(ValueError):
    """Another process holds the lock for longer than we wait."""


@contextmanager
def locked(folder: Path, soon: float = _SOON, at_most: float = _AT_MOST) -> Iterator[None]:
    """Hold the lock of `folder`. A wait of `soon` seconds is logged; one of `at_most` raises `LockHeldError`."""
    try:
        lock = _wait(FileLock(folder / LOCK), folder, soon, at_most)
    except (OSError, NotImplementedError) as error:  # the second is what filelock makes of ENOSYS
        if isinstance(error, OSError) and error.errno not in _NO_LOCKS:
            raise
        lock = _wait(SoftFileLock(folder / SOFT_LOCK), folder, soon, at_most)
    holder = folder / HOLDER
    try:
        try:
            user = getpass.getuser()
        except (KeyError, OSError):  # a container's user without a name
            user = "unknown"
        holder.write_text(f"process {os.getpid()} of {user} on {platform.node()}", encoding="utf-8")
        yield
    finally:
        holder.unlink(missing_ok=True)
        lock.release()


def _wait(lock: BaseFileLock, folder: Path, soon: float, at_most: float) -> BaseFileLock:
    first = min(soon, at_most)
    for seconds, is_last in ((first, False), (at_most - first, True)):
        try:
            lock.acquire(timeout=seconds)
            return lock
        except Timeout:
            holder = ""
            with suppress(OSError):
                holder = (folder / HOLDER).read_text(encoding="utf-8")
            holder = holder or "another process"
            if is_last:
                raise LockHeldError(
                    f"{lock.lock_file}: has been held by {holder} for {at_most:g} s; ask there, or end that process, "
                    "then give the same command again: finished runs are kept"
                ) from None
            _log.warning("%s: is held by %s; waiting", lock.lock_file, holder)
    raise AssertionError("the last wait returns or raises")


_BEGUN = {FOLDER, LOCK, SOFT_LOCK, HOLDER}  # what may stand in a folder before its manifest
_UNDER_LOCK = ("manifest.json", RUNS, TRACES, PIECE)  # files that only who holds the lock writes
_POINTS = 1 << 15  # points of traces that are read at a time
_AT_ONCE = 10_000  # runs that are merged at a time
_OF_THE_PLACE = ("study", "wall_s", "cpu_s")
_COMPARED = [column.name for column in COLUMNS if column.group != "origin" and column.name not in _OF_THE_PLACE]
_SHOWN = ("problem", "optimizer", "start", "budget")
_FOR_USERS = ("folder", "hits", "manifest", "open", "runs", "study", "traces", "write")  # what the tab key shows
FOLDER_OF = "folder"  # the key of `attrs` under which a table of runs says where its traces are


@final
@dataclass(frozen=True)
class Survey:
    """How each run ended, files with damaged lines, and the pace (runs a second) and machines of who writes now."""

    states: Mapping[str, State]
    damaged: tuple[Path, ...]
    pace: float
    hosts: frozenset[str]


@final
class ResultStore:
    """The folder of one study, or to read from, the folder of many. Writing creates it."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._journal: tuple[int, Journal] | None = None  # of this process, which forks
        self._study: str | None = None  # its name, once it was read
        self._unseen: set[tuple[str, str]] = set()  # names and options that were warned of

    def __repr__(self) -> str:
        try:
            states = [state for store in self._studies() for state in store.survey().states.values()]
        except StoreError as error:
            return f"<store {error}>"
        lost = sum(state.status == "failed" for state in states)
        return f"<store {self.folder}: {counted(len(states), 'finished run')}{f', {lost} failed' if lost else ''}>"

    def __dir__(self) -> list[str]:
        return list(_FOR_USERS)

    def _repr_html_(self) -> str:
        """Return what stands in the folder, as a notebook shows it: a row for each problem and method."""
        try:
            found = self.runs([*_SHOWN, "status", "charged", "best_value"], options=True)
        except StoreError as error:
            return html_table(str(error), (), ())
        names = [str(name) for name in found if name not in ("status", "charged", "best_value")]
        rows: list[list[object]] = []
        for _, mine in found.groupby(names, sort=False, dropna=False):
            lost = [int((mine["status"] == status).sum()) for status in ("failed", "timeout")]
            rows.append([*mine[names].iloc[0], len(mine), *lost, mine["charged"].median(), mine["best_value"].median()])
        title = f"store {self.folder}: {counted(len(found), 'finished run')}"
        return html_table(title, (*names, "runs", "failed", "out of time", "charged, median", "best, median"), rows)

    @property
    def is_begun(self) -> bool:
        """Tell whether the folder has a manifest: else nothing was planned there, or it holds other things."""
        return (self.folder / "manifest.json").exists()

    @property
    def study(self) -> str:
        """Return the study's name: its manifest's, or that of the folder where there is none yet."""
        return str(self.manifest()["study"]) if self.is_begun else self.folder.resolve().name

    def runs(self, columns: Sequence[str] | None = None, *, options: bool = False) -> pd.DataFrame:
        """Return all finished runs, a row each, collected or not: columns of `RUNS_SCHEMA` and ``merit.KEY``, or these.

        With `options` also those that differ within the study, ``prob.NAME`` and ``opt.NAME`` (`bench.store.columns`).
        """
        asked = None if columns is None else list(columns)
        read = [*asked, *(name for name in OF_OPTIONS if name not in asked)] if asked is not None and options else asked
        found = arrays.to_pandas(self.rows(read))
        arrays.give_back()
        found = offered(found) if columns is None else found
        found.attrs[FOLDER_OF] = str(self.folder.resolve())
        if not options:
            return found
        table = with_options(found)
        return table.drop(columns=[name for name in OF_OPTIONS if asked is not None and name not in asked])

    def rows(self, columns: Sequence[str] | None = None) -> pa.Table:
        """Return all finished runs as Arrow has them, texts perhaps as dictionaries: columns of `RUNS_SCHEMA`, or
        `columns`. No pandas is loaded."""
        found = arrays.joined([store._table(RUNS, columns, coded=True) for store in self._studies()])
        arrays.give_back()
        return found

    def traces(self) -> pd.DataFrame:
        """Return the traces of all finished runs: run_id, evaluations, charged, best_value, restart."""
        return arrays.to_pandas(pa.concat_tables([store._table(TRACES) for store in self._studies()]))

    def courses(self) -> pd.DataFrame:
        """Return of all traces run_id, as a category, charged and best_value: a quarter of the memory of `traces`."""
        read = ["run_id", "charged", "best_value"]
        parts = (store._table(TRACES, read, coded=True) for store in self._studies())
        found = arrays.to_pandas(arrays.joined([*parts]), category="run_id")
        arrays.give_back()
        return found

    def hits(self, levels: pd.DataFrame | None = None) -> pd.DataFrame:
        """Return when each finished run reached each target: columns of `HITS_SCHEMA`, null where it never did.

        `levels` (`bench.statistics.targets.levels_of`) says which targets; without it, those that the runs themselves
        name. ``evaluations`` and ``charged`` are counts at which the target was surely reached, ``*_after`` the last at
        which it surely was not; ``seconds`` is known only of what the last evaluation of a run reached.
        """
        found = [table for store in self._studies() for table in store._hit_tables(levels)]
        return arrays.to_pandas(pa.concat_tables([arrays.empty_table(arrays.HITS_SCHEMA), *found]))

    def write_hits(self, levels: pd.DataFrame | None = None) -> Path:
        """Write ``hits.parquet``, what `hits` returns, some thousand runs at a time; return its path."""
        return write_tables(self._hit_tables(levels), arrays.HITS_SCHEMA, self.folder / HITS)

    def _hit_tables(self, levels: pd.DataFrame | None) -> Iterator[pa.Table]:
        tables = self._tables()
        file = None if self.has_journals() or not tables.are_one_pair() else tables.open(TRACES)
        if file is None:
            rows, points = self.tables()
            traces: Iterable[pa.Table] = [points]
        else:
            read = [*columns_for([] if levels is None else levels["quantity"].unique()), "target"]
            rows = tables.runs(read, coded=True)
            batches = file.iter_batches(batch_size=_POINTS, use_threads=False)
            traces = (arrays.in_schema(pa.Table.from_batches([batch]), arrays.TRACES_SCHEMA) for batch in batches)
        if levels is None:
            levels = declared_levels(arrays.to_pandas(rows.select([*PROBLEM, "targets", "target"])))
        return hit_tables(rows, traces, levels)

    def open(self) -> None:
        """Create the folder for writing. Raises `StoreError` where something else stands there."""
        if self.folder.exists() and not self.folder.is_dir():
            raise StoreError(f"{self.folder}: is a file, a folder for results is needed")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            names = [path.name for path in self.folder.iterdir()]
            unfinished = {name for name in names if name.startswith("manifest.json.") and name.endswith(".tmp")}
            strangers = {*names} - unfinished - _BEGUN
            if strangers or self.is_begun:  # asked in this order: what is ours comes after the manifest
                self.manifest()
                return
            with locked(self.folder):
                if not self.is_begun:
                    manifests.write_manifest(self.folder, manifests.new_manifest(self.folder.resolve().name))
        except OSError as error:
            raise StoreError(f"{self.folder}: cannot be written: {error.strerror}") from None

    def manifest(self) -> dict[str, Any]:
        """Return the manifest. Raises `StoreError` where the folder is missing or not a study of ours."""
        return manifests.read_manifest(self.folder)

    def plan(
        self, labels: Mapping[str, str], command: str = "", files: Mapping[str, str] | None = None,
        called: Mapping[str, str] | None = None, other_shards: Collection[str] = (),
        budgets: Mapping[str, int] | None = None, drop: bool = False,
    ) -> None:  # fmt: skip
        """Note which runs are intended: {run_id: label}, and by which command. `status` tells what is left of them.

        `files` are those of a user's classes {name: path}, `called` the names and `budgets` those of cells, by label.
        With `drop` what was planned before and is not among these, nor of `other_shards`, is abandoned.
        """
        with locked(self.folder):
            manifest = self.manifest()
            if "imported" in manifest:
                raise StoreError(
                    f"{self.folder}: holds published results that were imported; run into another study= and "
                    "`bench merge` the two"
                )
            files = {**manifest.get("files", {}), **(files or {})}
            new = labels.keys() - manifest["planned"].keys()
            if drop:
                gone = {*manifest["planned"], *manifest.get("abandoned", ())} - labels.keys() - {*other_shards}
                manifest |= {"planned": {}, "other_shards": [], "abandoned": sorted(gone)}
            elif "abandoned" in manifest:
                manifest["abandoned"] = sorted({*manifest["abandoned"]} - labels.keys())
            every = {*manifest.get("other_shards", ()), *other_shards}
            others = sorted(every - manifest["planned"].keys() - labels.keys())
            if new or drop or manifest.get("files", {}) != files or manifest.get("other_shards", []) != others:
                manifest["planned"] = {**manifest["planned"], **labels}
                manifest |= {"other_shards": others} if others or "other_shards" in manifest else {}
                manifest["files"] = files
                manifest["called"] = {**manifest.get("called", {}), **(called or {})}
                manifest["budgets"] = {**manifest.get("budgets", {}), **(budgets or {})}
                manifest["commands"] = [*manifest.get("commands", []), *([command] if command and new else [])]
                manifests.write_manifest(self.folder, manifest)

    def note_costs(self, costs: Iterable[Mapping[str, Any]]) -> None:
        """Keep what a call of each problem costs (`bench.sweep.costs`) in the manifest."""
        new = list(costs)
        if not new:
            return
        with locked(self.folder):
            manifest = self.manifest()
            manifest["costs"] = [*manifest.get("costs", []), *new]
            manifests.write_manifest(self.folder, manifest)

    def finished(self) -> set[str]:
        """Return the ids of the runs that are done and can be read."""
        manifest = self.manifest()
        written = {state.run_id for reader in journals_in(self.folder) for state in reader.states()}
        return written | Tables(self.folder, str(manifest["study"])).complete()

    def collected(self) -> set[str]:
        """Return the ids of the runs that are whole in the tables."""
        return self._tables().complete()

    def survey(self) -> Survey:
        """Return how each run ended, what is damaged, and the pace: all that is told without reading the rows."""
        tables, readers = self._tables(), journals_in(self.folder)
        new: dict[str, State] = {}
        for state in itertools.chain.from_iterable(reader.states() for reader in readers):
            new.setdefault(state.run_id, state)
        # whose writer may still be there; on another machine it may: to be shown, not to be decided by
        headers = [(reader.count, header) for reader in readers if reader.count and (header := reader.header())]
        writing = [(n, one) for n, one in headers if not is_gone(one["host"], one["pid"], one["born"])]
        began = min((float(header["began_at"]) for _, header in writing), default=0.0)
        pace = sum(count for count, _ in writing) / max(time.time() - began, 1e-3) if began else 0.0
        damaged = tuple(reader.path for reader in readers if reader.damaged)
        rows, known = tables.runs(State._fields), tables.complete()
        for run_id, status, code in zip(*(rows[name].to_pylist() for name in State._fields), strict=True):
            if run_id in known:
                new[run_id] = State(run_id, status, code or "")
        return Survey(new, damaged, pace, frozenset(str(header["host"]) for _, header in writing))

    def rows_not_ok(self, columns: Sequence[str]) -> pd.DataFrame:
        """Return the rows (of `columns`) that did not end well; of journals only these are read."""
        asked = list(dict.fromkeys(["run_id", "status", *columns]))
        tables = self._tables()
        found = [record for reader in journals_in(self.folder) for record in reader if record.status != "ok"]
        rows = tables.runs(asked)
        rows = arrays.kept(rows, arrays.compute("not_equal", rows["status"], arrays.array_of(["ok"], pa.string())[0]))
        new = _as_parts(list(_distinct(found, tables.complete())))
        return arrays.to_pandas(pa.concat_tables([rows, new.select(asked)]))

    def has_journals(self) -> bool:
        """Tell whether something is not collected yet."""
        return bool(journals_in(self.folder))

    def damaged(self) -> list[Path]:
        """Return the journals of which some lines cannot be read."""
        readers = journals_in(self.folder)
        for reader in readers:
            deque(reader.states(), maxlen=0)  # what is damaged is known at its end
        return [reader.path for reader in readers if reader.damaged]

    def _tables(self) -> Tables:
        if self._study is None:  # a study keeps its name, and a manifest of many runs takes a tenth of a second
            self._study = str(self.manifest()["study"])
        return Tables(self.folder, self._study)

    def write(self, run: Run) -> None:
        """Append a run to the journal of this process.

        Warns once of an object whose parameters cannot be seen: another of the same box would have the same run id.
        """
        if self._journal is None or self._journal[0] != os.getpid():
            self._journal = os.getpid(), self.writer()
        record = run.record
        named = {(record.problem, record.problem_options), (record.optimizer, record.optimizer_options)}
        for name, options in sorted(named - self._unseen):
            if UNSEEN not in options:
                continue
            self._unseen.add((name, options))
            hidden = [key for key, value in json.loads(options).items() if str(value).startswith(UNSEEN)]
            if hidden:
                warnings.warn(
                    f"{name}: {', '.join(hidden)} cannot be seen on the object, so that objects of one box that differ "
                    f"in it alone have one run id; keep it as an attribute (self.{hidden[0]}), or give the object "
                    "`options`",
                    stacklevel=2,
                )
        self._journal[1].append(run)

    def writer(self, name: str | None = None) -> Journal:
        """Return a new journal of this study, whose files' names begin with `name`."""
        return Journal(self.folder, self.study, name)

    def fill(
        self, runs: pd.DataFrame, traces: pd.DataFrame, study: str = "", source: Mapping[str, Any] | None = None
    ) -> list[Path]:
        """Make this the folder of just these runs, collected, in place of what it had; return the three files.

        `source` says where they were imported from: runs of our own are then not planned in it.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        paths = [self.folder / name for name in ("manifest.json", TRACES, RUNS)]
        imported = {} if source is None else {"imported": dict(source)}
        with locked(self.folder):
            manifest = manifests.new_manifest(study or self.folder.resolve().name)
            manifests.write_manifest(self.folder, manifest | imported)
            tables = (traces, arrays.TRACES_SCHEMA), (runs.assign(study=self.study), arrays.RUNS_SCHEMA)
            for path, (table, schema) in zip(paths[1:], tables, strict=True):
                write_tables([pa.Table.from_pandas(table, schema, preserve_index=False)], schema, path)
        return paths

    def forget(self, run_ids: Iterable[str]) -> None:
        """Take runs out, so that they are done again."""
        with locked(self.folder):
            self._collect(self.manifest(), set(run_ids))

    def collect(self, workers: int = 1) -> list[Path]:
        """Fold all journals into ``runs.parquet`` and ``traces.parquet``; return where damaged ones were set aside.

        So many `workers` (processes) read the journals' rows at once.
        """
        if not self.is_begun:
            self.manifest()  # it raises what is wrong, before a lock is made there
        with locked(self.folder):
            return self._collect(self.manifest(), set(), workers)

    def _collect(self, manifest: Mapping[str, Any], drop: set[str], workers: int = 1) -> list[Path]:
        """Collect, without the runs to `drop`, by who holds the lock."""
        self._journal = None  # its next run goes to a new one
        for path in self.folder.glob("*.tmp"):  # what killed processes left; what may still be written stays
            writer = TEMPORARY.search(path.name)
            if writer is not None and (path.name.startswith(_UNDER_LOCK) or is_gone(writer[2], int(writer[1]), "")):
                with suppress(FileNotFoundError):  # it has just got its name
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
        readers = claim(self.folder)
        tables = Tables(self.folder, str(manifest["study"]))
        aside: dict[Path, None] = {}
        quarantine = self.folder / "quarantine"

        def refuse(record: Record) -> None:
            quarantine.mkdir(exist_ok=True)
            where = quarantine / f"{record.run_id}.json"
            where.write_bytes(record.row + b"\n" + record.trace)
            aside[where] = None

        collect_into(tables, in_journals(readers, tables.complete() | drop, refuse, workers), drop)
        for reader in readers:
            if reader.damaged:
                quarantine.mkdir(exist_ok=True)
                where = quarantine / reader.path.with_suffix(ENDING).name
                os.replace(reader.path, where)
                aside[where] = None
            else:
                reader.path.unlink()
        with suppress(OSError):  # somebody has begun another journal
            (self.folder / FOLDER).rmdir()
        arrays.give_back()
        return list(aside)

    def _studies(self) -> list[ResultStore]:
        """Return the stores to read: this one, or those of the studies in this folder of studies."""
        if self.is_begun:
            return [self]
        return [ResultStore(folder) for folder in manifests.studies_in(self.folder)] or [self]

    def _table(self, name: str, columns: Sequence[str] | None = None, coded: bool = False) -> pa.Table:
        """Return one of the two tables, of all finished runs; with `coded` its texts may be dictionaries."""
        tables = self._tables()
        if not self.has_journals() and tables.are_one_pair():  # whole, with no run to look for
            return (tables.runs if name == RUNS else tables.traces)(columns, coded)
        found = self.tables()[(RUNS, TRACES).index(name)]
        return found if columns is None else found.select(list(columns))

    def tables(self) -> tuple[pa.Table, pa.Table]:
        """Return rows and traces of all finished runs, in their order."""
        tables = self._tables()
        written = [record for reader in journals_in(self.folder) for record in reader]
        known = tables.complete()
        records = list(_distinct(written, known))
        rows, traces = tables.runs(), tables.traces()
        ids = arrays.array_of(sorted(known), pa.string())
        flags = [arrays.is_in(table["run_id"], ids) for table in (rows, traces)]
        rows, traces = (
            table if arrays.compute("all", whole).as_py() is not False else arrays.kept(table, whole)
            for table, whole in zip((rows, traces), flags, strict=True)
        )
        if records:
            new = _as_parts(records)
            rows = pa.concat_tables([rows, new.select(arrays.RUNS_SCHEMA.names)])
            rows, traces = in_order(rows, pa.concat_tables([traces, points_of(new)]))
        return rows, traces


def _distinct(records: Iterable[Record], known: Container[str]) -> Iterator[Record]:
    """Yield the first of each run that is not `known`."""
    seen: set[str] = set()
    for record in records:
        if record.run_id not in known and record.run_id not in seen:
            seen.add(record.run_id)
            yield record


def _as_parts(records: Sequence[Record]) -> pa.Table:
    """Return records as one table; one that no row can be made of is left out."""
    tables = [part_table(records[i : i + 5000])[0] for i in range(0, len(records), 5000)]
    return pa.concat_tables(tables or [arrays.empty_table(arrays.PART_SCHEMA)])


@final
@dataclass(frozen=True)
class Merged:
    """The runs in the folder now, those that stood in several, those not done: planned, and in other shards."""

    runs: int
    twice: int
    left: int
    in_other_shards: int = 0


def merge(sources: Sequence[Path], target: Path, keep_first: bool = False) -> Merged:
    """Make `target` the study of all runs in `sources` and of those it has already; the sources stay as they are.

    A run that stands in two of them is taken once. Raises `StoreError` where its rows differ in more than times and
    places, unless `keep_first`.
    """
    stores = [ResultStore(path) for path in sources]
    plans = [store.manifest() for store in stores]
    into = ResultStore(target)
    if any(path.resolve() == target.resolve() for path in sources):
        raise StoreError(f"{target}: is merged into, and stands among what is to be merged; give another --to")
    twice = _in_several([*([into] if target.exists() else []), *stores], keep_first)
    into.open()
    into.collect()
    with locked(target):
        joined = into.manifest()
        tables = Tables(target, str(joined["study"]))
        new = _rows_of_others(stores, tables.study, tables.complete())
        collect_into(tables, new, set())
        plans.insert(0, joined.copy())
        for other in plans[1:]:
            for key in ("planned", "called", "budgets", "files"):
                joined[key] = {**joined.get(key, {}), **other.get(key, {})}
            for key in ("commands", "costs"):
                before = joined.get(key, [])
                joined[key] = [*before, *(item for item in other.get(key, []) if item not in before)]
        gone, others = (
            {run_id for manifest in plans for run_id in manifest.get(key, ())} - joined["planned"].keys()
            for key in ("abandoned", "other_shards")
        )
        joined |= {"abandoned": sorted(gone)} if gone else {}
        if any(manifest.get("other_shards") for manifest in plans):
            joined["other_shards"] = sorted(others)
        manifests.write_manifest(target, joined)
        # notes and tags of all, each once
        noted = [manifests.read_notes(folder) for folder in (target, *sources)]
        tags = dict.fromkeys(tag for part in noted for tag in part.tags)
        notes = dict.fromkeys(note for part in noted for note in part.notes)
        one = manifests.Notes(tuple(tags), noted[0].archived, tuple(sorted(notes, key=lambda note: note.at)))
        if one != noted[0]:
            manifests.write_notes(target, one)
        known = tables.complete()
    manifest = into.manifest()
    left = len(manifest["planned"].keys() - known)
    return Merged(len(known), twice, left, len(manifests.in_other_shards(manifest, known)))


def _rows_of_others(stores: Sequence[ResultStore], study: str, known: set[str]) -> Iterator[pa.Table]:
    """Yield the runs of the stores that are not `known`, each once, as runs of `study`."""
    seen = set(known)
    at = arrays.RUNS_SCHEMA.get_field_index("study")
    for store in stores:
        rows, traces = store.tables()
        rows = rows.filter(pa.array([run_id not in seen for run_id in rows["run_id"].to_pylist()], pa.bool_()))
        seen.update(rows["run_id"].to_pylist())
        for begin in range(0, len(rows), _AT_ONCE):
            some = rows.slice(begin, _AT_ONCE)
            some = some.set_column(at, arrays.RUNS_SCHEMA.field("study"), pa.array([study] * len(some), pa.string()))
            yield nested(some, traces.filter(arrays.is_in(traces["run_id"], some["run_id"].combine_chunks())))


def _in_several(stores: Sequence[ResultStore], keep_first: bool) -> int:
    """Return how many runs stand in several stores; raise where two rows of one differ and nobody says which counts."""
    where: dict[str, list[int]] = {}
    for i, store in enumerate(stores):
        for run_id in store.finished():
            where.setdefault(run_id, []).append(i)
    several = {run_id: found for run_id, found in where.items() if len(found) > 1}
    if not several or keep_first:
        return len(several)
    first: dict[str, dict[str, Any]] = {}
    unlike = {}
    for i in sorted({i for found in several.values() for i in found}):
        rows, _ = stores[i].tables()
        chosen = rows.filter(arrays.is_in(rows["run_id"], pa.array(list(several), pa.string()))).select(_COMPARED)
        for row in chosen.to_pylist():
            before = first.setdefault(row["run_id"], row)
            pairs = {name: (value, before[name]) for name, value in row.items()}
            # NaN is NaN
            columns = [name for name, (a, b) in pairs.items() if not (bool(a == b) or (a != a and b != b))]
            if columns:
                unlike[row["run_id"]] = columns
    if unlike:
        run_id, columns = next(iter(unlike.items()))
        raise StoreError(
            f"{counted(len(unlike), 'run')} stand in several folders with rows that differ, such as {run_id} in "
            f"{', '.join(columns[:4])}; leave a folder out, or take the first of each with --keep-first"
        )
    return len(several)
