"""Check what was measured of an arm, once, and complete it: joints by name, order of time, directions, warmth, loads.

Joints have their URDF names, with `q_` before them or not, in rad (mm where they slide). Without a clock the rows are
taken in the order of time. Without a column of directions a joint came from where it stood one row before, and the
first row is left out. Notes say both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.core.notes import Code, Note, once
from calibench.core.options import suggest
from calibench.core.words import counted, listed
from calibench.discrepancy.checks.validate import entered
from calibench.discrepancy.machines.arm.geometry import PLACE, READING
from calibench.discrepancy.machines.arm.turns import ANGLES, CALLED, QUATERNION
from calibench.discrepancy.model.measured import TO_PREDICT, DataError, MeasuredData
from calibench.problems.arm.chains.chain import Chain
from calibench.problems.arm.columns import OF_A_JOINT, in_base_units, match_columns
from calibench.problems.base import Array

ROW, WARMTH, PAYLOAD = "row", "temp_K", "payload_kg"
SOCKET, SITE = "socket", "place"
MIDDLE = "temperature_middle"  # in the metadata: what `WARMTH` counts from
_PLAIN = ("pose_id", "visit_id", "split", SOCKET, SITE, PAYLOAD, *PLACE, *ANGLES, *QUATERNION)
_OF_A_JOINT = tuple(f"{told}_" for told in OF_A_JOINT)
_OURS = ("reading_place",)  # columns that no file has
_LISTED = 20  # joints or columns that a refusal names
_DEGREES = 4 * np.pi  # rad, beyond which a joint is in degrees
_ROUND = 1e-3  # rad or mm beyond a limit that a rounded number may be
_MOVED = 1e-6  # rad or mm: a smaller change is no move
_TIMES = 0.5  # part of the rows with a time of their own, which a clock needs to tell their order


def accepted(data: MeasuredData, chain: Chain) -> MeasuredData:
    """Return the readings with `q_J`, directions, a clock, temperatures.

    Raise `DataError` for data that are not an arm's.
    """
    if data.machine not in ("", "arm"):
        raise DataError(f"{data.name}: these are data of machine {data.machine!r}, not of an arm")
    data = _numbered(entered(data), chain)
    columns: dict[str, Any] = {name: data[name] for name in _PLAIN if name in data}
    for name in chain.driven:
        columns[READING + name] = _joint(data, chain, name)
    whole = _finite(
        replace(data, columns={**data.columns, **columns}), (*(READING + n for n in chain.driven), *_seen(data))
    )
    columns = {name: whole[name] for name in columns}
    notes = list(whole.notes)
    clock = _clock(whole, notes)
    columns[clock] = whole[clock] if clock != ROW else _rows(whole)
    untold = [] if TO_PREDICT in data else [n for n in chain.driven if f"direction_{n}" not in whole]
    order = np.argsort(columns[clock], kind="stable")
    columns |= _beside(whole, chain, columns, order)
    notes += [Note(Code.BEYOND_LIMITS, text) for text in _beyond_limits(columns, chain)]
    if untold:
        which = "joints" if len(untold) == len(chain.driven) else ", ".join(untold)
        told = "tells it, but of the first row, which is left out"
        text = f"no column tells from where {which} came: the order of {_order(clock)} {told}"
        notes.append(Note(Code.TIME_UNKNOWN, text))
    metadata = dict(whole.metadata)
    if (warm := _warmth(whole)) is not None:
        columns[WARMTH], metadata[MIDDLE] = warm
    made = replace(whole, columns=columns, notes=once(notes), machine="arm", metadata=metadata)
    return made.rows(np.arange(len(whole)) != order[0]) if untold else made


def _beyond_limits(columns: Mapping[str, Any], chain: Chain) -> list[str]:
    """Return a remark for each joint that stands outside its limits."""
    told = []
    for joint in chain.joints:
        q = columns.get(READING + joint.name)
        far = 0 if q is None or joint.mimic else int(np.sum((q < joint.lower - _ROUND) | (q > joint.upper + _ROUND)))
        if far:
            told.append(
                f"{joint.name} stands outside its limits {joint.lower:.4g} to {joint.upper:.4g} of the {chain.told} in "
                f"{counted(far, 'row')}: is the column that of this joint, and its unit right?"
            )
    return told


def completed(data: MeasuredData, chain: Chain) -> MeasuredData:
    """Return rows that are only predicted, all of them, under the names of a fit.

    Raise `DataError` for a missing joint. Without directions a joint came from its position a row before; in the first
    row it is in the middle of its play. Temperatures are relative to the median of the fitted ones.
    """
    data = _numbered(data, chain)
    columns = {READING + name: _joint(data, chain, name) for name in chain.driven}
    for name, column in columns.items():
        if not np.isfinite(column).all():
            raise DataError(f"{data.name}: column {name} is without a number in a row that is to be predicted")
    clock = "t_s" if "t_s" in data and np.isfinite(np.asarray(data["t_s"], dtype=float)).all() else ""
    order = np.argsort(data[clock], kind="stable") if clock else np.arange(len(data))
    columns |= _beside(data, chain, columns, order)
    if (warm := _warmth(data)) is not None:
        columns[WARMTH] = warm[0]
    return data.with_columns(columns)


def _beside(data: MeasuredData, chain: Chain, columns: Mapping[str, Any], order: NDArray[np.intp]) -> dict[str, Any]:
    """Return directions, velocities and torques of the joints in `columns`."""
    found: dict[str, Any] = {}
    for name in chain.driven:
        column = f"direction_{name}"
        found[column] = data[column] if column in data else _came_from(columns[READING + name], order)
        for other in ("velocity_", "torque_"):
            if other + name in data:
                found[other + name] = np.asarray(data[other + name], dtype=float)
    return found


def _numbered(data: MeasuredData, chain: Chain) -> MeasuredData:
    """Return the data with joints, places and the joints' further columns renamed from the file's names to ours."""
    given = [name for name, column in data.columns.items() if column.dtype.kind in "iuf" and name not in _OURS]
    try:
        found = match_columns(given, chain.driven, told=chain.told)
    except ValueError:
        return data
    used = (*found.joints.values(), *found.position.values(), *found.rotation.values())
    turned, units, told = in_base_units(data.columns, used, data.units)
    read = (*data.notes, *(Note(Code.UNIT, text) for text in told))
    data = replace(data, columns={**data.columns, **turned}, units={**data.units, **units}, notes=read)
    turning = {j.name for j in chain.joints if j.kind == "rotary"}
    angles = [column for name, column in found.joints.items() if name in turning]
    far = max((float(np.nanmax(np.abs(data[column]), initial=0.0)) for column in angles), default=0.0)
    if far > _DEGREES:
        said = ",".join(f"{column}:deg" for column in angles)
        raise DataError(f"{data.name}: joints reach {far:.0f} rad: it looks like degrees; units={said} states it")
    columns = {READING + name: data[column] for name, column in found.joints.items() if name not in data}
    beside = {name: column for name, column in found.other.items() if name.startswith(_OF_A_JOINT)}
    seen = {**found.position, **found.rotation}
    columns |= {name: data[column] for name, column in {**seen, **beside}.items() if name not in data}
    notes = [*data.notes, *(Note(Code.COLUMNS_MATCHED, text) for text in found.notes)]
    metres = [column for column in found.position.values() if found.figaroh and column not in data.units]
    if metres:
        columns |= {name: 1e3 * columns[name] for name in found.position}
        notes.append(Note(Code.UNIT, f"{', '.join(metres)}: FIGAROH's names, so metres", tuple(metres)))
    metadata = {**data.metadata, CALLED: found.rotation} if found.rotation else data.metadata
    return replace(data.with_columns(columns), notes=tuple(notes), metadata=metadata)


def _seen(data: MeasuredData) -> tuple[str, ...]:
    if SOCKET in data:
        return ()
    missing = [name for name in PLACE if name not in data]
    if missing:
        raise DataError(
            f"{data.name}: {'column' if len(missing) == 1 else 'columns'} {', '.join(missing)} "
            f"{'is' if len(missing) == 1 else 'are'} missing: x, y, z [mm] of the target as measured are needed (a "
            "distance alone is not read), or socket (0, 1, ...) of a ball; another name is stated with columns="
        )
    return (*PLACE, *(ANGLES if data.has(*ANGLES) else ()), *(QUATERNION if data.has(*QUATERNION) else ()))


def _joint(data: MeasuredData, chain: Chain, name: str) -> Array:
    column = READING + name if READING + name in data else name
    if column not in data:
        known = [str(c) for c in data.columns if c not in _OURS]
        if not any(one in data or READING + one in data for one in chain.driven):
            raise DataError(
                f"{data.name}: no column for any joint ({listed(chain.driven, _LISTED)}) among "
                f"{listed(known, _LISTED)}; columns= states other names, and where joints stand in a file of their own "
                "bench calibrate joins both, data=joints.csv,tracker.csv, and writes readings.parquet"
            )
        raise DataError(
            f"{data.name}: no column for joint {name}; {suggest(name, known)}; columns= states another name"
        )
    try:
        values = np.asarray(data[column], dtype=float)
    except (TypeError, ValueError):
        raise DataError(f"{data.name}: column {column} holds {str(data[column][0])!r}: numbers are needed") from None
    [kind] = {j.kind for j in chain.joints if name in (j.name, j.mimic.joint if j.mimic else j.name)} or {"rotary"}
    if kind == "rotary" and np.nanmax(np.abs(values), initial=0.0) > _DEGREES:
        raise DataError(
            f"{data.name}: joint {name} reaches {np.nanmax(np.abs(values)):.0f} rad: it looks like degrees; state "
            f'units={{"{column}": "deg"}}'
        )
    return values


def _finite(data: MeasuredData, columns: tuple[str, ...]) -> MeasuredData:
    """Return the rows with a number in all `columns`, with a note for the others."""
    good = np.ones(len(data), dtype=bool)
    for name in columns:
        try:
            good &= np.isfinite(np.asarray(data[name], dtype=float))
        except (TypeError, ValueError):
            raise DataError(f"{data.name}: column {name} holds {str(data[name][0])!r}: numbers are needed") from None
    if good.all():
        return data
    if not good.any():
        raise DataError(f"{data.name}: no row holds a finite number in all of {', '.join(columns)}")
    count = int((~good).sum())
    text = f"{count} row{'s' if count > 1 else ''} without a number in a column that is needed: left out"
    return data.rows(good).with_note(Code.ROWS_LEFT_OUT, text, rows=data.labels(~good))


def _clock(data: MeasuredData, notes: list[Note]) -> str:
    if "t_s" in data:
        times = np.asarray(data["t_s"], dtype=float)
        if np.isfinite(times).all() and len(np.unique(times)) >= _TIMES * len(times):
            return "t_s"
    text = "no clock tells the time of each row: their order is taken as that of time"
    notes.append(Note(Code.TIME_UNKNOWN, text))
    return ROW


def _order(clock: str) -> str:
    return "time" if clock == "t_s" else "rows"


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
