"""Child processes: made for a run, a batch or a sweep, heard, and ended with all processes that they have started.

`Child` does what it is sent until it is ended; `WorkerPool` has several do jobs at once; `forked` and `apart` have one
piece of work done. A worker and all that it starts are one family: it leads a process group, the system kills it when
its parent ends (when the *thread* that made it ends, so that must live as long), and what its descendants leave becomes
its own child. The death signal and the adoption are Linux's (prctl); elsewhere the group alone is there.
"""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import os
import pickle
import platform
import signal
import sys
import warnings
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar, final

from calibench.bench.gate.endings import ToldError, frames_of, text_of

T = TypeVar("T")
Job = Any
Answer = Any
CAN_FORK = "fork" in multiprocessing.get_all_start_methods()
_LOOK = 0.5  # seconds after which a silent process is looked at: is it alive?


@final
@dataclass(eq=False)
class Child:
    """A process that does ``work(connection, *given)`` until its pipe ends, or none before `start` and after `end`."""

    work: Callable[..., None]
    given: tuple[Any, ...] = ()
    process: BaseProcess | None = field(default=None, init=False)
    connection: Connection = field(init=False)

    @property
    def is_gone(self) -> bool:
        """Tell whether the process has ended by itself: not by its pipe, which a grandchild may hold open."""
        return self.process is not None and self.process.exitcode is not None

    def start(self, others: Iterable[Connection] = ()) -> None:
        """Start the process; of our connections to `others` it keeps none."""
        context: Any = multiprocessing.get_context("fork" if CAN_FORK else "spawn")
        self.connection, theirs = context.Pipe()
        inherited = [self.connection, *others] if CAN_FORK else []
        self.process = context.Process(target=_live, args=(theirs, inherited, os.getpid(), self.work, self.given))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # forking beside threads: the child uses none of them
            self.process.start()
        theirs.close()

    def send(self, what: object) -> None:
        with suppress(OSError):  # it has just died, which `why_lost` tells
            self.connection.send(what)

    def messages(self) -> list[bytes]:
        messages = []
        with suppress(EOFError, ConnectionError):  # it has died
            while self.connection.poll():
                messages.append(self.connection.recv_bytes())
        return messages

    def why_lost(self) -> tuple[str, str] | None:
        """Return status and reason for a run whose process has ended; None while it is there."""
        if self.process is None or self.process.exitcode is None:
            return None
        return "failed", f"its process ended with {exit_of(self.process.exitcode)}"

    def interrupt(self) -> None:
        """Kill the process with all that it has started, from any thread; `end` must still be called."""
        if self.process is None or self.process.pid is None:
            return
        if not self.is_gone:
            end_family(self.process.pid)
            self.process.kill()
        elif CAN_FORK:
            with suppress(OSError):  # what it has left in its group
                os.killpg(self.process.pid, signal.SIGKILL)

    def end(self) -> str:
        """End the process with all that it has started; return how it ended, "" where there was none."""
        if self.process is None:
            return ""
        self.interrupt()
        self.process.join()
        self.connection.close()
        ending, self.process = exit_of(self.process.exitcode), None
        return ending


def _live(
    theirs: Connection, inherited: Iterable[Connection], parent: int, work: Callable[..., None], given: tuple[Any, ...]
) -> None:
    become_worker(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends us
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    for connection in inherited:
        connection.close()
    gc.freeze()  # a fork has the parent's heap, numba's large one: to look through it for garbage would also copy it
    code = 1
    with suppress(EOFError, ConnectionError):  # the parent is gone
        work(theirs, *given)
        code = 0
    os._exit(code)  # without the parent's exit handlers


class ProcessDied(RuntimeError):
    """A process of the pool is gone: a crash in foreign code, or a kill from outside."""


@final
@dataclass(eq=False)
class WorkerPool:
    """Do ``work(job)`` in `size` forked processes, as a context. They know what this process knew when it began."""

    work: Callable[[Job], Answer]
    size: int
    _children: list[Child] = field(default_factory=list, init=False)
    _busy: set[Child] = field(default_factory=set, init=False)
    _owner: int = field(default=0, init=False)
    _jobs: Sequence[Job] = field(default=(), init=False)
    _round: int = field(default=0, init=False)
    _sent: int = field(default=0, init=False)
    _taken: int = field(default=0, init=False)
    _answers: dict[int, tuple[bool, Answer]] = field(default_factory=dict, init=False)
    _broken: ProcessDied | None = field(default=None, init=False)

    def begin(self, jobs: Sequence[Job]) -> None:
        """Begin these jobs; answers of earlier jobs that nobody has taken are dropped."""
        self._jobs, self._sent, self._taken, self._answers = jobs, 0, 0, {}
        self._round += 1
        self._feed()

    def take(self) -> Answer:
        """Return the answer of the next job, in the order of the jobs, or raise what it raised."""
        number = self._taken
        while number not in self._answers:
            if self._broken is not None:
                raise self._broken
            self._feed()
            lost = None
            # wait for an answer of any process
            ready = wait([child.connection for child in self._busy], _LOOK)
            for child in [child for child in self._busy if child.connection in ready]:
                try:
                    of_round, answered, done, answer = child.connection.recv()
                except (EOFError, OSError):
                    lost = child
                    break
                self._busy.remove(child)
                if of_round == self._round:
                    self._answers[answered] = done, answer
            if not ready:  # a process that has forked in its turn keeps the connection open beyond its own end
                lost = next((child for child in self._busy if child.is_gone), None)
            if lost is not None:
                self._mourn(lost)
        self._taken += 1
        self._feed()
        done, answer = self._answers.pop(number)
        if done:
            return answer
        raise answer.rebuilt()

    def interrupt(self) -> None:
        """End the processes from another thread; a waiting `take` raises. `close` must still be called."""
        for child in self._children:
            child.interrupt()

    def close(self) -> None:
        children, self._children = self._children, []
        for child in children:
            if self._owner == os.getpid():
                child.end()
            else:
                child.connection.close()

    def __enter__(self) -> WorkerPool:
        flush_output()  # else each process would print what is in there
        self._owner = os.getpid()
        load_prctl()
        for _ in range(self.size):
            child = Child(_serve, (self.work,))
            child.start(other.connection for other in self._children)
            self._children.append(child)
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.close()

    def _feed(self) -> None:
        for child in self._children:
            if self._sent == len(self._jobs):
                return
            if child in self._busy:
                continue
            try:
                child.connection.send((self._round, self._sent, self._jobs[self._sent]))
            except OSError:
                self._mourn(child)
                return
            self._busy.add(child)
            self._sent += 1

    def _mourn(self, child: Child) -> None:
        """Note that a process is gone; it stays busy, so that nobody gives it a job."""
        self._busy.add(child)
        self._broken = ProcessDied(f"a process that evaluated points ended with {child.end()}")


def _serve(connection: Connection, work: Callable[[Job], Answer]) -> None:
    while True:
        of_round, number, job = connection.recv()
        try:
            answer = pickle.dumps((of_round, number, True, work(job)))
        except BaseException as error:  # SystemExit too: what ends a run there ends it here
            answer = pickle.dumps((of_round, number, False, ToldError.of(error)))
        flush_output()
        connection.send_bytes(answer)


def at_once(calls: Sequence[Callable[[], T]]) -> list[T]:
    """Return what each call returns, in their order; the longest should stand first. What one raises is raised here."""
    size = min(os.cpu_count() or 1, len(calls))
    if size < 2 or not CAN_FORK:
        return [call() for call in calls]
    with WorkerPool(lambda number: calls[number](), size) as pool:
        pool.begin(range(len(calls)))
        return [pool.take() for _ in calls]


@contextmanager
def forked(work: Callable[[Sender], None]) -> Iterator[tuple[BaseProcess, Receiver]]:
    """Yield a child that does ``work(theirs)``, and our end of the line; at the end of the block its family is killed.

    The line ends (`EOFError`) when the child does: with code 0 after its work, with 1 where that raised.
    """
    load_prctl()
    flush_output()  # else the child would print what is in there
    mine, child = os.getpid(), Child(_work_once, (work,))
    child.start()
    assert child.process is not None
    line = Receiver(child)
    try:
        yield child.process, line
    finally:
        line.close()
        if os.getpid() == mine:  # and not in a process that was forked meanwhile
            child.end()  # it has answered, or never will


def _work_once(theirs: Connection, work: Callable[[Sender], None]) -> None:
    code = 0
    try:
        work(Sender(theirs))
        flush_output()
    except BaseException:
        code = 1
    _end_descendants(os.getpid())
    os._exit(code)


@final
@dataclass(eq=False)  # not frozen: Python writes the traceback of what is raised
class Lost(Exception):
    """The work in the child has no result: its exception as text, or how its process ended (`timed_out`: in time)."""

    error_type: str
    error: str
    traceback: str = ""
    timed_out: bool = False


def apart(work: Callable[[], T], limit: float) -> T:
    """Return ``work()``, done in a child (if one can be forked) within `limit` seconds. Raises `Lost` without it."""

    def tell(theirs: Sender) -> None:
        try:
            result = work()
        except BaseException as error:  # whatever foreign code raises, SystemExit too
            theirs.send((None, (type(error).__name__, text_of(error), frames_of(error))))
        else:
            theirs.send((result, None))

    if not CAN_FORK:
        try:
            return work()
        except (Exception, SystemExit) as error:
            raise Lost(type(error).__name__, text_of(error), frames_of(error)) from error
    with forked(tell) as (child, ours):
        if not ours.poll(limit):
            raise Lost("TimeoutError", f"it did not end within {limit:g} s", timed_out=True)
        try:
            result, why = ours.recv()
        except EOFError:
            result, why = None, ("ProcessDied", "")
    if why == ("ProcessDied", ""):
        raise Lost("ProcessDied", f"its process ended with {exit_of(child.exitcode)}")
    if why is not None:
        raise Lost(*why)
    found: T = result
    return found


def flush_output() -> None:
    """Write out what was printed here, also by libraries in C; what a run has made of its streams is passed over."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):
            stream.flush()
    with suppress(Exception):
        ctypes.CDLL(None).fflush(None)


_LONGEST = 1e6  # seconds of one wait: the system has its own largest number


@final
@dataclass(frozen=True)
class Sender:
    """The child's end: ``send(message)``, any picklable; what user code forks of it sends nothing."""

    connection: Connection
    process: int = field(default_factory=os.getpid)

    def send(self, message: Any) -> None:
        """Send it whole. Raises what pickle raises, with nothing sent; `OSError` where nobody listens any more."""
        if os.getpid() == self.process:
            self.connection.send(message)


@final
class Receiver:
    """Our end of the line to a child that was just started: also where what it leaves behind holds its end open."""

    def __init__(self, child: Child) -> None:
        self.connection, self._ends = child.connection, list[int]()
        with suppress(AttributeError, OSError):  # where there is no such thing the line alone tells that it has ended
            self._ends.append(os.pidfd_open(child.process.pid))  # type: ignore[union-attr, arg-type]

    def poll(self, timeout: float | None = 0.0) -> bool:
        """Tell whether `recv` would return, or raise, at once; wait for that at most `timeout` seconds (None: ever)."""
        return bool(wait([self.connection, *self._ends], None if timeout is None else min(timeout, _LONGEST)))

    def recv(self) -> Any:
        """Return the next message. Raises `EOFError` where the child ended without a further one."""
        self.poll(None)
        if not self.connection.poll():  # it has ended, and all that it has said was read
            raise EOFError("the process ended")
        try:
            return self.connection.recv()
        except ConnectionError:
            raise EOFError("the process ended") from None

    def close(self) -> None:
        while self._ends:
            os.close(self._ends.pop())


_DIES_WITH_PARENT, _ADOPTS = 1, 36  # PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER of <linux/prctl.h>
_GENERATIONS = 100  # of rounds that look for processes which were made as others were killed


def become_worker(parent: int) -> None:
    """Make this process, a child of `parent`, the head of a family that ends with it. To be called first in a child."""
    with suppress(OSError):  # it leads a group or a session already
        os.setpgid(0, 0)
    prctl = load_prctl()
    prctl(_DIES_WITH_PARENT, int(signal.SIGKILL), 0, 0, 0)
    prctl(_ADOPTS, 1, 0, 0, 0)
    if os.getppid() != parent:  # it ended before it could be watched
        os._exit(1)


def end_family(pid: int) -> None:
    """Kill the worker `pid`, a child that has not been waited for, and all that it has started.

    The worker is stopped first, so that it makes no new ones, and is left to be waited for.
    """
    try:
        os.kill(pid, signal.SIGSTOP)
    except OSError:
        return
    _end_descendants(pid)
    leads = False
    with suppress(OSError):
        leads = os.getpgid(pid) == pid  # asked while it is there: else the group would be ours
    with suppress(OSError):
        os.kill(pid, signal.SIGKILL)
    if leads:
        with suppress(OSError):
            os.killpg(pid, signal.SIGKILL)


@contextmanager
def leaving_nothing() -> Iterator[None]:
    """End with the block all processes that were started in it, also daemons, which become ours on Linux."""
    mine = os.getpid()
    before = set(_descendants(mine))
    load_prctl()(_ADOPTS, 1, 0, 0, 0)
    try:
        yield
    finally:
        if os.getpid() == mine:  # and not in a child that was forked in the block
            _end_descendants(mine, before)


def exit_of(code: int | None) -> str:
    """Return how a process ended, as text, from the exit code that `multiprocessing` gives.

    >>> exit_of(3), exit_of(-11)
    ('exit code 3', 'exit code -11 (SIGSEGV)')
    """
    try:
        return f"exit code {code}" + (f" ({signal.Signals(-code).name})" if code is not None and code < 0 else "")
    except ValueError:
        return f"exit code {code}"


def has_children() -> bool:
    with suppress(AttributeError):  # of a system that does not say at once that there are none
        try:
            os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        except ChildProcessError:
            return False
    return any(not _is_dead(child) for child in _descendants(os.getpid()))


def _end_descendants(pid: int, but: Container[int] = ()) -> None:
    """Kill the descendants of `pid` until there are none: those of a killed one come to the worker that adopts."""
    for _ in range(_GENERATIONS):
        found = [child for child in _descendants(pid) if child not in but and not _is_dead(child)]
        if not found:
            return
        for child in found:
            with suppress(OSError):
                os.kill(child, signal.SIGKILL)


def _descendants(pid: int) -> Iterator[int]:
    """Yield the processes that one has started, and those of these, by the system's table; none where there is none."""
    found: list[int] = []
    with suppress(OSError):  # it has ended
        for task in Path(f"/proc/{pid}/task").iterdir():
            with suppress(OSError):
                found += map(int, (task / "children").read_text().split())
    for child in found:
        yield child
        yield from _descendants(child)


def _is_dead(pid: int) -> bool:
    """Tell whether a process has ended: a killed one stays in the table until its parent waits for it."""
    return (_stat(pid) or "Z")[0] in "ZX"


@cache
def load_prctl() -> Callable[..., object]:
    """Return the call of Linux, elsewhere one that does nothing; loaded before a fork it is there in each child."""
    return ctypes.CDLL(None).prctl if sys.platform == "linux" else lambda *_: 0


def born(pid: int) -> str:
    """Return the start time of a process of this machine in the system's own count; '' where it is not known."""
    return "".join(_stat(pid)[19:20])


def _stat(pid: int) -> list[str]:
    """Return what the system's table says of a process, from its state on; [] where it has none."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def is_gone(host: str, pid: int, birth: str) -> bool:
    """Tell whether a process that began at `birth` (`born`) is known to be gone: of another machine it never is."""
    if host != platform.node():
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except OSError:  # it is another user's
        pass
    return bool(birth) and (born(pid) != birth or _is_dead(pid))
