"""What runs print: a file for each worker of a sweep, beside its results, so that progress stays readable.

The standard output of a worker's process goes there, and with it that of all it starts and of libraries in C. After
each run that printed, a line says which one it was. Standard error stays where it is: warnings are to be seen. A sweep
of a single run prints where it did, on the terminal.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import final

from calibench.bench.execution.run_row import RunRow
from calibench.bench.gate.processes import flush_output
from calibench.bench.store.atomic_file import open_within

_FOLDER = "printed"
_MOST = 16 * 1024 * 1024  # bytes a worker keeps: after the run that goes beyond, nothing more is
_SIGN = b"-- printed by "
_LINE = 4096  # bytes from the end that hold the last line, where it is a signature
_STDOUT = 1  # the number of the file that every process writes its output to


def file_of(folder: Path, worker: str) -> Path:
    """Return the file of what a worker prints into the study in `folder`."""
    return folder / _FOLDER / f"{worker}.txt"


def files_in(folder: Path) -> set[Path]:
    """Return the files of the study in `folder` in which something is printed."""
    return {path for path in (folder / _FOLDER).glob("*.txt") if _size(path)}


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # another sweep in this folder has just deleted it
        return 0


def forget_empty(path: Path) -> None:
    """Delete the file of a worker that printed nothing, and the folder with the last of them."""
    with suppress(OSError):
        if not path.stat().st_size:
            path.unlink()
            path.parent.rmdir()


def _is_cut_off(path: Path) -> bool:
    """Tell whether what a process before this one has printed last is not signed."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _LINE))
        lines = file.read().splitlines()
    return bool(lines) and not lines[-1].startswith(_SIGN)


@contextmanager
def nothing_printed() -> Iterator[None]:
    """Let nothing be seen of what is printed in the block, by Python or by C: it is of no run."""
    flush_output()
    before = os.dup(_STDOUT)
    try:
        with open(os.devnull, "w", encoding="utf-8") as nowhere, redirect_stdout(nowhere):
            os.dup2(nowhere.fileno(), _STDOUT)
            yield
            flush_output()
    finally:
        os.dup2(before, _STDOUT)
        os.close(before)


@final
class Printed:
    """The file of this process's output, from now on; `signed` is to be called after each run."""

    def __init__(self, path: Path) -> None:
        self._file = open_within(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        if _is_cut_off(path):
            os.write(self._file, b"\n-- printed by a run whose process ended\n")
        self._size = os.fstat(self._file).st_size
        self._full = False
        os.dup2(self._file, _STDOUT)
        sys.stdout = open(  # noqa: SIM115 (it lasts as long as the process)
            _STDOUT, "w", buffering=1, encoding="utf-8", errors="backslashreplace", closefd=False
        )

    def signed(self, row: RunRow) -> None:
        """Say which run has printed what stands above, where one has."""
        flush_output()
        if self._full or os.fstat(self._file).st_size == self._size:
            return
        whose = f"run {row.run_id}, {row.optimizer} on {row.problem}, repetition {row.repetition}"
        os.write(self._file, _SIGN + f"{whose}\n".encode())
        self._size = os.fstat(self._file).st_size
        if self._size > _MOST:
            os.write(self._file, b"-- what this worker's later runs print is left out\n")
            self._full = True
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, _STDOUT)
            os.close(nowhere)
