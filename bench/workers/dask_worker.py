"""What runs in a Dask worker's process: it has packs done in a seat (`bench.workers.dask_seat`), and streams runs home.

Runs go into a queue of the scheduler; a full queue makes the workers wait, and runs that end within a tenth of a second
share a message. Where nobody wants the pack any more the seat is ended.
"""

from __future__ import annotations

import asyncio
import logging
import os
import pickle
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from time import monotonic
from typing import Any, final

import dask
from distributed import Worker, get_worker

TOGETHER = 0.1  # seconds within which runs that end travel in one message
_LOOK = 0.25  # seconds between two looks at whether the pack is still wanted
_START = 300.0  # seconds for a seat to start, where a slow drive has to load all libraries
_TRIES = 3  # where a seat is killed as it starts
_END = 5.0  # seconds for a seat to end by itself
_SEAT_LOST = '["failed", "the process that started its process ended"]'
_ONE_THREAD = {
    name: "1"
    for name in (
        "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "NUMBA_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
    )
}  # fmt: skip
_ENTER = "import sys; sys.path[:] = {path!r}; from calibench.bench.workers.dask_seat import enter; enter({descriptor})"
_IDLE: dict[str, list[_Seat]] = {}  # queue -> the seats of this process that wait for work
_ALL: set[_Seat] = set()
_SPARE: list[_Seat] = []  # one that was forked while this process had no other thread
_LOCK = threading.Lock()


def do_flight(queue: str, flight: int, home: bytes, pack: bytes) -> None:
    """Do a pack; put messages into `queue`: {flight, begun, first, words, ended, refused}.

    `begun` says that a run may be at fault from here on; `words` are the seat's of runs, the first of them that
    ends being the pack's number `first`; `ended` is None, or "" at the end of the pack, or JSON of status and reason
    where the process was lost; `refused` says why this worker cannot.
    """
    stream = _Stream(queue, flight)
    seat, refused = _take(queue, home, pack, stream.is_wanted)
    if seat is None:
        stream.send(refused=refused)
        return
    ended: str | None = None
    try:
        stream.send(begun=True)  # who is lost from here on may be lost by a run
        seat.say(b"begin")
        while ended is None and stream.is_wanted():  # runs go home as they end
            for words in seat.words(stream.patience()):
                if words[:1] != b"T":
                    ended = words[1:].decode()
                    break
                stream.words += pickle.loads(words[1:])
            else:
                ended = _SEAT_LOST if seat.is_gone else None
                if ended is None and stream.words and stream.patience() == 0.0:
                    stream.send()
    except BaseException:
        seat.close()
        raise
    if ended is None:
        seat.close()
        return
    with _LOCK:
        _IDLE.setdefault(queue, []).append(seat)
    stream.send(ended=ended)


def close_seats(queue: str) -> None:
    with _LOCK:
        seats = _IDLE.pop(queue, [])
    for seat in seats:
        seat.close()


@final
class _Stream:
    """The way home of the runs of one pack."""

    def __init__(self, queue: str, flight: int) -> None:
        self._worker: Any = get_worker()
        self._key = self._worker.get_current_task()
        self._queue, self._flight = queue, flight
        self.words: list[bytes] = []
        self._first = 0
        self._sent = monotonic()

    def patience(self) -> float:
        return max(0.0, self._sent + TOGETHER - monotonic()) if self.words else _LOOK

    def send(self, ended: str | None = None, refused: str = "", begun: bool = False) -> None:
        """Put what there is into the queue; returns when the scheduler has it."""
        message = {
            "flight": self._flight, "begun": begun, "first": self._first, "words": self.words, "ended": ended,
            "refused": refused,
        }  # fmt: skip
        self._first += sum(words[:1] == b"R" for words in self.words)
        self.words = []
        put = self._worker.scheduler.queue_put(name=self._queue, data=message, timeout=None)
        on_its_way = asyncio.run_coroutine_threadsafe(put, self._worker.loop.asyncio_loop)
        while True:
            try:
                on_its_way.result(_LOOK)
                break
            except TimeoutError:  # the queue is full
                if on_its_way.done():
                    raise
                if not self.is_wanted():
                    on_its_way.cancel()
                    break
        self._sent = monotonic()

    def is_wanted(self) -> bool:
        """Tell whether the scheduler still wants this task: not where the sweep was stopped, or its process is gone."""
        task = self._worker.state.tasks.get(self._key)
        return task is not None and task.state in ("executing", "long-running")


@final
class _Seat:
    """A seat, as its worker sees it: a fresh process, or a fork, of a worker without other threads, with all loaded."""

    def __init__(self, fork: bool = False) -> None:
        self._code: Callable[[], int | None]
        if fork:
            from calibench.bench.gate.processes import Child  # not into the workers of a site
            from calibench.bench.workers.dask_seat import sit

            child = Child(sit)
            child.start()
            process: Any = child.process
            self._connection = child.connection
            self._code, self._wait, self._kill = lambda: process.exitcode, process.join, process.kill
        else:
            ours, theirs = socket.socketpair()
            enter = _ENTER.format(path=sys.path, descriptor=theirs.fileno())
            fresh = subprocess.Popen(
                [sys.executable, "-P", "-c", enter], env={**os.environ, **_ONE_THREAD}, pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL, process_group=0,
            )  # fmt: skip
            theirs.close()
            self._connection = Connection(ours.detach())
            self._code, self._wait, self._kill = fresh.poll, fresh.wait, fresh.kill
        self._hanging_up = threading.Lock()
        self._hung_up = False
        with _LOCK:
            _ALL.add(self)

    @property
    def is_gone(self) -> bool:
        return self._hung_up or self._code() is not None

    def say(self, words: bytes) -> bool:
        with suppress(OSError):
            self._connection.send_bytes(words)
            return True
        return False

    def words(self, patience: float) -> list[bytes]:
        """Return what it has said, after waiting for the first for so many seconds."""
        words = []
        try:
            while self._connection.poll(patience):
                words.append(self._connection.recv_bytes())
                patience = 0.0
        except (EOFError, OSError):
            self._hung_up = True
        return words

    def close(self) -> int:
        """Let it end its child and go; end it where it does not. Return its exit code, below 0 that of a signal."""
        with self._hanging_up:  # its pack's thread and the one that ends the worker may both close it
            self._connection.close()
        with suppress(subprocess.TimeoutExpired):
            self._wait(_END)
        if self._code() is None:
            self._kill()
            self._wait()
        with _LOCK:
            _ALL.discard(self)
        return self._code() or 0


def _take(queue: str, home: bytes, pack: bytes, is_wanted: Callable[[], bool]) -> tuple[_Seat | None, str]:
    """Return a seat that can begin with the pack, waiting or new; None and the reason where it refused."""
    code = 0
    for _ in range(_TRIES):
        seat: _Seat | None = None
        while seat is None or seat.is_gone:  # one of this process that waits for work, or a new one
            if seat is not None:
                seat.close()
            with _LOCK:
                seats = _IDLE.get(queue, [])
                seat = seats.pop() if seats else None
                spare = _SPARE.pop() if _SPARE and seat is None else None
            if seat is None:
                seat = spare or _Seat()
                seat.say(home)
                break
        seat.say(pack)
        end = monotonic() + _START
        answers: list[bytes] = []
        while b"B" not in answers and not seat.is_gone and is_wanted() and monotonic() < end:
            answers += seat.words(_LOOK)
            refusal = next((words for words in answers if words[:1] == b"X"), None)
            if refusal is not None:
                seat.close()
                return None, refusal[1:].decode()
        if b"B" in answers:
            return seat, ""
        code = seat.close()
        if not is_wanted():
            break
    return None, f"the process that starts its runs ends before it begins, with {code}"


def serve(parent: Connection) -> None:
    """Be a worker of the scheduler whose address, and folder for files, `parent` sends; end where it hangs up."""
    _SPARE.append(_Seat(fork=True))
    address, scratch = parent.recv()
    logging.disable(logging.CRITICAL)  # what matters is told by what happens to the runs
    dask.config.set({"distributed.worker.profile.enabled": False})  # it looks a hundred times a second
    threading.Thread(target=_end, args=(parent,), daemon=True).start()
    with suppress(Exception):  # the scheduler is gone, say
        asyncio.run(_serve(address, scratch))
    _end()


async def _serve(address: str, scratch: str) -> None:
    async with Worker(
        address, nthreads=1, memory_limit="0", dashboard=False, local_directory=scratch, host="127.0.0.1"
    ) as worker:
        await worker.finished()


def _end(parent: Connection | None = None) -> None:
    """End all seats of this process, and the process: now, or when the `parent` is gone or wants us no more."""
    if parent is not None:
        with suppress(EOFError, OSError):
            parent.recv_bytes()
    with _LOCK:
        seats = list(_ALL)
    for seat in seats:
        seat.close()
    os._exit(0)
