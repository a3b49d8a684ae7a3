"""A journal: the finished runs of one writer, appended a line each, until they are collected into the tables.

A line is checksummed and ends with a newline. So a kill costs the line that was being written and no other, and a line
that was damaged later is noticed and costs that run alone. A line is, with tabs between::

    CRC32  H  {header}                                          who writes, and the columns that all its rows share
    CRC32  R  run_id  status  code_digest  [row]  [trace]       a finished run, its values in the order of the columns
    CRC32  E                                                    no more comes

Values are JSON, in which a double is written so that the same bits are read, with the words NaN and Infinity.
"""

from __future__ import annotations

import json
import os
import platform
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING, Any, NamedTuple, final
from zlib import crc32

import numpy as np

from calibench.bench.execution.run_row import COLUMNS, SCHEMA_VERSION
from calibench.bench.provenance.environment import provenance

if TYPE_CHECKING:
    from calibench.bench.execution.run import Run

try:
    import fcntl
except ImportError:  # Windows, where an open file cannot be deleted
    fcntl = None  # type: ignore[assignment]

FOLDER, ENDING = "journal", ".journal"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_TIMES = frozenset(column.name for column in COLUMNS if column.parquet.startswith("timestamp"))
_HEADER_EVERY = 256  # records between two copies of the header: one that is damaged is not missed
_SYNC_EVERY = 2.0  # seconds between two orders to bring what was written to the disk
_TRIES, _WAIT = 50, 0.02  # to get the lock of a journal of one's own: it is looked at for a moment
_LAST = 16 << 20  # bytes at the end of a journal in which its last run is looked for
_ABANDONED = 86_400.0  # seconds without a word after which the writer on another machine is taken to be gone


@final
@dataclass(frozen=True)
class Record:
    """A finished run as a journal holds it; `row` and `trace` are read from JSON when they are asked for."""

    run_id: str
    status: str
    code_digest: str
    names: tuple[str, ...]  # of the columns in the line
    common: Mapping[str, Any]  # the other columns
    _row: bytes
    _trace: bytes

    @property
    def size(self) -> int:
        """Return the bytes of the line."""
        return len(self._row) + len(self._trace)

    def row(self) -> dict[str, Any]:
        """Return the row by the names of its columns; times are microseconds since 1970, UTC."""
        return {**self.common, **dict(zip(self.names, self.values(), strict=True))}

    def values(self) -> list[Any]:
        """Return the values of `names`."""
        values: list[Any] = json.loads(self._row)
        return values

    def raw(self) -> bytes:
        """Return row and trace as they were written."""
        return self._row + b"\n" + self._trace

    def trace(self) -> list[list[Any]]:
        """Return the columns of the trace, in the order of `schema.POINT`."""
        columns: list[list[Any]] = json.loads(self._trace)
        return columns


class State(NamedTuple):
    """How a finished run ended, and by what code."""

    run_id: str
    status: str
    code_digest: str


@final
class Journal:
    """A journal that is being written. One writer has it, which may be killed at any moment."""

    def __init__(
        self, folder: Path, study: str, name: str | None = None, origin: Mapping[str, Any] | None = None
    ) -> None:
        """Begin, or go on with, the journal `name` of the study in `folder`; a name that nobody has by default.

        `origin` is where its rows were made (`provenance`): in this process by default.
        A writer goes on with a journal only where it knows that the one before is gone: a line that was cut is cut off.
        """
        self.path = folder / FOLDER / f"{name or writer_name()}{ENDING}"
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._common = {**(origin or provenance()), "study": study, "schema_version": SCHEMA_VERSION}
        self._names = [column.name for column in COLUMNS if column.name not in self._common]
        self._file, self._locked = _opened(self.path)
        _cut_torn_tail(self._file)
        self._count, self._began_at = 0, time.time()
        self._synced = time.monotonic()

    def append(self, run: Run) -> None:
        """Write a finished run. When this returns, a kill of this process no longer loses it."""
        record = vars(run.record)
        row = [_plain(record[name], name) for name in self._names]
        points = [list(column) for column in zip(*run.points, strict=True)] or [[], [], [], []]
        fields = (b"R", record["run_id"].encode(), record["status"].encode(), (record["code_digest"] or "").encode())
        line = _line(*fields, _json(row), _json(points))
        if self._count % _HEADER_EVERY == 0:
            line = self._header() + line
        self._count += 1
        _write(self._file, line)
        if time.monotonic() - self._synced > _SYNC_EVERY:
            self._sync()

    def close(self) -> None:
        """Say that no more comes: the journal may go as soon as it is collected."""
        if self._file < 0:
            return
        empty = os.lseek(self._file, 0, os.SEEK_END) == 0
        if not empty:
            _write(self._file, _line(b"E"))
            self._sync()
        os.close(self._file)
        self._file = -1
        if empty:
            self.path.unlink(missing_ok=True)

    def _sync(self) -> None:
        with suppress(OSError):  # some network drives have no such order
            os.fsync(self._file)
        self._synced = time.monotonic()

    def _header(self) -> bytes:
        told = {
            "schema_version": SCHEMA_VERSION, "host": platform.node(), "pid": os.getpid(), "locked": self._locked,
            "began_at": self._began_at, "columns": self._names, "common": self._common,
        }  # fmt: skip
        return _line(b"H", _json(told))


@final
class JournalReader:
    """The whole records of one journal, in order; after them `damaged` counts the lines that cannot be read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damaged = self.count = 0
        self.closed = False
        self._header: dict[str, Any] | None = None

    def __iter__(self) -> Iterator[Record]:
        """Yield the records. A line without its end is being written, or was when its writer was killed: left out."""
        self.damaged, self.closed = 0, False
        names: tuple[str, ...] = ()
        with open(self.path, "rb") as file:
            for line in file:
                if not line.endswith(b"\n"):
                    return
                fields = _fields(line)
                self.closed = fields is not None and fields[0] == b"E"
                if fields is None:
                    self.damaged += 1
                elif fields[0] == b"H":
                    self._header, names = json.loads(fields[1]), ()
                elif fields[0] == b"R" and len(fields) == 6:
                    header = self._any_header()
                    if header is None:
                        self.damaged += 1
                        continue
                    names = names or tuple(header["columns"])
                    run_id, status, code = (field.decode() for field in fields[1:4])
                    yield Record(run_id, status, code, names, header["common"], fields[4], fields[5])

    def states(self) -> Iterator[State]:
        """Yield of each record what stands before its row, which is not looked at; `count` says how many it were."""
        self.damaged = self.count = 0
        with open(self.path, "rb") as file:
            for line in file:
                if not line.endswith(b"\n"):
                    return
                if line[:8] != _checksum(line):
                    self.damaged += 1
                elif line[9:11] == b"R\t":
                    self.count += 1
                    _, run_id, status, code, _ = line[9:].split(b"\t", 4)
                    yield State(run_id.decode(), status.decode(), code.decode())
                self.closed = line[9:-1] == b"E"

    def began(self) -> float:
        """Return when its writer began, in seconds since 1970; 0 where that cannot be read."""
        return float((self._any_header() or {}).get("began_at", 0.0))

    def is_left(self) -> bool:
        """Tell whether its writer is gone: it said so, or no longer holds the file's lock, or was silent for a day."""
        return self._if_left(lambda: None)

    def remove_if_left(self) -> None:
        """Delete the journal where its writer is gone."""
        self._if_left(self.path.unlink)

    def _if_left(self, act: Callable[[], object]) -> bool:
        """Act where the writer is gone, so that no other begins meanwhile; return whether it is."""
        try:
            header = self._any_header() or {"host": platform.node(), "locked": True}  # it has written nothing yet
            here = header["host"] == platform.node() and header["locked"]
            gone = self.closed or time.time() - self.path.stat().st_mtime > _ABANDONED
            if not (gone or here):
                return False
            with _held(self.path) as free:
                if gone or free:
                    act()
                return gone or free
        except OSError:
            return False

    def _any_header(self) -> dict[str, Any] | None:
        """Return the header before this place, or where that is damaged, the next copy."""
        if self._header is None:
            with open(self.path, "rb") as file:
                for line in file:
                    fields = _fields(line) if line.endswith(b"\n") else None
                    if fields is not None and fields[0] == b"H":
                        self._header = json.loads(fields[1])
                        break
        return self._header


def journals_in(folder: Path) -> list[Path]:
    """Return the journals of the study in `folder`, by name."""
    return sorted((folder / FOLDER).glob(f"*{ENDING}"))


def writer_name() -> str:
    """Return a name that no other writer has, on this machine or another."""
    host = re.sub(r"[^A-Za-z0-9.-]", "_", platform.node())[:40]
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{host}-{os.getpid()}-{token_hex(3)}"


def last_ids(folder: Path, name: str) -> dict[str, str]:
    """Return {run_id: status} of the last runs in the journal `name` of the study in `folder`."""
    try:
        with open(folder / FOLDER / f"{name}{ENDING}", "rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - _LAST))
            lines = file.read().splitlines(keepends=True)
    except OSError:
        return {}
    found = [_fields(line) for line in lines if line.endswith(b"\n")]
    return {fields[1].decode(): fields[2].decode() for fields in found if fields is not None and fields[0] == b"R"}


def _line(*fields: bytes) -> bytes:
    rest = b"\t".join(fields)
    return b"%08x\t%b\n" % (crc32(rest), rest)


def _fields(line: bytes) -> list[bytes] | None:
    """Return the fields after the checksum; None where that is wrong."""
    if len(line) < 11 or line[8:9] != b"\t" or line[:8] != _checksum(line):
        return None
    return line[9:-1].split(b"\t")


def _checksum(line: bytes) -> bytes:
    return b"%08x" % crc32(memoryview(line)[9:-1])


def _json(value: Any) -> bytes:
    return _ENCODER.encode(value).encode()


def _plain(value: Any, name: str) -> Any:
    return (value - _EPOCH) // _MICROSECOND if name in _TIMES and value is not None else value


def _of_numpy(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be kept in a row")


_ENCODER = json.JSONEncoder(separators=(",", ":"), default=_of_numpy, check_circular=False)


def _write(file: int, line: bytes) -> None:
    """Append all of `line`; a disk that is full raises `OSError`, and what was written of the line is cut off."""
    before = os.lseek(file, 0, os.SEEK_END)
    try:
        left = memoryview(line)
        while left:
            left = left[os.write(file, left) :]
    except OSError:
        with suppress(OSError):
            os.ftruncate(file, before)
        raise


def _cut_torn_tail(file: int) -> None:
    """Cut off what follows the last newline."""
    size = os.lseek(file, 0, os.SEEK_END)
    step, end = 1 << 16, size
    while end:
        begin = max(0, end - step)
        os.lseek(file, begin, os.SEEK_SET)
        found = os.read(file, end - begin).rfind(b"\n")
        if found >= 0:
            if begin + found + 1 < size:
                os.ftruncate(file, begin + found + 1)
            return
        end = begin
    os.ftruncate(file, 0)


def _opened(path: Path) -> tuple[int, bool]:
    """Return the file, open to append, and whether it is locked: it may just have been deleted by who collects."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o644)
        locked = _lock(file)
        if os.fstat(file).st_nlink:
            return file, locked
        os.close(file)


def _lock(file: int) -> bool:
    """Hold the system's lock of a file as long as it is open; False where there is none."""
    if fcntl is None:
        return False
    for _ in range(_TRIES):
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:  # who collects looks at it
            time.sleep(_WAIT)
        except OSError:
            return False
    return False


@contextmanager
def _held(path: Path) -> Iterator[bool]:
    """Hold the lock of a file if nobody does; yield whether that is so."""
    if fcntl is None:
        yield False
        return
    with open(path, "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield False
            return
        yield True
