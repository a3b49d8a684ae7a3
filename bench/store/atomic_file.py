"""A file that appears whole or not at all: written under a temporary name beside it, then renamed.

A process that is killed in between leaves its temporary file or folder. The name holds who wrote it.
"""

import os
import platform
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

TEMPORARY = re.compile(r"\.(\d+)@(.*)\.tmp$")  # the process, and its machine


def write_whole(path: Path, content: bytes | Callable[[BinaryIO], object]) -> Path:
    """Write the content, or let it fill the file; bring it to the disk, then give it its name `path`; return that."""
    temporary = temporary_name(path)
    try:
        with open(temporary, "wb") as file:
            file.write(content) if isinstance(content, bytes) else content(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:  # a write that fails, of a file too large, names none
        if error.errno and not error.filename:
            error.filename = str(path)
        raise
    finally:
        with suppress(OSError):  # that of a folder which can no longer be written hides why
            temporary.unlink(missing_ok=True)
    return path


def temporary_name(path: Path) -> Path:
    """Return the name under which this process writes what will be `path`."""
    return path.with_name(f"{path.name}.{os.getpid()}@{platform.node()}.tmp")


def open_within(path: Path, flags: int) -> int:
    """Open a file, and make its folder where it is missing: others may delete that while it is empty."""
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            return os.open(path, flags, 0o644)
