"""A run that goes on where it was killed: the gate answers from the values of before until these are used up.

Whatever library searches, it is begun again from its seed and asks the same points; each is compared by its digest.
Written down are runs whose evaluations take `DEAR` seconds or more: the first `FIRST` calls are timed and held in
memory, and if none is dear the gate asks the problem as if there were no replay; `look` has calls timed again later.
The file has a record a value: its length, the CRC-32 of what follows, and that, one ``os.write`` a record. A torn last
record is cut off. The first says which run by which code it is; a file of another, or of another process, is not used.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from threading import Lock, get_ident
from time import perf_counter, process_time
from typing import Any, final
from zlib import crc32

import numpy as np

from calibench.bench.gate.calls import Calls
from calibench.bench.gate.evaluator import Evaluator
from calibench.problems.base import Array

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]
VERSION = 1
_PATIENCE = 2.0  # seconds for the rest of a killed run to be gone
_FRAME = struct.Struct("<II")
_HEAD = struct.Struct("<Bq16sddI")  # kind, place, digest of the point, wall and processor seconds so far, noise length
_SPREAD = 16  # a view that spreads over more than this many times its size is kept without its gaps


@final
@dataclass(frozen=True)
class Record:
    """What was asked (`kind`, `point`: a digest), the place among the run's calls, the answer, and the time so far.

    `noise` is the state of the generator after the call, of a problem that has one.
    """

    kind: int
    place: int
    point: bytes
    answer: float | Array
    wall_s: float
    cpu_s: float
    noise: dict[str, Any] | None = None

    def packed(self) -> bytes:
        noise = b"" if self.noise is None else json.dumps(self.noise).encode()
        head = _HEAD.pack(self.kind, self.place, self.point, self.wall_s, self.cpu_s, len(noise))
        return head + noise + _packed(self.answer)

    @staticmethod
    def unpacked(raw: bytes) -> Record:
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
        self._path, self._names = path, json.dumps({"replay": VERSION, "run_id": run_id, "code": code}).encode()
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

        # take the file; who had it before may have deleted it
        end = time.monotonic() + _PATIENCE
        while not (ours := _locked(fd)) and time.monotonic() < end:
            time.sleep(0.01)
        try:
            stands = os.path.samestat(os.fstat(fd), os.stat(path))
        except OSError:
            stands = False
        if not ours or not stands:
            os.close(fd)
            self.usable = False
            return
        self._fd = fd

        # learn which places are known, and cut off what is torn
        size = os.fstat(fd).st_size
        head, self._offset = _read(fd, 0, size)
        if head != self._names:
            with suppress(OSError):
                os.ftruncate(fd, 0)
            self.usable = os.fstat(fd).st_size == 0
            self._offset = 0
            return
        self._end = self._offset
        while True:
            raw, after = _read(fd, self._end, size)
            if raw is None or len(raw) < _HEAD.size:
                break
            self._places.append(_HEAD.unpack_from(raw)[1])
            self._end = after
        if self._end < size:
            try:
                os.ftruncate(fd, self._end)
            except OSError:
                self.usable = False

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
        self._next = None
        self._at += 1

    def known(self, place: int, count: int) -> int:
        """Return how many of the calls from `place` on, one place each, are known without a gap; at most `count`."""
        there = self._places[self._at : self._at + count]
        return next((i for i, known in enumerate(there) if known != place + i), len(there))

    def add(self, record: Record) -> None:
        """Write a record at the end. Raises `OSError` where it cannot: the file is then whole as it was before."""
        if self._fd is None:
            os.makedirs(os.path.dirname(self._path), exist_ok=True)
            flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | getattr(os, "O_BINARY", 0)
            fd = os.open(self._path, flags, 0o666)
            if not _locked(fd) or os.fstat(fd).st_size:
                os.close(fd)
                raise OSError(f"{self._path}: another process has begun it")
            self._fd = fd
        payloads = [record.packed()] if self._end else [self._names, record.packed()]
        framed = b"".join(_FRAME.pack(len(payload), crc32(payload)) + payload for payload in payloads)
        written = os.write(self._fd, framed)
        if written < len(framed):
            os.ftruncate(self._fd, self._end)
            raise OSError(f"{self._path}: no room for a record")
        self._end += written

    def clear(self) -> None:
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


DEAR = 0.02  # seconds an evaluation from which on its value is worth a record, which takes about 1e-4
FIRST = 3  # calls that are timed
_CHEAP, _WINDOW = DEAR / 4, 16  # mean of so many calls below which no more is written
_VALUE, _BATCH, _BELOW, _RESIDUALS, _JACOBIAN, _GRADIENT, _JOINT = range(7)
_NAMES = ("a value", "a batch", "a batch", "residuals", "a Jacobian", "a gradient", "a value and its gradient")


class ReplayDiffers(RuntimeError):
    """The optimiser asks another point than before it was killed."""


@final
class Replayed:
    """Let `gate` be answered from `file` first, then by `calls`, whose answers are added to it.

    `processes` evaluate at once. `limit` [s] is that of the run; `noise` the generator that a noisy problem draws from.
    """

    def __init__(
        self, gate: Evaluator, calls: Calls, file: ReplayFile, *, always: bool = False, processes: int = 1,
        limit: float | None = None, noise: np.random.Generator | None = None,
    ) -> None:  # fmt: skip
        self._gate, self._bare, self._file = gate, calls, file
        self._always, self._processes, self._limit, self._noise = always, processes, limit, noise
        self._began, self._cpu_began = perf_counter(), process_time()
        self._writing = always or file.next is not None
        self._held: list[tuple[int, int, tuple[Array, ...], Any, Any]] = []  # what is not written yet
        self._calls, self._took = 0, 0.0  # of the window
        self._armed = False
        self._useless = False  # the file cannot be written, or not be answered from
        self._thread: int | None = None
        self._noting = Lock()  # a second thread gives up while the first may be writing
        self._told: BaseException | None = None
        self.differs: ReplayDiffers | None = None
        self._seen, self._wait, self._patience = -1, 0, 1
        self._ours = Calls(
            value=self._value, fixed=calls.fixed, again=self._again,
            batch=calls.batch and (lambda points: self._through(_BATCH, calls.batch, points)),
            below=calls.below and (lambda points, limits: self._through(_BELOW, calls.below, points, limits)),
            residuals=calls.residuals and (lambda x: self._through(_RESIDUALS, calls.residuals, x)),
            jacobian=calls.jacobian and (lambda x: self._through(_JACOBIAN, calls.jacobian, x)),
            gradient=calls.gradient and (lambda x: self._through(_GRADIENT, calls.gradient, x)),
            joint=calls.joint and (lambda x: self._through(_JOINT, calls.joint, x)),
            ahead=calls.ahead and self._ahead,
        )  # fmt: skip

    def arm(self) -> None:
        self._armed = True
        self._gate.ask(self._ours)

    def look(self) -> None:
        """Check, once a second from another thread, whether evaluations have become costly, and time them again."""
        if self._armed or self._useless:
            return
        made = self._gate.evaluations + self._gate.jacobian_evaluations
        slow = made - self._seen < self._processes / DEAR
        self._seen = made
        self._wait -= 1
        if slow and self._wait < 0:
            self._patience = self._wait = min(2 * self._patience, 64)  # an optimiser may be what is slow
            self.arm()

    def _value(self, x: Array, _fixed: Any) -> float:
        try:
            value: float = self._through(_VALUE, self._bare.one, x)
        except BaseException as error:
            self._told = error
            raise
        return value

    def _again(self, x: Array) -> float:
        """Raise our own exceptions; repeat the call as without us where the problem failed before we were armed."""
        if sys.exception() is self._told:
            raise
        value: float = self._bare.again(x)
        return value

    def _ahead(self, points: Array) -> None:
        """Have those points computed ahead whose values are not known."""
        known = self._file.known(self._place() + 1, len(points))
        if known < len(points):
            self._bare.ahead(points[known:])

    def _place(self) -> int:
        return self._gate.evaluations + self._gate.jacobian_evaluations  # each call raises one of the two, or both

    def _through(self, kind: int, ask: Callable[..., Any], *given: Array) -> Any:
        """Return the answer to what is `given`: the one of before, or else what ``ask(*given)`` returns."""
        if self.differs is not None:
            raise self.differs
        if self._thread is None:
            self._thread = get_ident()
        if self._thread != get_ident():  # the order of calls cannot be repeated
            with self._noting:
                self._useless = True
                self._off()
                self._file.clear()
            return ask(*given)
        place, known = self._place(), self._file.next
        if known is not None and known.place <= place:
            if (known.place, known.kind, known.point) != (place, kind, _digest(given)):
                self.differs = ReplayDiffers(
                    f"evaluation {place} after a kill: the optimiser or its library asks for {_NAMES[kind]} at another "
                    f"point than before (then {_NAMES[known.kind]}, evaluation {known.place}); same versions? does it "
                    "draw from rng alone, and the objective depend on x alone?"
                )
                raise self.differs
            self._file.passed()
            now, cpu = perf_counter(), process_time()
            self._gate.earlier = known.wall_s - (now - self._began), known.cpu_s - (cpu - self._cpu_began)
            if self._limit is not None:
                self._gate.deadline = now + self._limit - known.wall_s
            self._gate.bring_news()
            if self._noise is not None and known.noise is not None:
                self._noise.bit_generator.state = known.noise
            return known.answer
        if not self._armed:  # a batch that was begun before we were switched off
            self._gate.ask(self._bare)
            return ask(*given)
        began = perf_counter()
        answer = ask(*given)
        took = perf_counter() - began
        with self._noting:
            if known is None and not self._useless:
                self._note(kind, place, given, answer, took)
        return answer

    def _note(self, kind: int, place: int, given: tuple[Array, ...], answer: Any, took: float) -> None:
        """Write an answer to the file, hold it in memory, or switch ourselves off, depending on its time."""
        each = took * self._processes / (len(given[0]) if kind in (_BATCH, _BELOW) else 1)
        state = None if self._noise is None else dict(self._noise.bit_generator.state)
        if not (self._writing or each >= DEAR):  # it is held, and the optimiser may write to either
            if isinstance(answer, np.ndarray):
                answer = _unpacked(_packed(answer))  # which nobody else can write to, of the same layout in memory
            self._held.append((kind, place, tuple(map(np.array, given)), answer, state))
            if len(self._held) >= FIRST:
                self._off()
            return
        self._writing = True
        self._held.append((kind, place, given, answer, state))
        wall, cpu = self._gate.earlier
        wall, cpu = wall + perf_counter() - self._began, cpu + process_time() - self._cpu_began
        try:
            for held_kind, held_place, asked, value, noise in self._held:
                self._file.add(Record(held_kind, held_place, _digest(asked), value, wall, cpu, noise))
        except OSError:  # no room, say: the run goes on, and what is whole so far is of use after a kill
            self._useless = True
            self._off()
        self._held = []
        if self._writing and not self._always:
            self._calls, self._took = self._calls + 1, self._took + each
            if self._calls == _WINDOW:
                if self._took < _CHEAP * _WINDOW:
                    self._off()
                self._calls, self._took = 0, 0.0

    def _off(self) -> None:
        self._writing, self._held = False, []
        self._seen = self._place()
        self._gate.ask(self._bare)
        self._armed = False  # last, for `look`


def _digest(given: tuple[Array, ...]) -> bytes:
    digest = blake2b(digest_size=16)
    for array in given:
        values = np.ascontiguousarray(array, dtype=np.float64)
        digest.update(repr(values.shape).encode() + values.tobytes())
    return digest.digest()
