"""What was measured of an arm: read as `bench calibrate` reads it, and completed for a search.

`calibration` matches joints, finds units and the order of rotations, and refuses what is not this arm's. Added here are
the order of time, directions, warmth and payloads. Without a clock the rows are taken in the order of time. Without a
column of directions a joint came from where it stood one row before, and the first row is left out. Notes say both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.calibration.arm import Arm
from calibench.calibration.columns import OF_A_JOINT, in_base_units, match_columns
from calibench.calibration.kinematics import Chain
from calibench.calibration.mistakes import UNITS
from calibench.calibration.readings import Table, columns_of, read_readings
from calibench.calibration.rigid import Array, rpy_of
from calibench.calibration.start import HowRead, Start, rotations_by, rotations_of, start_of
from calibench.calibration.walk import READING, TURNS
from calibench.core.notes import Code, Note, once
from calibench.core.options import suggest
from calibench.discrepancy.checks.validate import entered
from calibench.discrepancy.model.measured import TO_PREDICT, DataError, MeasuredData

ROW, WARMTH, PAYLOAD = "row", "temp_K", "payload_kg"
SOCKET, SITE = "socket", "place"
QUATERNION = ("qx", "qy", "qz", "qw")
MIDDLE = "temperature_middle"  # in the metadata: what `WARMTH` counts from
_KEPT = ("pose_id", "visit_id", "split", SOCKET, SITE, PAYLOAD)  # as the file has them
_OF_A_JOINT = tuple(f"{quantity}_" for quantity in OF_A_JOINT)
_OURS = ("reading_place",)  # columns that no file has
_MOVED = 1e-6  # rad or mm: a smaller change is no move
_TIMES = 0.5  # part of the rows with a time of their own, which a clock needs to tell their order


def table_of_data(data: MeasuredData) -> Table:
    """Return the data as the table that a calibration reads."""
    columns = {name: column for name, column in data.columns.items() if name not in _OURS}
    if "split" in columns and not (np.asarray(columns["split"]) == "hold").any():
        del columns["split"]  # nothing is held back
    return Table.of(columns, data.name, units=data.units, stated=data.metadata, row=data.row_numbers)


def accepted(data: MeasuredData, arm: Arm, observe: str = "") -> tuple[MeasuredData, Start]:
    """Return the readings with `q_J`, places, rotations, directions, a clock, temperatures; and where a fit starts.

    Raise `DataError` for data that are not this arm's, with the change of its table that cures that, if one does.
    """
    if data.machine not in ("", "arm"):
        raise DataError(f"{data.name}: these are data of machine {data.machine!r}, not of an arm")
    data, chain = entered(data), arm.chain
    table, how = table_of_data(data), HowRead(observe or ("sockets" if SOCKET in data else ""))
    try:
        start = start_of(read_readings(table, chain, how.observe, copies=True), chain)
    except DataError as error:
        raise arm.refusal(error, table, how) from None
    whole = data.rows(start.readings.rows)
    columns, units, _ = columns_of(start.readings)
    columns |= {name: whole[name] for name in _KEPT if name in whole}
    read_notes = (note for note in start.readings.notes if note.code is not Code.COLUMNS_UNREAD)  # poses and visits are
    notes = [*whole.notes, *read_notes]
    full = whole.with_columns(columns)
    clock = _clock(full, notes)
    columns[clock] = full[clock] if clock != ROW else _rows(full)
    unknown = [] if TO_PREDICT in data else [n for n in chain.driven if f"direction_{n}" not in full]
    order = np.argsort(columns[clock], kind="stable")
    columns |= _beside(full, chain, columns, order)
    if unknown:
        which = "joints" if len(unknown) == len(chain.driven) else ", ".join(unknown)
        by = "time" if clock == "t_s" else "rows"
        text = (
            f"no column tells from where {which} came: the order of {by} tells it, but of the first row, which is "
            "left out"
        )
        notes.append(Note(Code.TIME_UNKNOWN, text))
    metadata = dict(whole.metadata)
    if (warm := _warmth(full)) is not None:
        columns[WARMTH], metadata[MIDDLE] = warm
    made = replace(whole, columns=columns, units=units, notes=once(notes), machine="arm", metadata=metadata)
    return (made.rows(np.arange(len(whole)) != order[0]) if unknown else made), start


def completed(data: MeasuredData, chain: Chain, start: Start) -> MeasuredData:
    """Return rows that are only predicted, all of them, under the names of a fit and read as its `start` was.

    Raise `DataError` for a missing joint. Without directions a joint came from its position a row before; in the first
    row it is in the middle of its play. Temperatures are relative to the median of the fitted ones.
    """
    given = [name for name, column in data.columns.items() if column.dtype.kind in "iuf" and name not in _OURS]
    try:
        matched = match_columns(given, chain.driven, source=chain.source)
    except ValueError as error:
        raise DataError(f"{data.name}: {error}") from None
    parts = (matched.joints, matched.position, matched.rotation)
    turned, _, _ = in_base_units(data.columns, [name for part in parts for name in part.values()], data.units)
    units = {column: unit for column, unit in start.units.items() if column not in {**data.units, **turned}}
    numbers = {
        column: np.asarray(turned.get(column, data[column]), dtype=float) * UNITS.get(units.get(column, "mm"), 1.0)
        for part in parts
        for column in part.values()
    }
    columns: dict[str, Any] = {READING + name: numbers[column] for name, column in matched.joints.items()}
    for name, column in matched.joints.items():
        if not np.isfinite(numbers[column]).all():
            raise DataError(f"{data.name}: column {column} of joint {name} is without a number in a row to predict")
    columns |= {axis: numbers[column] for axis, column in matched.position.items()}
    if start.meaning and matched.rotation:
        rotations = rotations_by(start.meaning, np.column_stack([numbers[c] for c in matched.rotation.values()]))
        columns |= dict(zip(TURNS, rpy_of(rotations).T, strict=True))
    columns |= {name: data[column] for name, column in matched.other.items() if name.startswith(_OF_A_JOINT)}
    data = data.with_columns(columns)
    clock = "t_s" if "t_s" in data and np.isfinite(np.asarray(data["t_s"], dtype=float)).all() else ""
    order = np.argsort(data[clock], kind="stable") if clock else np.arange(len(data))
    columns = _beside(data, chain, columns, order)
    if (warm := _warmth(data)) is not None:
        columns[WARMTH] = warm[0]
    return data.with_columns(columns)


def _beside(data: MeasuredData, chain: Chain, columns: Mapping[str, Any], order: NDArray[np.intp]) -> dict[str, Any]:
    """Return directions, velocities and torques of the joints in `columns`."""
    beside: dict[str, Any] = {}
    for name in chain.driven:
        column = f"direction_{name}"
        beside[column] = data[column] if column in data else _came_from(columns[READING + name], order)
        for other in ("velocity_", "torque_"):
            if other + name in data:
                beside[other + name] = np.asarray(data[other + name], dtype=float)
    return beside


def _clock(data: MeasuredData, notes: list[Note]) -> str:
    if "t_s" in data:
        times = np.asarray(data["t_s"], dtype=float)
        if np.isfinite(times).all() and len(np.unique(times)) >= _TIMES * len(times):
            return "t_s"
    text = "no clock tells the time of each row: their order is taken as that of time"
    notes.append(Note(Code.TIME_UNKNOWN, text))
    return ROW


def _rows(data: MeasuredData) -> Array:
    return np.asarray(data[ROW], dtype=float) if ROW in data else np.arange(len(data), dtype=float)


def _came_from(q: Array, order: NDArray[np.intp]) -> Array:
    """Return the sign of the last move of a joint, (n,): 0 before the first."""
    moved = np.diff(q[order], prepend=q[order[0]])
    sign = np.where(np.abs(moved) > _MOVED, np.sign(moved), 0.0)
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(len(sign)), 0))
    came = np.empty(len(q))
    came[order] = sign[last]
    return came


def _warmth(data: MeasuredData) -> tuple[Array, float] | None:
    """Return the temperature above its middle [K], (n,), with readings that are missing at the middle; and the middle.

    The middle is the one that the metadata have from an earlier fit, if any. None where no temperature is told.
    """
    for name in (WARMTH, "temperature_C", "temperature_K"):
        if name in data:
            degrees = np.asarray(data[name], dtype=float)
            if np.isfinite(degrees).mean() > _TIMES:
                known = data.metadata.get(MIDDLE)
                middle = float(np.nanmedian(degrees)) if known is None else 0.0 if name == WARMTH else float(known)
                return np.asarray(np.nan_to_num(degrees - middle, nan=0.0)), middle
    return None


def stated_teeth(metadata: Mapping[str, Any], joints: Sequence[str]) -> dict[str, float]:
    """Return joint -> the number of teeth that `teeth=` states, one for all or a joint each, 0 where it states none.

    Raises `DataError` for what is no number above 0, or of no joint.
    """
    stated = metadata.get("teeth", {})
    each = stated if isinstance(stated, Mapping) else dict.fromkeys(joints, stated)
    for name, value in each.items():
        if name not in joints:
            raise DataError(f"teeth={stated}: {name!r} is no joint of this arm; {suggest(str(name), joints)}")
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = float("nan")
        if not 0 <= number < np.inf:
            example = f"""teeth='{{"{joints[0]}":101}}'"""
            raise DataError(f"teeth={stated}: a number above 0 for all joints, or one a joint: teeth=101, {example}")
    return {name: float(each.get(name, 0.0)) for name in joints}


def stated_number(metadata: Mapping[str, Any], name: str, default: float) -> float:
    """Return a number of the metadata, or `default`; raise `DataError` for anything else."""
    value = metadata.get(name, default)
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not np.isfinite(number):
        raise DataError(f"{name}={value}: a number is needed")
    return number


def rotations(data: MeasuredData) -> Array | None:
    """Return the measured rotations, (n, 3, 3), of accepted data; None where the place alone was read."""
    if not data.has(*TURNS):
        return None
    return rotations_of(np.stack([np.asarray(data[name], dtype=float) for name in TURNS], axis=-1), "rpy")
