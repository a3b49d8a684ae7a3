"""Rows that are exact copies of others: a copy is no repeat, and noise estimated from copies is too small.

Two readings of one pose differ by noise. On a scale with steps d they agree by chance with probability d / (2 sqrt(pi)
sigma). So the steps of the columns that carry noise, and their stated noise, give the expected number of equal rows.
A column that only numbers the rows is not compared, and of times the day is not: a block of times of day that is pasted
again is read as the next day. Data with equal rows are refused where that number is zero. Where there are more equal
rows than expected, the copies are left out, with a note.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from calibench.core.notes import Code, Note
from calibench.core.words import plain
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.discrepancy.model.roles import columns_of, inputs_of, roles_of
from calibench.discrepancy.registries import description_of

_BOOKKEEPING = ("pose_id", "visit_id", "repeat", "split", "valid", "reading_place")
_SAME = "are the same in every column"
_IMPOSSIBLE = 1e-3  # expected number of equal rows, below which an equal row must be a copy
_UNLIKELY = 1e-3
_SHOWN = 4  # pairs in a message
_TELLING = 8  # values by which a column is recognised under another name
_BY_ONE = 0.75  # of the steps of a column that numbers the rows with leaps: the least part that is one
_NUMBERED = re.compile(r"(\D*)(\d{1,18})")
_DAY = 86400.0  # s
_MOST_GAPS = 2000  # differences of a column that are used to find its step


def copied_rows(
    data: MeasuredData, rows: NDArray[np.intp], formulation: Formulation
) -> tuple[NDArray[np.bool_], Note | None]:
    """Return which rows of `data` are copies to be left out, (n,), and a note; none elsewhere.

    `rows` are their numbers in the file. Raises `DataError` with the rows where equal rows cannot be (the time is the
    same, or a column that carries noise is continuous), and where copies make the times of the other rows unsure.
    """
    counters = _counters(data, rows, formulation)
    times = [name for name in _times(data, formulation) if name not in counters]
    first, again = _pairs(data, counters, times)
    copies = np.zeros(len(data), dtype=bool)
    if not len(again):
        return copies, None
    pairs = ", ".join(f"{rows[k]} and {rows[i]}" for i, k in list(zip(again, first))[:_SHOWN])
    pairs += f" and {len(again) - _SHOWN} more" if len(again) > _SHOWN else ""
    distinct = np.setdiff1d(np.arange(len(data)), again)
    same = f"{_SAME} but {', '.join(counters)}, which counts them" if len(counters) == 1 else _SAME
    later = any(not np.array_equal(data[name][again], data[name][first]) for name in times)
    same += ", the times of day too" if later else ""
    way_out = "leave out the copies, or state their own time of reading"
    if not later and "t_s" in data and len(np.unique(data["t_s"][distinct])) == len(distinct) > 1:
        raise DataError(f"{data.name}: rows {pairs} {same}, t_s too: copies; {way_out}")
    expected = _repeats(formulation.data) * _chance(data.rows(distinct), formulation)
    if expected < _IMPOSSIBLE:
        raise DataError(
            f"{data.name}: rows {pairs} {same}, to the last digit, which noise does not allow: copies; {way_out}"
        )
    if pdtrc(len(again) - 1, expected) > _UNLIKELY:
        text = (
            f"rows {pairs} {same}: on a coarse scale chance may do that, and so would copies, "
            "from which too small a noise is learned; leave out what was not read"
        )
        return copies, Note(Code.ROWS_EQUAL, text, rows=tuple(str(row) for row in rows[again]))
    if later:
        raise DataError(
            f"{data.name}: rows {pairs} {same}: copies, at which the times begin another day, and all after them may "
            "be of a wrong one; leave out the copies, or state times with their date"
        )
    copies[again] = True
    text = (
        f"rows {pairs} {same}: {len(again)} copies, more than the {plain(expected, 2)} that chance has, "
        "are left out, and no noise is learned from them"
    )
    return copies, Note(
        Code.ROWS_COPIED, text, rows=tuple(str(row) for row in rows[again]), values={"expected": float(expected)}
    )


def step_of(values: NDArray[Any]) -> float:
    """Return the step of the scale that all `values` stand on, 0 where there is none such.

    >>> round(step_of(np.array([0.012, 0.015, 0.021, 0.04])), 6), step_of(np.sqrt(np.arange(9.0)))
    (0.001, 0.0)
    """
    found = np.unique(values[np.isfinite(values)].astype(float))
    if len(found) < 3:
        return np.inf  # two values determine no scale
    gaps = np.sort(np.diff(found))[:_MOST_GAPS]
    tiny = 1e-9 * float(np.ptp(found)) + 16 * float(np.spacing(np.abs(found).max()))
    step = float(gaps[-1])
    for gap in gaps.tolist():
        step = _common(step, gap, tiny)
        if step < 1e3 * tiny:
            return 0.0
    return step


def _common(a: float, b: float, tiny: float) -> float:
    """Return the largest number of which both are multiples, within `tiny`."""
    while b > tiny:
        rest = a % b
        a, b = b, rest if b - rest > tiny else 0.0
    return a


def _repeats(data: MeasuredData) -> int:
    """Return how many pairs of rows were read at one pose; the number of rows where the data do not tell poses."""
    if "visit_id" not in data:
        return len(data)
    count = np.unique(data["visit_id"], return_counts=True)[1]
    return int((count * (count - 1) // 2).sum()) or len(data)


def _chance(data: MeasuredData, formulation: Formulation) -> float:
    """Return the probability that two readings of one pose agree in all columns that carry noise.

    A reading that was computed from several columns has no step in the file, so it does not count.
    """
    chance = 1.0
    for name in formulation.readings:
        column = _in_file(name, data, formulation)
        if column is not None:
            sigma = float(np.median(np.asarray(formulation.sigma[name])))
            chance *= min(1.0, step_of(column) / (2 * np.sqrt(np.pi) * sigma))
    return chance


def _in_file(name: str, data: MeasuredData, formulation: Formulation) -> NDArray[Any] | None:
    """Return the column of the file that a reading comes from, perhaps under another name.

    It is None for a reading that was computed from several columns.
    """
    if name in data:
        return data[name] if data[name].dtype.kind in "iuf" else None
    if name not in formulation.data:
        return None
    made = formulation.data[name]
    if made.dtype.kind not in "iuf" or len(np.unique(made)) < _TELLING:
        return None
    numbers = (column for column in data.columns.values() if column.dtype.kind in "iuf")
    return next((column for column in numbers if np.isin(made, column).all()), None)


def _spoken_of(formulation: Formulation) -> frozenset[str]:
    """Return the columns that count as readings even where they increase by one each row, such as months."""
    roles = roles_of(formulation)
    return frozenset((*formulation.readings, *inputs_of(formulation), *roles.columns, roles.time))


def _times(data: MeasuredData, formulation: Formulation) -> tuple[str, ...]:
    """Return the columns of numbers that are times in seconds."""
    named = {"t_s", roles_of(formulation).time, *(name for name, unit in data.units.items() if unit == "s")}
    return tuple(name for name in data.columns if name in named and np.asarray(data[name]).dtype.kind in "iuf")


def _pairs(
    data: MeasuredData, but: Collection[str], times: Collection[str]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows that equal an earlier row, and for each of them that earlier row, two arrays (m,).

    The columns in `but` are not compared, and of `times` the time of day alone.
    """
    rows = np.arange(len(data))
    alike = np.zeros(len(data), dtype=np.int64)
    for name, column in data.columns.items():
        if name in _BOOKKEEPING or name in but:
            continue
        column = np.round(np.mod(column, _DAY), 6) if name in times else column
        own = np.unique(column, return_inverse=True)[1].reshape(-1)
        _, first, alike = np.unique(alike * (own.max() + 1) + own, return_index=True, return_inverse=True)
        alike = alike.reshape(-1)
        if len(first) == len(data):
            return rows[:0], rows[:0]
    if not alike.any():
        return rows[:0], rows[:0]
    again = rows[first[alike] != rows]
    return first[alike][again], again


def _counters(data: MeasuredData, rows: NDArray[np.intp], formulation: Formulation) -> tuple[str, ...]:
    """Return the columns that only number the rows; `rows` are their numbers in the file.

    A column that the formulation speaks of numbers nothing, and a time or another column that the machine knows does so
    only where it counts from row to row by one.
    """
    known = {*columns_of(roles_of(formulation)), *(q.name for q in description_of(data.machine).columns)}
    known |= set(_times(data, formulation))
    names = (name for name in data.columns if name not in _spoken_of(formulation) and name not in _BOOKKEEPING)
    return tuple(name for name in names if _numbers_rows(data[name], rows, name in known))


def _numbers_rows(column: NDArray[Any], rows: NDArray[np.intp], by_one: bool) -> bool:
    """Return whether whole numbers, or words that end in them (`R17`), count the rows; `by_one`: each by one.

    Else the rows are counted as they stand, or as they stood in the file, by any step. Who pastes a block numbers it on
    from elsewhere, so a few leaps are allowed where the step is one.
    """
    count = _counts(column) if len(column) > 1 else None
    if count is None:
        return False
    steps, apart = np.diff(count), np.diff(rows)
    if by_one or not (steps > 0).all():
        return bool((steps == 1).all() and column.dtype.kind in "iu")
    regular = (steps == steps[0]).all() or (steps * apart[0] == steps[0] * apart).all()
    return bool(regular or np.mean(steps == 1) >= _BY_ONE)


def _counts(column: NDArray[Any]) -> NDArray[np.int64] | None:
    """Return whole numbers, or those that words of one form end in, (n,); None for a column of anything else."""
    if column.dtype.kind in "iu":
        return column.astype(np.int64)
    if column.dtype.kind != "U":
        return None
    forms, numbers = set(), []
    for word in column.tolist():
        if (found := _NUMBERED.fullmatch(word)) is None:
            return None
        forms.add(found[1])
        numbers.append(int(found[2]))
    return np.array(numbers, dtype=np.int64) if len(forms) == 1 else None
