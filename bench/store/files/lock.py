"""One process at a time rewrites the tables of a study: a lock file in its folder, on every system and file system.

The lock is the system's own (`filelock.FileLock`), which ends with the process that holds it. On a file system that has
none, such as some network drives, the lock is that a file exists (`filelock.SoftFileLock`). Beside it stands a note of
who holds it, for those that wait.
"""

from __future__ import annotations

import errno
import getpass
import logging
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import BaseFileLock, FileLock, SoftFileLock, Timeout

LOCK, SOFT_LOCK, HOLDER = ".lock", ".lock.soft", ".lock.holder"  # what stands in the folder of a study
_SOON = 5.0  # seconds after which a wait is logged
_AT_MOST = 600.0  # seconds; the tables of a hundred thousand runs are folded in less
_NO_LOCKS = {errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOLCK}  # what a file system without locks answers

_log = logging.getLogger(__name__)


class LockHeldError(ValueError):
    """Another process holds the lock for longer than we wait."""


@contextmanager
def locked(folder: Path, soon: float = _SOON, at_most: float = _AT_MOST) -> Iterator[None]:
    """Hold the lock of `folder`. A wait of `soon` seconds is logged; one of `at_most` raises `LockHeldError`."""
    lock = _acquired(folder, soon, at_most)
    holder = folder / HOLDER
    try:
        holder.write_text(_ourselves(), encoding="utf-8")
        yield
    finally:
        holder.unlink(missing_ok=True)
        lock.release()


def _acquired(folder: Path, soon: float, at_most: float) -> BaseFileLock:
    try:
        return _wait(FileLock(folder / LOCK), folder, soon, at_most)
    except NotImplementedError:  # what filelock makes of ENOSYS
        pass
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    return _wait(SoftFileLock(folder / SOFT_LOCK), folder, soon, at_most)


def _wait(lock: BaseFileLock, folder: Path, soon: float, at_most: float) -> BaseFileLock:
    first = min(soon, at_most)
    try:
        lock.acquire(timeout=first)
    except Timeout:
        _log.warning("%s: is held by %s; waiting", lock.lock_file, _holder(folder))
        try:
            lock.acquire(timeout=at_most - first)
        except Timeout:
            raise LockHeldError(
                f"{lock.lock_file}: has been held by {_holder(folder)} for {at_most:g} s; ask there, or end that "
                "process, then give the same command again: finished runs are kept"
            ) from None
    return lock


def _ourselves() -> str:
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container's user without a name
        user = "unknown"
    return f"process {os.getpid()} of {user} on {platform.node()}"


def _holder(folder: Path) -> str:
    try:
        return (folder / HOLDER).read_text(encoding="utf-8") or "another process"
    except OSError:
        return "another process"
