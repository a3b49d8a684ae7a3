"""Packs: runs that travel to a worker together, as many as it takes about a second to do.

Short runs would otherwise wait for messages, and long ones for each other. What a run takes is measured as runs end,
a cell for itself. Where a worker is lost, the run that it was at goes alone to another: if that is lost too, the run is
at fault and its row says so; the others of its pack are done by whoever comes next.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import final

from calibench.bench.execution.costly import ReplayFolder
from calibench.bench.execution.run import Spec

_PACK_S = 1.0  # seconds of work in a pack
_MOST = 2000  # runs in a pack, of however short runs
_SHARE = 4  # packs for each worker of what is left, at the end of a sweep


@final
@dataclass(frozen=True)
class Job:
    """A run to be done: its id, what it is, and the cell whose other runs take as long."""

    run_id: str
    spec: Spec
    cell: str


@final
@dataclass(frozen=True)
class How:
    """The way of executing runs: `inner` processes for the batches of each, and the folder of values to resume from."""

    inner: int = 1
    replay: ReplayFolder | None = None


@final
@dataclass(frozen=True)
class Pack:
    """Jobs for one worker, in order. An `alone` one is of a single job that a worker was lost with."""

    jobs: tuple[Job, ...]
    alone: bool = False
    how: How = How()


@final
class Packs:
    """What is left to do, handed out in packs."""

    def __init__(self, jobs: Iterable[Job], workers: int = 1, how: How | None = None) -> None:
        self._how = how or How()
        self._left = deque(jobs)
        self._alone: deque[Job] = deque()
        self._workers = workers
        self._took: dict[str, tuple[int, float]] = {}  # cell -> runs, seconds

    def __len__(self) -> int:
        return len(self._left) + len(self._alone)

    def take(self) -> Pack | None:
        """Return the next pack; None where nothing is left."""
        if self._alone:
            return Pack((self._alone.popleft(),), alone=True, how=self._how)
        most = min(_MOST, max(1, len(self._left) // (_SHARE * self._workers)))
        jobs: list[Job] = []
        seconds = 0.0
        while self._left and len(jobs) < most and seconds < _PACK_S:
            job = self._left.popleft()
            jobs.append(job)
            known = self._took.get(job.cell)
            seconds += _PACK_S if known is None else known[1] / known[0]  # of an unknown cell one run shows it
        return Pack(tuple(jobs), how=self._how) if jobs else None

    def jobs(self) -> Iterator[Job]:
        """Yield what is left, in no order that matters."""
        yield from self._alone
        yield from self._left

    def shared_by(self, workers: int) -> None:
        """Size packs for so many workers from now on: those of a cluster come and go."""
        self._workers = max(1, workers)

    def back(self, pack: Pack) -> None:
        """Take back a pack that was never begun."""
        if pack.alone:
            self._alone.extendleft(pack.jobs)
        else:
            self._left.extendleft(reversed(pack.jobs))

    def finished(self, job: Job, seconds: float) -> None:
        """Note how long a run took."""
        runs, before = self._took.get(job.cell, (0, 0.0))
        self._took[job.cell] = runs + 1, before + seconds

    def lost(self, rest: Sequence[Job], at_fault: bool) -> Job | None:
        """Take back the jobs that a lost worker had left, the one it was at first; return that where it is `at_fault`.

        It is where it was alone, or is known to have hung.
        """
        if not rest:
            return None
        if at_fault:
            self._left.extendleft(reversed(rest[1:]))
            return rest[0]
        self._alone.append(rest[0])
        self._left.extendleft(reversed(rest[1:]))
        return None
