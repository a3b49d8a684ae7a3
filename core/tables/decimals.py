"""Decimal commas in the cells of a table: read where no cell of the file has a decimal point, refused elsewhere.

A number with a comma in a file with points may be one with a mark between thousands, so nobody guesses. Where commas
part the cells, no cell holds a decimal comma.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

_COMMA = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?")
_POINT = re.compile(r"[+-]?(\d+\.\d*|\.\d+)([eE][+-]?\d+)?")


def with_points(columns: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    """Return the cells of the columns, name -> cells without blanks around them, with a point for the decimal comma.

    >>> with_points({"x": ["0,5", "2"]})
    {'x': ['0.5', '2']}

    Raises `ValueError` with the columns and the readings where some numbers have a comma and some a point.
    """
    comma, point = _first(columns, _COMMA), _first(columns, _POINT)
    if comma is None:
        return {name: list(column) for name, column in columns.items()}
    if point is not None:
        raise ValueError(
            f"column {comma[0]}, reading {comma[1]}: {comma[2]!r} has a decimal comma, and column {point[0]}, reading "
            f"{point[1]}: {point[2]!r} a decimal point; write one of them throughout"
        )
    return {
        name: [cell.replace(",", ".") if _COMMA.fullmatch(cell) else cell for cell in column]
        for name, column in columns.items()
    }


def _first(columns: Mapping[str, Sequence[str]], mark: re.Pattern[str]) -> tuple[str, int, str] | None:
    """Return the column, the number of the reading from 1 on, and the first cell that `mark` matches."""
    for name, column in columns.items():
        for i, cell in enumerate(column):
            if mark.fullmatch(cell):
                return name, i + 1, cell
    return None
