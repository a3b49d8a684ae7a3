"""A run that goes on where it was killed: the gate answers from the values of before until these are used up.

Whatever library searches, it is begun again from its seed and asks the same points; each is compared by its digest.
Written down is each answer that took `DEAR` seconds or more an evaluation; others are asked for again. After `FIRST`
cheap ones in a row the gate asks the problem as if there were no replay, until `look` finds it slow. The file has a
record a line: the CRC-32 of what follows, and that, JSON. A torn last line is cut off. The first says which run by
which code it is; a file of another, or of another process, is not used.
"""

from __future__ import annotations

import json
import os
import time
from base64 import b64decode, b64encode
from collections.abc import Callable
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from threading import Lock, get_ident
from time import perf_counter, process_time
from typing import Any, NamedTuple, final
from zlib import crc32

import numpy as np

from calibench.bench.gate.calls import Calls, raise_again
from calibench.bench.gate.evaluator import Evaluator
from calibench.problems.base import Array

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]
VERSION = 2
_PATIENCE = 2.0  # seconds for the rest of a killed run to be gone
_FLAGS = os.O_RDWR | os.O_APPEND | getattr(os, "O_BINARY", 0)


class Record(NamedTuple):
    """What was asked (`kind`, `point`: a digest), the place among the run's calls, the answer, and the time so far.

    `noise` is the state of the generator after the call, of a problem that has one.
    """

    kind: str
    place: int
    point: str
    answer: Any
    wall_s: float
    cpu_s: float
    noise: dict[str, Any] | None = None


@final
class ReplayFile:
    """The records of a run in `path`, to be answered from (`next`) and then added to. Nothing is written before `add`.

    `usable` is False where another process has the file, or where it cannot be written: then it is left alone.
    """

    def __init__(self, path: Path | str, run_id: str, code: str) -> None:
        self._path, self._names = path, _line({"replay": VERSION, "run_id": run_id, "code": code})
        self._fd: int | None = None
        self._known: list[tuple[int, int, int]] = []  # place, offset and length of each record
        self._at = self._end = 0  # records that have been answered; bytes of the file
        self._next: Record | None = None
        self.usable = False
        try:
            self._fd = fd = os.open(path, _FLAGS)
        except OSError as error:
            self.usable = isinstance(error, FileNotFoundError)
            return
        end = time.monotonic() + _PATIENCE
        while not (ours := _locked(fd)) and time.monotonic() < end:
            time.sleep(0.01)
        with suppress(OSError):
            if ours and os.path.samestat(os.fstat(fd), os.stat(path)):  # who had it before may have deleted it
                self._learn(fd)
                self.usable = True
        if not self.usable:
            self.close()

    def _learn(self, fd: int) -> None:
        """Learn which places are known, and cut off what is torn, or of another run or code."""
        with open(fd, "rb", closefd=False) as file:
            for line in file:
                content = _content(line)
                if content is None or (self._end == 0 and line != self._names):
                    break
                if self._end:
                    self._known.append((content[1], self._end, len(line)))
                self._end += len(line)
        os.ftruncate(fd, self._end)

    @property
    def next(self) -> Record | None:
        """Return the first record that has not been passed; None where there is none left."""
        if self._next is None and self._at < len(self._known) and self._fd is not None:
            _, offset, length = self._known[self._at]
            os.lseek(self._fd, offset, os.SEEK_SET)
            known = Record(*_content(os.read(self._fd, length)))
            self._next = known._replace(answer=answer_of(known.answer))
        return self._next

    def passed(self) -> None:
        self._next = None
        self._at += 1

    def known(self, place: int, count: int) -> int:
        """Return how many of the calls from `place` on, one place each, are known without a gap; at most `count`."""
        there = self._known[self._at : self._at + count]
        return next((i for i, (known, _, _) in enumerate(there) if known != place + i), len(there))

    def add(self, record: Record) -> None:
        """Write a record at the end. Raises `OSError` where it cannot: the file is then whole as it was before."""
        if self._fd is None:
            os.makedirs(os.path.dirname(self._path), exist_ok=True)
            self._fd = os.open(self._path, _FLAGS | os.O_CREAT, 0o666)
            if not _locked(self._fd) or os.fstat(self._fd).st_size:
                self.close()
                raise OSError(f"{self._path}: another process has begun it")
        line = (b"" if self._end else self._names) + _line(record._replace(answer=written(record.answer)))
        if os.write(self._fd, line) < len(line):
            os.ftruncate(self._fd, self._end)
            raise OSError(f"{self._path}: no room for a record")
        self._end += len(line)

    def clear(self) -> None:
        self._known, self._at, self._next, self._end = [], 0, None, 0
        if self._fd is not None:
            with suppress(OSError):
                os.ftruncate(self._fd, 0)

    def close(self) -> None:
        """Let the file go; it stays on the disk."""
        if self._fd is not None:
            with suppress(OSError):
                os.close(self._fd)
        self._fd = None


def _line(content: Any) -> bytes:
    text = json.dumps(content).encode()
    return b"%08x %b\n" % (crc32(text), text)


def _content(line: bytes) -> Any:
    """Return what a line holds; None where it is not whole."""
    text = line[9:-1]
    return json.loads(text) if line == b"%08x %b\n" % (crc32(text), text) else None


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


def written(answer: float | Array) -> Any:
    """Return an answer for JSON: of an array its shape, whether it lies in columns (BLAS sums otherwise), its bytes."""
    if not isinstance(answer, np.ndarray):
        return float(answer)
    by_columns = answer.flags.f_contiguous and not answer.flags.c_contiguous
    values = answer.T if by_columns else answer
    return values.shape, by_columns, b64encode(values.astype("<f8").tobytes()).decode()


def answer_of(given: Any) -> float | Array:
    """Return the answer that `written` wrote."""
    if isinstance(given, float):
        return given
    shape, by_columns, text = given
    values = np.frombuffer(bytearray(b64decode(text)), dtype="<f8").reshape(shape)
    return values.T if by_columns else values


DEAR = 0.02  # seconds an evaluation from which on its value is worth a record, which takes about 1e-4
FIRST = 3  # cheap calls in a row
_BATCH = "a batch"


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
        self._dear = 0.0 if always else DEAR
        self._processes, self._limit, self._noise = processes, limit, noise
        self._began, self._cpu_began = perf_counter(), process_time()
        self._cheap = self._seen = 0  # cheap calls in a row; calls at the last look
        self._useless = False  # the file cannot be written, or not be answered from
        self._thread: int | None = None
        self._noting = Lock()  # a second thread gives up while the first may be writing
        self.differs: ReplayDiffers | None = None
        self._ours = Calls(
            value=lambda x, _: self._through("a value", calls.one, x), fixed=calls.fixed, again=raise_again,
            batch=calls.batch and (lambda points: self._through(_BATCH, calls.batch, points)),
            below=calls.below and (lambda points, limits: self._through(_BATCH, calls.below, points, limits)),
            residuals=calls.residuals and (lambda x: self._through("residuals", calls.residuals, x)),
            jacobian=calls.jacobian and (lambda x: self._through("a Jacobian", calls.jacobian, x)),
            gradient=calls.gradient and (lambda x: self._through("a gradient", calls.gradient, x)),
            joint=calls.joint and (lambda x: self._through("a value and its gradient", calls.joint, x)),
            ahead=calls.ahead and self._ahead,
        )  # fmt: skip
        gate.ask(self._ours)

    def look(self) -> None:
        """Have calls timed again where few were made since the last look; to be called once a second by a thread."""
        made = self._place()
        if made - self._seen < self._processes / DEAR and not self._useless:
            self._cheap = 0
            self._gate.ask(self._ours)
        self._seen = made

    def _ahead(self, points: Array) -> None:
        """Have those points computed ahead whose values are not known."""
        known = self._file.known(self._place() + 1, len(points))
        if known < len(points):
            self._bare.ahead(points[known:])

    def _place(self) -> int:
        return self._gate.evaluations + self._gate.jacobian_evaluations  # each call raises one of the two, or both

    def _through(self, kind: str, ask: Callable[..., Any], *given: Array) -> Any:
        """Return the answer to what is `given`: the one of before, or else what ``ask(*given)`` returns."""
        if self.differs is not None:
            raise self.differs
        if self._thread is None:
            self._thread = get_ident()
        if self._thread != get_ident():  # the order of calls cannot be repeated
            with self._noting:
                self._give_up()
                self._file.clear()
            return ask(*given)
        place, known = self._place(), self._file.next
        if known is not None and known.place <= place:
            if (known.place, known.kind, known.point) != (place, kind, _digest(given)):
                self.differs = ReplayDiffers(
                    f"evaluation {place} after a kill: the optimiser or its library asks for {kind} at another point "
                    f"than before (then {known.kind}, evaluation {known.place}); same versions? does it draw from rng "
                    "alone, and the objective depend on x alone?"
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
        began = perf_counter()
        answer = ask(*given)
        each = (perf_counter() - began) * self._processes / (len(given[0]) if kind == _BATCH else 1)
        with self._noting:
            if known is None and not self._useless:
                self._note(kind, place, given, answer, each)
        return answer

    def _note(self, kind: str, place: int, given: tuple[Array, ...], answer: Any, each: float) -> None:
        """Write an answer to the file if it was dear: it took `each` seconds an evaluation."""
        if each < self._dear:
            self._cheap += 1
            if self._cheap >= FIRST:
                self._gate.ask(self._bare)
            return
        self._cheap, self._dear = 0, min(self._dear, DEAR / 4)  # of a run that is written no value is left out lightly
        wall, cpu = self._gate.earlier
        wall, cpu = wall + perf_counter() - self._began, cpu + process_time() - self._cpu_began
        noise = None if self._noise is None else dict(self._noise.bit_generator.state)
        try:
            self._file.add(Record(kind, place, _digest(given), answer, wall, cpu, noise))
        except OSError:  # no room, say: the run goes on, and what is whole so far is of use after a kill
            self._give_up()

    def _give_up(self) -> None:
        self._useless = True
        self._gate.ask(self._bare)


def _digest(given: tuple[Array, ...]) -> str:
    digest = blake2b(digest_size=16)
    for array in given:
        values = np.ascontiguousarray(array, dtype=np.float64)
        digest.update(repr(values.shape).encode() + values.tobytes())
    return digest.hexdigest()
