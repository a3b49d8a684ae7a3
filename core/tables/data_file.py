"""Checks of a data file before it is read or parsed: its kind, size and width.

All readers use them: readings of a problem, plans, measured data. A pipe or a device never ends or never begins; a file
that is read while another process writes it is half of two files; a reader that is given a million columns takes
minutes to refuse them, and Arrow may crash the process. A refusal is one line.
"""

import codecs
import os
import re
import stat
from pathlib import Path

MEGABYTE = 1_000_000
LARGEST_TEXT = 100 * MEGABYTE  # of a CSV file: one of the most cells has 80 MB where each has 20 digits
LARGEST_OWN = 10 * MEGABYTE  # of a format of a machine's own field, such as printer.cfg: a night of pointing has .1
LARGEST_PARQUET = 500 * MEGABYTE  # five times that, and compressed besides
MOST_COLUMNS = 2_000  # a machine's readings have some 50; each column of numbers is one more that may explain the gap
MOST_CELLS = 4_000_000  # of a CSV file: they take 6 to 25 s, and .5 to 1.7 GB, as each is a text before it is a number
MOST_NUMBERS = 10_000_000  # of a Parquet or MATLAB file: 80 MB, and a search holds them some five times
LONGEST_FOOTER = 8 * MEGABYTE  # of a Parquet file: of 2000 columns it has .4 MB a row group
LARGEST_UNPACKED = 1_000 * MEGABYTE  # of a Parquet file, as its footer states
LARGEST_METADATA = 1 * MEGABYTE  # of the JSON that states machine, noise and nominal values: it has some hundred bytes
MOST_LETTERS = 100_000_000  # of a column of words, each as wide as the widest: 400 MB
_KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}  # fmt: skip
_PACKED = {b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip", b"BZh": "bzip2", b"\xfd7zXZ\0": "xz", b"\x28\xb5\x2f\xfd": "zstd"}
_CONTROL = re.compile(r"[\x01-\x08\x0e-\x1f\x7f]")
_WITHOUT_WAITING = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)


def read_whole(path: str | Path, largest: int, way_out: str = "") -> bytes:
    """Return the bytes of a regular file of at most `largest`; `way_out` tells what to do with a larger one.

    Raises `ValueError` in one line, without the path, for a file of another kind or size, and for one that changes
    while it is read; `OSError` where it cannot be opened.
    """
    _check_kind(os.stat(path))  # before it is opened: opening a device may already do something
    descriptor = os.open(path, os.O_RDONLY | _WITHOUT_WAITING)
    with os.fdopen(descriptor, "rb", buffering=0) as file:
        before = os.fstat(descriptor)
        _check_kind(before)
        if before.st_size > largest:
            more = f"; {way_out}" if way_out else ""
            raise ValueError(
                f"has {round(before.st_size / MEGABYTE, 1):g} MB, and at most {largest / MEGABYTE:g} MB are read{more}"
            )
        parts: list[bytes] = []
        while part := file.read(before.st_size + 1 - sum(map(len, parts))):
            parts.append(part)
        after = os.fstat(descriptor)
    content = b"".join(parts)
    same = (before.st_size, before.st_mtime_ns) == (after.st_size, after.st_mtime_ns)
    if not same or len(content) != before.st_size:
        raise ValueError("changed while it was read; wait until it is written, then ask again")
    return content


def text_of(content: bytes) -> str:
    """Return the text of a file: UTF-8, UTF-16 with its mark, cp1252; raise `ValueError` for none, or a packed one."""
    packed = next((name for start, name in _PACKED.items() if content.startswith(start)), None)
    if packed is not None:
        raise ValueError(f"the file is packed ({packed}); unpack it first")
    if content.startswith(b"PAR1"):
        raise ValueError("the file is Parquet and no text; let its name end in .parquet")
    marked = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = content.decode("utf-16" if marked else "utf-8-sig")
    except UnicodeDecodeError:
        if marked:
            raise ValueError("the file begins as UTF-16 text and is none; write it anew as UTF-8") from None
        text = content.decode("cp1252", "replace")  # five bytes of 256 are nothing there: no text rarely goes without
        if "\ufffd" in text or _CONTROL.search(text):
            raise ValueError("the file is no text (UTF-8, UTF-16 with its mark, or cp1252)") from None
    ended = re.findall(r"\0(?=\r?\n|$)", text)  # by programs in C that write the zero behind a string
    if len(ended) > 1 and len(ended) == text.count("\0") and len(ended) + 1 >= len(text.split()):
        text = text.replace("\0", "")
    if "\0" in text:
        raise ValueError("the file holds NUL bytes and is no text")
    return text


def check_columns(count: int) -> None:
    """Raise `ValueError` for a table with more columns than are read."""
    if count > MOST_COLUMNS:
        raise ValueError(
            f"has {count} columns, and at most {MOST_COLUMNS} are read; leave out those that are not needed"
        )


def _check_kind(about: os.stat_result) -> None:
    if not stat.S_ISREG(about.st_mode):
        kind = _KINDS.get(stat.S_IFMT(about.st_mode), "something else")
        more = "" if stat.S_ISDIR(about.st_mode) else "; write what it gives to a file first"
        raise ValueError(f"is {kind}, and a file is needed{more}")
