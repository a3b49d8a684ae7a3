"""The carrier of this machine: processes, each with a journal of its own, and with a file of what its runs print.

They are forked after the kernels were loaded, so that a new one is there at once; where a system cannot fork they are
started anew. One that dies costs the run it was at, and another takes its place. Each is the head of a family
(`bench.gate.processes`) that ends with it, and with us.

The standard output of such a process goes to its file beside the results, and with it that of all it starts and of
libraries in C, so that progress stays readable. After each run that printed, a line says which one it was. Standard
error stays where it is: warnings are to be seen. A sweep of a single run prints where it did, on the terminal.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from time import monotonic
from typing import final

from calibench.bench.execution.in_progress import publishing, remove_gone, to_files, was_silent
from calibench.bench.execution.run import Run
from calibench.bench.execution.run_row import RunRow
from calibench.bench.gate.processes import Child, flush_output, prepare
from calibench.bench.store.atomic_file import open_within
from calibench.bench.store.journal import Journal, kept_by, writer_name
from calibench.bench.workers.carrier import Job, Notice, Pack, Packs, do_pack, row_of_lost, too_late

_LOOK = 0.25  # seconds between two looks at who is still there
_FOLDER = "printed"
_MOST = 16 * 1024 * 1024  # bytes a worker keeps: after the run that goes beyond, nothing more is
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
        """Do all runs, each notice as its run ends."""
        session = writer_name()
        prepare()
        apart = len(packs) > 1  # a single run prints on the terminal
        count = min(self.workers, len(packs))
        pool = [_Worker(f"{session}-{slot}", self.folder, self.study, apart) for slot in range(count)]
        journal = Journal(self.folder, self.study, session)  # its file is made with its first row
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
                    why = worker.why_lost()  # before it is heard: what it sent last must not be missed
                    if worker.child.connection in ready or why:
                        for notice, job in worker.notices():
                            packs.note_time(job, notice.seconds)
                            yield notice
                    if why:
                        yield from self._settle(worker, why, packs, journal)
                        worker.start(pool)
        finally:
            for worker in pool:
                worker.end()
                with suppress(OSError):  # nothing was printed: the file goes, and the folder with the last of them
                    path = file_of(self.folder, worker.name)
                    if not path.stat().st_size:
                        path.unlink()
                        path.parent.rmdir()

    def _settle(self, worker: _Worker, why: tuple[str, str], packs: Packs, journal: Journal) -> Iterator[Notice]:
        """Give back what a lost worker had still to do; the run that it was at may be at fault."""
        jobs, alone = worker.end()
        kept = kept_by(self.folder, worker.name)  # it may have kept runs and sent no notice
        for job in jobs:
            if job.run_id in kept:
                yield Notice(job.run_id, kept[job.run_id], 0.0)
        jobs = [job for job in jobs if job.run_id not in kept]
        hung = bool(jobs) and was_silent(self.folder, jobs[0].run_id)  # somebody has ended it for that
        at_fault = packs.return_lost(jobs, alone or hung)
        if at_fault is not None:
            run = row_of_lost(at_fault, *why)
            journal.append(run)
            remove_gone(self.folder)
            yield Notice(run.run_id, run.record.status, 0.0)


@final
class _Worker:
    """A place of the pool: its process, whose journals begin with this name, and what that has still to do."""

    def __init__(self, name: str, folder: Path, study: str, prints_apart: bool) -> None:
        self.name = name
        self.child = Child(_work, name, folder, study, list(sys.path), prints_apart)
        self._jobs: deque[Job] = deque()
        self._alone = False
        self._heard = monotonic()

    @property
    def is_idle(self) -> bool:
        """Tell whether it has nothing to do."""
        return not self._jobs

    def start(self, pool: Sequence[_Worker]) -> None:
        """Start a new process in this place; of the connections to the others of `pool` it keeps none."""
        self.child.start(worker.child.connection for worker in pool if worker.child.is_there)

    def give(self, pack: Pack) -> None:
        """Give it a pack to do."""
        self._jobs, self._alone, self._heard = deque(pack.jobs), pack.alone, monotonic()
        self.child.send(pack)

    def notices(self) -> Iterator[tuple[Notice, Job]]:
        """Yield what it has sent since the last time; raise what it raised."""
        for words in self.child.messages():
            message: Sequence[Notice] | BaseException = pickle.loads(words)
            if isinstance(message, BaseException):
                raise message
            self._heard = monotonic()
            for notice in message:
                yield notice, self._jobs.popleft()

    def why_lost(self) -> tuple[str, str] | None:
        """Return the status and reason for a run whose process has ended, or is far beyond its time limit."""
        limit = self._jobs[0].spec.time_limit if self._jobs else None
        return self.child.why_lost() or too_late(limit, self._heard)

    def end(self) -> tuple[list[Job], bool]:
        """End the process with all that it has started; return what it had still to do, and whether that was alone."""
        self.child.end()
        jobs, self._jobs = list(self._jobs), deque()
        return jobs, self._alone


def _work(
    theirs: Connection, name: str, folder: Path, study: str, path: Sequence[str], prints_apart: bool
) -> None:  # fmt: skip
    """Do the packs that come until there is none, or this process can do no more."""
    sys.path[:] = dict.fromkeys([*sys.path, *path])  # a user's classes are imported from where the sweep finds them
    try:
        journal = Journal(folder, study, name)
        printed = Printed(file_of(folder, name)) if prints_apart else None

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
        self._full = False
        os.dup2(self._file, _STDOUT)
        sys.stdout = open(  # noqa: SIM115 (it lasts as long as the process)
            _STDOUT, "w", buffering=1, encoding="utf-8", errors="backslashreplace", closefd=False
        )

    def sign(self, row: RunRow) -> None:
        """Say which run has printed what stands above, where one has."""
        flush_output()
        if self._full or os.fstat(self._file).st_size == self._size:
            return
        whose = f"run {row.run_id}, {row.optimizer} on {row.problem}, repetition {row.repetition}"
        os.write(self._file, _SIGN + f"{whose}\n".encode())
        self._size = os.fstat(self._file).st_size
        if self._size > _MOST:
            os.write(self._file, b"-- what this worker's later runs print is left out\n")
            self._full = True
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, _STDOUT)
            os.close(nowhere)


def file_of(folder: Path, worker: str) -> Path:
    """Return the file of what a worker prints into the study in `folder`."""
    return folder / _FOLDER / f"{worker}.txt"


def printed_files(folder: Path) -> set[Path]:
    """Return the files of the study in `folder` in which something is printed."""
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
