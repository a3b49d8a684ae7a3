"""A forked child: for work that may take its process down with it, or that has to be ended from outside.

It costs a fork and nothing a call. The child ends with its parent, also where that is killed, and what the child has
started ends with the child (`bench.gate.processes.process_group`).
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar, final

from calibench.bench.gate.frames import frames_of, text_of
from calibench.bench.gate.processes.child_messages import Receiver, Sender
from calibench.bench.gate.processes.process_group import become_worker, end_family, end_own_children, exit_of, prepare
from calibench.core.process_state import OWN_THREAD

T = TypeVar("T")
CAN_FORK = "fork" in multiprocessing.get_all_start_methods()
Work = Callable[[Any], None]  # of the child's `Sender`


@contextmanager
def forked(work: Work) -> Iterator[tuple[BaseProcess, Receiver]]:
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
            good, told = ours.recv()
        except EOFError:
            good, told = False, None
    if told is None and not good:
        raise Lost("ProcessDied", f"its process ended with {exit_of(child.exitcode)}")
    if not good:
        raise Lost(*told)
    result: T = told
    return result


def flush_output() -> None:
    """Write out what was printed here, also by libraries in C; what a run has made of its streams is passed over."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):
            stream.flush()
    with suppress(Exception):
        ctypes.CDLL(None).fflush(None)


def _in_child(work: Work, theirs: int, ours: int, parent_pipe: int, held: int, parent: int) -> None:
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
