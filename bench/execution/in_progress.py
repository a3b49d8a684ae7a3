"""The progress of a run while it runs: read by another thread, written as small files, read by who asks.

``with publishing(publish):`` stands around all runs of a process. `publish` then gets the fields of a `Running` every
second for each run that lasts longer, and a last one with ``ended``. The thread only reads the gate's counts: shorter
runs cost a few microseconds, evaluations nothing. `to_files` writes them to ``FOLDER/running``, a file each, and beside
them a file of each sweep. What a killed process leaves there is not counted.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, replace
from math import isfinite
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, final

from calibench.bench.gate.processes import born, is_gone
from calibench.core.plain import json_of
from calibench.core.process_state import OWN_THREAD
from calibench.core.words import plain, span

if TYPE_CHECKING:
    from calibench.bench.gate.evaluator import Evaluator
    from calibench.bench.gate.time_limit import Mirror

    Counts = Evaluator | Mirror  # what can be read of a run at any time: the gate, or its mirror in shared memory

_RECENT = 30.0  # seconds: the rate is that of the last one or two of these
Progress = dict[str, Any]  # the fields of a `Running`, by name
_QUIET = 10.0  # seconds without an evaluation from which on no end is foreseen
SILENT = 600.0  # seconds without an evaluation from which on it is told


@final
@dataclass(frozen=True, kw_only=True)
class Running:
    """A run in progress; times in seconds, `began_at` and `updated_at` since 1970.

    `spent` of `budget` is what has been charged, `rate` counts evaluations a second, `silent_s` is for how long there
    has been none. `best_value` is None before the first finite value, `eta_s` where there is no rate. `pid` is the
    process that searches, on `host`; `born` tells it from a later one of that number.
    """

    run_id: str
    problem: str
    optimizer: str
    repetition: int
    pid: int
    host: str
    born: str
    began_at: float
    updated_at: float
    evaluations: int
    spent: int
    budget: int
    best_value: float | None
    rate: float
    eta_s: float | None
    silent_s: float
    ended: bool = False

    def line(self) -> str:
        best = "no value yet" if self.best_value is None else f"best {plain(self.best_value, 2)}"
        left = "" if self.eta_s is None else f", {span(self.eta_s)} left"
        usual = 1 / self.rate if self.rate > 0 else 0.0  # seconds an evaluation takes
        silent = "" if self.silent_s < max(_QUIET, 5 * usual) else f", silent for {span(self.silent_s)}"
        spent, budget = (f"{n:,}".replace(",", " ") for n in (self.spent, self.budget))
        return (
            f"run {self.run_id[:4]} {self.optimizer} on {self.problem}: {spent} of "
            f"{budget} evaluations, {best}, {plain(self.rate, 3)}/s{silent or left}"
        )

    def silent_line(self) -> str | None:
        """Return what to say of a run that has made no evaluation for ten minutes; None of another."""
        if self.silent_s < SILENT:
            return None
        there = "" if self.host == platform.node() else f" on {self.host}"
        return (
            f"run {self.run_id[:4]} {self.optimizer} on {self.problem} has made no evaluation for "
            f"{span(self.silent_s)}; `kill -9 {self.pid}`{there} ends it, it becomes a failed row and the others go "
            "on; time_limit=SECONDS ends such runs by itself"
        )


@final
@dataclass(frozen=True)
class Name:
    """What a run is called, and its budget."""

    run_id: str
    problem: str
    optimizer: str
    repetition: int
    budget: int


Publish = Callable[[Progress], None]
_PUBLISHERS: list[_Publisher] = []  # the last one is told


@contextmanager
def publishing(publish: Publish, every: float = 1.0) -> Iterator[None]:
    """Call `publish` every `every` seconds for the runs in this process that last longer than that."""
    publisher = _Publisher(publish, every)
    _PUBLISHERS.append(publisher)
    try:
        with looked_at(publisher.look, every):
            yield
    finally:
        _PUBLISHERS.remove(publisher)


@contextmanager
def followed(name: Name, counts: Counts, pid: int | None = None) -> Iterator[None]:
    """Follow a run by its `counts` while the block lasts; `pid` is the process that makes it, where that is another."""
    if not _PUBLISHERS or _PUBLISHERS[-1].pid != os.getpid():  # a forked child has no thread that looks
        yield
        return
    publisher, run = _PUBLISHERS[-1], _Followed(name, counts, pid or os.getpid())
    publisher.runs.add(run)
    try:
        yield
    finally:
        with publisher.lock:
            publisher.runs.discard(run)
            if run.was_told:
                with suppress(Exception):
                    publisher.publish(run.progress(ended=True))


@final
@dataclass(eq=False)
class _Publisher:
    publish: Publish
    every: float
    pid: int = field(default_factory=os.getpid)
    runs: set[_Followed] = field(default_factory=set)
    lock: Lock = field(default_factory=Lock)  # an ended run is told as ended last

    def look(self) -> None:
        for run in list(self.runs):
            with self.lock:
                if run in self.runs and time.monotonic() - run.began >= self.every:
                    with suppress(Exception):
                        self.publish(run.progress())


@final
@dataclass(eq=False)
class _Followed:
    """One run: what was read when, and what follows for its rate, which is taken from `before`."""

    name: Name
    counts: Counts
    pid: int
    began: float = field(default_factory=time.monotonic)
    began_at: float = field(default_factory=time.time)
    heard: float = field(default_factory=time.monotonic)
    evaluations: int = 0
    before: tuple[float, int, int] | None = None  # time, evaluations, charged
    mark: tuple[float, int, int] = (0.0, 0, 0)
    was_told: bool = False

    def progress(self, ended: bool = False) -> Progress:
        self.was_told = True
        now, counts, name = time.monotonic(), self.counts, self.name
        evaluations, spent, best = counts.evaluations, counts.charged, counts.best_value
        if evaluations != self.evaluations:
            self.evaluations, self.heard = evaluations, now

        # evaluations and charged evaluations a second, of late; of the whole run where there are none of late. The
        # first look is where they are first taken from, so that values replayed after a kill do not count
        here = now, evaluations, spent
        if self.before is None:
            self.before = self.mark = here
        elif now - self.mark[0] >= _RECENT:
            self.before, self.mark = self.mark, here
        then, made, paid = self.before
        if evaluations == made:
            then, made, paid = self.began, 0, 0
        took = max(now - then, 1e-9)
        pace = (spent - paid) / took
        run = Running(
            **vars(name), pid=self.pid, host=platform.node(), born=born(self.pid), began_at=self.began_at,
            updated_at=time.time(), evaluations=evaluations, spent=spent, best_value=best if isfinite(best) else None,
            rate=(evaluations - made) / took, eta_s=(name.budget - spent) / pace if pace > 0 else None,
            silent_s=now - self.heard, ended=ended,
        )  # fmt: skip
        return dict(vars(run))


_SWEEP = ".sweep"  # how the file of a sweep ends


def to_files(folder: Path | str) -> Publish:
    """Return what writes each run in progress as a file of `folder`, to be given to `publishing`."""
    home = Path(folder).absolute() / "running"

    def publish(progress: Progress) -> None:
        path = home / f"{progress['run_id']}-{os.getpid()}@{progress['host']}.json"
        if progress["ended"]:
            path.unlink(missing_ok=True)
            return
        home.mkdir(parents=True, exist_ok=True)
        temporary = path.with_suffix(".tmp")  # a name of ours alone: what a kill leaves is written over
        temporary.write_text(json.dumps(progress), encoding="utf-8")
        os.replace(temporary, path)  # whole, but not brought to the disk: it is worth a second

    return publish


def running_of(progress: Progress) -> Running:
    """Return a run in progress as it is now: since its last message it has been silent, as far as is known."""
    age = max(0.0, time.time() - progress["updated_at"])
    run = Running(**{each.name: progress[each.name] for each in fields(Running)})
    return replace(run, silent_s=run.silent_s + (age if age > 5 else 0.0))


def read_running(folder: Path | str) -> list[Running]:
    """Return the runs in progress of `folder`, those that began first first. Changes nothing there."""
    runs = [_read(path) for path in sorted((Path(folder) / "running").glob("*.json"))]
    there = [run for run in runs if run is not None and not is_gone(run.host, run.pid, run.born)]
    return sorted(there, key=lambda run: (run.began_at, run.run_id))


@contextmanager
def at_work(folder: Path | str) -> Iterator[None]:
    """Let others see, while the block lasts, that this process carries out a sweep in `folder`."""
    host, pid = platform.node(), os.getpid()
    path = Path(folder).absolute() / "running" / f"{pid}@{host}{_SWEEP}"
    with suppress(OSError):  # no sweep fails by what is told of it
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"host": host, "pid": pid, "born": born(pid)}), encoding="utf-8")
    try:
        yield
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)
            path.parent.rmdir()  # where no run is told of


def hosts_at_work(folder: Path | str) -> set[str]:
    """Return the machines on which a sweep or a run is in progress in `folder`; of others than this one, may be."""
    sweeps = [_sweep(path) for path in (Path(folder) / "running").glob(f"*{_SWEEP}")]
    return {host for host, pid, birth in sweeps if not is_gone(host, pid, birth)} | {
        run.host for run in read_running(folder)
    }


def was_silent(folder: Path | str, run_id: str) -> bool:
    """Tell whether a run of `folder` had made no evaluation for ten minutes at its last message, or since then."""
    runs = [_read(path) for path in (Path(folder) / "running").glob(f"{run_id}-*.json")]
    return any(run.silent_s >= SILENT for run in runs if run is not None)


def remove_gone(folder: Path | str) -> None:
    """Delete what killed processes of this machine have left."""
    home = Path(folder) / "running"
    left = [path for path in home.glob(f"*{_SWEEP}") if is_gone(*_sweep(path))]
    for path in home.glob("*.json"):
        run = _read(path)
        if run is not None and is_gone(run.host, run.pid, run.born):
            left += [path, path.with_suffix(".tmp")]
    for path in left:
        with suppress(OSError):
            path.unlink(missing_ok=True)
    with suppress(OSError):
        home.rmdir()  # where nothing is left


def _read(path: Path) -> Running | None:
    """Return what a file says; None where it has just gone, or is none of ours."""
    try:
        run = running_of(json_of(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return run if isinstance(run.pid, int) else None


def _sweep(path: Path) -> tuple[str, int, str]:
    """Return host, pid and birth of the process that carries out a sweep; of a file that is not whole, no process."""
    try:
        owner = json_of(path.read_text(encoding="utf-8"))
        return str(owner["host"]), int(owner["pid"]), str(owner["born"])
    except (OSError, ValueError, KeyError, TypeError):
        return platform.node(), os.getpid(), "-"


_LOOKS: dict[float, list[tuple[float, Callable[[], None]]]] = {}  # how often -> from when on, what is called
_CHANGE = [Lock()]


def _begin_anew() -> None:
    """Forget the thread of the parent, and its lock, which that may have held."""
    _LOOKS.clear()
    _CHANGE[0] = Lock()


if sys.platform != "win32":
    os.register_at_fork(after_in_child=_begin_anew)


@contextmanager
def looked_at(look: Callable[[], None], every: float = 1.0) -> Iterator[None]:
    """Call `look` every so many seconds, from another thread, while the block lasts. Its exceptions are ignored."""
    entry = time.monotonic() + every, look
    with _CHANGE[0]:
        if every not in _LOOKS:
            _LOOKS[every] = []
            threading.Thread(target=_beat, args=(every,), name=f"{OWN_THREAD}pulse", daemon=True).start()
        _LOOKS[every].append(entry)
    try:
        yield
    finally:
        with _CHANGE[0]:
            if entry in _LOOKS.get(every, ()):
                _LOOKS[every].remove(entry)


def _beat(every: float) -> None:
    """Look until there is nothing to look at: of runs that follow one another fast few begin a thread."""
    while True:
        time.sleep(every)
        with _CHANGE[0]:
            looks = list(_LOOKS[every])
            if not looks:
                del _LOOKS[every]
                return
        for begin, look in looks:
            with suppress(Exception):
                if time.monotonic() >= begin:
                    look()
