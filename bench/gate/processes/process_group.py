"""A worker process and all that it starts: one family, which ends as a whole.

``become_worker(parent)`` is the first thing that a child does: it leads a process group of its own, the system kills it
when its parent ends (also where it is stuck in C and no thread of Python runs), and what its descendants leave behind
becomes its own child, so that nobody gets lost. ``end_family(pid)`` is what a parent does to end it: the worker,
its group, and those descendants that have left the group.

The death signal and the adoption are Linux's (prctl); elsewhere the group alone is there. The signal is sent when the
*thread* that made the worker ends, so that thread must live as long as the worker. What a worker that dies by itself
leaves is found by its group; a daemon of its own session survives it.
"""

from __future__ import annotations

import ctypes
import os
import platform
import signal
import sys
from collections.abc import Container, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

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
