"""A journal: the finished runs of one writer, appended a line each, until they are collected into the tables.

Lines are checksummed, begin and end with a newline, and each file begins with two headers: a kill costs the line that
was being written, and damage to one line at most that line. Values are JSON, with NaN and Infinity. With tabs between::

    CRC32  H  {header}                                          who writes, and the columns that all its rows share
    CRC32  R  run_id  status  code_digest  [row]  [trace]       a finished run, its values in the order of the columns

Only its writer appends to a journal, and opens it for each line anew. Who holds the study's lock claims it: renames
it, reads it, and deletes it when the tables hold its runs. Where the file has lost its name as the writer looks again,
the line is written once more, into a new file, and a run that stands twice is taken once. A shared drive has to show a
rename to all at once, as NFS from version 4 on and the parallel file systems of clusters do.
"""

from __future__ import annotations

import json
import os
import platform
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from math import inf
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, final
from zlib import crc32

import numpy as np

from calibench.bench.execution.run_row import COLUMNS, SCHEMA_VERSION
from calibench.bench.gate.processes import born
from calibench.bench.provenance.environment import Provenance, provenance
from calibench.bench.store.atomic_file import open_within

if TYPE_CHECKING:
    from calibench.bench.execution.run import Run

FOLDER, ENDING, CLAIMED = "journal", ".journal", ".claimed"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_TIMES = frozenset(column.name for column in COLUMNS if column.parquet.startswith("timestamp"))
_SHARED = {*Provenance.__annotations__, "study", "schema_version"}  # columns that all rows of a journal share
_OWN = [column.name for column in COLUMNS if column.name not in _SHARED]
_HEADER_EVERY = 256  # records between two copies of the header: one that is damaged is not missed
_SYNC_EVERY = 2.0  # seconds between two orders to bring what was written to the disk
_APPEND = os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0)


@final
@dataclass(frozen=True)
class Record:
    """A finished run as a journal holds it; `row` and `trace` are JSON: values of `names`, and columns of points.

    Times are microseconds since 1970, UTC; columns of a trace are in the order of `schema.POINT`.
    """

    run_id: str
    status: str
    code_digest: str
    names: tuple[str, ...]  # of the columns in the line
    common: Mapping[str, Any]  # the other columns
    row: bytes
    trace: bytes


class State(NamedTuple):
    """How a finished run ended, and by what code."""

    run_id: str
    status: str
    code_digest: str


@final
class Journal:
    """A journal that is being written, by one process, which may be killed at any moment. Nothing has to be closed."""

    def __init__(
        self, folder: Path, study: str, name: str | None = None, origin: Mapping[str, Any] | None = None
    ) -> None:
        """Begin a journal: its file, made with the first run, is named from `name`; `origin` is where rows are made."""
        self._folder, self._name = folder / FOLDER, name or writer_name()
        self._common = {**(origin or provenance()), "study": study, "schema_version": SCHEMA_VERSION}
        self._header, self._count = b"", 0
        self._synced = time.monotonic()
        self.path: Path | None = None

    def append(self, run: Run) -> None:
        """Write a finished run. When this returns, a kill of this process no longer loses it."""
        self.append_lines([line_of(run)])

    def append_lines(self, lines: Sequence[bytes]) -> None:
        """Write finished runs likewise, as `line_of` makes them."""
        while True:  # until nobody has claimed the file that holds it
            if self.path is None:
                path, flags = self._folder / f"{self._name}-{token_hex(8)}{ENDING}", _APPEND | os.O_CREAT | os.O_EXCL
                header = {
                    "schema_version": SCHEMA_VERSION, "host": platform.node(), "pid": os.getpid(),
                    "born": born(os.getpid()), "began_at": time.time(), "columns": _OWN, "common": self._common,
                }  # fmt: skip
                self._header, self._count = _line("H", _ENCODER.encode(header)), 0
            else:
                path, flags = self.path, _APPEND
            try:
                file = open_within(path, flags) if self.path is None else os.open(path, flags)
            except FileNotFoundError:
                self.path = None
                continue
            self.path = path
            try:
                copies = 2 if os.fstat(file).st_size == 0 else self._count >= _HEADER_EVERY
                _write(file, self._header * copies + b"".join(lines))
                if time.monotonic() - self._synced > _SYNC_EVERY:
                    with suppress(OSError):  # some network drives have no such order
                        os.fsync(file)
                    self._synced = time.monotonic()
            finally:
                os.close(file)
            self._count = len(lines) + (0 if copies else self._count)  # since the last header
            try:  # whether it is still there: by opening it, which a network drive answers anew
                os.close(os.open(path, os.O_RDONLY))
                return
            except FileNotFoundError:
                self.path = None


def line_of(run: Run) -> bytes:
    """Return a finished run as a journal holds it, wherever it was made."""
    record = vars(run.record)
    times = {name for name in _TIMES if record.get(name) is not None}
    row = [(record[name] - _EPOCH) // _MICROSECOND if name in times else record[name] for name in _OWN]
    points = [list(column) for column in zip(*run.points, strict=True)] or [[], [], [], []]
    fields = ("R", record["run_id"], record["status"], record["code_digest"] or "")
    return _line(*fields, _ENCODER.encode(row), _ENCODER.encode(points))


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


def _line(*fields: str) -> bytes:
    rest = "\t".join(fields).encode()
    return b"\n%08x\t%b\n" % (crc32(rest), rest)


def _of_numpy(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be kept in a row")


_ENCODER = json.JSONEncoder(separators=(",", ":"), default=_of_numpy, check_circular=False)


@final
@dataclass(eq=False)
class JournalReader:
    """The whole records of one journal, in order; after them `damaged` counts the lines that cannot be read.

    With `span`, two places in the file, it has those alone whose lines begin there: of `parts` each record is in one.
    A journal that is claimed meanwhile is read all the same; one that is gone is empty: its runs stand in the tables.
    """

    path: Path
    span: tuple[int, float] = (0, inf)
    damaged: int = 0
    count: int = 0
    _header: dict[str, Any] | None = field(default=None, repr=False)

    def __iter__(self) -> Iterator[Record]:
        """Yield the records."""
        header = self.header()
        for fields in self._lines(-1):
            if fields[0] == b"R" and len(fields) == 6 and header is not None:
                run_id, status, code = (field.decode() for field in fields[1:4])
                names = tuple(header["columns"])
                yield Record(run_id, status, code, names, header["common"], fields[4], fields[5])
            elif fields[0] != b"H":
                self.damaged += 1

    def states(self) -> Iterator[State]:
        """Yield of each record what stands before its row, which is not looked at; `count` says how many it were."""
        self.count = 0
        readable = self.header() is not None
        for fields in self._lines(4):
            if fields[0] == b"R" and len(fields) == 5 and readable:
                self.count += 1
                yield State(*(field.decode() for field in fields[1:4]))
            elif fields[0] != b"H":
                self.damaged += 1

    def header(self) -> dict[str, Any] | None:
        """Return the first header that can be read: all are the same; None where there is none."""
        if self._header is None:
            self._header = next((json.loads(fields[1]) for fields in self._lines(1) if fields[0] == b"H"), None)
        return self._header

    def parts(self, size: int) -> list[JournalReader]:
        """Return readers of spans of so many bytes; the last is of all that is written beyond them, too."""
        with suppress(FileNotFoundError), _opened(self.path) as file:
            begins = range(0, max(1, file.seek(0, os.SEEK_END)), size)
            return [JournalReader(self.path, span, _header=self.header()) for span in pairwise([*begins, inf])]
        return []

    def _lines(self, splits: int) -> Iterator[list[bytes]]:
        """Yield the fields of each whole line; one without its end is being written, or its writer was killed."""
        self.damaged = 0
        begin, end = self.span
        with suppress(FileNotFoundError), _opened(self.path) as file:
            if begin:  # the line that the place before is in is of the span before
                file.seek(begin - 1)
                begin += len(file.readline()) - 1
            for line in file:
                if begin >= end or not line.endswith(b"\n"):
                    return
                begin += len(line)
                if line == b"\n":
                    continue
                if len(line) < 11 or line[8:9] != b"\t" or line[:8] != b"%08x" % crc32(memoryview(line)[9:-1]):
                    self.damaged += 1
                else:
                    yield line[9:-1].split(b"\t", splits)


def _opened(path: Path) -> BinaryIO:
    """Open a journal to read, under the name that it has now."""
    try:
        return open(path, "rb")
    except FileNotFoundError:
        return open(path.with_suffix(CLAIMED), "rb")


def claim(folder: Path) -> list[JournalReader]:
    """Rename all journals of the study in `folder` and return them, with those that a killed one has claimed."""
    for path in (folder / FOLDER).glob(f"*{ENDING}"):
        with suppress(OSError):  # where an open file cannot be renamed: next time
            path.rename(path.with_suffix(CLAIMED))
    return [JournalReader(path) for path in sorted((folder / FOLDER).glob(f"*{CLAIMED}"))]


def journals_in(folder: Path) -> list[JournalReader]:
    """Return the journals of the study in `folder`, by name.

    A folder is listed twice: of a file that is renamed meanwhile, one listing may show neither name.
    """
    found = [path for _ in range(2) for ending in (ENDING, CLAIMED) for path in (folder / FOLDER).glob(f"*{ending}")]
    return [JournalReader(path) for path in sorted({path.with_suffix(ENDING) for path in found})]


def writer_name() -> str:
    """Return a name that no other writer has, on this machine or another."""
    host = re.sub(r"[^A-Za-z0-9.-]", "_", platform.node())[:40]
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{host}-{os.getpid()}-{token_hex(3)}"


def kept_by(folder: Path, name: str) -> dict[str, str]:
    """Return {run_id: status} of the runs in the journals of the writer `name` of the study in `folder`."""
    journals = [reader for reader in journals_in(folder) if reader.path.name.startswith(f"{name}-")]
    return {state.run_id: state.status for reader in journals for state in reader.states()}
