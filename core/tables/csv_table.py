"""Read a table of text from disk: comment lines, a preamble, a header with units in brackets, a row a reading.

Cells are parted by a comma, a semicolon, a tab, or spaces. Text in brackets behind a name is its unit; the caller
checks whether it is known. Of an Excel file it is the first sheet that holds a table, with the values that Excel last
computed; what it unpacks to is looked at beforehand, and a sheet is read row by row.
"""

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

from calibench.core.notes import DataError
from calibench.core.tables import data_file
from calibench.core.tables.cells import NUMBER, is_unit
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
_LARGEST_UNPACKED = 400 * data_file.MEGABYTE  # of a sheet's XML: the most cells have some 40 to 80 bytes each
_MOST_TIMES, _SMALL = 100, 10 * data_file.MEGABYTE  # as it is packed: sheets unpack to 5 to 20 times; a small one more
_MOST_ROWS = 1 << 20  # of any sheet of Excel
_SMALLER_SHEET = "save it as CSV or Parquet, or take part of the readings"

Rows = Sequence[tuple[int, tuple[str, ...]]]  # line of the file, cells


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
    text = data_file.text_of(data_file.read_whole(path, data_file.LARGEST_TEXT, _SMALLER))
    _check_cells(text.count("\n"))  # before they are parted
    lines = text.splitlines()
    at = next((i for i, line in enumerate(lines) if line.strip() and line.lstrip()[0] != "#"), len(lines))
    if at == len(lines):
        raise ValueError(_EMPTY)
    data_file.check_columns(max(lines[at].count(mark) for mark in ",;\t") + 1)
    at, delimiter = _header(lines, at)
    if at and _OPENED.search(lines[at - 1]) and lines[at].count('"') % 2:
        raise ValueError(f"line {at}: the header goes over several lines; write each name in one line")
    data_file.check_columns(lines[at].count(delimiter) + 1)
    _check_cells((text.count(delimiter) if delimiter != " " else 0) + len(lines))

    reader = csv.reader(lines[at:], delimiter=delimiter, strict=True, skipinitialspace=delimiter == " ")
    try:
        rows = [(at + reader.line_num, tuple(row)) for row in reader if row and not row[0].lstrip().startswith("#")]
    except csv.Error as error:
        opened = next((at + k + 1 for k, line in enumerate(lines[at:]) if line.count('"') % 2), None)
        mark = f"; line {opened} has a quotation mark that is not closed" if opened else ""
        raise ValueError(f"the file is no CSV: {error}{mark}") from None
    if not rows:  # comments in quotation marks
        raise ValueError(_EMPTY)
    notes: tuple[str, ...] = ()
    above = lines[at - 1].strip().lstrip("#").strip() if at and lines[at - 1].lstrip().startswith("#") else ""
    first = _cut(rows[0][1], 1)
    if above and ":" not in above and all(map(NUMBER.fullmatch, first)):  # does it hold names, a name a number?
        heads_above = [tuple(name.strip() for name in _parted(above, mark)) for mark in ",;\t "]
        head = next((names for names in heads_above if len(names) == len(first) > 1 and not _any_number(names)), None)
        if head is not None:
            rows = [(at, head), *rows]
            notes = (f"the names of the columns are those of the comment above the first reading, line {at}",)
    return table_of(rows, " ".join(line.strip() for line in lines[:at]), bare, delimiter, notes)


def table_of(
    rows: Rows, comment: str = "", bare: bool = False, delimiter: str = ",", notes: tuple[str, ...] = ()
) -> Table:
    """Return the table of rows of cells of which the first is the header.

    Columns at the end that have neither a name nor a cell are left out, and so is a header that comes again among the
    rows, as where files were put together. Raises `ValueError` as `heads` does.
    """
    if bare and all(NUMBER.fullmatch(cell) for cell in _cut(rows[0][1], 1)):
        return Table((), {}, tuple((line, _cut(row, 1)) for line, row in rows), comment, delimiter)
    head = _joined(rows[0][1], rows[1][1]) if len(rows) > 1 else rows[0][1]
    names, units = heads(_cut(head, 1))
    again = [line for line, cells in rows[1:] if cells == rows[0][1]]
    if again:
        notes = (*notes, f"the header comes again in line {listed(list(map(str, again)), 4)} and is left out there")
    cut = ((line, _cut(cells, len(names))) for line, cells in rows[1:] if line not in again)
    kept = tuple((line, cells) for line, cells in cut if len(cells) > 1 or len(names) == 1 or cells[0].strip())
    return Table(names, units, kept, comment, delimiter, notes)


def heads(row: Sequence[str]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the names of a header, and the units that stand behind them in brackets, or behind a slash.

    >>> heads(["enc_1 [rad]", "t_s", "Winkel 2 (Grad)", "x / mm"])
    (('enc_1', 't_s', 'Winkel 2', 'x'), {'enc_1': 'rad', 'Winkel 2': 'Grad', 'x': 'mm'})

    Raises `ValueError` for a head without a name, and for a name that is there twice.
    """
    names: dict[str, None] = {}
    units: dict[str, str] = {}
    for place, head in enumerate(row):
        if place == 0 and not head.strip() and len(row) > 1:  # the row numbers of pandas, which are no column
            names[""] = None
            continue
        match = _HEAD.fullmatch(head) if len(head) <= _LONGEST_HEAD else None
        if match is None or not match["name"]:
            where = f"{shortened(head)!r}" if head.strip() else f"'' of column {place + 1}"
            over = "" if head.strip() else "; leave out a line that names groups of columns"
            raise ValueError(f"header {where}: a name, or a name with its unit such as angle [rad], is needed{over}")
        name, stated = match["name"], match["over"] if match["unit"] is None else match["unit"]
        if name in names and NUMBER.fullmatch(name):
            raise ValueError(
                f"the first row holds the number {name} twice, so it is no header; write the names of the "
                "columns above it"
            )
        if name in names:
            raise ValueError(f"column {name} is there twice; give each a name of its own")
        names[name] = None
        if stated is not None:
            units[name] = stated
    return tuple(names), units


def header_row(rows: Sequence[Sequence[str]]) -> int | None:
    """Return the place of the header in the first rows of a file: words, above a row of as many cells with numbers.

    A row of units may stand between them. None where there is no such row.
    """
    for k, (row, reading) in enumerate(pairwise(rows)):
        row, below = _cut(row, 1), _cut(reading, 1)
        if len(below) != len(row) > len(_joined(row, below)):
            row = _joined(row, below)
        as_many = len(row) == len(below) or 2 <= len(below) < len(row) <= len(reading)
        if len(row) > 1 and as_many and not _any_number(row) and _any_number(below):
            return k - 1 if k and _are_units(row, _cut(rows[k - 1], 1)) else k
    return None


def _header(lines: Sequence[str], first: int) -> tuple[int, str]:
    """Return the line of the header and what parts its cells; `first` is the first line that is no comment."""
    for mark in ";\t":  # no header, and decimal commas
        cells = _cut(_parted(lines[first], mark), 1)
        if len(cells) > 1 and all(map(NUMBER.fullmatch, cells)):
            return first, mark
    delimiter = max(",;\t", key=lines[first].count)
    beginning = [i for i in range(first, len(lines)) if lines[i].strip() and lines[i].lstrip()[0] != "#"]
    beginning = beginning[: _LONGEST_PREAMBLE + 1]
    head, below = (_cut(_parted(lines[i], delimiter), 1) for i in (beginning * 2)[:2])
    readings = _any_number(below) or _are_units(below, head)
    groups = not all(cell.strip() for cell in head[1:])  # which `heads` refuses, with what to do
    if len(beginning) == 1 or (len(head) == len(below) > 1 and (readings or groups)):
        return first, delimiter
    for mark in sorted(";\t, ", key=lambda mark: mark != delimiter):
        row = header_row([_parted(lines[i], mark) for i in beginning])
        if row is not None:
            return beginning[row], mark
    numbers = lines[first].split()
    if len(numbers) > 1 and all(map(NUMBER.fullmatch, numbers)) and not lines[first].count(";"):
        return first, " "
    return first, delimiter


def _parted(line: str, delimiter: str) -> tuple[str, ...]:
    if line.count(delimiter) > data_file.MOST_COLUMNS:
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


def _any_number(cells: Sequence[str]) -> bool:
    return any(map(NUMBER.fullmatch, cells))


def _are_units(row: Sequence[str], names: Sequence[str]) -> bool:
    """Return whether a row holds units alone, and `names` may stand above it: none empty or a date, nor all units."""
    of_units, names_too = (
        all(is_unit(cell.strip().strip("[](){}<>").strip()) for cell in cells if cell.strip()) for cells in (row, names)
    )
    words = all(cell.strip() and not cell.strip()[0].isdigit() for cell in names)
    return of_units and len(names) == len(row) and words and not names_too


def _check_cells(count: int) -> None:
    if count > data_file.MOST_CELLS:
        raise ValueError(f"has {count} cells, and at most {data_file.MOST_CELLS} are read; {_SMALLER}")


def read_excel(path: Path) -> tuple[Table, tuple[str, ...]]:
    """Return the table, and a note where other sheets hold something too. Raises `ValueError`."""
    try:
        import openpyxl
    except ImportError:
        raise DataError(
            "is an Excel file; reading it needs openpyxl: pip install 'calibench[excel]', or save it as CSV"
        ) from None
    content = data_file.read_whole(path, data_file.LARGEST_TEXT, _SMALLER_SHEET)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as packed:
            unpacked = sum(part.file_size for part in packed.infolist())
        if unpacked > max(_SMALL, _MOST_TIMES * len(content)):
            raise DataError(
                f"unpacks to {unpacked // len(content)} times its size, and no sheet of readings to more than "
                f"{_MOST_TIMES}; {_SMALLER_SHEET}"
            )
        if unpacked > _LARGEST_UNPACKED:
            most = _LARGEST_UNPACKED // data_file.MEGABYTE
            raise DataError(
                f"unpacks to {unpacked / data_file.MEGABYTE:.0f} MB, and at most {most} MB are read; {_SMALLER_SHEET}"
            )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of styles and extensions that no number depends on
            book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
            sheets = {sheet.title: _rows(sheet) for sheet in book.worksheets}
    except (DataError, MemoryError):
        raise
    except Exception as error:  # openpyxl raises what its XML reader, zipfile and its own checks raise
        raise DataError(
            f"is no Excel file that can be read ({type(error).__name__}: {error}); save it as CSV"
        ) from None

    full = {title: rows for title, rows in sheets.items() if rows}
    if not full:
        raise DataError("the sheets are empty: a header and a row for each reading are needed")
    starts = {title: header_row([row for _, row in rows[:60]]) for title, rows in full.items()}
    title = next((title for title, at in starts.items() if at is not None), next(iter(full)))
    rows, start = full[title], starts[title] or 0
    others = [other for other in full if other != title]
    notes = (f"sheet {title} is read, and not {', '.join(others)}",) if others else ()
    table = table_of(rows[start:], " ".join(" ".join(filter(None, row)) for _, row in rows[:start]), bare=True)
    width = len(table.names) or max(len(row) for _, row in table.rows)  # a sheet keeps no empty cells at a row's end
    return replace(table, rows=tuple((line, (*row, *[""] * (width - len(row)))) for line, row in table.rows)), notes


def _rows(sheet: Any) -> list[tuple[int, tuple[str, ...]]]:
    """Return the rows of a sheet that hold something, with their numbers, as text."""
    rows: list[tuple[int, tuple[str, ...]]] = []
    count = 0
    sheet.reset_dimensions()  # what the file says of its width: each row is as wide as its own last cell
    for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        count += len(row)
        if number > _MOST_ROWS:  # the rows before that are not there cost time too
            raise DataError(f"has a row after {_MOST_ROWS}, the last of a sheet; {_SMALLER_SHEET}")
        if count > data_file.MOST_CELLS:
            raise DataError(f"has more than {data_file.MOST_CELLS} cells, and no more are read; {_SMALLER_SHEET}")
        cells = tuple(_text(cell) for cell in row)
        if any(cells):
            data_file.check_columns(max(i for i, cell in enumerate(cells) if cell) + 1)
            rows.append((number, cells))
    return rows


def _text(cell: Any) -> str:
    if isinstance(cell, datetime):
        return cell.isoformat()
    if isinstance(cell, timedelta):
        return repr(cell.total_seconds())
    if isinstance(cell, int | float):
        return repr(cell)
    return "" if cell is None else str(cell)
