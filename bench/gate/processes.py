"""Child processes: made for a run, a batch or a sweep, heard, and ended with all processes that they have started.

`Child` does what it is sent until it is ended; `WorkerPool` has several of them do jobs at once and gives the answers
in the order of the jobs; `at_once` makes calls so. `forked` and `apart` have one piece of work done, which may take its
process down with it, or has to be ended from outside: the child is watched and not the pipe alone, which a process that
it has started holds open for as long as it lives; and what it had sent before it ended is heard first.

A worker process and all that it starts are one family, which ends as a whole. ``become_worker(parent)`` is the first
thing that a child does: it leads a process group of its own, the system kills it when its parent ends (also where it is
stuck in C and no thread of Python runs), and what its descendants leave behind becomes its own child, so that nobody
gets lost. ``end_family(pid)`` is what a parent does to end it: the worker, its group, and those descendants that have
left the group.

The death signal and the adoption are Linux's (prctl); elsewhere the group alone is there. The signal is sent when the
*thread* that made the worker ends, so that thread must live as long as the worker. What a worker that dies by itself
leaves is found by its group; a daemon of its own session survives it.
"""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import os
import pickle
import platform
import select
import signal
import struct
import sys
import threading
import warnings
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import cache
from math import inf
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from time import perf_counter
from types import TracebackType
from typing import Any, TypeVar, final

from calibench.bench.gate.endings import ToldError, frames_of, text_of
from calibench.core.process_state import OWN_THREAD
from calibench.core.user_file import as_usual, safe_children

T = TypeVar("T")
Job = Any
Answer = Any
CAN_FORK = "fork" in multiprocessing.get_all_start_methods()
_LOOK = 0.5  # seconds after which a silent process is looked at: is it alive?


@final
class Child:
    """A process that does ``work(connection, *given)``, or none before `start` and after `end`.

    `connection` is our end of its pipe. The work lasts until the pipe ends; `prepare` was called before. Where a system
    cannot fork it is started anew.
    """

    def __init__(self, work: Callable[..., None], *given: Any) -> None:
        self._work, self._given = work, given
        self._process: BaseProcess | None = None
        self.connection: Connection

    @property
    def is_there(self) -> bool:
        """Tell whether a process was started, and not ended by us: it may be gone by itself."""
        return self._process is not None

    @property
    def is_gone(self) -> bool:
        """Tell whether the process has ended by itself: not by its pipe, which a grandchild may hold open."""
        return self._process is not None and self._process.exitcode is not None

    def start(self, others: Iterable[Connection] = ()) -> None:
        """Start the process; of our connections to `others` it keeps none."""
        context: Any = multiprocessing.get_context("fork" if CAN_FORK else "spawn")
        self.connection, theirs = context.Pipe()
        inherited = [self.connection, *others] if CAN_FORK else []
        self._process = context.Process(target=_live, args=(theirs, inherited, os.getpid(), self._work, self._given))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # forking beside threads: the child uses none of them
            with nullcontext() if CAN_FORK else safe_children():
                self._process.start()
        theirs.close()

    def send(self, what: object) -> None:
        """Send it something to do."""
        with suppress(OSError):  # it has just died, which `why_lost` tells
            self.connection.send(what)

    def messages(self) -> list[bytes]:
        """Return what it has sent since the last time, message by message."""
        messages = []
        with suppress(EOFError, ConnectionError):  # it has died
            while self.connection.poll():
                messages.append(self.connection.recv_bytes())
        return messages

    def why_lost(self) -> tuple[str, str] | None:
        """Return status and reason for a run whose process has ended; None while it is there."""
        if self._process is None or self._process.exitcode is None:
            return None
        return "failed", f"its process ended with {exit_of(self._process.exitcode)}"

    def interrupt(self) -> None:
        """Kill the process with all that it has started, from any thread; `end` must still be called."""
        if self._process is None or self._process.pid is None:
            return
        if not self.is_gone:
            end_family(self._process.pid)
            self._process.kill()
        elif CAN_FORK:
            with suppress(OSError):  # what it has left in its group
                os.killpg(self._process.pid, signal.SIGKILL)

    def end(self) -> str:
        """End the process with all that it has started; return how it ended, "" where there was none."""
        if self._process is None:
            return ""
        self.interrupt()
        self._process.join()
        self.connection.close()
        ending, self._process = exit_of(self._process.exitcode), None
        return ending


def _live(
    theirs: Connection, inherited: Iterable[Connection], parent: int, work: Callable[..., None], given: tuple[Any, ...]
) -> None:
    """Do the work of a child, from its first breath to its last."""
    as_usual()
    become_worker(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends us
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    for connection in inherited:
        connection.close()
    gc.freeze()  # a fork has the parent's heap, numba's large one: to look through it for garbage would also copy it
    with suppress(EOFError, ConnectionError):  # the parent is gone
        work(theirs, *given)
    os._exit(1)


class ProcessDied(RuntimeError):
    """A process of the pool is gone: a crash in foreign code, or a kill from outside."""


@final
class WorkerPool:
    """Do ``work(job)`` in `size` forked processes, as a context. They know what this process knew when it began."""

    def __init__(self, work: Callable[[Job], Answer], size: int) -> None:
        self._work, self._size = work, size
        self._children: list[Child] = []
        self._busy: set[Child] = set()
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
        for child in self._children:
            child.interrupt()

    def close(self) -> None:
        """End the processes and wait until they are gone."""
        children, self._children = self._children, []
        for child in children:
            if self._owner == os.getpid():
                child.end()
            else:
                child.connection.close()
        if children:
            os.close(self._held)

    def __enter__(self) -> WorkerPool:
        flush_output()  # else each process would print what is in there
        self._owner = os.getpid()
        parent_pipe, self._held = os.pipe()
        prepare()
        for _ in range(self._size):
            child = Child(_serve, self._work, parent_pipe, self._held)
            child.start(other.connection for other in self._children)
            self._children.append(child)
        os.close(parent_pipe)
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.close()

    def _feed(self) -> None:
        """Hand a job to each process that has none."""
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

    def _hear(self) -> None:
        """Wait for an answer of any process."""
        ready = wait([child.connection for child in self._busy], _LOOK)
        for child in [child for child in self._busy if child.connection in ready]:
            try:
                of_round, number, done, answer = child.connection.recv()
            except (EOFError, OSError):
                self._mourn(child)
                return
            self._busy.remove(child)
            if of_round == self._round:
                self._answers[number] = done, answer
        if not ready:  # a process that has forked in its turn keeps the connection open beyond its own end
            for child in self._busy:
                if child.is_gone:
                    self._mourn(child)
                    return

    def _mourn(self, child: Child) -> None:
        """Note that a process is gone; it stays busy, so that nobody gives it a job."""
        self._busy.add(child)
        self._broken = ProcessDied(f"a process that evaluated points ended with {child.end()}")


def _serve(connection: Connection, work: Callable[[Job], Answer], parent_pipe: int, held: int) -> None:
    """Be a process of the pool until the parent ends it."""
    os.close(held)
    threading.Thread(target=_follow, name=f"{OWN_THREAD}follow", args=(parent_pipe,), daemon=True).start()
    while True:
        of_round, number, job = connection.recv()
        try:
            answer = pickle.dumps((of_round, number, True, work(job)))
        except BaseException as error:  # SystemExit too: what ends a run there ends it here
            answer = pickle.dumps((of_round, number, False, ToldError.of(error)))
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        connection.send_bytes(answer)


def at_once(calls: Sequence[Callable[[], T]]) -> list[T]:
    """Return what each call returns, in their order. The first call begins first: the longest should stand there.

    What a call changes in memory stays in its process, what it returns is pickled, and what it raises is raised here.
    With one core, or where the system cannot fork, they are made here, one after the other.
    """
    size = min(os.cpu_count() or 1, len(calls))
    if size < 2 or not CAN_FORK:
        return [call() for call in calls]
    with WorkerPool(lambda number: calls[number](), size) as pool:
        pool.begin(range(len(calls)))
        return [pool.take() for _ in calls]


@contextmanager
def forked(work: Callable[[Sender], None]) -> Iterator[tuple[BaseProcess, Receiver]]:
    """Yield a child that does ``work(theirs)``, and our end of the line; at the end of the block it is killed.

    Its family is killed with it. The line ends (`EOFError`) when the child does, whoever still holds it: with code 0
    after its work, with 1 where that raised.
    """
    prepare()
    flush_output()  # else the child would print what is in there
    context = multiprocessing.get_context("fork")
    ours, theirs = os.pipe()
    parent_pipe, held = os.pipe()
    child = context.Process(target=_in_child, args=(work, theirs, ours, parent_pipe, held, os.getpid()))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # forking beside threads: the child uses none of them
        child.start()
    assert child.pid is not None
    os.close(theirs)
    os.close(parent_pipe)
    line = Receiver(ours, child.pid)
    mine = os.getpid()
    try:
        yield child, line
    finally:
        if os.getpid() == mine:  # and not in a process that was forked meanwhile
            end_family(child.pid)  # it has answered, or never will
            child.join()
        line.close()
        os.close(held)


@final
@dataclass(eq=False)  # not frozen: Python writes the traceback of what is raised
class Lost(Exception):
    """The work in the child has no result: the type, text and frames of its exception, or how its process ended.

    `timed_out`: it was ended because of its time.
    """

    error_type: str
    error: str
    traceback: str = ""
    timed_out: bool = False


def apart(work: Callable[[], T], limit: float) -> T:
    """Return ``work()``, done in a forked child within `limit` seconds. Raises `Lost` where there is no result.

    Where a system cannot fork it is done here.
    """

    def tell(theirs: Sender) -> None:
        try:
            result = work()
        except BaseException as error:  # whatever foreign code raises, SystemExit too
            theirs.send((False, (type(error).__name__, text_of(error), frames_of(error))))
            return
        theirs.send((True, result))

    if not CAN_FORK:
        try:
            return work()
        except (Exception, SystemExit) as error:
            raise Lost(type(error).__name__, text_of(error), frames_of(error)) from error
    with forked(tell) as (child, ours):
        if not ours.poll(limit):
            raise Lost("TimeoutError", f"it did not end within {limit:g} s", timed_out=True)
        try:
            good, answer = ours.recv()
        except EOFError:
            good, answer = False, None
    if answer is None and not good:
        raise Lost("ProcessDied", f"its process ended with {exit_of(child.exitcode)}")
    if not good:
        raise Lost(*answer)
    result: T = answer
    return result


def flush_output() -> None:
    """Write out what was printed here, also by libraries in C; what a run has made of its streams is passed over."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):
            stream.flush()
    with suppress(Exception):
        ctypes.CDLL(None).fflush(None)


def _in_child(work: Callable[[Sender], None], theirs: int, ours: int, parent_pipe: int, held: int, parent: int) -> None:
    become_worker(parent)
    os.close(ours)
    os.close(held)
    threading.Thread(target=_follow, name=f"{OWN_THREAD}follow", args=(parent_pipe,), daemon=True).start()
    code = 0
    try:
        work(Sender(theirs))
        flush_output()
    except BaseException:
        code = 1
    end_own_children()
    os._exit(code)  # without the parent's exit handlers


def _follow(parent_pipe: int) -> None:
    """Wait until the parent is gone; then exit with all processes started here, where the system has not done so."""
    os.read(parent_pipe, 1)
    end_own_children()
    os._exit(1)


_LENGTH = struct.Struct("!Q")
_CHUNK = 1 << 16
_LONGEST = 3600.0  # seconds of one wait: the system has its own largest number


@final
class Sender:
    """The child's end: ``send(message)``, anything that can be pickled."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def send(self, message: Any) -> None:
        """Send it whole. Raises what pickle raises, with nothing sent; `OSError` where nobody listens any more."""
        data = pickle.dumps(message)
        left = memoryview(_LENGTH.pack(len(data)) + data)
        while left:
            left = left[os.write(self._descriptor, left) :]


@final
class Receiver:
    """The parent's end, of the pipe and of the process `pid`, a child of ours that nobody has waited for yet."""

    def __init__(self, descriptor: int, pid: int) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor, self._heard, self._over = descriptor, bytearray(), False
        self._process = _process_descriptor(pid)

    def poll(self, timeout: float | None = 0.0) -> bool:
        """Tell whether `recv` would return, or raise, at once; wait for that at most `timeout` seconds (None: ever)."""
        end = None if timeout is None else perf_counter() + timeout
        while not (self._over or self._is_whole()):
            left = inf if end is None else max(0.0, end - perf_counter())
            ready = self._wait(min(left, _LONGEST))
            if not ready and left <= _LONGEST:
                return False
            self._read()
            if self._process in ready:  # all that it has said is in the pipe, and read
                self._over = True
        return True

    def recv(self) -> Any:
        """Return the next message. Raises `EOFError` where the child ended without a further complete one."""
        self.poll(None)
        if not self._is_whole():
            raise EOFError("the process ended")
        size = self._size()
        message = bytes(self._heard[_LENGTH.size : size])
        del self._heard[:size]
        return pickle.loads(message)

    def close(self) -> None:
        """Close the descriptors."""
        os.close(self._descriptor)
        if self._process is not None:
            os.close(self._process)

    def _wait(self, timeout: float) -> list[int | None]:
        watched = select.poll()
        watched.register(self._descriptor, select.POLLIN)
        if self._process is not None:
            watched.register(self._process, select.POLLIN)
        return [ready for ready, _ in watched.poll(1000 * timeout)]

    def _read(self) -> None:
        with suppress(BlockingIOError):
            while data := os.read(self._descriptor, _CHUNK):
                self._heard += data
            self._over = True  # the process has only this end

    def _size(self) -> int:
        return _LENGTH.size + int(_LENGTH.unpack_from(self._heard)[0])

    def _is_whole(self) -> bool:
        return len(self._heard) >= _LENGTH.size and len(self._heard) >= self._size()


def _process_descriptor(pid: int) -> int | None:
    """Return what tells that the process has ended; None where the system has no such thing: only the pipe tells."""
    try:
        return os.pidfd_open(pid)
    except (AttributeError, OSError):
        return None


_LINUX = sys.platform == "linux"
_DIES_WITH_PARENT, _ADOPTS = 1, 36  # PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER of <linux/prctl.h>
_GENERATIONS = 100  # of rounds that look for processes which were made as others were killed


def prepare() -> None:
    """Load what `become_worker` needs: once before the fork is faster than in every child."""
    if _LINUX:
        _prctl()


def become_worker(parent: int) -> None:
    """Make this process, a child of `parent`, the head of a family that ends with it. To be called first in a child."""
    with suppress(OSError):  # it leads a group or a session already
        os.setpgid(0, 0)
    if _LINUX:
        _prctl()(_DIES_WITH_PARENT, int(signal.SIGKILL), 0, 0, 0)
        _prctl()(_ADOPTS, 1, 0, 0, 0)
    if os.getppid() != parent:  # it ended before it could be watched
        os._exit(1)


def end_family(pid: int) -> None:
    """Kill the worker `pid`, a child that has not been waited for, and all that it has started.

    The worker is stopped first, so that it makes no new ones, and is left to be waited for.
    """
    if not _send(pid, signal.SIGSTOP):
        return
    _end_descendants(pid)
    leads = _leads_a_group(pid)  # asked while it is there: else the group would be ours
    _send(pid, signal.SIGKILL)
    if leads:
        with suppress(OSError):
            os.killpg(pid, signal.SIGKILL)


@contextmanager
def leaving_nothing() -> Iterator[None]:
    """End with the block all processes that were started in it, also daemons, which become ours on Linux."""
    mine = os.getpid()
    before = set(_descendants(mine))
    if _LINUX:
        _prctl()(_ADOPTS, 1, 0, 0, 0)
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
    """Tell whether processes that were started here are left."""
    return any(not _is_dead(child) for child in _children(os.getpid()))


def end_own_children() -> None:
    """Kill all remaining processes that this worker has started: its last action."""
    _end_descendants(os.getpid())


def _end_descendants(pid: int, but: Container[int] = ()) -> None:
    """Kill the descendants of `pid` until there are none: those of a killed one come to the worker that adopts."""
    for _ in range(_GENERATIONS):
        found = [child for child in _descendants(pid) if child not in but and not _is_dead(child)]
        if not found:
            return
        for child in found:
            _send(child, signal.SIGKILL)


def _descendants(pid: int) -> Iterator[int]:
    for child in _children(pid):
        yield child
        yield from _descendants(child)


def _children(pid: int) -> list[int]:
    """Return the children of a process by the system's table; none where there is no such table."""
    found: list[int] = []
    with suppress(OSError):  # it has ended
        for task in Path(f"/proc/{pid}/task").iterdir():
            with suppress(OSError):
                found += map(int, (task / "children").read_text().split())
    return found


def _is_dead(pid: int) -> bool:
    """Tell whether a process has ended: a killed one stays in the table until its parent waits for it."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return True
    return state in "ZX"


def _leads_a_group(pid: int) -> bool:
    try:
        return os.getpgid(pid) == pid
    except OSError:
        return False


def _send(pid: int, what: int) -> bool:
    try:
        os.kill(pid, what)
    except OSError:
        return False
    return True


@cache
def _prctl() -> Any:
    return ctypes.CDLL(None).prctl


def born(pid: int) -> str:
    """Return the start time of a process of this machine in the system's own count; '' where it is not known."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""


def is_gone(host: str, pid: int, birth: str) -> bool:
    """Tell whether a process that began at `birth` (`born`) is known to be gone: of another machine it never is.

    One that was killed is gone, though it stays in the system's table until its parent waits for it.
    """
    if host != platform.node():
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except OSError:  # it is another user's
        pass
    return bool(birth) and (born(pid) != birth or _is_dead(pid))
