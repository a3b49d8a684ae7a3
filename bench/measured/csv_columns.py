"""Measured data as CSV: a header with units in brackets, a row a reading, and a first line of metadata if wanted."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibench.core.csv_table import read_table
from calibench.core.data_file import MOST_LETTERS
from calibench.core.words import shortened
from calibench.discrepancy import DataError
from calibench.discrepancy.labels import columns_of_numbers

_INTEGER = re.compile(r"[+-]?\d{1,18}")
_EMPTY = {"", "nan", "na", "null", "none"}
_TRUTH = {"true": True, "false": False}


def read_csv(path: Path, text: Collection[str]) -> tuple[dict[str, Any], dict[str, str], str]:
    """Return columns, the units their heads state, and the comment lines before the header, as one line.

    Columns in `text` hold words; any other holds numbers, true and false, or words if no cell of it is a number.
    Cells are parted by a comma, a semicolon or a tab; an empty one is NaN.
    """
    table = read_table(path)
    if not table.rows:
        raise DataError("holds a header and no readings")
    for number, (_, row) in enumerate(table.rows, start=1):
        if len(row) != len(table.names):
            raise DataError(f"reading {number} has {len(row)} cells, the header {len(table.names)}")
    cells = zip(*(row for _, row in table.rows), strict=True)
    columns = {
        name: _column(name, column, name in text) for name, column in zip(table.names, cells, strict=True) if name
    }
    return columns, dict(table.units), table.comment


def csv_lines(columns: Mapping[str, Any], units: Mapping[str, str], comment: str) -> str:
    """Return `columns` under their heads below `comment`, numbers so that they are read back to the last bit."""
    file = io.StringIO()
    file.write(f"{comment}\n")
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([f"{name} [{units[name]}]" if name in units else name for name in columns])
    writer.writerows(zip(*(_cells(column) for column in columns.values()), strict=True))
    return file.getvalue()


def _column(name: str, cells: Sequence[str], is_text: bool) -> Any:
    stripped = [cell.strip() for cell in cells]
    if is_text:
        return as_words(name, stripped)
    if all(_INTEGER.fullmatch(cell) for cell in stripped):
        return np.array([int(cell) for cell in stripped], dtype=np.int64)
    if all(cell.lower() in _TRUTH for cell in stripped):
        return np.array([_TRUTH[cell.lower()] for cell in stripped], dtype=bool)
    values, wrong = np.full(len(stripped), np.nan), []
    for i, cell in enumerate(stripped):
        try:
            values[i] = float(cell)
        except ValueError:
            if cell.lower() not in _EMPTY:
                wrong.append(i)
    if not wrong:
        return values
    if len(wrong) == sum(cell.lower() not in _EMPTY for cell in stripped) and not _holds_numbers(name):
        return as_words(name, stripped)
    i = wrong[0]
    comma = "; write the decimal point as a point" if re.fullmatch(r"[+-]?\d+,\d+", stripped[i]) else ""
    raise DataError(f"column {name}, reading {i + 1}: {shortened(stripped[i])!r} is no number{comma}")


def as_words(name: str, words: Sequence[str]) -> Any:
    """Return a column of words as an array, whose cells are all as wide as the widest; raise `DataError` beyond it."""
    widest = max(map(len, words), default=0)
    if widest * len(words) > MOST_LETTERS:
        raise DataError(f"column {name}: a cell has {widest} characters; words are needed, or leave the column out")
    return np.array(words, dtype=str)


def _holds_numbers(name: str) -> bool:
    return name in columns_of_numbers()


def _cells(column: Any) -> list[str]:
    if column.dtype.kind == "f":
        return ["" if np.isnan(value) else repr(value) for value in column.tolist()]
    if column.dtype.kind == "b":
        return ["true" if value else "false" for value in column.tolist()]
    return [str(value) for value in column.tolist()]
