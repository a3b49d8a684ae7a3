"""Rows that hold a number in every column that a machine reads, in the units that its sensors declare.

A cell without a number (empty, NaN, infinite, or so large that its powers are infinite) costs its row; how many rows,
and for which columns, is told. A column that is empty in most rows, or holds words, is refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.core.tables.no_number import way_out
from calibench.core.tables.units import between, is_unit
from calibench.discrepancy.model.measured.data import DataError, MeasuredData
from calibench.discrepancy.model.measured.sensor import Sensor
from calibench.problems.base import Array

STILL = "never varies: is it read at all?"  # in the note, by which a page knows it
_LARGEST = 1e60  # of a cell, in any unit
_MOST_MISSING = 0.5  # of the rows: beyond it the column is not measured
_SHOWN = 3  # words of a column in a note
_MOST_GAPS = 0.2  # of the rows that columns which an error may follow cost together: with more one is done without


def complete(data: MeasuredData, columns: Sequence[str], sensors: Sequence[Sensor] = ()) -> MeasuredData:
    """Return the rows of `data` with a finite number in each of `columns`, in the unit of its sensor, and notes.

    Raises `DataError` for a column that is missing, holds words, is of another unit, or is empty in most rows.
    """
    numbers = {name: _numbers(data, name) for name in columns}
    data = _in_their_units(data, numbers, sensors)
    missing = {name: _without_number(data[name]) for name in numbers}
    out = _refuse_empty(data, missing, dict.fromkeys(missing, len(data)))
    data = _told_turns(_told_still(data, columns), columns, sensors) if len(data) > 2 else data
    return _without(data, out, missing)


def with_numbers(data: MeasuredData, needed: Mapping[str, NDArray[np.bool_]]) -> MeasuredData:
    """Return the rows with a finite number in each column where it is `needed`, column -> rows (n,), and a note.

    Raises `DataError` for a column that holds words, or no number in most of the rows that need it.
    """
    missing = {name: rows & _without_number(_numbers(data, name)) for name, rows in needed.items()}
    out = _refuse_empty(data, missing, {name: int(rows.sum()) for name, rows in needed.items()})
    return _without(data, out, missing)


def _refuse_empty(
    data: MeasuredData, missing: Mapping[str, NDArray[np.bool_]], rows: Mapping[str, int]
) -> NDArray[np.bool_]:
    """Return which rows lack a number, (n,); raise `DataError` where most do, of the `rows` that need a column."""
    out = np.any(list(missing.values()), axis=0) if missing else np.zeros(len(data), dtype=bool)
    for name, empty in missing.items():
        if empty.sum() > _MOST_MISSING * rows[name]:
            raise DataError(
                f"{data.name}: column {name} holds no finite number in {int(empty.sum())} of {rows[name]} rows; "
                "measure it, or take a model that does without it"
            )
    if out.all() and len(data):
        raise DataError(f"{data.name}: no row holds a finite number in all of {', '.join(missing)}; complete some")
    return np.asarray(out)


def _without(data: MeasuredData, out: NDArray[np.bool_], missing: Mapping[str, NDArray[np.bool_]]) -> MeasuredData:
    if not out.any():
        return data
    each = [_counted(data, name, empty) for name, empty in missing.items() if empty.any()]
    return data.rows(~out).with_note(_left_out(int(out.sum()), each))


def without_gaps(data: MeasuredData, columns: Sequence[str], directions: Sequence[str] = ()) -> MeasuredData:
    """Return the rows of `data` with a number in each of `columns`, which an error may depend on, and notes.

    Of `directions` that are written in two words one becomes -1 and the other 1, as a note says. At most a fifth of the
    rows is left out. A column that would need more keeps its rows; effects of that column are then not tested, which a
    note and the reason of each such effect say.
    """
    columns = [name for name in dict.fromkeys(columns) if name in data]
    for name in directions:
        data = _as_signs(data, name) if name in columns else data
    for name in columns:
        if data[name].dtype.kind not in "iufb":
            words = ", ".join(repr(str(word)) for word in np.unique(data[name])[:_SHOWN])
            data = data.with_note(
                f"column {name} holds words ({words}), where numbers are needed, of a direction -1 and 1: errors that "
                "follow it are not looked for"
            )
    there = [name for name in columns if data[name].dtype.kind == "f"]
    empty = {name: _without_number(data[name]) for name in there}
    out, told = np.zeros(len(data), dtype=bool), []
    for name, gaps in sorted(empty.items(), key=lambda item: int(item[1].sum())):
        if (out | gaps).mean() > _MOST_GAPS:
            data = data.with_note(f"column {name} {_gaps_of(gaps)}: errors that follow it are not looked for")
        elif gaps.any():
            out = out | gaps
            told.append(_counted(data, name, gaps))
    return data.rows(~out).with_note(_left_out(int(out.sum()), told)) if told else data


def _as_signs(data: MeasuredData, name: str) -> MeasuredData:
    """Return the data with a direction of two words as -1 and 1, in their order; "-" comes before "+"."""
    if data[name].dtype.kind in "iufb":
        return data
    words = np.array([str(word).strip() for word in data[name]])
    told = sorted(set(words.tolist()), key=lambda word: (word != "-", word))
    if len(told) != 2 or "" in told:
        return data
    note = f"column {name}: {told[0]!r} is taken for -1, {told[1]!r} for 1: the sign of what follows it is by these"
    return data.with_columns({name: np.where(words == told[1], 1.0, -1.0)}).with_note(note)


def _without_number(column: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray(~(np.abs(column) < _LARGEST))


def _counted(data: MeasuredData, name: str, empty: NDArray[np.bool_]) -> str:
    huge = int(np.isfinite(np.asarray(data[name], dtype=float)[empty]).sum())
    return f"{name} in {int(empty.sum())}{f' (beyond {_LARGEST:g} in {huge} of them)' if huge else ''}"


def _left_out(count: int, each: Sequence[str]) -> str:
    rows = f"{count} row{'s are' if count > 1 else ' is'}"
    return f"{rows} left out for cells that hold no finite number: {', '.join(each)}"


def _gaps_of(gaps: NDArray[np.bool_]) -> str:
    return f"holds no finite number in {int(gaps.sum())} of {len(gaps)} rows"


def told_gaps(column: NDArray[Any]) -> str:
    """Return why no error can depend on a column that lacks numbers; "" where an error can."""
    if column.dtype.kind not in "iufb":
        return "holds words: numbers are needed"
    gaps = _without_number(column) if column.dtype.kind == "f" else np.zeros(0, dtype=bool)
    return _gaps_of(gaps) if gaps.any() else ""


def _numbers(data: MeasuredData, name: str) -> Array:
    column: NDArray[np.generic] = data[name]
    if column.dtype.kind not in "iuf":
        first = str(column[:1].tolist()[0])
        raise DataError(f"{data.name}: column {name} holds {first!r}: numbers are needed{way_out(first, '')}")
    return np.asarray(column, dtype=float)


def _in_their_units(data: MeasuredData, numbers: dict[str, Array], sensors: Sequence[Sensor]) -> MeasuredData:
    wanted = {sensor.column: sensor.unit for sensor in sensors if sensor.unit}
    turned, notes = {}, []
    for name, stated in data.units.items():
        unit = wanted.get(name)
        if name not in numbers or unit is None or unit == stated:
            continue
        if not is_unit(unit):
            raise DataError(f"{data.name}: column {name} is in {stated}, and its sensor in {unit!r}, which is unknown")
        try:
            factor = between(name, stated, unit)
        except ValueError as error:
            raise DataError(f"{data.name}: {error}") from None
        if factor != 1:
            turned[name] = numbers[name] * factor
            notes.append(f"{name}: in {stated} from the file, turned into {unit}, the unit of its sensor")
    units = {**data.units, **{name: wanted[name] for name in data.units if name in wanted and name in numbers}}
    data = data.with_columns({**{n: c for n, c in numbers.items() if data[n].dtype.kind != "f"}, **turned})
    return data.with_units(units, tuple(notes))


def _told_still(data: MeasuredData, columns: Sequence[str]) -> MeasuredData:
    for name in columns:
        note = f"column {name} {STILL} No effect that follows it can be told"
        if np.ptp(data[name]) == 0 and note not in data.notes:
            data = data.with_note(note)
    return data


def _told_turns(data: MeasuredData, columns: Sequence[str], sensors: Sequence[Sensor]) -> MeasuredData:
    """Return the data with a note where an angle jumps by whole turns, which a model without turns does not follow."""
    radians = {s.column for s in sensors if s.unit == "rad"} | {n for n, unit in data.units.items() if unit == "rad"}
    for name in columns:
        reading = data[name][~_without_number(data[name])]
        if name not in radians or not len(reading) or np.ptp(reading) > 2.02 * np.pi:
            continue
        middle = float(np.angle(np.exp(1j * reading).mean()))
        whole = reading - 2 * np.pi * np.round((reading - middle) / (2 * np.pi))
        note = (
            f"{name} jumps by whole turns; a model in which the angle stands outside sine and cosine needs it without: "
            "take 2 pi off the readings beyond the jump"
        )
        if np.ptp(whole) < np.ptp(reading) - np.pi and note not in data.notes:
            data = data.with_note(note)
    return data
