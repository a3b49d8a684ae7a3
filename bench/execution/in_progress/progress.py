"""Progress of a run, published every second by another thread, which only reads the gate's counts.

Use ``with publishing(publish):`` around all runs of a process. `publish` then gets a `Progress` every second for each
run that lasts longer than that, and a last one with ``ended``. Shorter runs cost a few microseconds, evaluations
nothing. An exception of `publish` is ignored: no run fails by it. While foreign code holds Python's lock in a C loop
this thread does not run either; the last `Progress` then becomes old, which a reader can see
(`bench.execution.in_progress.running`).
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from math import isfinite
from threading import Lock
from typing import NamedTuple, Protocol, TypedDict, final

from calibench.bench.execution.in_progress.pulse import looked_at
from calibench.bench.gate.processes.process_group import born

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
                        self._publish(run.told())

    def end(self, run: _Followed) -> None:
        with self._lock:
            self.runs.discard(run)
            if run.was_told:
                with suppress(Exception):
                    self._publish(run.told(ended=True))


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

    def told(self, ended: bool = False) -> Progress:
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
