"""The catalogue: every study of runs, discovery and calibration below a folder, each a line that can be searched.

An `Entry` is made of what lies in a study's folder, and of nothing else. Entries are kept in an index (JSON) in the
user's cache folder, so that results may be read-only; each is kept with the names, sizes and times of the files it was
made of, and made again when these differ. Whoever deletes the index loses nothing but time. Links are not followed.
"""

import json
import os
import re
import stat
import time
from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime, timedelta
from fnmatch import fnmatchcase
from hashlib import blake2b
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, final, get_origin

from calibench.bench.store.atomic_file import write_whole
from calibench.bench.store.manifest import (
    DISCOVERY,
    KIND,
    LARGEST_MANIFEST,
    NOTES,
    StoreError,
    read_manifest,
    read_notes,
)
from calibench.core.kept import cache_root
from calibench.core.options import suggest
from calibench.core.plain import json_of
from calibench.core.tables.data_file import read_whole
from calibench.core.words import counted, listed, plain

if TYPE_CHECKING:
    import pandas as pd

Kind = Literal["runs", "discovery", "calibration"]
Status = Literal["ok", "failed", "unfinished", "empty", "damaged"]
MANIFEST, CALIBRATION, HAND_EYE = "manifest.json", "calibration.json", "hand_eye.json"
_MARKS = (MANIFEST, CALIBRATION, HAND_EYE)  # a folder that has one may be a study
_MADE_OF = frozenset((*_MARKS, NOTES, "runs.parquet", "gaps.parquet"))
_JOURNALS = "journal"  # `bench.store.journal.FOLDER`, which is slow to load
_VERSION = 2  # of what an index holds
_FRESH = 2.0  # seconds in which a file may change again and keep its size and time
_MOST_FOLDERS = 500_000
_LARGEST_JSON = 50_000_000  # bytes of a calibration
_AGO = re.compile(r"(\d{1,4})([hdw])")
_HOURS = {"h": 1, "d": 24, "w": 168}
File = tuple[str, int, int, int]  # that an entry is made of: name, size, time and number


@final
@dataclass(frozen=True, kw_only=True)
class Entry:
    """A line of the catalogue. `study` is its folder below the results, `when` its last run began (ISO, UTC)."""

    study: str
    kind: Kind
    when: str = ""
    status: Status = "empty"
    problem: tuple[str, ...] = ()
    optimizer: tuple[str, ...] = ()
    machine: tuple[str, ...] = ()
    budget: tuple[int, ...] = ()
    planned: int = 0
    done: int = 0
    failed: int = 0
    timeouts: int = 0
    remaining: int = 0
    in_journals: int = 0  # done, and not in the tables yet
    headline: str = ""
    commit: str = ""
    dirty: bool = False
    command: str = ""
    size: int = 0  # bytes
    tag: tuple[str, ...] = ()
    notes: int = 0
    archived: bool = False


Kept = dict[str, tuple[str, Entry | None]]  # by a folder's name: the state of its files, and None if it is not ours
COLUMNS = tuple(one.name for one in fields(Entry))
_TUPLES = tuple(one.name for one in fields(Entry) if get_origin(one.type) is tuple)
_NAMES = (*_TUPLES, "study", "kind", "status")  # columns of few values, each of which may be asked for


def catalogue(results: str | Path = "results", words: Sequence[str] = ()) -> list[Entry]:
    """Return the entries below `results` that keep to all `words`, newest first.

    A word is ``COLUMN=VALUE`` or ``COLUMN!=VALUE``; VALUE has globs and commas between choices. ``since=`` and
    ``until=`` take a day (2026-11-01), a time, or how long ago (7d, 12h, 2w), ``words=`` words that stand anywhere in
    an entry or in the notes of its study. What is archived is left out unless a word is of `archived`.
    """
    keep = _filters(words, Path(results))
    found = [entry for entry in entries(Path(results)) if all(each(entry) for each in keep)]
    return sorted(found, key=lambda entry: (entry.when, entry.study), reverse=True)


def studies(results: str | Path = "results", *words: str) -> "pd.DataFrame":
    """Return the `catalogue` as a table: a row a study, discovery or calibration below `results`, newest first.

    `words` are the filters of ``bench studies``: ``"optimizer=de"``, ``"problem=full*"``, ``"since=7d"``.
    """
    import pandas as pd

    table = pd.DataFrame([asdict(entry) for entry in catalogue(results, words)], columns=list(COLUMNS))
    return table.assign(when=pd.to_datetime(table["when"], utc=True, format="ISO8601"))


def entries(results: Path) -> Iterator[Entry]:
    """Yield every entry below a folder, from the index where it still holds. Raises `ValueError`."""
    if not results.is_dir():
        raise ValueError(f"{results}: there is no such results folder; name one with results=DIR")
    with suppress(OSError):  # a mount that can no longer be reached
        results = results.resolve()
    digest = blake2b(os.fsencode(results), digest_size=12).hexdigest()
    path = cache_root() / "studies" / f"{digest}-{_VERSION}.json"
    kept, now = Kept(), Kept()
    with suppress(OSError, AttributeError, TypeError, ValueError, KeyError):  # there is none, or a hand has been at it
        kept = {
            name: (state, None if row is None else Entry(**row | {key: tuple(row[key]) for key in _TUPLES}))
            for name, (state, row) in json.loads(path.read_bytes()).items()
        }
    foreign: set[str] = set()  # folders whose manifest is not ours
    fresh = time.time_ns() - int(_FRESH * 1e9)
    for name, folder, files in _walk(results, foreign):
        files.sort()
        state = "/".join([f"{one} {size} {time_ns} {number}" for one, size, time_ns, number in files])
        before, entry = kept.get(name, ("", None))
        if before:
            now[name] = kept[name]
        if before != state:
            entry = _read(folder, name)
            if (entry is None or entry.status != "damaged") and max(file[2] for file in files) < fresh:
                now[name] = state, entry
        if entry is None:
            foreign.add(name)
        else:
            yield entry
    if now != kept:
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, json.dumps(now, default=vars).encode())


def _walk(results: Path, foreign: Container[str]) -> Iterator[tuple[str, str, list[File]]]:
    """Yield of each folder that may be a study its name below `results`, its path, and its files."""
    waiting, looked_at = [("", str(results))], 0
    while waiting:
        name, path = waiting.pop()
        looked_at += 1
        if looked_at > _MOST_FOLDERS:
            raise ValueError(f"{results}: has more than {_MOST_FOLDERS} folders; name one with fewer")
        files: list[File] = []
        below: list[tuple[str, str]] = []
        try:
            with os.scandir(path) as found:
                for one in found:
                    if one.name in _MADE_OF:
                        files.append(_file_of(one))
                    elif one.name == _JOURNALS and one.is_dir(follow_symlinks=False):
                        with os.scandir(one.path) as journals:
                            files += [_file_of(journal) for journal in journals]
                    elif one.name[0] != "." and one.is_dir(follow_symlinks=False):
                        below.append((f"{name}/{one.name}" if name else one.name, one.path))
        except OSError:  # it is gone, or is not ours to read
            continue
        if any(file[0] in _MARKS for file in files):
            yield name or results.name, path, files
            if (name or results.name) not in foreign:
                continue
        waiting += below


def _file_of(one: "os.DirEntry[str]") -> File:
    try:
        found = one.stat(follow_symlinks=False)
    except OSError:
        return one.name, -1, 0, 0
    return one.name, found.st_size, found.st_mtime_ns, found.st_ino


def _read(path: str, name: str) -> Entry | None:
    """Return the entry of a folder, read from its files; None for a folder that is none of ours."""
    folder = Path(path)
    size, waiting = 0, [path]  # the bytes of all regular files, at any depth
    while waiting:
        with suppress(OSError), os.scandir(waiting.pop()) as found:
            for one in found:
                if one.is_dir(follow_symlinks=False):
                    waiting.append(one.path)
                elif one.is_file(follow_symlinks=False):
                    size += one.stat(follow_symlinks=False).st_size
    entry = Entry(study=name, kind="runs", size=size)
    try:
        if (whole := _entry_of(folder, entry)) is None:
            return None
        noted = read_notes(folder)
    except (ValueError, OSError) as error:
        text = str(error).removeprefix(f"{folder}: ").removeprefix(f"{folder}/")
        return replace(entry, status="damaged", headline=" ".join(text.split())[:300], when=_when_of(folder))
    return replace(whole, tag=noted.tags, notes=len(noted.notes), archived=noted.archived)


def _entry_of(folder: Path, entry: Entry) -> Entry | None:
    if not (folder / MANIFEST).exists():
        # an arm's calibration, or a camera's
        from calibench.bench.tracking.tables import calibration_in

        row = calibration_in(folder)
        if row is None:
            return None
        before, after = row["before"], row["after"]
        size = f"{plain(after)} mm" if before is None else f"{plain(before)} -> {plain(after)} mm"
        return replace(
            entry, kind="calibration", when=row["started_at"].isoformat(timespec="seconds"), status="ok",
            machine=(row["machine"],), planned=1, done=1, commit=row["git_commit"], dirty=row["git_dirty"],
            headline=f"{size}, {row['level']}" if after is not None else row["level"], command=row["command"],
        )  # fmt: skip
    try:
        manifest = json_of(read_whole(folder / MANIFEST, LARGEST_MANIFEST))
    except ValueError as error:
        raise StoreError(f"{MANIFEST}: cannot be read: {error}") from None
    kind = manifest.get("kind") if isinstance(manifest, dict) else None
    if kind != DISCOVERY:
        return _of_runs(folder, entry) if kind == KIND else None
    said = manifest.get("commands") or [""]
    command = str(said[-1]) if isinstance(said, list) else ""
    from calibench.bench.tracking.tables import rows_in

    columns = ("verdict", "status", "machine", "started_at", "git_commit", "git_dirty")
    rows = rows_in(folder, "gaps", columns).to_pylist()
    verdicts = Counter(row["verdict"] for row in rows if row["status"] == "ok")
    failed = sum(row["status"] != "ok" for row in rows)
    dated = [row for row in rows if row["started_at"]]
    last: Mapping[str, Any] = max(dated, key=lambda row: row["started_at"], default={})
    began = last.get("started_at")
    return replace(
        entry, kind="discovery", command=command,
        when=began.isoformat(timespec="seconds") if began else _when_of(folder),
        status="failed" if failed else "ok" if rows else "empty", machine=_names(row["machine"] for row in rows),
        planned=len(rows), done=len(rows), failed=failed, commit=last.get("git_commit") or "",
        dirty=bool(last.get("git_dirty")),
        headline=", ".join(f"{verdict} in {n} of {len(rows)}" for verdict, n in verdicts.most_common()),
    )  # fmt: skip


def _of_runs(folder: Path, entry: Entry) -> Entry:
    from calibench.bench.store.journal import journals_in
    from calibench.bench.tracking.tables import rows_in

    manifest = read_manifest(folder)
    table = rows_in(folder, "runs", (
        "run_id", "problem", "optimizer", "budget", "status", "unit", "best_value", "started_at", "git_commit",
        "git_dirty",
    ))  # fmt: skip
    groups = table.group_by(["problem", "optimizer", "budget", "status", "unit"], use_threads=False).aggregate(
        [("best_value", "min"), ("run_id", "count")]
    ).to_pylist()  # fmt: skip
    done = set(table["run_id"].to_pylist())
    waiting = {state.run_id: state for reader in journals_in(folder) for state in reader.states()}
    journaled = [state for run_id, state in waiting.items() if run_id not in done]
    count = Counter(state.status for state in journaled)
    for group in groups:
        count[str(group["status"])] += int(group["run_id_count"])
    finished = done | waiting.keys()
    planned = manifest["planned"]
    remaining = len(planned.keys() - finished)
    budgets = {int(group["budget"]) for group in groups} | {int(one) for one in manifest.get("budgets", {}).values()}
    last: Mapping[str, Any] = {}
    if len(table):
        from calibench.bench.store.arrays import compute, kept

        times = table["started_at"]
        last = next(iter(kept(table, compute("equal", times, compute("max", times))).slice(0, 1).to_pylist()), {})
    # which method found the lowest value: of one problem with it, of several on how many
    best: dict[str, Mapping[str, Any]] = {}
    for group in groups:
        value = group["best_value_min"]
        if value is not None and value == value and abs(value) != float("inf"):
            before = best.get(group["problem"])
            if before is None or value < before["best_value_min"]:
                best[group["problem"]] = group
    most = Counter(group["optimizer"] for group in best.values()).most_common(1)
    headline = f"lowest value by {most[0][0]} on {most[0][1]} of {counted(len(best), 'problem')}" if most else ""
    if len(best) == 1:
        [group] = best.values()
        unit = f" {group['unit']}" if group["unit"] else ""
        headline = f"lowest {plain(group['best_value_min'])}{unit} by {group['optimizer']}"
    began = last.get("started_at")
    status: Status = "failed" if count["failed"] + count["timeout"] else "ok" if finished else "empty"
    return replace(
        entry,
        when=began.isoformat(timespec="seconds") if began and not journaled else _when_of(folder),
        status="unfinished" if remaining else status,
        problem=_names(group["problem"] for group in groups), optimizer=_names(group["optimizer"] for group in groups),
        budget=tuple(sorted(budgets)), planned=len(planned), done=len(finished), failed=count["failed"],
        timeouts=count["timeout"], remaining=remaining, in_journals=len(journaled), headline=headline,
        commit=last.get("git_commit") or "", dirty=bool(last.get("git_dirty")),
        command=(manifest.get("commands") or [""])[-1],
    )  # fmt: skip


def _names(found: Iterable[Any]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(str(name) for name in found if name))


def _when_of(folder: Path) -> str:
    """Return when a file of a study was last written, its notes left out."""
    times = [0.0]
    for name in (*_MADE_OF - {NOTES}, _JOURNALS):
        with suppress(OSError):
            times.append(os.lstat(folder / name).st_mtime)
    return datetime.fromtimestamp(max(times), UTC).isoformat(timespec="seconds")


def _filters(words: Sequence[str], results: Path) -> list[Callable[[Entry], bool]]:
    """Return what the words ask of an entry. Raises `ValueError`, in one line."""
    keep: list[Callable[[Entry], bool]] = []
    known = (*COLUMNS, "since", "until", "words")
    for word in words:
        key, equals, value = word.partition("=")
        differs = key.endswith("!")
        key = key.removesuffix("!")
        if key not in known:
            raise ValueError(f"studies: there is no column {key!r}; {suggest(key, known)}")
        if not equals or not value:
            raise ValueError(f"studies: {key} needs a value, such as {key}=VALUE; globs (full*) and a,b are read")
        if key == "words":
            sought = value.casefold().split()
            keep.append(lambda entry, of=sought, no=differs: all(w in _said(entry, results) for w in of) != no)  # type: ignore[misc]
            continue
        if key not in ("since", "until"):
            keep.append(lambda entry, key=key, of=value, no=differs: _has(entry, key, of) != no)  # type: ignore[misc]
            continue
        if differs:
            raise ValueError(f"studies: {word}: write since= or until=")
        try:
            if ago := _AGO.fullmatch(value):
                moment = datetime.now(UTC) - timedelta(hours=int(ago[1]) * _HOURS[ago[2]])
            else:
                moment = datetime.fromisoformat(value)
                moment = moment.astimezone(UTC) if moment.tzinfo else moment.replace(tzinfo=UTC)
        except (ValueError, OverflowError):
            such = "a day (2026-11-01), a time, or how long ago (7d, 12h, 2w)"
            raise ValueError(f"studies: {key}={value:.40}: {such}") from None
        at = moment.isoformat(timespec="seconds")  # as entries have it: ISO, UTC
        keep.append(lambda entry, at=at, since=key == "since": (entry.when >= at) == since)  # type: ignore[misc]
    if not any(word.startswith(("archived=", "archived!=")) for word in words):
        keep.append(lambda entry: not entry.archived)
    return keep


def _said(entry: Entry, results: Path) -> str:
    """Return all that stands in an entry and in the notes of its study, in small letters."""
    noted = [one.text for one in read_notes(results / entry.study).notes] if entry.notes else []
    return " ".join([*(text for key in COLUMNS for text in _texts_of(entry, key)), *noted]).casefold()


def _has(entry: Entry, key: str, choices: str) -> bool:
    return any(fnmatchcase(text, choice) for text in _texts_of(entry, key) for choice in choices.split(","))


def _texts_of(entry: Entry, key: str) -> list[str]:
    found = getattr(entry, key)
    texts = [str(one) for one in found] if isinstance(found, tuple) else [str(found)]
    return [text.lower() for text in texts] if isinstance(found, bool) else texts


def advice_on(results: Path, words: Sequence[str]) -> str:
    """Return what to write in place of each word COLUMN=VALUE to which no entry below `results` keeps."""
    known, advice = list(entries(results)), ""
    for word in words if known else ():
        key, _, value = word.partition("=")
        if key in _NAMES and not any(_has(entry, key, value) for entry in known):
            texts = sorted({text for entry in known for text in _texts_of(entry, key) if text})
            advice += f"; {word}: {suggest(value, texts)}"
    return advice


def find_study(results: Path, name: str) -> tuple[Path, Entry]:
    """Return folder and entry of a study by its name below `results`, or by its path. Raises `ValueError`.

    The folder is inside of `results`, and is itself no link.
    """
    known = {entry.study: entry for entry in entries(results)}
    asked = name.rstrip("/")
    if asked not in known:
        with suppress(ValueError, OSError):  # a path, as the shell completes it
            asked = Path(os.path.abspath(asked)).relative_to(os.path.abspath(results)).as_posix()
    if asked not in known:
        raise ValueError(f"{name}: there is no such study in {results}; {suggest(name, known)}")
    folder = results / asked if (results / asked).is_dir() else results
    if stat.S_ISLNK(os.lstat(folder).st_mode) and folder != results:
        raise ValueError(f"{name}: is a link; name the folder that it leads to")
    return folder, known[asked]


def line_of(entry: Entry) -> dict[str, str]:
    end = [f"{entry.done}/{max(entry.planned, entry.done)}"]
    end += [f"{n} {what}" for n, what in ((entry.failed, "failed"), (entry.timeouts, "out of time")) if n]
    return {
        "study": entry.study, "what": entry.kind, "when": entry.when[:16].replace("T", " "),
        "done": ", ".join(end) if entry.status != "damaged" else "damaged",
        "problem": listed(entry.problem or entry.machine, 2), "optimizer": listed(entry.optimizer, 3),
        "budget": listed([str(one) for one in entry.budget], 2), "headline": entry.headline,
        "commit": entry.commit[:8] + ("+" if entry.dirty else ""),
        "size": f"{entry.size / 1e6:.1f} MB" if entry.size >= 1e5 else f"{entry.size / 1e3:.1f} kB",
        "tags": " ".join(entry.tag) + (" (archived)" if entry.archived else ""),
    }  # fmt: skip
