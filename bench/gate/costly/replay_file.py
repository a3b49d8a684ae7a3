"""The file of one run's values: appended to as they come, read from its beginning after a kill.

Each record is its length, the CRC-32 of what follows, and that; one ``os.write`` a record, so that a process killed by
signal 9 loses at most the evaluation in flight. A last record that is torn is cut off. The first record says which run
by which code it is; a file that says otherwise is not used. While a process has the file, others leave it alone.
"""

from __future__ import annotations

import json
import os
import struct
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

Array = NDArray[np.float64]
VERSION = 1
_PATIENCE = 2.0  # seconds for the rest of a killed run to be gone
_FRAME = struct.Struct("<II")
_HEAD = struct.Struct("<Bq16sddI")  # kind, place, digest of the point, wall and processor seconds so far, noise length
_SPREAD = 16  # a view that spreads over more than this many times its size is kept without its gaps


@final
@dataclass(frozen=True)
class Record:
    """What was asked (`kind`, `point`: a digest), the place among the run's calls, the answer, and the time so far.

    `answer` is a float or an array of any shape and layout. `noise` is the state of the generator after the call, of a
    problem that has one.
    """

    kind: int
    place: int
    point: bytes
    answer: float | Array
    wall_s: float
    cpu_s: float
    noise: dict[str, Any] | None = None

    def packed(self) -> bytes:
        """Return the record as bytes."""
        noise = b"" if self.noise is None else json.dumps(self.noise).encode()
        head = _HEAD.pack(self.kind, self.place, self.point, self.wall_s, self.cpu_s, len(noise))
        return head + noise + _packed(self.answer)

    @staticmethod
    def unpacked(raw: bytes) -> Record:
        """Return the record that was packed as `raw`."""
        kind, place, point, wall_s, cpu_s, length = _HEAD.unpack_from(raw)
        rest = raw[_HEAD.size :]
        noise = json.loads(rest[:length]) if length else None
        return Record(kind, place, point, _unpacked(rest[length:]), wall_s, cpu_s, noise)


@final
class ReplayFile:
    """The records of a run in `path`, to be answered from (`next`) and then added to. Nothing is written before `add`.

    `usable` is False where another process has the file, or where it cannot be written: then it is left alone.
    """

    def __init__(self, path: Path | str, run_id: str, code: str) -> None:
        self._path, self._names = path, {"replay": VERSION, "run_id": run_id, "code": code}
        self._fd: int | None = None
        self._places: list[int] = []
        self._at = 0  # of the places: those before it have been answered
        self._offset = self._end = 0
        self._next: Record | None = None
        self.usable = True
        try:
            fd = os.open(path, os.O_RDWR | os.O_APPEND | getattr(os, "O_BINARY", 0))
        except FileNotFoundError:
            return
        except OSError:
            self.usable = False
            return
        self._hold(fd)

    @property
    def next(self) -> Record | None:
        """Return the first record that has not been passed; None where there is none left."""
        if self._next is None and self._at < len(self._places):
            assert self._fd is not None
            raw, self._offset = _read(self._fd, self._offset, self._end)
            assert raw is not None
            self._next = Record.unpacked(raw)
        return self._next

    def passed(self) -> None:
        """Go on to the record after `next`."""
        self._next = None
        self._at += 1

    def known(self, place: int, count: int) -> int:
        """Return how many of the calls from `place` on, one place each, are known without a gap; at most `count`."""
        found = 0
        while (
            found < count and self._at + found < len(self._places) and self._places[self._at + found] == place + found
        ):
            found += 1
        return found

    def add(self, record: Record) -> None:
        """Write a record at the end. Raises `OSError` where it cannot: the file is then whole as it was before."""
        self._write(_framed(record.packed()))

    def clear(self) -> None:
        """Forget all records, on the disk too."""
        self._places, self._at, self._next, self._end = [], 0, None, 0
        if self._fd is not None:
            with suppress(OSError):
                os.ftruncate(self._fd, 0)

    def close(self) -> None:
        """Let the file go; it stays on the disk."""
        if self._fd is not None:
            with suppress(OSError):
                os.close(self._fd)
        self._fd = None

    def _hold(self, fd: int) -> None:
        """Take the file, cut off what is torn, and learn which places are known."""
        end = time.monotonic() + _PATIENCE
        while not (ours := _locked(fd)) and time.monotonic() < end:
            time.sleep(0.01)
        if not ours or not _stands(fd, self._path):
            os.close(fd)
            self.usable = False
            return
        self._fd = fd
        size = os.fstat(fd).st_size
        head, start = _read(fd, 0, size)
        if head is None or head != json.dumps(self._names).encode():
            with suppress(OSError):
                os.ftruncate(fd, 0)
            self.usable = os.fstat(fd).st_size == 0
            return
        offset = start
        while True:
            raw, after = _read(fd, offset, size)
            if raw is None or len(raw) < _HEAD.size:
                break
            self._places.append(_HEAD.unpack_from(raw)[1])
            offset = after
        if offset < size:
            try:
                os.ftruncate(fd, offset)
            except OSError:
                self.usable = False
        self._offset, self._end = start, offset

    def _write(self, framed: bytes) -> None:
        if self._fd is None:
            os.makedirs(os.path.dirname(self._path), exist_ok=True)
            flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | getattr(os, "O_BINARY", 0)
            fd = os.open(self._path, flags, 0o666)
            if not _locked(fd) or os.fstat(fd).st_size:
                os.close(fd)
                raise OSError(f"{self._path}: another process has begun it")
            self._fd = fd
        if not self._end:
            framed = _framed(json.dumps(self._names).encode()) + framed
        written = os.write(self._fd, framed)
        if written < len(framed):
            os.ftruncate(self._fd, self._end)
            raise OSError(f"{self._path}: no room for a record")
        self._end += written


def copied(answer: float | Array) -> float | Array:
    """Return an answer that nobody else can write to, with the same layout in memory."""
    return _unpacked(_packed(answer)) if isinstance(answer, np.ndarray) else answer


def _framed(payload: bytes) -> bytes:
    return _FRAME.pack(len(payload), crc32(payload)) + payload


def _read(fd: int, offset: int, end: int) -> tuple[bytes | None, int]:
    """Return the record at `offset` and where the next one is; None where no whole one is."""
    if offset + _FRAME.size > end:
        return None, offset
    os.lseek(fd, offset, os.SEEK_SET)
    length, crc = _FRAME.unpack(_bytes(fd, _FRAME.size))
    after = offset + _FRAME.size + length
    if after > end:
        return None, offset
    payload = _bytes(fd, length)
    return (payload, after) if crc32(payload) == crc else (None, offset)


def _bytes(fd: int, size: int) -> bytes:
    parts = []
    while size:
        part = os.read(fd, size)
        if not part:
            raise OSError("the file has become shorter")
        parts.append(part)
        size -= len(part)
    return b"".join(parts)


def _locked(fd: int) -> bool:
    """Tell whether the file is ours now. The lock is this process's alone: none that it forks holds it."""
    if fcntl is None:
        return True
    try:
        fcntl.lockf(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # a file system without locks
        return True
    return True


def _stands(fd: int, path: Path | str) -> bool:
    """Tell whether `path` still is this file: who had it before may have deleted it."""
    try:
        return os.path.samestat(os.fstat(fd), os.stat(path))
    except OSError:
        return False


def _packed(answer: float | Array) -> bytes:
    if not isinstance(answer, np.ndarray):
        return struct.pack("<Bd", 255, answer)
    shape, strides = answer.shape, answer.strides
    span = 8 + sum(abs(s) * (n - 1) for n, s in zip(shape, strides, strict=True) if n)
    if not answer.size or span > _SPREAD * 8 * max(answer.size, 1) or any(s % 8 for s in strides):
        strides = np.empty(shape).strides
    head = struct.pack(f"<B{2 * len(shape)}q", len(shape), *shape, *strides)
    return head + np.ascontiguousarray(answer, dtype="<f8").tobytes()


def _unpacked(raw: bytes) -> float | Array:
    """Return the answer as it was, its layout in memory included: other strides, other last bits in BLAS."""
    dimensions = raw[0]
    if dimensions == 255:
        value: float = struct.unpack_from("<d", raw, 1)[0]
        return value
    numbers = struct.unpack_from(f"<{2 * dimensions}q", raw, 1)
    shape, strides = numbers[:dimensions], numbers[dimensions:]
    data = np.frombuffer(raw, dtype="<f8", offset=1 + 16 * dimensions).reshape(shape)
    if 0 in shape:
        return np.empty(shape)
    steps = [(n - 1) * s for n, s in zip(shape, strides, strict=True)]
    first = -sum(min(0, step) for step in steps)
    room = np.empty((first + sum(max(0, step) for step in steps)) // 8 + 1)
    answer: Array = np.ndarray(shape, np.float64, room.data, first, strides)
    answer[...] = data
    return answer
