"""Read a table of text from disk: comment lines, a preamble, a header with units in brackets, a row a reading.

Readings for a problem, plans, and measured data all use it. Cells are separated by a comma, a semicolon, a tab, or
spaces. Text in brackets behind a name is its unit, whatever the shape of the brackets; the caller checks whether the
unit is known.

A sheet of an Excel file as a table: the first that holds one, with the values that Excel last computed.

The file is a packed folder of XML. What it unpacks to stands in its directory, which is looked at beforehand, and a
sheet is read row by row: one that says it has a million columns is refused at its first row.
"""

from __future__ import annotations

import csv
import io
import re
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any, final

from calibench.core.tables.cells import is_unit
from calibench.core.tables.data_file import (
    LARGEST_TEXT,
    MEGABYTE,
    MOST_CELLS,
    MOST_COLUMNS,
    check_columns,
    read_whole,
    text_of,
)
from calibench.core.words import listed, shortened

_LONGEST_HEAD = 200  # characters
_LONGEST_PREAMBLE = 60  # lines
_SMALLER = "write it as Parquet (measured data), or in parts"
_EMPTY = "the file is empty: a header and a row for each reading are needed"
_OPEN, _CLOSE = r"\[({<（［｛【〔⟨〈", r"\])}>）］｝】〕⟩〉"
_HEAD = re.compile(
    rf"\s*(?P<name>[^\[\]]*?)\s*(?:[{_OPEN}](?P<unit>[^{_OPEN}{_CLOSE}]*)[{_CLOSE}]|\s/\s+(?P<over>[^\[\]/]+?))?\s*"
)
_OPENED = re.compile(r'(^|[,;\t])\s*"[^"]*$')  # a cell whose quotation mark does not close in its line
_NUMBER = re.compile(r"\s*[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?\s*")


@final
@dataclass(frozen=True)
class Table:
    """The cells of a file as they are written: `names` of the columns, `units` by name where the header states them.

    A column without a name is called "". `rows` are (line of the file, cells); `comment` is what stood before the
    header, as one line. `names` is empty where there is no header. Cells are parted by `delimiter`. `notes` tell what
    was taken for a header that does not look like one.
    """

    names: tuple[str, ...]
    units: Mapping[str, str]
    rows: tuple[tuple[int, tuple[str, ...]], ...]
    comment: str = ""
    delimiter: str = ","
    notes: tuple[str, ...] = ()


def read_table(path: str | Path, bare: bool = False) -> Table:
    """Return the table in a file; lines that begin with # are comments, and what stands before the header a preamble.

    With `bare` a first row of numbers is a row, and the table has no header. Raises `ValueError` in one line for what
    is no such table or beyond the bounds of `calibench.core.tables.data_file`, `OSError` for what cannot be opened.
    """
    text = text_of(read_whole(path, LARGEST_TEXT, _SMALLER))
    _check_cells(text.count("\n"))  # before they are parted
    lines = text.splitlines()
    at = next((i for i, line in enumerate(lines) if line.strip() and not _comment(line)), len(lines))
    if at == len(lines):
        raise ValueError(_EMPTY)
    check_columns(max(lines[at].count(mark) for mark in ",;\t") + 1)
    at, delimiter = _header(lines, at)
    if at and _OPENED.search(lines[at - 1]) and lines[at].count('"') % 2:
        raise ValueError(f"line {at}: the header goes over several lines; write each name in one line")
    check_columns(lines[at].count(delimiter) + 1)
    _check_cells((text.count(delimiter) if delimiter != " " else 0) + len(lines))
    reader = csv.reader(lines[at:], delimiter=delimiter, strict=True, skipinitialspace=delimiter == " ")
    try:
        read = [(at + reader.line_num, tuple(row)) for row in reader if row and not _comment(row[0])]
    except csv.Error as error:
        opened = next((at + k + 1 for k, line in enumerate(lines[at:]) if line.count('"') % 2), None)
        mark = f"; line {opened} has a quotation mark that is not closed" if opened else ""
        raise ValueError(f"the file is no CSV: {error}{mark}") from None
    if not read:  # comments in quotation marks
        raise ValueError(_EMPTY)
    comment = " ".join(line.strip() for line in lines[:at])
    above = _heading_in_comment(lines[at - 1], read[0][1]) if at else ()
    if above:
        noted = f"the names of the columns are those of the comment above the first reading, line {at}"
        return table_of([(at, above), *read], comment, bare, delimiter, (noted,))
    return table_of(read, comment, bare, delimiter)


def table_of(
    read: Sequence[tuple[int, tuple[str, ...]]], comment: str = "", bare: bool = False, delimiter: str = ",",
    notes: tuple[str, ...] = (),
) -> Table:  # fmt: skip
    """Return the table of rows of cells, (place in the file, cells), of which the first is the header.

    Columns at the end that have neither a name nor a cell are left out, and so is a header that comes again among the
    rows, as where files were put together. Raises `ValueError` as `heads` does.
    """
    if bare and all(_NUMBER.fullmatch(cell) for cell in _cut(read[0][1], 1)):
        return Table((), {}, tuple((line, _cut(row, 1)) for line, row in read), comment, delimiter)
    row = _joined(read[0][1], read[1][1]) if len(read) > 1 else read[0][1]
    row = _cut(row, 1)
    names, units = heads(row)
    again = [line for line, cells in read[1:] if cells == read[0][1]]
    if again:
        notes = (*notes, f"the header comes again in line {listed(list(map(str, again)), 4)} and is left out there")
    cut = ((line, _cut(cells, len(names))) for line, cells in read[1:] if line not in again)
    rows = tuple((line, cells) for line, cells in cut if len(cells) > 1 or len(names) == 1 or cells[0].strip())
    return Table(names, units, rows, comment, delimiter, notes)


def heads(row: Sequence[str]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the names of a header, and the units that stand behind them in brackets, or behind a slash.

    >>> heads(["enc_1 [rad]", "t_s", "Winkel 2 (Grad)", "x / mm"])
    (('enc_1', 't_s', 'Winkel 2', 'x'), {'enc_1': 'rad', 'Winkel 2': 'Grad', 'x': 'mm'})

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
            where = f"{shortened(head)!r}" if head.strip() else f"'' of column {place + 1}"
            over = "" if head.strip() else "; leave out a line that names groups of columns"
            raise ValueError(f"header {where}: a name, or a name with its unit such as angle [rad], is needed{over}")
        if match["name"] in known and _NUMBER.fullmatch(match["name"]):
            raise ValueError(
                f"the first row holds the number {match['name']} twice, so it is no header; write the names of the "
                "columns above it"
            )
        if match["name"] in known:
            raise ValueError(f"column {match['name']} is there twice; give each a name of its own")
        names.append(match["name"])
        known.add(match["name"])
        stated = match["over"] if match["unit"] is None else match["unit"]
        if stated is not None:
            units[match["name"]] = stated
    return tuple(names), units


def header_row(rows: Sequence[Sequence[str]]) -> int | None:
    """Return the place of the header in the first rows of a file: words, above a row of as many cells with numbers.

    The last cells of that row may be empty, such as remarks. A row of units may stand between them. None where there is
    no such row.
    """
    for k, (row, reading) in enumerate(pairwise(rows)):
        row, below = _cut(row, 1), _cut(reading, 1)
        if len(below) != len(row) > len(_joined(row, below)):
            row = _joined(row, below)
        numbers = any(map(_NUMBER.fullmatch, row))
        as_many = len(row) == len(below) or 2 <= len(below) < len(row) <= len(reading)
        if len(row) > 1 and as_many and not numbers and any(map(_NUMBER.fullmatch, below)):
            return k - 1 if k and _are_units(row) and _are_names(_cut(rows[k - 1], 1), len(row)) else k
    return None


def _are_units(row: Sequence[str]) -> bool:
    """Return whether a row holds units alone, as one beneath the header does."""
    return all(is_unit(cell.strip().strip("[](){}<>").strip()) for cell in row if cell.strip())


def _are_names(row: Sequence[str], width: int) -> bool:
    """Return whether a row of so many cells may be the names above one of units: no cell is empty or a date."""
    words = all(cell.strip() and not cell.strip()[0].isdigit() for cell in row)
    return len(row) == width and words and not _are_units(row)


def _heading_in_comment(line: str, row: Sequence[str]) -> tuple[str, ...]:
    """Return the names in a comment that stands right above a first row of numbers; () where it holds no such names."""
    text = line.strip().lstrip("#").strip()
    if not _comment(line) or ":" in text or not all(map(_NUMBER.fullmatch, _cut(row, 1))):
        return ()
    for mark in ",;\t ":
        names = tuple(name.strip() for name in _parted(text, mark))
        if len(names) == len(_cut(row, 1)) > 1 and not any(map(_NUMBER.fullmatch, names)):
            return names
    return ()


def _header(lines: Sequence[str], first: int) -> tuple[int, str]:
    """Return the line of the header and what parts its cells; `first` is the first line that is no comment."""
    for mark in ";\t":  # no header, and decimal commas
        cells = _cut(_parted(lines[first], mark), 1)
        if len(cells) > 1 and all(map(_NUMBER.fullmatch, cells)):
            return first, mark
    delimiter = max(",;\t", key=lines[first].count)
    beginning = [i for i in range(first, len(lines)) if lines[i].strip() and not _comment(lines[i])]
    beginning = beginning[: _LONGEST_PREAMBLE + 1]
    head, below = (_cut(_parted(lines[i], delimiter), 1) for i in (beginning * 2)[:2])
    readings = any(map(_NUMBER.fullmatch, below)) or (_are_units(below) and _are_names(head, len(below)))
    groups = not all(cell.strip() for cell in head[1:])  # which `heads` refuses, with what to do
    if len(beginning) == 1 or (len(head) == len(below) > 1 and (readings or groups)):
        return first, delimiter
    for mark in sorted(";\t, ", key=lambda mark: mark != delimiter):
        found = header_row([_parted(lines[i], mark) for i in beginning])
        if found is not None:
            return beginning[found], mark
    numbers = lines[first].split()
    if len(numbers) > 1 and all(map(_NUMBER.fullmatch, numbers)) and not lines[first].count(";"):
        return first, " "
    return first, delimiter


def _parted(line: str, delimiter: str) -> tuple[str, ...]:
    if line.count(delimiter) > MOST_COLUMNS:
        return (line,)
    try:
        return tuple(next(csv.reader([line], delimiter=delimiter, strict=True, skipinitialspace=delimiter == " ")))
    except (csv.Error, StopIteration):
        return (line,)


def _joined(head: Sequence[str], row: Sequence[str]) -> tuple[str, ...]:
    """Return a header whose brackets hold what parts cells, put together; as it is where that does not fit `row`."""
    if len(head) <= len(row):
        return tuple(head)
    whole: list[str] = []
    for cell in head:
        inside = whole and len(re.findall(f"[{_OPEN}]", whole[-1])) > len(re.findall(f"[{_CLOSE}]", whole[-1]))
        whole[-1:] = [f"{whole[-1]},{cell}"] if inside else [*whole[-1:], cell]
    return tuple(whole) if len(whole) == len(row) else tuple(head)


def _cut(row: Sequence[str], least: int) -> tuple[str, ...]:
    """Return the cells without the empty ones at the end, but at least so many."""
    end = len(row)
    while end > least and not row[end - 1].strip():
        end -= 1
    return tuple(row[:end])


def _check_cells(count: int) -> None:
    if count > MOST_CELLS:
        raise ValueError(f"has {count} cells, and at most {MOST_CELLS} are read; {_SMALLER}")


def _comment(line: str) -> bool:
    return line.lstrip().startswith("#")


_LARGEST_UNPACKED = 400 * MEGABYTE  # of a sheet's XML: the most cells have some 40 to 80 bytes each
_MOST_TIMES, _SMALL = 100, 10 * MEGABYTE  # as it is packed: sheets unpack to 5 to 20 times; a small one may to more
_MOST_ROWS = 1 << 20  # of any sheet of Excel
_SMALLER_SHEET = "save it as CSV or Parquet, or take part of the readings"


class ExcelError(ValueError):
    """A file that is no Excel table, or too large a one; the message is one line that says what to do."""


def read_excel(path: Path) -> tuple[Table, tuple[str, ...]]:
    """Return the table, and a note where other sheets hold something too. Raises `ValueError`."""
    try:
        import openpyxl
    except ImportError:
        raise ExcelError(
            "is an Excel file; reading it needs openpyxl: pip install 'calibench[excel]', or save it as CSV"
        ) from None
    content = read_whole(path, LARGEST_TEXT, _SMALLER_SHEET)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as packed:
            unpacked = sum(part.file_size for part in packed.infolist())
        if unpacked > max(_SMALL, _MOST_TIMES * len(content)):
            raise ExcelError(
                f"unpacks to {unpacked // len(content)} times its size, and no sheet of readings to more than "
                f"{_MOST_TIMES}; {_SMALLER_SHEET}"
            )
        if unpacked > _LARGEST_UNPACKED:
            most = _LARGEST_UNPACKED // MEGABYTE
            raise ExcelError(
                f"unpacks to {unpacked / MEGABYTE:.0f} MB, and at most {most} MB are read; {_SMALLER_SHEET}"
            )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of styles and extensions that no number depends on
            book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
            sheets = {sheet.title: _rows(sheet) for sheet in book.worksheets}
    except (ExcelError, MemoryError):
        raise
    except Exception as error:  # openpyxl raises what its XML reader, zipfile and its own checks raise
        raise ExcelError(
            f"is no Excel file that can be read ({type(error).__name__}: {error}); save it as CSV"
        ) from None
    full = {title: rows for title, rows in sheets.items() if rows}
    if not full:
        raise ExcelError("the sheets are empty: a header and a row for each reading are needed")
    found = {title: header_row([row for _, row in rows[:60]]) for title, rows in full.items()}
    title = next((title for title, at in found.items() if at is not None), next(iter(full)))
    rows, start = full[title], found[title] or 0
    others = [other for other in full if other != title]
    notes = (f"sheet {title} is read, and not {', '.join(others)}",) if others else ()
    comment = " ".join(" ".join(filter(None, row)) for _, row in rows[:start])
    return _even(table_of(rows[start:], comment, bare=True)), notes


def _even(table: Table) -> Table:
    """Return the table with rows as wide as the header: a sheet does not keep empty cells at the end of a row."""
    width = len(table.names) or max(len(row) for _, row in table.rows)
    rows = tuple((line, (*row, *[""] * (width - len(row)))) for line, row in table.rows)
    return replace(table, rows=rows)


def _rows(sheet: Any) -> list[tuple[int, tuple[str, ...]]]:
    """Return the rows that hold something, with their numbers, as text."""
    rows: list[tuple[int, tuple[str, ...]]] = []
    cells = 0
    sheet.reset_dimensions()  # what the file says of its width: each row is as wide as its own last cell
    for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        cells += len(row)
        if number > _MOST_ROWS:  # the rows before that are not there cost time too
            raise ExcelError(f"has a row after {_MOST_ROWS}, the last of a sheet; {_SMALLER_SHEET}")
        if cells > MOST_CELLS:
            raise ExcelError(f"has more than {MOST_CELLS} cells, and no more are read; {_SMALLER_SHEET}")
        told = tuple(_text(cell) for cell in row)
        if any(told):
            check_columns(max(i for i, cell in enumerate(told) if cell) + 1)
            rows.append((number, told))
    return rows


def _text(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, datetime):
        return cell.isoformat()
    if isinstance(cell, timedelta):
        return repr(cell.total_seconds())
    return repr(cell) if isinstance(cell, int | float) else str(cell)
