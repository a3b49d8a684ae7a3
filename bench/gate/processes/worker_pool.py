"""A pool of forked processes that do jobs at once and give the answers back in the order of the jobs.

For one run and its costly objective: made as the run begins, by the thread that makes it, ended with the run. What a
job raises is raised here, as the same type with the same text. A process that dies raises `ProcessDied`. The processes
end with their parent, also where that is killed, and what they have started ends with them
(`bench.gate.processes.process_group`).
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe, wait
from types import TracebackType
from typing import Any, final

from calibench.bench.gate.costly.told_error import ToldError
from calibench.bench.gate.processes.process_group import become_worker, end_family, end_own_children, exit_of, prepare
from calibench.core.process_state import OWN_THREAD

_LOOK = 0.5  # seconds after which a silent process is looked at: is it alive?
Job = Any
Answer = Any


class ProcessDied(RuntimeError):
    """A process of the pool is gone: a crash in foreign code, or a kill from outside."""


@final
class WorkerPool:
    """Do ``work(job)`` in `size` forked processes, as a context. They know what this process knew when it began."""

    def __init__(self, work: Callable[[Job], Answer], size: int) -> None:
        self._work, self._size = work, size
        self._workers: list[_Worker] = []
        self._owner = 0
        self._jobs: Sequence[Job] = ()
        self._round = self._sent = self._taken = 0
        self._answers: dict[int, tuple[bool, Answer]] = {}
        self._broken: ProcessDied | None = None

    def begin(self, jobs: Sequence[Job]) -> None:
        """Take these jobs; answers of earlier jobs that nobody has taken are dropped."""
        self._jobs, self._sent, self._taken, self._answers = jobs, 0, 0, {}
        self._round += 1

    def take(self) -> Answer:
        """Return the answer of the next job, in the order of the jobs, or raise what it raised."""
        number = self._taken
        while number not in self._answers:
            if self._broken is not None:
                raise self._broken
            self._feed()
            self._hear()
        self._taken += 1
        self._feed()
        done, answer = self._answers.pop(number)
        if done:
            return answer
        raise answer.rebuilt()

    def interrupt(self) -> None:
        """End the processes from another thread; a waiting `take` raises. `close` must still be called."""
        for worker in self._workers:
            end_family(worker.pid)

    def close(self) -> None:
        """End the processes and wait until they are gone."""
        workers, self._workers = self._workers, []
        for worker in workers:
            if self._owner == os.getpid():
                worker.kill()
            worker.connection.close()
        if workers:
            os.close(self._held)

    def __enter__(self) -> WorkerPool:
        self._start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.close()

    def _feed(self) -> None:
        """Hand a job to each process that has none."""
        for worker in self._workers:
            if self._sent == len(self._jobs):
                return
            if worker.busy:
                continue
            try:
                worker.connection.send((self._round, self._sent, self._jobs[self._sent]))
            except OSError:
                self._mourn(worker)
                return
            worker.busy = True
            self._sent += 1

    def _hear(self) -> None:
        """Wait for an answer of any process."""
        busy = {worker.connection: worker for worker in self._workers if worker.busy}
        heard = wait(list(busy), _LOOK)
        for connection in heard:
            worker = busy[connection]  # type: ignore[index]
            try:
                of_round, number, done, answer = worker.connection.recv()
            except (EOFError, OSError):
                self._mourn(worker)
                return
            worker.busy = False
            if of_round == self._round:
                self._answers[number] = done, answer
        if not heard:  # a process that has forked in its turn keeps the connection open beyond its own end
            for worker in busy.values():
                if worker.is_gone():
                    self._mourn(worker)

    def _mourn(self, worker: _Worker) -> None:
        self._broken = ProcessDied(f"a process that evaluated points ended with {worker.ending()}")

    def _start(self) -> None:
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()  # else each process would print what is in there
        self._owner = os.getpid()
        parent_pipe, self._held = os.pipe()
        prepare()
        for _ in range(self._size):
            ours, theirs = Pipe()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # threads beside: the child uses none of them
                pid = os.fork()
            if not pid:
                _live(
                    self._work,
                    self._owner,
                    theirs,
                    parent_pipe,
                    [ours, *(w.connection for w in self._workers)],
                    self._held,
                )
            theirs.close()
            self._workers.append(_Worker(pid, ours))
        os.close(parent_pipe)


@final
class _Worker:
    """What the parent knows of one process, which nobody else waits for."""

    def __init__(self, pid: int, connection: Connection) -> None:
        self.pid, self.connection = pid, connection
        self.busy = False
        self._status: int | None = None

    def is_gone(self) -> bool:
        """Tell whether the process has ended; it is left to be waited for, so that its number stays its own."""
        if self._status is not None:
            return True
        if not hasattr(os, "waitid"):  # macOS before Python 3.13: there the end of its connection tells
            return False
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None

    def kill(self) -> None:
        """End the process and what it has started, and wait for its end."""
        if self._status is None:
            end_family(self.pid)
            self._status = os.waitpid(self.pid, 0)[1]

    def ending(self) -> str:
        """Return how it ended, as text, where it has ended or its connection has."""
        self.kill()
        return exit_of(os.waitstatus_to_exitcode(self._status or 0))


def _live(
    work: Callable[[Job], Answer], parent: int, ours: Connection, parent_pipe: int, others: list[Connection], held: int
) -> None:
    """Be a process of the pool until the parent ends it. Never returns."""
    try:
        become_worker(parent)
        os.close(held)
        for other in others:
            other.close()
        threading.Thread(target=_follow, name=f"{OWN_THREAD}follow", args=(parent_pipe,), daemon=True).start()
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # what this process has for them is not for us
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        _serve(work, ours)
        end_own_children()
    finally:
        os._exit(0)


def _serve(work: Callable[[Job], Answer], connection: Connection) -> None:
    while True:
        try:
            of_round, number, job = connection.recv()
        except (EOFError, OSError):
            return
        try:
            answer, done = work(job), True
        except BaseException as error:  # SystemExit too: what ends a run there ends it here
            answer, done = ToldError.of(error), False
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        connection.send((of_round, number, done, answer))


def _follow(parent_pipe: int) -> None:
    """Wait until the parent is gone; then go, with all that was started here, where the system has not done so."""
    os.read(parent_pipe, 1)
    end_own_children()
    os._exit(1)
