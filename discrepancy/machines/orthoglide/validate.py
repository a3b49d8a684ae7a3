"""The table of an Orthoglide's measurement: its columns, validated and returned as arrays.

A row is one deviation [mm]: how far `leg` stands along `direction` from where it stood at the Zero posture, with the
tool moved to `level_mm` along the axis that `posture` names (x, or xmax and xmin for the ends of the stroke; max and
min for the leg's own axis). Needed: leg, direction, posture (and level_mm where the posture names no end), deviation.
With defaults: gauge_position (.5, the share of the leg from its joint to the tool), against_mm (0: compared with Zero),
pass (fwd: the tool arrives moving towards +, or rev), zero_pass (as pass), payload_N (0), repeat (0).
Optional: t_s and zero_t_s, temp_K and zero_temp_K: time and temperature of the reading and of its Zero reading.

The Zero is read once for a gauge that stands where it stands, and subtracted from all its readings: rows that agree in
leg, direction, gauge_position, zero_pass, payload_N and repeat share it. It is reached along the leg's own axis. Where
against_mm is another level, as in Table 1, zero_pass, zero_t_s and zero_temp_K are those of the reading there.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import suggest
from calibench.core.words import as_columns
from calibench.discrepancy.checks.enter import entered
from calibench.discrepancy.model.measured.data import Column, DataError, MeasuredData
from calibench.problems.base import Array
from calibench.problems.orthoglide.kinematics import AXES, geometry, inverse_kinematics
from calibench.problems.orthoglide.measured import check_deviations
from calibench.problems.orthoglide.plans import Reading, check_plan

Index = NDArray[np.intp]
_WORDS = ("leg", "direction", "posture", "pass", "zero_pass")
_DEFAULTS = {"gauge_position": 0.5, "against_mm": 0.0, "payload_N": 0.0, "repeat": 0.0}
ACCEPTED = "checked"  # the column that says so
_OPTIONAL = ("t_s", "zero_t_s", "temp_K", "zero_temp_K")


@final
@dataclass(frozen=True, eq=False)
class Rows:
    """The rows as arrays, shape (n,): indices 0 1 2 for x y z, mm, N, and +1 or -1 for the direction of arrival."""

    leg: Index
    direction: Index
    axis: Index
    level: Array
    against: Array
    share: Array
    arrival: Array
    zero_arrival: Array
    payload: Array
    repeat: Array

    @property
    def other(self) -> Index:
        """Return the direction across the leg that the gauge does not read, shape (n,)."""
        return np.asarray(3 - self.leg - self.direction)

    def joints(self, level: Array) -> Array:
        """Return the commanded joints, shape (n, 3), mm, with the tool moved to `level`, shape (n,), on its axis."""
        return inverse_kinematics(level[:, None] * np.eye(3)[self.axis])

    def senses(self) -> tuple[Array, Array]:
        """Return the sense of each joint's last move, +1, -1 or 0, shape (n, 3): at the posture and at the Zero.

        The moved joint goes with the tool; the others are drawn in by sqrt(L^2 - v^2) as it leaves Zero.
        """
        own, home = np.eye(3)[self.axis], np.eye(3)[self.leg]
        home = np.where(self.against[:, None] == 0, home, own)
        drawn_in = np.where(self.against == 0, 1.0, -np.sign(self.against) * self.zero_arrival)
        at_posture = own * self.arrival[:, None] + (1 - own) * (-np.sign(self.level) * self.arrival)[:, None]
        return at_posture, home * self.zero_arrival[:, None] + (1 - home) * drawn_in[:, None]

    def zero_group(self) -> Index:
        """Return the number of the Zero reading each row was subtracted from, shape (n,)."""
        parts = (self.leg, self.direction, self.share, self.zero_arrival, self.payload, self.repeat)
        key = np.column_stack([np.asarray(part, dtype=float) for part in parts])
        return np.asarray(np.unique(key, axis=0, return_inverse=True)[1]).reshape(-1)


def accepted(data: MeasuredData) -> MeasuredData:
    """Return `data` with every column there, in one spelling, rows without a deviation left out and told in a note.

    Raises `DataError` that names the column, the row, and the way out.
    """
    if data.machine not in ("", "orthoglide"):
        raise DataError(f"{data.name}: these are data of machine {data.machine!r}, not of an orthoglide")
    missing = [name for name in ("leg", "direction", "posture", "deviation") if name not in data]
    if missing:
        raise DataError(
            f"{data.name}: no column {', '.join(missing)}; there are {', '.join(data.in_file)}: "
            f"{as_columns({missing[0]: 'NAME'})} tells another name"
        )
    data = entered(data)
    keep = np.isfinite(_numbers(data, "deviation"))
    if not keep.any():
        raise DataError(f"{data.name}: no row has a deviation")
    if not keep.all():
        data = data.rows(keep).with_note(f"{int((~keep).sum())} rows without a deviation were left out")
    columns: dict[str, Column] = {name: _words(data, name) for name in _WORDS[:3]}
    columns["posture"], columns["level_mm"] = _levels(data, columns["leg"], columns["posture"])
    columns["pass"] = _words(data, "pass") if "pass" in data else np.full(len(data), "fwd")
    columns["zero_pass"] = _words(data, "zero_pass") if "zero_pass" in data else columns["pass"]
    for name in ("pass", "zero_pass"):
        _refuse_row(data, name, columns[name], np.isin(columns[name], ("fwd", "rev")), "fwd or rev is needed")
    for name, value in _DEFAULTS.items():
        columns[name] = _numbers(data, name) if name in data else np.full(len(data), value)
    for name in _OPTIONAL:
        if name in data:
            columns[name] = _numbers(data, name)
    for name, column in columns.items():
        if name not in _WORDS:
            _refuse_row(data, name, column, np.isfinite(column), "a finite number is needed, or leave the row out")
    columns["deviation"] = _numbers(data, "deviation")
    data = _numbered(data.with_columns(columns))
    _check(data)
    data = _visited(data)
    return replace(data.with_columns({ACCEPTED: np.ones(len(data))}), machine="orthoglide")


def is_accepted(data: MeasuredData) -> bool:
    """Return whether `data` come from `accepted`, perhaps with fewer rows or other deviations."""
    return ACCEPTED in data


def rows_of(data: MeasuredData) -> Rows:
    """Return the rows of accepted data as arrays; asked again, the same."""
    if data not in _ROWS:
        _ROWS[data] = _rows(data)
    return _ROWS[data]


def share_rows(data: MeasuredData, other: MeasuredData) -> bool:
    """Let `data` have the rows of `other` if nothing but the deviations differs; tell whether it is so."""
    if any(data.columns.get(name) is not column for name, column in other.columns.items() if name != "deviation"):
        return False
    _ROWS[data] = rows_of(other)
    return True


_ROWS: WeakKeyDictionary[MeasuredData, Rows] = WeakKeyDictionary()


def _rows(data: MeasuredData) -> Rows:
    index = {name: np.searchsorted(AXES, data[name]) for name in ("leg", "direction", "posture")}
    sense = {name: np.where(np.asarray(data[name]) == "fwd", 1.0, -1.0) for name in ("pass", "zero_pass")}
    columns: dict[str, Any] = {
        "leg": index["leg"],
        "direction": index["direction"],
        "axis": index["posture"],
        "level": data["level_mm"],
        "against": data["against_mm"],
        "share": data["gauge_position"],
        "arrival": sense["pass"],
        "zero_arrival": sense["zero_pass"],
        "payload": data["payload_N"],
        "repeat": data["repeat"],
    }
    return Rows(**{f.name: columns[f.name] for f in fields(Rows)})


def _check(data: MeasuredData) -> None:
    """Raise `DataError` for a row no Orthoglide can give, or numbers that are not millimetres."""
    keys = ("leg", "direction", "posture", "level_mm", "gauge_position", "against_mm")
    distinct = list(dict.fromkeys(zip(*(data[key].tolist() for key in keys))))
    try:
        check_plan([Reading(*key) for key in distinct])
        check_deviations(data["deviation"], "deviation")
    except ValueError as error:
        raise DataError(f"{data.name}: {error}") from None


def _numbered(data: MeasuredData) -> MeasuredData:
    """Return the data with readings that cannot be told apart numbered by repeat."""
    names = ("leg", "direction", "posture", "level_mm", "gauge_position", "against_mm", "pass", "payload_N", "repeat")
    seen: dict[tuple[Any, ...], int] = {}
    again = np.zeros(len(data))
    for k, key in enumerate(zip(*(data[name].tolist() for name in names))):
        again[k] = seen[key] = seen.get(key, -1) + 1
    if not again.any():
        return data
    repeat = data["repeat"] + again * (1 + np.ptp(data["repeat"]))
    note = (
        f"{int((again > 0).sum())} rows were there before: they were taken as repeats with a Zero reading of their own"
    )
    return data.with_columns({"repeat": repeat}).with_note(note)


def _visited(data: MeasuredData) -> MeasuredData:
    """Return the data with pose_id and visit_id: readings set up alike are one pose, and its repeats one visit.

    Poses of one gauge are compared with one Zero: they have a shared_id.
    """
    names = (
        "leg",
        "direction",
        "posture",
        "level_mm",
        "gauge_position",
        "against_mm",
        "pass",
        "zero_pass",
        "payload_N",
    )
    pose, gauge = (_alike(data, some) for some in (names, ("leg", "direction", "gauge_position", "payload_N")))
    return data.with_columns({"pose_id": pose, "visit_id": pose, "shared_id": gauge})


def _alike(data: MeasuredData, names: tuple[str, ...]) -> Array:
    """Return a number for each row, (n,), the same for rows that agree in all columns of `names`."""
    parts = [np.unique(data[name], return_inverse=True)[1].reshape(-1) for name in names]
    return np.asarray(np.unique(np.column_stack(parts), axis=0, return_inverse=True)[1].reshape(-1), dtype=float)


def _levels(data: MeasuredData, leg: Column, posture: Column) -> tuple[Column, Array]:
    """Return the axis the tool is moved along, and how far [mm]: x and the stroke for xmax."""
    strokes = {"max": geometry().stroke_plus, "min": geometry().stroke_minus}
    given = _numbers(data, "level_mm") if "level_mm" in data else np.full(len(data), np.nan)
    axes, levels = [], given.copy()
    for k, (own, word) in enumerate(zip(leg, posture)):
        axis, end = (word[0], word[1:]) if word[:1] in AXES else (own, word)
        if end not in ("", *strokes):
            choices = [*AXES, *strokes, *(a + e for a in AXES for e in strokes)]
            raise DataError(f"{data.name}: row {k + 1}: posture={word!r}: {suggest(word, choices)}")
        if not np.isfinite(given[k]):
            if not end:
                raise DataError(f"{data.name}: row {k + 1}: posture={word} needs a level_mm, or xmax, xmin and so on")
            levels[k] = strokes[end]
        elif end and given[k] * strokes[end] <= 0:
            raise DataError(f"{data.name}: row {k + 1}: posture={word} and level_mm={given[k]:g} differ in sign")
        axes.append(axis)
    return np.array(axes), levels


def _words(data: MeasuredData, name: str) -> Column:
    words = [w.decode() if isinstance(w, bytes) else str(w) for w in data[name]]
    column = np.array([w.strip().lower() for w in words])
    if name in ("leg", "direction"):
        _refuse_row(data, name, column, np.isin(column, AXES), "x, y or z is needed")
    return column


def _numbers(data: MeasuredData, name: str) -> Array:
    try:
        return np.asarray(data[name], dtype=float)
    except (TypeError, ValueError):
        raise DataError(f"{data.name}: column {name!r} holds something that is not a number") from None


def _refuse_row(data: MeasuredData, name: str, column: Column, good: NDArray[np.bool_], rule: str) -> None:
    if not good.all():
        k = int(np.flatnonzero(~good)[0])
        raise DataError(f"{data.name}: row {k + 1}: {name}={column[k]}: {rule}")
