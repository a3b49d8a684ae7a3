"""A forked child: for work that may take its process down with it, or that has to be ended from outside.

It costs a fork and nothing a call. The child ends with its parent, also where that is killed: it holds the reading end
of a pipe that only the parent can close.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

CAN_FORK = "fork" in multiprocessing.get_all_start_methods()
Work = Callable[[Connection], None]


@contextmanager
def forked(work: Work) -> Iterator[tuple[BaseProcess, Connection]]:
    """Yield a child that does ``work(theirs)``, and our end of the connection; at the end of the block it is killed.

    The connection ends (`EOFError`) when the child does: with code 0 after its work, with 1 where that raised.
    """
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    leash, held = os.pipe()
    child = context.Process(target=_in_child, args=(work, theirs, ours, leash, held))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # forking beside threads: the child uses none of them
        child.start()
    theirs.close()
    os.close(leash)
    try:
        yield child, ours
    finally:
        child.kill()  # it has answered, or never will
        child.join()
        ours.close()
        os.close(held)


def _in_child(work: Work, theirs: Connection, ours: Connection, leash: int, held: int) -> None:
    ours.close()
    os.close(held)
    threading.Thread(target=_follow, args=(leash,), daemon=True).start()
    try:
        work(theirs)
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        os._exit(1)
    os._exit(0)  # without the parent's exit handlers


def _follow(leash: int) -> None:
    """Wait until the parent is gone; then go."""
    os.read(leash, 1)
    os._exit(1)
