"""A file that appears whole or not at all: written under a temporary name beside it, then renamed.

A process that is killed in between leaves its temporary file or folder. The name holds who wrote it, so that it can be
told from one that is being written: its process is gone from this machine, or it is too old to be anything but left.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

_OLD = 3600.0  # seconds: a file of ours is written in less
_ENDING = re.compile(r"\.(\d+)@(.*)\.tmp$")


def write_whole(path: Path, write: Callable[[BinaryIO], object]) -> Path:
    """Let `write` fill the file, bring it to the disk, then give it its name `path`; return that."""
    temporary = temporary_name(path)
    try:
        with open(temporary, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def temporary_name(path: Path) -> Path:
    """Return the name under which this process writes what will be `path`."""
    return path.with_name(f"{path.name}.{os.getpid()}@{platform.node()}.tmp")


def remove_stale(folder: Path) -> None:
    """Delete what killed processes left in `folder`; what may still be written stays."""
    for path in folder.glob("*.tmp"):
        writer = _ENDING.search(path.name)
        here = writer is not None and writer[2] == platform.node()
        try:
            gone = here and writer is not None and not is_alive(int(writer[1]))
            if gone or time.time() - path.stat().st_mtime > _OLD:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        except FileNotFoundError:  # it has just got its name
            continue


def is_alive(pid: int) -> bool:
    """Tell whether this machine has a process of this number."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it is another user's
        return True
    return True
