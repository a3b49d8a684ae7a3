"""The carrier of this machine: processes, each with a journal of its own, and with a file of what its runs print.

They are forked after the kernels were loaded. One that dies costs the run it was at, and another takes its place. The
standard output of such a process, and of all it starts, goes to its file beside the results: after each run that
printed, a line says which one it was. A sweep of a single run prints on the terminal.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from time import monotonic
from typing import final

from calibench.bench.execution.in_progress import publishing, remove_gone, to_files, was_silent
from calibench.bench.execution.run import Run
from calibench.bench.execution.run_row import RunRow
from calibench.bench.execution.standing import lost_run
from calibench.bench.gate.processes import Child, flush_output, load_prctl
from calibench.bench.store.atomic_file import open_within
from calibench.bench.store.journal import Journal, kept_by, writer_name
from calibench.bench.workers.carrier import Job, Notice, Packs, do_pack, too_late

_LOOK = 0.25  # seconds between two looks at who is still there
_FOLDER = "printed"
_SIGN = b"-- printed by "
_LINE = 4096  # bytes from the end that hold the last line, where it is a signature
_STDOUT = 1  # the number of the file that every process writes its output to


@final
@dataclass(frozen=True)
class Processes:
    """Carries out runs by so many processes; those of lost runs get their rows in a journal of this one."""

    folder: Path
    study: str
    workers: int

    def carry(self, packs: Packs) -> Generator[Notice, None, None]:
        session = writer_name()
        load_prctl()
        apart = len(packs) > 1  # a single run prints on the terminal
        names = [f"{session}-{slot}" for slot in range(min(self.workers, len(packs)))]
        given = self.folder, self.study, list(sys.path), apart
        pool = [_Worker(name, Child(_work, (name, *given))) for name in names]
        journal = Journal(self.folder, self.study, session)  # its file is made with its first row
        try:
            while True:
                for worker in pool:
                    if worker.child.process is None:  # a new process keeps none of the connections to the others
                        worker.child.start(other.child.connection for other in pool if other.child.process is not None)
                    if not worker.jobs and (pack := packs.take()) is not None:
                        worker.jobs, worker.alone, worker.heard = deque(pack.jobs), pack.alone, monotonic()
                        worker.child.send(pack)
                if not any(worker.jobs for worker in pool):
                    return
                ready = wait([worker.child.connection for worker in pool], _LOOK)
                for worker in pool:
                    # before it is heard: what it sent last must not be missed
                    limit = worker.jobs[0].spec.time_limit if worker.jobs else None
                    why = worker.child.why_lost() or too_late(limit, worker.heard)
                    if worker.child.connection in ready or why:
                        yield from self._hear(worker, packs)
                    if why:
                        yield from self._settle(worker, why, packs, journal)
        finally:
            for worker in pool:
                worker.child.end()
                with suppress(OSError):  # nothing was printed: the file goes, and the folder with the last of them
                    path = self.folder / _FOLDER / f"{worker.name}.txt"
                    if not path.stat().st_size:
                        path.unlink()
                        path.parent.rmdir()

    def _hear(self, worker: _Worker, packs: Packs) -> Iterator[Notice]:
        """Yield what a worker has sent since the last time; raise what it raised."""
        for words in worker.child.messages():
            message: Sequence[Notice] | BaseException = pickle.loads(words)
            if isinstance(message, BaseException):
                raise message
            worker.heard = monotonic()
            for notice in message:
                packs.note_time(worker.jobs.popleft(), notice.seconds)
                yield notice

    def _settle(self, worker: _Worker, why: tuple[str, str], packs: Packs, journal: Journal) -> Iterator[Notice]:
        """Give back what a lost worker had still to do; the run that it was at may be at fault."""
        worker.child.end()
        jobs, worker.jobs = list(worker.jobs), deque()
        kept = kept_by(self.folder, worker.name)  # it may have kept runs and sent no notice
        for job in jobs:
            if job.run_id in kept:
                yield Notice(job.run_id, kept[job.run_id], 0.0)
        jobs = [job for job in jobs if job.run_id not in kept]
        hung = bool(jobs) and was_silent(self.folder, jobs[0].run_id)  # somebody has ended it for that
        at_fault = packs.return_lost(jobs, worker.alone or hung)
        if at_fault is not None:
            status, said = why
            run = lost_run(at_fault.spec, at_fault.run_id, "ProcessDied", said, timed_out=status == "timeout")
            journal.append(run)
            remove_gone(self.folder)
            yield Notice(run.run_id, run.record.status, 0.0)


@final
@dataclass(eq=False)
class _Worker:
    """A place of the pool: its process, whose journals begin with this name, and what that has still to do."""

    name: str
    child: Child
    jobs: deque[Job] = field(default_factory=deque)
    alone: bool = False
    heard: float = field(default_factory=monotonic)


def _work(
    theirs: Connection, name: str, folder: Path, study: str, path: Sequence[str], prints_apart: bool
) -> None:  # fmt: skip
    sys.path[:] = dict.fromkeys([*sys.path, *path])  # a user's classes are imported from where the sweep finds them
    try:
        journal = Journal(folder, study, name)
        printed = Printed(folder / _FOLDER / f"{name}.txt") if prints_apart else None

        def keep(run: Run, seconds: float) -> None:
            if printed is not None:
                printed.sign(run.record)
            journal.append(run)

        with publishing(to_files(folder)):
            while do_pack(theirs.recv(), keep, theirs.send):
                pass
    except (EOFError, ConnectionError):  # the parent is gone
        raise
    except (Exception, KeyboardInterrupt) as error:  # a full disk, say, or what a user's code raised to end it all
        with suppress(Exception):
            theirs.send(error)


@final
class Printed:
    """The file of this process's output, from now on; `sign` is to be called after each run."""

    def __init__(self, path: Path) -> None:
        self._file = open_within(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - _LINE))
            lines = file.read().splitlines()
        if lines and not lines[-1].startswith(_SIGN):  # of a process before this one
            os.write(self._file, b"\n-- printed by a run whose process ended\n")
        self._size = os.fstat(self._file).st_size
        os.dup2(self._file, _STDOUT)
        sys.stdout = open(  # noqa: SIM115 (it lasts as long as the process)
            _STDOUT, "w", buffering=1, encoding="utf-8", errors="backslashreplace", closefd=False
        )

    def sign(self, row: RunRow) -> None:
        flush_output()
        if os.fstat(self._file).st_size == self._size:
            return
        whose = f"run {row.run_id}, {row.optimizer} on {row.problem}, repetition {row.repetition}"
        os.write(self._file, _SIGN + f"{whose}\n".encode())
        self._size = os.fstat(self._file).st_size


def printed_files(folder: Path) -> set[Path]:
    files = set()
    for path in (folder / _FOLDER).glob("*.txt"):
        with suppress(FileNotFoundError):  # another sweep in this folder has just deleted it
            if path.stat().st_size:
                files.add(path)
    return files


@contextmanager
def nothing_printed() -> Iterator[None]:
    """Let nothing be seen of what is printed in the block, by Python or by C: it is of no run."""
    flush_output()
    before = os.dup(_STDOUT)
    try:
        with open(os.devnull, "w", encoding="utf-8") as nowhere, redirect_stdout(nowhere):
            os.dup2(nowhere.fileno(), _STDOUT)
            yield
            flush_output()
    finally:
        os.dup2(before, _STDOUT)
        os.close(before)
