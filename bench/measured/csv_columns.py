"""Measured data as CSV: a header with units in brackets, a row a reading, and a first line of metadata if wanted.

Blocks of rows that empty lines part in a text file: one table, which is told, or several, which are refused.

The meaning of the cells of one column: numbers with a point or a comma, true and false, times, words, or nothing.

A cell that means "no value" (n/a, NaN, -, #NV, or nothing) is NaN. A decimal comma is read where commas do not separate
the cells, and never where the same file has decimal points too. Times become seconds.

Columns of times: ISO times with their date, and times of day without one; both become seconds.

A time of day is `14:03:22.5` or `14:03`. One that is more than twelve hours before the one above it is of the next day.
A column whose unit, stated or declared, is no unit of time holds angles in hours or degrees, which are not read here.

`Found`: the content of a file of measured data, whatever its format, before names and units are interpreted.

Units of measured columns, as the machines declare them; any other column is in the unit that its file states.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, final

import numpy as np

from calibench.core.notes import Code, Note
from calibench.core.tables.cells import factor_to_base, is_unit, no_value, way_out, with_points
from calibench.core.tables.csv_table import Table, read_table
from calibench.core.tables.data_file import LARGEST_TEXT, MOST_LETTERS, read_whole, text_of
from calibench.core.words import counted, shortened
from calibench.discrepancy import DataError
from calibench.discrepancy.labels import COLUMNS_OF_NAMES, column_units, columns_of_numbers
from calibench.discrepancy.registries import description_of, descriptions

_READ = {"1", "-", ""}  # cells that a row of readings may have as well as one of units


def read_csv(path: Path, text: Collection[str]) -> Found:
    """Return the columns, the units their heads state, and the comment lines before the header, as one line.

    Columns in `text` hold words; any other holds numbers, true and false, or words if no cell of it is a number.
    Cells are parted by a comma, a semicolon, a tab or spaces; an empty one is NaN. Raises `DataError` for rows that do
    not fit the header.
    """
    table = read_table(path, bare=True)
    blocks = blocks_of(path, table)
    return of_table(replace(table, notes=(*table.notes, *blocks)), text)


def of_table(table: Table, text: Collection[str]) -> Found:
    """Return the content of a table of text. Raises `DataError` for rows that do not fit the header."""
    names, units, rows = table.names, dict(table.units), table.rows
    notes = table.notes
    if not names:
        names = tuple(f"column_{k + 1}" for k in range(len(rows[0][1])))
        notes = (
            *notes,
            f"no header: columns are called {names[0]} to {names[-1]}; columns= names them",
        )
    elif rows and (beneath := _units_row(rows[0][1])):
        units = {n: unit for n, unit in zip(names, beneath, strict=False) if unit} | units
        rows = rows[1:]
    if not rows:
        raise DataError("holds a header and no readings; a row for each reading is needed")
    for number, (line, row) in enumerate(rows, start=1):
        if len(row) != len(names):
            commas = table.delimiter == "," and len(row) > len(names)
            way_out = "decimal commas? then part the cells by semicolons" if commas else "mend it, or leave the row out"
            problem = f"reading {number} has {len(row)} cells, the {'header' if table.names else 'first'} {len(names)}"
            raise DataError(f"{problem}; it is line {line} of the file: {way_out}")
    cells = zip(*(row for _, row in rows), strict=True)
    named = {name: column for name, column in zip(names, cells, strict=True) if name}
    columns, times = columns_of(named, text, table.delimiter != ",", units)
    for note in dict.fromkeys(time.note for time in times.values()):
        notes = (*notes, f"{', '.join(name for name, time in times.items() if time.note == note)}: {note}")
    for name in (name for name in columns if name not in text):
        if first := like_numbers(columns[name]):
            notes = (*notes, f"column {name} is read as words: {shortened(first)!r} is no number")
    of_day = frozenset(name for name, time in times.items() if time.of_day)
    units = {n: u for n, u in units.items() if n not in times} | dict.fromkeys(of_day, "s")
    return Found(columns, units, table.comment, tuple(Note(Code.FILE, text) for text in notes), of_day)


def csv_lines(columns: Mapping[str, Any], units: Mapping[str, str], comment: str) -> str:
    """Return `columns` under their heads below `comment`, numbers so that they are read back to the last bit."""
    file = io.StringIO()
    file.write(f"{comment}\n")
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([f"{name} [{units[name]}]" if name in units else name for name in columns])
    writer.writerows(zip(*(_cells(column) for column in columns.values()), strict=True))
    return file.getvalue()


def _units_row(row: tuple[str, ...]) -> tuple[str, ...]:
    """Return the units that stand in a row of their own beneath the header; () where the first row is a reading.

    The unit of what has none is written 1, so a row of nothing but bare ones and dashes is a reading.
    """
    bare = tuple(cell.strip().strip("[](){}<>").strip() for cell in row)
    bracketed = [cell.strip()[:1] in tuple("[({<") for cell in row if cell.strip()]
    is_row = bool(bracketed) and (
        all(bracketed) or (sum(map(bool, bare)) > 1 and all(map(is_unit, filter(None, bare))) and set(bare) - _READ)
    )
    return tuple("" if unit == "-" else unit for unit in bare) if is_row and "-" not in set(bare[:1]) else ()


def _cells(column: Any) -> list[str]:
    if column.dtype.kind == "f":
        return ["" if np.isnan(value) else repr(value) for value in column.tolist()]
    if column.dtype.kind == "b":
        return ["true" if value else "false" for value in column.tolist()]
    return [str(value) for value in column.tolist()]


_NUMBER = re.compile(r"\s*[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?\s*")
_TOLD = 4  # blocks whose lines are told


def blocks_of(path: Path, table: Table) -> tuple[str, ...]:
    """Return a note where empty lines part the rows of a file into blocks, which may be tables of their own.

    A file whose every row stands alone has no blocks. The file is read again only where lines without a row lie
    between rows. Raises `DataError` for a block with a header of its own.
    """
    rows = table.rows
    apart = [k for k in range(1, len(rows)) if rows[k][0] > rows[k - 1][0] + 1 and _any_number(rows[k - 1][1])]
    if not apart:
        return ()
    lines = text_of(read_whole(path, LARGEST_TEXT)).splitlines()
    starts = [k for k in apart if not all(line.strip() for line in lines[rows[k - 1][0] : rows[k][0] - 1])]
    for k in (k for k in starts if k + 1 < len(rows) and _begins_table(rows[k][1], rows[k + 1][1])):
        head = shortened(", ".join(cell.strip() for cell in rows[k][1]))
        raise DataError(
            f"line {rows[k][0]}: a second table begins below an empty line ({head}); give each a file of its own"
        )
    if not starts or len(starts) == len(rows) - 1 > 1:
        return ()
    where = ", ".join(str(rows[k][0]) for k in starts[:_TOLD]) + (", ..." if len(starts) > _TOLD else "")
    later = f"the later one from line {where}" if len(starts) == 1 else f"the later ones from lines {where}"
    said = f"empty lines part the rows into {len(starts) + 1} blocks, {later} on"
    return (f"{said}: they are read as one table; tables that differ need a file each",)


def _begins_table(head: Sequence[str], below: Sequence[str]) -> bool:
    """Tell whether a row among readings is a header: names that differ, above as many cells with a number."""
    names = [cell.strip() for cell in head]
    words = all(names) and not _any_number(names) and len(set(names)) == len(names) > 1
    return words and len(names) == len(below) and _any_number(below)


def _any_number(cells: Sequence[str]) -> bool:
    return any(map(_NUMBER.fullmatch, cells))


_INTEGER = re.compile(r"[+-]?\d{1,18}")
_LIKE_NUMBER = re.compile(r"[+-]?[.,]?\d")
_TRUTH = {"true": True, "false": False, "wahr": True, "falsch": False}


def columns_of(
    cells: Mapping[str, Sequence[str]], text: Collection[str], commas: bool, units: Mapping[str, str]
) -> tuple[dict[str, Any], dict[str, Seconds]]:
    """Return the columns of a file, name -> (n,), and those that were times; those in `text` hold words.

    With `commas` numbers may have a decimal comma. `units` are those that the heads state. Raises `DataError` with the
    column and the reading of a cell that is no number among numbers.
    """
    stripped = {
        name: [cell.strip() if name in text else cell.strip().replace("\u2212", "-") for cell in column]
        for name, column in cells.items()
    }  # U+2212 is the minus of typography
    if commas:
        try:
            numbers = with_points({n: c for n, c in stripped.items() if n not in text})
        except ValueError as error:
            raise DataError(str(error)) from None
        stripped = numbers | {name: column for name, column in stripped.items() if name in text}
        stripped = {name: stripped[name] for name in cells}
    columns: dict[str, Any] = {}
    times: dict[str, Seconds] = {}
    for name, column in stripped.items():
        if name not in text and (found := times_of(name, column, units.get(name))):
            columns[name], times[name] = found.values, found
        else:
            columns[name] = _column(name, column, name in text)
    return columns, times


def _column(name: str, stripped: Sequence[str], is_text: bool) -> Any:
    if is_text:
        return as_words(name, stripped)
    if all(_INTEGER.fullmatch(cell) for cell in stripped):
        return np.array([int(cell) for cell in stripped], dtype=np.int64)
    if all(cell.lower() in _TRUTH for cell in stripped):
        return np.array([_TRUTH[cell.lower()] for cell in stripped], dtype=bool)
    values, wrong = np.full(len(stripped), np.nan), []
    for i, cell in enumerate(stripped):
        try:
            values[i] = float("words" if "_" in cell else cell)  # 1_2 is the name of something, to Python 12
        except ValueError:
            if not no_value(cell):
                wrong.append(i)
    if not wrong:
        return values
    if name in COLUMNS_OF_NAMES:
        return as_words(name, stripped)
    if len(wrong) == sum(not no_value(cell) for cell in stripped) and name not in columns_of_numbers():
        return as_words(name, stripped)
    i = wrong[0]
    what = f"column {name}, reading {i + 1}: {shortened(stripped[i])!r} is no number"
    raise DataError(f"{what}{way_out(stripped[i])}")


def like_numbers(column: Any) -> str:
    """Return the first word of a column, (n,), of which all words begin like numbers; "" for any other column."""
    words = [word for word in column.tolist() if not no_value(word)] if column.dtype.kind == "U" else []
    return words[0] if words and all(map(_LIKE_NUMBER.match, words)) else ""


def as_words(name: str, words: Sequence[str]) -> Any:
    """Return a column of words as an array, whose cells are all as wide as the widest; raise `DataError` beyond it."""
    check_letters(name, max(map(len, words), default=0), len(words))
    return np.array(words, dtype=str)


def check_letters(name: str, widest: int, rows: int) -> None:
    """Raise `DataError` for a column whose words, each as wide as the widest, would take too much room."""
    if widest * rows > MOST_LETTERS:
        raise DataError(f"column {name}: a cell has {widest} characters; words are needed, or leave the column out")


_TIME = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d{1,9})?)?\s*(Z|[+-]\d\d:?\d\d)?")
_OF_DAY = re.compile(r"([01]?\d|2[0-3]):([0-5]\d)(?::([0-5]\d(?:[.,]\d{1,9})?|60(?:[.,]0{1,9})?))?")  # 60: rounded up
_DAY = 86400.0  # s
_FEW = 0.1  # of a column: so many cells among times of day are mistakes, and more are words
_DO = "write all of them alike"


@final
@dataclass(frozen=True, eq=False)
class Seconds:
    """A column of times in seconds, (n,), NaN where there is none, with a note; `of_day`: they had no date."""

    values: Any
    note: str
    of_day: bool = False


def times_of(name: str, column: Sequence[str], unit: str | None) -> Seconds | None:
    """Return a column of times in seconds, None for one of other cells; `unit` is what its head states.

    Raises `DataError` for a cell that is no time among times, and where some times have a date and some have none.
    """
    first = next((cell for cell in column if not no_value(cell)), "")
    if _TIME.fullmatch(first):
        return Seconds(_from_earliest(name, column), "times, turned into seconds from the earliest")
    if not _OF_DAY.fullmatch(first) or name in COLUMNS_OF_NAMES or not _may_be_time(name, unit):
        return None
    others = [i for i, cell in enumerate(column) if not (no_value(cell) or _OF_DAY.fullmatch(cell))]
    dated = next((i for i in others if _TIME.fullmatch(column[i])), None)
    if dated is not None:
        raise DataError(
            f"column {name}, reading {dated + 1}: {column[dated]!r} has a date, and {first!r} has none; {_DO}"
        )
    if len(others) > _FEW * len(column) and name not in columns_of_numbers():
        return None  # words, one of which looks like a time
    if others:
        word = shortened(column[others[0]])
        raise DataError(f"column {name}, reading {others[0] + 1}: {word!r} is no time of day such as 14:03:22.5")
    values, nights = seconds_of_day(column)
    over = f", on over {counted(nights, 'midnight')}" if nights else ""
    return Seconds(values, f"times of day, turned into seconds from the first{over}", True)


def seconds_of_day(column: Sequence[str]) -> tuple[Any, int]:
    """Return times of day as seconds from the first, (n,), NaN where there is none, and how often midnight passes.

    >>> seconds_of_day(["23:59:58.5", "-", "0:01"])
    (array([ 0. ,  nan, 61.5]), 1)
    """
    found = np.full(len(column), np.nan)
    for i, cell in enumerate(column):
        if time := _OF_DAY.fullmatch(cell):
            hours, minutes, rest = time.groups("0")
            found[i] = 3600 * int(hours) + 60 * int(minutes) + float(rest.replace(",", "."))
    known = np.flatnonzero(~np.isnan(found))
    nights = np.cumsum(np.diff(found[known], prepend=found[known[0]]) < -_DAY / 2)
    found[known] += _DAY * nights - found[known[0]]
    return found, int(nights[-1])


def _from_earliest(name: str, column: Sequence[str]) -> Any:
    """Return ISO times as seconds from the earliest, (n,), NaN where there is none."""
    times: list[datetime | None] = []
    for i, cell in enumerate(column):
        if no_value(cell):
            times.append(None)
            continue
        if _OF_DAY.fullmatch(cell):
            raise DataError(f"column {name}, reading {i + 1}: {cell!r} has no date, and other times have one; {_DO}")
        try:
            times.append(datetime.fromisoformat(cell.replace(",", ".").replace(" ", "T", 1).replace(" ", "")))
        except ValueError:
            word = shortened(cell)
            raise DataError(
                f"column {name}, reading {i + 1}: {word!r} is no time such as 2026-03-01T12:30:05"
            ) from None
    known = [time for time in times if time is not None]
    if len({time.tzinfo is None for time in known}) > 1:
        raise DataError(f"column {name}: some times state their zone and some do not; {_DO}")
    start = min(known)
    return np.array([np.nan if time is None else (time - start).total_seconds() for time in times])


def _may_be_time(name: str, unit: str | None) -> bool:
    """Return whether nothing says that the column is another quantity; [h] may be hours of an angle."""
    if name in columns_of_numbers() and COLUMN_UNITS.get(name) != "s":
        return False
    return unit is None or not is_unit(unit) or (factor_to_base(name, unit)[0] == "s" and unit.strip() != "h")


@final
@dataclass(frozen=True)
class Found:
    """Columns name -> (n,), the units stated of them, what stands before the header or as metadata, and notes.

    `of_day` are the columns that were times of day, such as 14:03:22.
    """

    columns: dict[str, Any]
    units: Mapping[str, str]
    said: str = ""
    notes: tuple[Note, ...] = ()
    of_day: frozenset[str] = frozenset()


COLUMN_UNITS = MappingProxyType(column_units())


def units_of(machine: str) -> dict[str, str]:
    """Return column -> unit of the files of one machine, as it declares them; nothing for one that declares nothing."""
    return {column.name: column.unit for column in description_of(machine).columns if column.unit}


def factor(column: str, unit: str, machine: str = "") -> tuple[str, float]:
    """Return the unit in which `column` of `machine` is kept and the factor that turns `unit` into it.

    >>> factor("x", "m")
    ('mm', 1000.0)

    Raises `ValueError` with the column, the unit, the choices and the way out for one that is unknown or of another
    kind; a machine whose files keep their own units takes any. The sensors of a machine that declares no columns may
    want another unit of the same kind (`Sensor.unit`).
    """
    if machine in descriptions() and description_of(machine).own_units:
        return unit, 1.0
    needed = (units_of(machine) if machine in descriptions() else {}) if machine else dict(COLUMN_UNITS)
    try:
        return factor_to_base(column, unit, needed.get(column))
    except ValueError as error:
        way_out = f'units={{"{column}": "UNIT"}} states it where the file cannot be changed'
        raise ValueError(f"{error}; {way_out}") from None
