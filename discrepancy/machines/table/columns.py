"""The columns of a table: which hold numbers, those of earlier rows beside them, and how fast each one changes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import suggest
from calibench.discrepancy.model.formulations.constraints import BOOKKEEPING
from calibench.discrepancy.model.measured.data import DataError, MeasuredData
from calibench.problems.base import Array

RATE = "rate of "  # before a column: its derivative in time
_OF_ROWS = (*BOOKKEEPING, "split", "place_x", "place_y")
_MOST_BACK = 20


def numbers_of(data: MeasuredData) -> tuple[str, ...]:
    """Return the columns of numbers that describe a reading."""
    return tuple(c for c in data.columns if c not in _OF_ROWS and np.issubdtype(np.asarray(data[c]).dtype, np.number))


def known(data: MeasuredData, what: str, *names: str) -> None:
    """Raise `DataError` for a name that is no column of numbers."""
    for name in names:
        if name not in numbers_of(data):
            raise DataError(f"{data.name}: {what}={name}: no column of numbers; {suggest(name, numbers_of(data))}")


def with_earlier(data: MeasuredData, names: tuple[str, ...], back: int) -> MeasuredData:
    """Return the rows from number `back` on, with `u_1`, `u_2`, ...: the column u one, two, ... rows earlier."""
    if not 0 <= back <= min(_MOST_BACK, len(data) - 2):
        raise DataError(f"{data.name}: machine.back={back}: 0 to {min(_MOST_BACK, len(data) - 2)} rows can be meant")
    if not back:
        return data
    if "valid" in data or "visit_id" in data:
        raise DataError(f"{data.name}: machine.back= needs rows that follow each other: no column valid, no visits")
    n = len(data)
    earlier = {f"{u}_{k}": data[u][back - k : n - k] for u in names for k in range(1, back + 1)}
    taken = sorted({*earlier} & {*data.columns})
    if taken:
        raise DataError(f"{data.name}: machine.back={back} makes a column {taken[0]}, which there is; rename that one")
    return data.rows(np.arange(n) >= back).with_columns(earlier)


def with_rates(data: MeasuredData, names: tuple[str, ...], clock: str) -> MeasuredData:
    """Return the data with the derivative of each column in the column `clock`; as they are without a clock."""
    if not clock or len(data) < 3:
        return data
    t, at = np.unique(np.asarray(data[clock], dtype=float), return_inverse=True)
    if len(t) < 3:
        return data
    rates: dict[str, Any] = {}
    for name in names:
        if f"{RATE}{name}" not in data:
            rates[f"{RATE}{name}"] = np.gradient(_means(np.asarray(data[name], dtype=float), at, len(t)), t)[at]
    return data.with_columns(rates)


def _means(column: Array, at: NDArray[np.intp], count: int) -> Array:
    return np.asarray(np.bincount(at, column, count) / np.bincount(at, minlength=count))
