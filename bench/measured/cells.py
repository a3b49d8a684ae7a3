"""The meaning of the cells of one column: numbers with a point or a comma, true and false, times, words, or nothing.

A cell that means "no value" (n/a, NaN, -, #NV, or nothing) is NaN. A decimal comma is read where commas do not separate
the cells, and never where the same file has decimal points too. Times become seconds.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from calibench.bench.measured.times import Seconds, times_of
from calibench.core.tables.data_file import MOST_LETTERS
from calibench.core.tables.decimals import with_points
from calibench.core.tables.no_number import way_out
from calibench.core.tables.no_value import no_value
from calibench.core.words import shortened
from calibench.discrepancy import DataError
from calibench.discrepancy.labels import COLUMNS_OF_NAMES, columns_of_numbers

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
    if len(wrong) == sum(not no_value(cell) for cell in stripped) and not _holds_numbers(name):
        return as_words(name, stripped)
    i = wrong[0]
    told = f"column {name}, reading {i + 1}: {shortened(stripped[i])!r} is no number"
    raise DataError(f"{told}{way_out(stripped[i])}")


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


def _holds_numbers(name: str) -> bool:
    return name in columns_of_numbers()
