"""Measured data as CSV: a header with units in brackets, a row a reading, and a first line of metadata if wanted."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calibench.bench.measured.blocks import blocks_of
from calibench.bench.measured.cells import columns_of, like_numbers
from calibench.bench.measured.found import Found
from calibench.core.tables.csv_table import Table, read_table
from calibench.core.tables.units import is_unit
from calibench.core.words import shortened
from calibench.discrepancy import DataError

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
            told = f"reading {number} has {len(row)} cells, the {'header' if table.names else 'first'} {len(names)}"
            raise DataError(f"{told}; it is line {line} of the file: {way_out}")
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
    return Found(columns, units, table.comment, notes, of_day)


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
