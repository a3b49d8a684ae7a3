"""A child process that does what it is sent: started by a fork with a pipe, watched, and ended with its family.

It is the head of a family (`bench.gate.processes`) that ends with it, and with us. Whoever has such
children knows what is sent and told; this knows how one of them comes and goes. Where a system cannot fork it is
started anew.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import warnings
from collections.abc import Callable, Iterable
from contextlib import nullcontext, suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from time import monotonic
from typing import Any, final

from calibench.bench.gate.processes import CAN_FORK, become_worker, end_family, exit_of
from calibench.core.user_file import as_usual, safe_children

_PHASES = 5  # that have the time limit each: building, compiling, search; and of a run cut there building and judging
_LATE = 60.0  # seconds beyond all of them after which a run is ended with its process


@final
class Child:
    """A process that does ``work(connection, *given)``, or none before `start` and after `end`.

    `connection` is our end of its pipe. The work lasts until the pipe ends; `process_group.prepare` was called before.
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

    def told(self) -> list[bytes]:
        """Return what it has told since the last time, message by message."""
        found = []
        with suppress(EOFError, ConnectionError):  # it has died
            while self.connection.poll():
                found.append(self.connection.recv_bytes())
        return found

    def why_lost(self) -> tuple[str, str] | None:
        """Return status and reason for a run whose process has ended; None while it is there."""
        if self._process is None or self._process.exitcode is None:
            return None
        return "failed", f"its process ended with {exit_of(self._process.exitcode)}"

    def end(self) -> None:
        """End the process with all that it has started."""
        if self._process is None:
            return
        if self._process.pid is not None and not self.is_gone:
            end_family(self._process.pid)
            self._process.kill()
        elif self._process.pid is not None and CAN_FORK:
            with suppress(OSError):  # what it has left in its group
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.join()
        self.connection.close()
        self._process = None


def too_late(limit: float | None, heard: float) -> tuple[str, str] | None:
    """Return status and reason for a run of this time limit [s] that should have been told of long ago; None else.

    `heard` is when (`time.monotonic`) the last was heard of the process that does it.
    """
    if limit is None or monotonic() - heard <= _PHASES * limit + _LATE:
        return None
    return "timeout", "the time limit has passed outside the search, and nothing came back"


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
