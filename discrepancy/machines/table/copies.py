"""A column that is another one in other numbers: in another unit, converted, or corrected in some rows.

Tables of calibration hold it often: volts beside what was computed from them, centimetres beside inches, grams beside
kilograms. What is measured follows such a column of itself better than any cause, and it is none.
"""

from __future__ import annotations

import numpy as np

from calibench.core.counted import counted, plain
from calibench.problems.base import Array

_LEAST_VALUES = 8  # of a column: what has fewer is a setting of the machine
_MOST_OFF = 0.05  # of the measured column's standard deviation: a scale that is coarser tells nothing
_LEAST_ALIKE = 0.75  # of the rows: a correction changes some
_ROUNDED = 0.55  # of the step of the last digit: what rounding moves a number by, and a little
_MOST_DIGITS = 12


def said_again(name: str, y: Array, column: str, c: Array, alike: float = _LEAST_ALIKE) -> str:
    """Return in words that `y` is a line of `c` in the last digits of both, (n,) each; "" where it is none.

    `alike` is the share of the rows in which it has to be.
    """
    y, c = np.asarray(y, dtype=float), np.asarray(c, dtype=float)
    if len(np.unique(c)) < _LEAST_VALUES or not (np.ptp(y) and np.all(np.isfinite(c + y))):
        return ""
    order = np.argsort(c, kind="stable")
    low, high = order[: len(c) // 2], order[len(c) - len(c) // 2 :]
    apart = c[high] > c[low]
    slope = float(np.median((y[high] - y[low])[apart] / (c[high] - c[low])[apart])) if apart.any() else 0.0
    zero = float(np.median(y - slope * c))
    most = _ROUNDED * (_step(y) + abs(slope) * _step(c)) + 1e-9 * float(np.ptp(y))
    many = int(np.count_nonzero(np.abs(y - slope * c - zero) <= most))
    if not slope or most > _MOST_OFF * np.std(y) or many < alike * len(y):
        return ""
    shift = f" {'-' if zero < 0 else '+'} {plain(abs(zero), 4)}" if abs(zero) > most else ""
    rows = "all rows" if many == len(y) else f"{many} of {counted(len(y), 'row')}"
    return f"{name} is {plain(slope, 4)} times {column}{shift} in {rows}, the same in other numbers"


def _step(column: Array) -> float:
    """Return the step of the last digit in which a column is told, 0 for more digits than are written."""
    for digits in range(_MOST_DIGITS):
        if np.array_equal(np.round(column, digits), column):
            return float(10.0**-digits)
    return 0.0
