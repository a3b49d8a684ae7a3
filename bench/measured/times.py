"""Columns of times: ISO times with their date, and times of day without one; both become seconds.

A time of day is `14:03:22.5` or `14:03`. One that is more than twelve hours before the one above it is of the next day.
A column whose unit, stated or declared, is no unit of time holds angles in hours or degrees, which are not read here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, final

import numpy as np

from calibench.bench.measured.units import COLUMN_UNITS
from calibench.core.counted import counted
from calibench.core.tables.no_value import no_value
from calibench.core.tables.units import factor_to_base, is_unit
from calibench.core.words import shortened
from calibench.discrepancy import DataError
from calibench.discrepancy.labels import COLUMNS_OF_NAMES, columns_of_numbers

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
        told = shortened(column[others[0]])
        raise DataError(f"column {name}, reading {others[0] + 1}: {told!r} is no time of day such as 14:03:22.5")
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
        if told := _OF_DAY.fullmatch(cell):
            hours, minutes, rest = told.groups("0")
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
            told = shortened(cell)
            raise DataError(
                f"column {name}, reading {i + 1}: {told!r} is no time such as 2026-03-01T12:30:05"
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
