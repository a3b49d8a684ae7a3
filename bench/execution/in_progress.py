"""The progress of a run while it runs: read by another thread, written as small files, read by who asks.

``with publishing(publish):`` stands around all runs of a process. `publish` then gets a `Progress` every second for
each run that lasts longer than that, and a last one with ``ended``. The thread only reads the gate's counts: shorter
runs cost a few microseconds, evaluations nothing, and an exception of `publish` fails no run. While foreign code holds
Python's lock in a C loop this thread does not run either; the last `Progress` then becomes old, which a reader sees.

`to_files` writes them to ``FOLDER/running``, a file each, gone at its end. Beside them stands a file of each sweep, so
that one that has no run to tell of yet is seen as well. What a killed process leaves there is not counted: on its own
machine a process that is gone is known to be.
"""

from __future__ import annotations

import json
import os
import platform
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from math import isfinite
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import Any, NamedTuple, Protocol, TypedDict, final

from calibench.bench.gate.processes import born, is_gone
from calibench.core.plain import json_of
from calibench.core.process_state import OWN_THREAD
from calibench.core.words import grouped, plain, span

_RECENT = 30.0  # seconds: the rate is that of the last one or two of these


class Progress(TypedDict):
    """A run in progress; times in seconds, `began_at` and `updated_at` since 1970.

    `spent` of `budget` is what has been charged, `rate` counts evaluations a second, `silent_s` is for how long there
    has been none. `best_value` is null before the first finite value, `eta_s` where there is no rate. `pid` is the
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
    ended: bool


class Name(NamedTuple):
    """What a run is called, and its budget."""

    run_id: str
    problem: str
    optimizer: str
    repetition: int
    budget: int


Publish = Callable[[Progress], None]


class Counts(Protocol):
    """What can be read of a run at any time: the gate, or its mirror in memory shared with another process."""

    @property
    def evaluations(self) -> int: ...
    @property
    def charged(self) -> int: ...
    @property
    def best_value(self) -> float: ...


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
    publisher, run = _PUBLISHERS[-1], _Followed(name, counts, pid)
    publisher.runs.add(run)
    try:
        yield
    finally:
        publisher.end(run)


@final
class _Publisher:
    def __init__(self, publish: Publish, every: float) -> None:
        self._publish, self._every = publish, every
        self.pid = os.getpid()
        self.runs: set[_Followed] = set()
        self._lock = Lock()  # an ended run is told as ended last

    def look(self) -> None:
        for run in list(self.runs):
            with self._lock:
                if run in self.runs and run.lasts(self._every):
                    with suppress(Exception):
                        self._publish(run.progress())

    def end(self, run: _Followed) -> None:
        with self._lock:
            self.runs.discard(run)
            if run.was_told:
                with suppress(Exception):
                    self._publish(run.progress(ended=True))


@final
class _Followed:
    """One run: what was read when, and what follows for its rate."""

    def __init__(self, name: Name, counts: Counts, pid: int | None) -> None:
        self._name, self._counts, self._pid = name, counts, pid or os.getpid()
        self._began, self._began_at = time.monotonic(), time.time()
        self._heard, self._evaluations = self._began, 0
        self._before: tuple[float, int, int] | None = None  # time, evaluations, charged: where the rate is taken from
        self._mark: tuple[float, int, int] | None = None
        self.was_told = False

    def lasts(self, seconds: float) -> bool:
        return time.monotonic() - self._began >= seconds

    def progress(self, ended: bool = False) -> Progress:
        self.was_told = True
        now, counts, name = time.monotonic(), self._counts, self._name
        evaluations, spent, best = counts.evaluations, counts.charged, counts.best_value
        if evaluations != self._evaluations:
            self._evaluations, self._heard = evaluations, now
        rate, pace = self._rates(now, evaluations, spent)
        return Progress(
            run_id=name.run_id,
            problem=name.problem,
            optimizer=name.optimizer,
            repetition=name.repetition,
            pid=self._pid,
            host=platform.node(),
            born=born(self._pid),
            began_at=self._began_at,
            updated_at=time.time(),
            evaluations=evaluations,
            spent=spent,
            budget=name.budget,
            best_value=best if isfinite(best) else None,
            rate=rate,
            eta_s=(name.budget - spent) / pace if pace > 0 else None,
            silent_s=now - self._heard,
            ended=ended,
        )

    def _rates(self, now: float, evaluations: int, spent: int) -> tuple[float, float]:
        """Return evaluations and charged evaluations a second, of late; of the whole run where there are none of late.

        The first look is where they are first taken from, so that values replayed after a kill do not count.
        """
        here = now, evaluations, spent
        if self._before is None or self._mark is None:
            self._before = self._mark = here
        elif now - self._mark[0] >= _RECENT:
            self._before, self._mark = self._mark, here
        then, made, paid = self._before
        if evaluations == made:
            then, made, paid = self._began, 0, 0
        took = max(now - then, 1e-9)
        return (evaluations - made) / took, (spent - paid) / took


_SWEEP = ".sweep"  # how the file of a sweep ends
_QUIET = 10.0  # seconds without an evaluation from which on no end is foreseen
SILENT = 600.0  # seconds without an evaluation from which on it is told


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


@final
@dataclass(frozen=True)
class Running:
    """A run in progress: what its `Progress` said, with `silent_s` up to now."""

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

    def line(self) -> str:
        """Return one line for the terminal and the log."""
        best = "no value yet" if self.best_value is None else f"best {plain(self.best_value, 2)}"
        left = "" if self.eta_s is None else f", {span(self.eta_s)} left"
        usual = 1 / self.rate if self.rate > 0 else 0.0  # seconds an evaluation takes
        silent = "" if self.silent_s < max(_QUIET, 5 * usual) else f", silent for {span(self.silent_s)}"
        return (
            f"run {self.run_id[:4]} {self.optimizer} on {self.problem}: {grouped(self.spent)} of "
            f"{grouped(self.budget)} evaluations, {best}, {plain(self.rate, 3)}/s{silent or left}"
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


def running_of(progress: Progress) -> Running:
    """Return a run in progress as it is now: since its last message it has been silent, as far as is known."""
    age = max(0.0, time.time() - progress["updated_at"])
    values: dict[str, Any] = dict(progress)
    known = {field.name: values[field.name] for field in fields(Running)}
    return Running(**known | {"silent_s": progress["silent_s"] + (age if age > 5 else 0.0)})


def read_running(folder: Path | str) -> list[Running]:
    """Return the runs in progress of `folder`, those that began first first. Changes nothing there."""
    found = []
    for path in sorted((Path(folder) / "running").glob("*.json")):
        progress = _read(path)
        if progress is not None and not _is_gone(progress):
            found.append(running_of(progress))
    return sorted(found, key=lambda run: (run.began_at, run.run_id))


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
    found = [_read(path) for path in (Path(folder) / "running").glob(f"{run_id}-*.json")]
    return any(running_of(progress).silent_s >= SILENT for progress in found if progress is not None)


def remove_gone(folder: Path | str) -> None:
    """Delete what killed processes of this machine have left."""
    home = Path(folder) / "running"
    for path in home.glob("*.json"):
        progress = _read(path)
        if progress is not None and _is_gone(progress):
            for left in (path, path.with_suffix(".tmp")):
                with suppress(OSError):
                    left.unlink(missing_ok=True)
    for path in home.glob(f"*{_SWEEP}"):
        if is_gone(*_sweep(path)):
            with suppress(OSError):
                path.unlink(missing_ok=True)
    with suppress(OSError):
        home.rmdir()  # where nothing is left


def _read(path: Path) -> Progress | None:
    """Return what a file says; None where it has just gone, or is none of ours."""
    try:
        progress: Progress = json_of(path.read_text(encoding="utf-8"))
        running_of(progress)
        return progress if isinstance(progress["pid"], int) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _sweep(path: Path) -> tuple[str, int, str]:
    """Return host, pid and birth of the process that carries out a sweep; of a file that is not whole, no process."""
    try:
        owner = json_of(path.read_text(encoding="utf-8"))
        return str(owner["host"]), int(owner["pid"]), str(owner["born"])
    except (OSError, ValueError, KeyError, TypeError):
        return platform.node(), os.getpid(), "-"


def _is_gone(progress: Progress) -> bool:
    return is_gone(progress["host"], progress["pid"], progress["born"])


_IDLE = 10.0  # seconds for which the thread waits for something to look at


@contextmanager
def looked_at(look: Callable[[], None], every: float = 1.0) -> Iterator[None]:
    """Call `look` every so many seconds, from another thread, while the block lasts. Its exceptions are ignored."""
    key = _here().add(look, every)
    try:
        yield
    finally:
        _here().remove(key)


@final
class _Pulse:
    def __init__(self) -> None:
        self._change = threading.Condition()
        self._looks: dict[object, tuple[float, float, Callable[[], None]]] = {}  # when it is due, how often, what
        self._wakes = 0.0
        self._alive = False

    def add(self, look: Callable[[], None], every: float) -> object:
        key, due = object(), monotonic() + every
        with self._change:
            self._looks[key] = (due, every, look)
            if not self._alive:
                self._alive = True
                threading.Thread(target=self._beat, name=f"{OWN_THREAD}pulse", daemon=True).start()
            elif due < self._wakes:
                self._change.notify()
        return key

    def remove(self, key: object) -> None:
        with self._change:
            self._looks.pop(key, None)

    def _beat(self) -> None:
        idle_until = monotonic() + _IDLE
        while True:
            with self._change:
                now = monotonic()
                if self._looks:
                    idle_until = now + _IDLE
                elif now >= idle_until:
                    self._alive = False
                    return
                self._wakes = min((due for due, _, _ in self._looks.values()), default=min(idle_until, now + 1.0))
                if self._wakes > now:
                    self._change.wait(self._wakes - now)
                    continue
                ready = [(key, every, look) for key, (due, every, look) in self._looks.items() if due <= now]
                for key, every, look in ready:
                    self._looks[key] = (now + every, every, look)
            for _, _, look in ready:
                with suppress(Exception):
                    look()


_PULSES: dict[int, _Pulse] = {}  # of this process alone: no thread lives on in a forked child


def _here() -> _Pulse:
    pid = os.getpid()
    if pid not in _PULSES:
        _PULSES.clear()
        _PULSES[pid] = _Pulse()
    return _PULSES[pid]
