"""The best values of cells as a terminal has them: what is above f*, or themselves, all of one precision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

_SMALL, _LARGE = 1e-3, 1e6  # between which a number is read best without a power of ten


def best_texts(cells: Sequence[Mapping[Any, Any]], *columns: str) -> list[list[str]]:
    """Return the best values in `columns` of rows of `bench.statistics.summary.summary` as a terminal has them: f* and
    what is above it, or themselves, all of one precision.

    That is six digits where no value is very small or large; three and a power of ten where all are; six and a power
    where some are.

    >>> known = {"minimum": -3.2, "unit": "V", "noisy": False}
    >>> unknown = known | {"minimum": float("nan"), "unit": ""}
    >>> best_texts([known | {"best_median": -3.1999}, unknown | {"best_median": -3.1999}], "best_median")
    [['f*+1.0e-04 V'], ['-3.19990']]
    >>> best_texts([unknown | {"best_median": value} for value in (12.1, 6.184e-21)], "best_median")
    [['1.21000e+01'], ['6.18400e-21']]
    """
    gaps = [_least_told(cell) for cell in cells]
    plain = [
        abs(float(cell[column]))
        for cell, gap in zip(cells, gaps, strict=True)
        for column in columns
        if gap is None or not isfinite(cell[column])
    ]
    usual = [_SMALL <= value < _LARGE for value in plain if isfinite(value) and value]
    form = "#.6g" if all(usual) else ".5e" if any(usual) else ".2e"
    return [
        [_best_text(float(cell[column]), gap, form, str(cell["unit"])) for column in columns]
        for cell, gap in zip(cells, gaps, strict=True)
    ]


def _least_told(cell: Mapping[Any, Any]) -> float | None:
    """Return f* where values are told as what is above it, else None."""
    least = float(cell["minimum"])
    return least if isfinite(least) and least and not cell["noisy"] else None


def _best_text(value: float, least: float | None, form: str, unit: str) -> str:
    told = f"{value:{form}}" if least is None or not isfinite(value) else f"f*{value - least:+.1e}"
    return f"{told} {unit}" if unit else told
