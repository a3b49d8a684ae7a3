"""Who carries out the runs of a sweep: one protocol, `Carrier`, and three that keep it.

`Serial` (here), `workers.processes.Processes` and `workers.dask.Dask` take their work in packs, execute and keep a run
alike (`do_pack`), and yield a `Notice` of each. A pack is as many runs as take about a second, by what the runs of a
cell took before. Where a worker is lost, the run that it was at goes alone to another: if that is lost too, the run is
at fault and its row says so.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic, perf_counter
from typing import Protocol, final

from calibench.bench.execution.costly import ReplayFolder, forget_replay
from calibench.bench.execution.run import Run, Spec
from calibench.bench.store.journal import Journal
from calibench.core import own_state, user_file
from calibench.core.process import one_thread

_PACK_S = 1.0  # seconds of work in a pack
_MOST = 2000  # runs in a pack, of however short runs
_SHARE = 4  # packs for each worker of what remains, at the end of a sweep
_NOTICE_EVERY = 0.2  # seconds
_FOR_EVER = 1e9  # seconds: a time limit that only asks for a process of its own
_PHASES = 5  # that have the time limit each: building, compiling, search; and of a run cut there building and judging
_LATE = 60.0  # seconds beyond all of them after which a run is ended with its process


class Carrier(Protocol):
    """Carries out runs and keeps their rows in the journals of a study."""

    def carry(self, packs: Packs) -> Generator[Notice, None, None]:
        """Do all that `packs` has, and yield a notice of each run as it is kept.

        Closing the generator ends all that was started. Raises what a carrier cannot go on with, such as a full disk.
        """
        ...


@final
@dataclass(frozen=True)
class Notice:
    """A run has ended and is kept: its row's status, and the seconds that all of it took."""

    run_id: str
    status: str
    seconds: float


@final
@dataclass(frozen=True)
class Serial:
    """Does the runs in this process, where a system cannot fork: it goes on here whatever a run leaves behind."""

    folder: Path
    study: str

    def carry(self, packs: Packs) -> Generator[Notice, None, None]:
        journal = Journal(self.folder, self.study)
        ended: list[Notice] = []

        def keep(run: Run, seconds: float) -> None:
            journal.append(run)
            ended.append(Notice(run.run_id, run.record.status, seconds))

        while (pack := packs.take()) is not None:
            do_pack(pack, keep, lambda _: None)
            yield from ended
            ended.clear()


@final
@dataclass(frozen=True)
class Job:
    """A run to be done: its id, what it is, and the cell whose other runs take as long."""

    run_id: str
    spec: Spec
    cell: str


@final
@dataclass(frozen=True)
class Pack:
    """Jobs for one worker, in order. An `alone` one is of a single job that a worker was lost with.

    `inner` processes evaluate the batches of each run; `replay` is the folder of values to resume from.
    """

    jobs: tuple[Job, ...]
    alone: bool = False
    inner: int = 1
    replay: ReplayFolder | None = None


@final
@dataclass(eq=False)
class Packs:
    """What remains to be done, handed out in packs, sized for so many `workers`: those of a cluster come and go."""

    waiting: deque[Job]
    workers: int = 1
    inner: int = 1
    replay: ReplayFolder | None = None
    alone: deque[Job] = field(default_factory=deque)
    times: dict[str, tuple[int, float]] = field(default_factory=dict)  # cell -> runs, seconds

    def __len__(self) -> int:
        return len(self.waiting) + len(self.alone)

    def take(self) -> Pack | None:
        if self.alone:
            return Pack((self.alone.popleft(),), True, self.inner, self.replay)
        most = min(_MOST, max(1, len(self.waiting) // (_SHARE * max(1, self.workers))))
        jobs: list[Job] = []
        seconds = 0.0
        while self.waiting and len(jobs) < most and seconds < _PACK_S:
            jobs.append(self.waiting.popleft())
            runs, total = self.times.get(jobs[-1].cell, (1, _PACK_S))  # of an unknown cell one run shows it
            seconds += total / runs
        return Pack(tuple(jobs), False, self.inner, self.replay) if jobs else None

    def note_time(self, job: Job, seconds: float) -> None:
        runs, total = self.times.get(job.cell, (0, 0.0))
        self.times[job.cell] = runs + 1, total + seconds

    def return_lost(self, jobs: Sequence[Job], at_fault: bool) -> Job | None:
        """Take back the jobs that a lost worker had still to do, of which it was at the first.

        That one is returned where it is `at_fault`: it was alone, or is known to have hung.
        """
        if not jobs:
            return None
        self.waiting.extendleft(reversed(jobs[1:]))
        if at_fault:
            return jobs[0]
        self.alone.append(jobs[0])
        return None


def do_pack(pack: Pack, keep: Callable[[Run, float], None], tell: Callable[[list[Notice]], None]) -> bool:
    """Execute the runs of a pack in order; `keep` each with its seconds, and `tell` of those that were kept.

    A run that a worker was lost with is executed in a process of its own. Returns False where no further run may be
    done in this process: it is to end at once, and the last run that was kept has not been told of.
    """
    replay = pack.replay
    if replay is not None and not (Path(replay.folder) / "manifest.json").is_file():
        replay = None  # this machine does not share the folder
    ended: list[Notice] = []
    last = perf_counter()
    with user_file.as_loaded(), one_thread():  # each run finds both as it needs them
        for job in pack.jobs:
            spec = replace(job.spec, time_limit=job.spec.time_limit or _FOR_EVER) if pack.alone else job.spec
            began = perf_counter()
            run = spec.execute(inner=pack.inner, replay=replay, run_id=job.run_id)
            now = perf_counter()
            keep(run, now - began)
            if replay is not None:
                forget_replay(replay.folder, job.run_id)
            ended.append(Notice(run.run_id, run.record.status, now - began))
            if own_state.lasting():
                tell(ended[:-1])
                return False
            if now - last > _NOTICE_EVERY or job is pack.jobs[-1]:
                tell(ended)
                ended, last = [], now
    return True


def too_late(limit: float | None, heard: float) -> tuple[str, str] | None:
    """Return status and reason for a run of this time limit [s] that should have ended long ago; None else."""
    if limit is None or monotonic() - heard <= _PHASES * limit + _LATE:
        return None
    return "timeout", "the time limit has passed outside the search, and nothing came back"
