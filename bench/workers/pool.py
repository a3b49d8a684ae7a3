"""Processes of this machine, each with a journal of its own. One that dies costs the run it was at; another takes over.

They are forked after the kernels were loaded, so that a new one is there at once; where a system cannot fork they are
started anew. Each is the head of a family (`bench.gate.processes`) that ends with it, and with us.
"""

from __future__ import annotations

import pickle
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from pathlib import Path
from time import monotonic
from typing import final

from calibench.bench.execution.in_progress import publishing, remove_gone, to_files, was_silent
from calibench.bench.execution.run import Run
from calibench.bench.gate.processes import prepare
from calibench.bench.store.journal import Journal, kept_by, writer_name
from calibench.bench.workers.child import Child, too_late
from calibench.bench.workers.packs import Job, Pack, Packs
from calibench.bench.workers.printed import Printed, file_of, forget_empty
from calibench.bench.workers.worker import Notice, do_pack, find_user_code

_LOOK = 0.25  # seconds between two looks at who is still there
Lost = Callable[[Job, str, str], Run]  # (job, status, why) -> the row of a run whose worker was lost twice


def run_in_pool(packs: Packs, folder: Path, study: str, workers: int, lost: Lost) -> Generator[Notice, None, None]:
    """Do all that is left in `packs` by `workers` processes, each as it ends; closing the iterator ends them.

    Rows go to journals of the `study` in `folder`, those of lost runs, which `lost` makes, to one of this process.
    Raises what a worker cannot go on with, such as a full disk.
    """
    session = writer_name()
    prepare()
    apart = len(packs) > 1  # a single run prints on the terminal
    pool = [_Worker(f"{session}-{slot}", folder, study, apart) for slot in range(min(workers, max(1, len(packs))))]
    own: Journal | None = None
    try:
        for worker in pool:
            worker.start(pool)
        while True:
            for worker in pool:
                if worker.is_idle and (pack := packs.take()) is not None:
                    worker.give(pack)
            if all(worker.is_idle for worker in pool):
                return
            ready = wait([worker.child.connection for worker in pool], _LOOK)
            for worker in pool:
                why = worker.why_lost()  # before it is heard: what it told last must not be missed
                if worker.child.connection in ready or why:
                    for notice, job in worker.told():
                        packs.finished(job, notice.seconds)
                        yield notice
                if not why:
                    continue
                rest, alone = worker.end()
                kept = kept_by(folder, worker.name)  # it may have kept runs and told nobody
                for job in rest:
                    if job.run_id in kept:
                        yield Notice(job.run_id, kept[job.run_id], 0.0)
                rest = [job for job in rest if job.run_id not in kept]
                hung = bool(rest) and was_silent(folder, rest[0].run_id)  # somebody has ended it for that
                at_fault = packs.lost(rest, alone or hung)
                if at_fault is not None:
                    own = own or Journal(folder, study, session)
                    run = lost(at_fault, *why)
                    own.append(run)
                    remove_gone(folder)
                    yield Notice(run.run_id, run.record.status, 0.0)
                worker.start(pool)
    finally:
        for worker in pool:
            worker.end()
            forget_empty(file_of(folder, worker.name))


@final
class _Worker:
    """A place of the pool: its process, whose journals begin with this name, and what that has still to do."""

    def __init__(self, name: str, folder: Path, study: str, prints_apart: bool) -> None:
        self.name = name
        self.child = Child(_work, name, folder, study, list(sys.path), prints_apart)
        self._rest: deque[Job] = deque()
        self._alone = False
        self._heard = monotonic()

    @property
    def is_idle(self) -> bool:
        """Tell whether it has nothing to do."""
        return not self._rest

    def start(self, pool: Sequence[_Worker]) -> None:
        """Start a new process in this place; of the connections to the others of `pool` it keeps none."""
        self.child.start(worker.child.connection for worker in pool if worker.child.is_there)

    def give(self, pack: Pack) -> None:
        """Give it a pack to do."""
        self._rest, self._alone, self._heard = deque(pack.jobs), pack.alone, monotonic()
        self.child.send(pack)

    def told(self) -> Iterator[tuple[Notice, Job]]:
        """Yield what it has told since the last time; raise what it raised."""
        for words in self.child.told():
            told: Sequence[Notice] | BaseException = pickle.loads(words)
            if isinstance(told, BaseException):
                raise told
            self._heard = monotonic()
            for notice in told:
                yield notice, self._rest.popleft()

    def why_lost(self) -> tuple[str, str] | None:
        """Return the status and reason for a run whose process has ended, or is far beyond its time limit."""
        limit = self._rest[0].spec.time_limit if self._rest else None
        return self.child.why_lost() or too_late(limit, self._heard)

    def end(self) -> tuple[list[Job], bool]:
        """End the process with all that it has started; return what it had still to do."""
        self.child.end()
        rest, self._rest = list(self._rest), deque()
        return rest, self._alone


def _work(
    theirs: Connection, name: str, folder: Path, study: str, path: Sequence[str], prints_apart: bool
) -> None:  # fmt: skip
    """Do the packs that come until there is none, or this process can do no more."""
    find_user_code(path)
    try:
        journal = Journal(folder, study, name)
        printed = Printed(file_of(folder, name)) if prints_apart else None

        def keep(run: Run, seconds: float) -> None:
            if printed is not None:
                printed.signed(run.record)
            journal.append(run)

        with publishing(to_files(folder)):
            while do_pack(theirs.recv(), keep, theirs.send):
                pass
    except (EOFError, ConnectionError):  # the parent is gone
        raise
    except (Exception, KeyboardInterrupt) as error:  # a full disk, say, or what a user's code raised to end it all
        with suppress(Exception):
            theirs.send(error)
