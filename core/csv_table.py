"""Read a CSV table: comment lines, a header whose names may have units in brackets, one row for each reading.

One reader for every door: readings for a problem, plans, and measured data.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

from calibench.core.data_file import LARGEST_TEXT, MOST_CELLS, check_columns, read_whole, text_of
from calibench.core.words import shortened

_LONGEST_HEAD = 200  # characters
_SMALLER = "write it as Parquet (measured data), or in parts"
_HEAD = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\]]*)\])?\s*")


@final
@dataclass(frozen=True)
class Table:
    """The cells of a file as they are written: `names` of the columns, `units` by name where the header states them.

    A column without a name is called "". `rows` are (line of the file, cells); `comment` is what stood before the
    header, as one line. `names` is empty where there is no header.
    """

    names: tuple[str, ...]
    units: Mapping[str, str]
    rows: tuple[tuple[int, tuple[str, ...]], ...]
    comment: str = ""


def read_table(path: str | Path, bare: bool = False) -> Table:
    """Return the table in a file. Cells are parted by a comma, a semicolon or a tab; lines that begin with # are not.

    With `bare` a first row of numbers is a row, and the table has no header. Raises `ValueError` in one line for what
    is no such table or beyond the bounds of `calibench.core.data_file`, `OSError` for what cannot be opened.
    """
    text = text_of(read_whole(path, LARGEST_TEXT, _SMALLER))
    _check_cells(text.count("\n"))  # before they are parted
    lines = text.splitlines()
    at = next((i for i, line in enumerate(lines) if line.strip() and not _comment(line)), len(lines))
    if at == len(lines):
        raise ValueError("the file is empty: a header and a row for each reading are needed")
    delimiter = max(",;\t", key=lines[at].count)
    check_columns(lines[at].count(delimiter) + 1)
    _check_cells(text.count(delimiter) + len(lines))
    reader = csv.reader(lines[at:], delimiter=delimiter, strict=True)
    try:
        read = [(at + reader.line_num, tuple(row)) for row in reader if row and not _comment(row[0])]
    except csv.Error as error:
        raise ValueError(f"the file is no CSV: {error}") from None
    comment = " ".join(line.strip() for line in lines[:at])
    if bare and all(map(_is_number, read[0][1])):
        return Table((), {}, tuple(read), comment)
    names, units = heads(read[0][1])
    rows = tuple((line, row) for line, row in read[1:] if len(row) > 1 or len(names) == 1 or row[0].strip())
    return Table(names, units, rows, comment)


def heads(row: Sequence[str]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the names of a header, and the units that stand in brackets behind them.

    >>> heads(["enc_1 [rad]", "t_s"])
    (('enc_1', 't_s'), {'enc_1': 'rad'})

    Raises `ValueError` for a head without a name, and for a name that is there twice.
    """
    names: list[str] = []
    known: set[str] = set()
    units: dict[str, str] = {}
    for place, head in enumerate(row):
        if place == 0 and not head.strip() and len(row) > 1:  # the row numbers of pandas, which are no column
            names.append("")
            continue
        match = _HEAD.fullmatch(head) if len(head) <= _LONGEST_HEAD else None
        if match is None or not match["name"]:
            told = shortened(head)
            raise ValueError(f"header {told!r}: a name, or a name with its unit such as angle [rad], is needed")
        if match["name"] in known:
            raise ValueError(f"column {match['name']} is there twice")
        names.append(match["name"])
        known.add(match["name"])
        if match["unit"] is not None:
            units[match["name"]] = match["unit"]
    return tuple(names), units


def _check_cells(count: int) -> None:
    if count > MOST_CELLS:
        raise ValueError(f"has {count} cells, and at most {MOST_CELLS} are read; {_SMALLER}")


def _comment(line: str) -> bool:
    return line.lstrip().startswith("#")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
