"""What was measured of an arm: read as `bench calibrate` reads it, and completed for a search.

Added are the order of time (that of the rows without a clock), directions (from where a joint stood one row before; the
first row is left out), warmth, and the moments of gravity (n, 3) [N mm] on each joint, in its frame before it moves:
the part along the axis loads the drive, the rest bends bearing and link. Masses are the URDF's, and the payload hangs
at the target; where no mass is known each link is an even rod, so the moment's size is a guess.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.calibration import columns as arm_columns
from calibench.calibration.arm import Arm
from calibench.calibration.columns import PAYLOAD, SITE, SOCKET, TARGET, WARMTH, match_columns
from calibench.calibration.kinematics import Chain
from calibench.calibration.readings import Table, by_target, columns_of, read_readings, readable
from calibench.calibration.rigid import Array, rpy_of
from calibench.calibration.start import ANGLES, UNITS, HowRead, Start, meanings, rotations_of, start_of
from calibench.calibration.walk import GRAVITY, READING, TURNS, moments, torques_about_axes, walk
from calibench.core.notes import Code, Note, once
from calibench.core.options import suggest
from calibench.discrepancy.checks.validate import entered, with_unread
from calibench.discrepancy.model.measured import PLACE, TO_PREDICT, DataError, MeasuredData

ROW = "row"
MIDDLE = "temperature_middle"  # in the metadata: what `WARMTH` counts from
_KEPT = ("pose_id", "visit_id", "split", SOCKET, SITE, PAYLOAD)  # as the file has them
_OF_A_JOINT = tuple(f"{quantity}_" for quantity in arm_columns.OF_A_JOINT)
TARGET_NUMBER = "target_number"  # of each row, 0 the one that is read most
_OURS = (PLACE, TARGET_NUMBER)  # columns that no file has
_MOVED = 1e-6  # rad or mm: a smaller change is no move
_TIMES = 0.5  # part of the rows with a time of their own, which a clock needs to tell their order


def table_of_data(data: MeasuredData) -> Table:
    """Return the data as the table that a calibration reads."""
    columns = {name: column for name, column in data.columns.items() if name not in _OURS}
    if data.fitted.all():
        columns.pop("split", None)
    return Table.of(columns, data.name, units=data.units, stated=data.metadata, row=data.row_numbers)


def accepted(data: MeasuredData, arm: Arm, observe: str = "") -> tuple[MeasuredData, Start]:
    """Return the readings with `q_J`, places, rotations, directions, a clock, temperatures; and where a fit starts."""
    if data.machine not in ("", "arm"):
        raise DataError(f"{data.name}: these are data of machine {data.machine!r}, not of an arm")
    chain = arm.chain
    # one target of the flange in a row, without what targets of the base tell of a drift
    table = table_of_data(data)
    try:
        matched = match_columns(readable(table), chain.driven, source=chain.source)
        table, matched, rows = by_target(table, matched)
    except ValueError as error:
        raise DataError(f"{data.name}: {error}", getattr(error, "note", None)) from None
    if rows is not None:
        by_row = dict(table.columns)
        if TARGET in by_row:  # what one target repeats is no repeat of another
            same = [np.unique(by_row[c], return_inverse=True)[1] for c in (*matched.joints.values(), TARGET)]
            by_row["pose_id"] = np.unique(np.column_stack(same), axis=0, return_inverse=True)[1].ravel()
            by_row["visit_id"] = np.arange(len(table))
        data = replace(data.rows(rows), columns=by_row, notes=once([*data.notes, *table.notes]))
    parts = (matched.joints, matched.position, matched.rotation, matched.other, *matched.targets.values())
    data = with_unread("arm", entered(data), {column for part in parts for column in part.values()})
    table, how = table_of_data(data), HowRead(observe or ("sockets" if SOCKET in data else ""))
    try:
        start = start_of(read_readings(table, chain, how.observe, copies=True), chain)
    except DataError as error:
        raise arm.refusal(error, table, how) from None
    if start.readings.loci is not None:
        raise DataError(f"{data.name}: a search needs x, y and z in each row; bench calibrate takes less than places")
    whole = data.rows(start.readings.rows)
    columns, units, _ = columns_of(start.readings)
    columns |= {name: whole[name] for name in _KEPT if name in whole}
    if start.readings.targets:
        columns[TARGET_NUMBER] = start.readings.target.astype(float)
    read_notes = (note for note in start.readings.notes if note.code is not Code.COLUMNS_UNREAD)  # poses and visits are
    notes = [*whole.notes, *read_notes]
    full = whole.with_columns(columns)
    times = np.asarray(full["t_s"], dtype=float) if "t_s" in full else np.full(len(full), np.nan)
    clock = "t_s" if np.isfinite(times).all() and len(np.unique(times)) >= _TIMES * len(times) else ROW
    if clock == ROW:
        text = "no clock tells the time of each row: their order is taken as that of time"
        notes.append(Note(Code.TIME_UNKNOWN, text))
        columns[ROW] = np.asarray(full[ROW], dtype=float) if ROW in full else np.arange(len(full), dtype=float)
    else:
        columns[clock] = full[clock]
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
    """Return rows that are only predicted, all of them, under the names of a fit and read as its `start` was."""
    given = [name for name, column in data.columns.items() if column.dtype.kind in "iuf" and name not in _OURS]
    try:
        matched = match_columns(given, chain.driven, source=chain.source)
    except ValueError as error:
        raise DataError(f"{data.name}: {error}") from None
    parts = (matched.joints, matched.position, matched.rotation)
    read = [column for part in parts for column in part.values()]
    turned, _, _ = arm_columns.by_their_names(data.columns, read, data.units)
    units: dict[str, str] = {}  # those that nothing states and the arm told
    for note in (note for note in start.readings.notes if note.code is Code.UNIT_FOUND):
        units |= {column: note.values["unit"] for column in note.columns if column not in {**data.units, **turned}}
    numbers: dict[str, Array] = {}
    for column in read:
        scale = UNITS.get(units.get(column, "mm"), 1.0)
        numbers[column] = np.asarray(turned.get(column, data[column]), dtype=float) * scale
    columns: dict[str, Any] = {READING + name: numbers[column] for name, column in matched.joints.items()}
    for name, column in matched.joints.items():
        if not np.isfinite(numbers[column]).all():
            raise DataError(f"{data.name}: column {column} of joint {name} is without a number in a row to predict")
    columns |= {axis: numbers[column] for axis, column in matched.position.items()}
    if start.meaning and matched.rotation:
        angles = np.column_stack([numbers[c] for c in matched.rotation.values()])
        turns = meanings(angles, "", ANGLES, either_way=True)[start.meaning]
        columns |= dict(zip(TURNS, rpy_of(turns).T, strict=True))
    columns |= {name: data[column] for name, column in matched.other.items() if name.startswith(_OF_A_JOINT)}
    if known := start.readings.targets:  # the one that is read most where nothing says which
        words = np.asarray(data[TARGET]).astype(str) if TARGET in data else np.repeat(known[:1], len(data))
        if other := sorted(set(words.tolist()) - set(known)):
            raise DataError(f"{data.name}: target {other[0]!r} was not fitted; {suggest(other[0], known)}")
        columns[TARGET_NUMBER] = np.array([float(known.index(word)) for word in words.tolist()])
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
        column, q = f"direction_{name}", columns[READING + name]
        if column in data:
            beside[column] = data[column]
        else:  # the sign of the last move, 0 before the first
            moved = np.diff(q[order], prepend=q[order[0]])
            sign = np.where(np.abs(moved) > _MOVED, np.sign(moved), 0.0)
            last = np.maximum.accumulate(np.where(sign != 0, np.arange(len(sign)), 0))
            beside[column] = np.empty(len(q))
            beside[column][order] = sign[last]
        for other in ("velocity_", "torque_"):
            if other + name in data:
                beside[other + name] = np.asarray(data[other + name], dtype=float)
    return beside


def _warmth(data: MeasuredData) -> tuple[Array, float] | None:
    """Return the temperature above its middle [K], (n,), missing readings being at the middle; and the middle."""
    for name in (WARMTH, "temperature_C", "temperature_K"):
        if name in data:
            degrees = np.asarray(data[name], dtype=float)
            if np.isfinite(degrees).mean() > _TIMES:
                known = data.metadata.get(MIDDLE)
                middle = float(np.nanmedian(degrees)) if known is None else 0.0 if name == WARMTH else float(known)
                return np.asarray(np.nan_to_num(degrees - middle, nan=0.0)), middle
    return None


def rotations(data: MeasuredData) -> Array | None:
    """Return the measured rotations, (n, 3, 3), of accepted data; None where the place alone was read."""
    if not data.has(*TURNS):
        return None
    return rotations_of(np.stack([np.asarray(data[name], dtype=float) for name in TURNS], axis=-1), "rpy")


ROD = 10.0  # kg a metre: what links of which no mass is told are taken to weigh
_WEIGHTLESS = (
    "the {source} tells no masses and the file no payload_kg: for what gravity bends each link is taken for a rod of "
    f"{ROD:g} kg a metre, so the size of a compliance or a bending is a guess, and either may stand under an "
    "eccentricity, a harmonic or an angle error of the same joint; {way_out}"
)
_WAY_OUT = {"URDF": "write masses into the URDF", "table": "a URDF has a place for masses"}


def with_loads(chain: Chain, base: Array, start: Mapping[str, float], data: MeasuredData) -> MeasuredData:
    """Return the data with the torques that vary, and a note where no mass is told."""
    held = torques(chain, base, start, data)
    if held and all(j.mass is None for j in chain.joints) and not payload_of(data).any():
        text = _WEIGHTLESS.format(source=chain.source, way_out=_WAY_OUT[chain.source])
        data = data.with_note(Code.MASSES_UNKNOWN, text)
    rounding = 1e-9 * max((float(np.max(np.abs(c))) for c in held.values()), default=0.0)
    vary = {name: c for name, c in held.items() if np.ptp(c) > rounding}
    return replace(data.with_columns(vary), computed=data.computed | set(vary))


def torques(chain: Chain, base: Array, start: Mapping[str, float], data: MeasuredData) -> dict[str, Array]:
    """Return `torque_J` [N mm] of each driven joint that gravity asks of it, where none was measured."""
    by_joint = torques_about_axes(chain, loads(chain, base, start, data)).T
    asked = {f"torque_{name}": torque for name, torque in zip(chain.driven, by_joint, strict=True)}
    return {name: torque for name, torque in asked.items() if name not in data}


def loads(chain: Chain, base: Array, start: Mapping[str, float], data: MeasuredData) -> Array:
    """Return the moments on the joints, (n, J, 3) [N mm]."""
    q: dict[str, Any] = dict(start) | {READING + n: data[READING + n] for n in chain.driven}
    if all(j.mass is None for j in chain.joints) and not payload_of(data).any():
        # each link is an even rod of `ROD`, from its joint to the next one, or to the tip
        ways = [*(joint.origin for joint in chain.joints[1:]), chain.tail]
        joints = tuple(
            replace(joint, mass=ROD * float(np.linalg.norm(way[:3, 3])) / 1e3, centre=way[:3, 3] / 2)
            for joint, way in zip(chain.joints, ways, strict=True)
        )
        chain = replace(chain, joints=joints)
    return moments(chain, walk(chain, base, q), base, payload_of(data), gravity_of(data))


def payload_of(data: MeasuredData) -> Array:
    """Return the payload of each row, (n,) [kg]: its column, an empty cell being none, or what is stated."""
    if PAYLOAD in data and PAYLOAD in data.stated:
        raise DataError(f"{data.name}: {PAYLOAD}= is stated, and the file has a column of it; leave one out")
    if PAYLOAD in data:
        stated = data[PAYLOAD]
    else:
        value = data.metadata.get(PAYLOAD, 0.0)
        try:
            stated = np.full(len(data), float(value))
        except (TypeError, ValueError):
            stated = np.full(len(data), np.nan)
        if not np.isfinite(stated).all():
            raise DataError(f"{PAYLOAD}={value}: a number is needed")
    payload = np.where(np.isnan(stated), 0.0, np.asarray(stated, dtype=float))
    wrong = ~((payload >= 0) & (payload < np.inf))
    if wrong.any():
        raise DataError(f"{data.name}: {PAYLOAD} is {payload[wrong][0]:g}: 0 kg or more is needed")
    return payload


def gravity_of(data: MeasuredData) -> Array:
    """Return gravity in the frame of the base, (3,) [m/s2]; raise `DataError` for a value that is not a direction."""
    stated = data.metadata.get("gravity", GRAVITY)
    try:
        pull = np.asarray(stated, dtype=float)
    except (TypeError, ValueError):
        pull = np.zeros(0)
    if pull.shape != (3,) or not 0 < np.linalg.norm(pull) < np.inf:
        raise DataError(f"{data.name}: gravity={stated}: three numbers [m/s2] in the frame of the base are needed")
    return pull
