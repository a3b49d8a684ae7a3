"""The start of a calibration: frames in closed form, and with them units and orders that the file does not state.

The unit of positions, the order and unit of rotations, a left-handed frame: each causes its own pattern of differences
between the nominal arm and the readings, whatever the frames. A statement of the file, or the usual meaning of its
column names, is kept. What contradicts the arm is refused in a line that says what to do, with the mistake that was
found (`mistakes`) as a note.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.calibration.frames import Frames, ball_in_sockets, frames_of_positions, moved, tool_rotation
from calibench.calibration.kinematics import Chain, ChainJoint, forward, nominal
from calibench.calibration.mistakes import APART, NEAR, UNITS, mistake_in, most_apart, reach_of, unit_of
from calibench.calibration.readings import TURNS, Readings, Table, columns_in_degrees, joints_beside, read_readings
from calibench.calibration.rigid import Array, quaternion, turn
from calibench.core.notes import Code, DataError, Note
from calibench.core.options import suggest
from calibench.core.words import as_columns, counted, plain

DOUBTFUL = 0.01  # part of the reach: arms that are not calibrated lie nearer to their descriptions
_TURNED = 0.12  # rad: rotations further off are not of this arm
_AGAIN = 0.5  # of what is left: rails in m must leave less than this to be taken for it
_LONGEST_RAIL = 20.0  # m: a limit with a larger number is no number of metres
_ROUND = 1e-2  # rad or mm beyond a limit: controllers stop a little behind it, and numbers are rounded
ROTATIONS = ("rpy", "xyz", "vector", "quaternion")
_CHOICE = {"URDF": "machine.tip= the right arm of it", "table": "convention= the one it was written in"}
_ANGLES = {"rad": 1.0, "degrees": np.pi / 180}
_ORDERS = {
    "rpy": "roll, pitch and yaw (rotation=rpy)",
    "xyz": "turns about the moving x, y and z (rotation=xyz)",
    "vector": "a rotation vector (rotation=vector)",
    "quaternion": "a quaternion",
}


@final
@dataclass(frozen=True, eq=False)
class Start:
    """Readings in mm with their rotations, and the frames (4, 4): tracker's to base, tip to target.

    `meaning` is what the rotations mean (`meanings`), "" where none are read; `units` are those of columns that the arm
    told, for rows of the same columns that are read later.
    """

    readings: Readings
    base: Array
    tool: Array
    meaning: str = ""

    @property
    def units(self) -> dict[str, str]:
        """Return the units of columns that nothing states and the arm told, column -> unit."""
        return {
            column: note.values["unit"]
            for note in self.readings.notes
            if note.code is Code.UNIT_FOUND
            for column in note.columns
        }


@final
@dataclass(frozen=True)
class HowRead:
    """What is stated on how a table is read: what is observed, the order of rotations, whether limits are strict."""

    observe: str = ""
    rotation: str = ""
    limits: bool = False

    def start(self, table: Table, chain: Chain) -> Start:
        """Return the start of the readings of `table` for `chain`. Raises `DataError` in one line."""
        return start_of(read_readings(table, chain, self.observe), chain, self.rotation, self.limits)


def start_of(readings: Readings, chain: Chain, rotation: str = "", limits: bool = False) -> Start:
    """Return where the calibration starts: the readings as the arm says they are meant, and frames by the fitted ones.

    `rotation` states the order of rotations, before what the table states. With `limits` joints must stand inside
    theirs; else a note says which do not. Raises `DataError` where the readings are not of this arm.
    """
    rotation = rotation or str(readings.table.stated.get("rotation", ""))
    try:
        if rotation and rotation not in ROTATIONS:
            raise DataError(f"rotation={rotation}: {suggest(rotation, ROTATIONS)}")
        start = _start(readings.where(readings.train), chain, rotation, limits)
        if readings.train.all():
            return start
        return replace(start, readings=_start(readings, chain, rotation, limits).readings)
    except DataError as error:
        raise DataError(f"{readings.table.name}: {error}", error.note) from None


def _start(readings: Readings, chain: Chain, rotation: str, limits: bool) -> Start:
    if readings.position is None:
        tool = _ball(readings, chain, limits)
        return Start(_within_limits(readings, chain, limits), np.eye(4), tool)
    readings, source = _in_metres(readings)
    readings, poses, frames = slid(readings, chain)
    readings, frames = _in_mm(readings, frames, poses, chain, source, limits)
    readings = _within_limits(readings, chain, limits)
    assert readings.position is not None
    far, what = moved(poses, readings.position, frames)
    if what:
        there = np.flatnonzero(far)
        text = (
            f"{len(there)} of {len(far)} poses, {readings.label(int(there[0]))} to {readings.label(int(there[-1]))}, "
            f"fit the arm by themselves only: {what}; use what was read from one stand"
        )
        raise DataError(text, Note(Code.TWO_STANDS, text, rows=tuple(readings.label(int(i)) for i in there)))
    if readings.observed != "pose":
        return Start(readings, frames.base, frames.tool)
    return _with_rotations(readings, frames, poses, rotation)


def slid(readings: Readings, chain: Chain) -> tuple[Readings, Array, Frames]:
    """Return readings, nominal poses and frames; sliding joints are taken for m where only that fits the arm."""
    assert readings.position is not None
    poses = forward(chain, nominal(chain), readings.joints)
    frames = frames_of_positions(poses, readings.position)
    columns = {name: readings.matched.joints[name] for name in readings.sliding if name in chain.driven}
    open_ = [k for k, name in enumerate(chain.driven) if columns.get(name, "") not in {"", *readings.table.units}]
    if not open_:
        return readings, poses, frames
    joints = readings.joints.copy()
    joints[:, open_] *= UNITS["m"]
    there = forward(chain, nominal(chain), joints)
    tried = frames_of_positions(there, readings.position)
    if tried.apart / tried.reach > _AGAIN * frames.apart / frames.reach:
        return readings, poses, frames
    names = [columns[chain.driven[k]] for k in open_]
    text = f"{', '.join(names)}: no unit is stated; {'it fits' if len(open_) == 1 else 'they fit'} the arm in m"
    return replace(readings, joints=joints).with_note(Code.UNIT_FOUND, text, names, unit="m"), there, tried


def _in_metres(readings: Readings) -> tuple[Readings, str]:
    """Return positions in mm where FIGAROH's names mean metres, and the source of the unit ("": none)."""
    assert readings.position is not None
    columns = readings.matched.position
    if any(name in readings.table.units for name in columns.values()):
        return readings, "stated"
    if readings.matched.figaroh:
        text = f"{', '.join(columns.values())}: FIGAROH's names, so metres"
        readings = replace(readings, position=1e3 * readings.position)
        return readings.with_note(Code.UNIT_FOUND, text, columns.values(), unit="m"), "m"
    return readings, "mm" if set(columns.values()) == {"x", "y", "z"} else ""


def _in_mm(
    readings: Readings, frames: Frames, poses: Array, chain: Chain, source: str, limits: bool
) -> tuple[Readings, Frames]:
    """Return positions in mm and their frames; refuse what no unit explains."""
    assert readings.position is not None
    names = readings.matched.position
    listed = ", ".join(names.values())
    unit = unit_of(frames)
    if frames.mirrored:
        other = frames_of_positions(poses, readings.position * [-1.0, 1.0, 1.0])
        if other.apart < APART * other.reach:
            text = (
                "x, y and z fit the arm as a left-handed frame only: an axis points the other way, or two are "
                f"exchanged; {as_columns({'x': names['y'], 'y': names['x']})} exchanges x and y"
            )
            raise DataError(text, Note(Code.LEFT_HANDED, text, tuple(names.values())))
    if unit is not None:
        frames = frames_of_positions(poses, readings.position, UNITS[unit])
    if unit is None or frames.apart > APART * frames.reach:
        apart = f"readings and nominal arm lie {plain(frames.apart, 3)} mm apart, wherever the frames are"
        raise _misfit(readings, chain, apart, limits)
    if source and unit == "mm":
        return readings, frames
    if source:
        size = UNITS[unit] * (1e3 if source == "m" else 1.0)
        really = next((u for u, other in UNITS.items() if abs(size / other - 1) < NEAR), unit)
        really = "mm" if source == "stated" and really == "um" else really  # metres were stated
        taken = {"m": "metres, as FIGAROH's names say", "mm": "mm", "stated": "what the file states"}[source]
        named = ",".join(f"{name}:{really}" for name in names.values())
        text = f"{listed} are taken for {taken}, and fit the arm when they are {really}: units={named}"
        raise DataError(text, Note(Code.POSITION_UNIT, text, tuple(names.values()), values={"unit": really}))
    readings = replace(readings, position=UNITS[unit] * readings.position)
    text = f"{listed}: no unit is stated; they fit the arm in {unit}"
    return readings.with_note(Code.UNIT_FOUND, text, names.values(), unit=unit), frames


def _misfit(readings: Readings, chain: Chain, apart: str, limits: bool) -> DataError:
    """Return the refusal of readings that do not fit the arm, with the mistake that explains them where one does."""
    mistake = mistake_in(readings, chain)
    if mistake is not None:
        text = f"{apart}, and {mistake.text}"
        return DataError(text, replace(mistake, text=text))
    if limits:
        _within_limits(readings, chain, strict=True)  # a better reason than none
    still = [name for k, name in enumerate(chain.driven) if not np.ptp(readings.joints[:, k]) > 0]
    if still:
        column = readings.matched.joints[still[0]]
        text = f"{apart}; column {column} is the same in every row: is it that of joint {still[0]}?"
        return DataError(text, Note(Code.JOINT_STILL, text, (column,), values={"joint": still[0]}))
    rows = "does each file hold one socket" if readings.position is None else "are the joints' zeros and senses those"
    rows += "" if readings.position is None else f" of the {chain.source}"
    text = (
        f"{apart}: is this the {chain.source} of the arm, {_CHOICE[chain.source]}, and {rows}?"
        f"{joints_beside(readings, chain)}"
    )
    return DataError(text, Note(Code.OTHER_ARM, text))


def _ball(readings: Readings, chain: Chain, limits: bool) -> Array:
    """Return where a ball that sits in sockets is on the tip, (4, 4)."""
    poses = forward(chain, nominal(chain), readings.joints)
    ball, _, apart = ball_in_sockets(poses, readings.socket)
    if apart > most_apart(reach_of(poses), sockets=True):
        text = f"the ball is {plain(apart, 3)} mm away from its sockets, wherever it sits on the last link"
        raise _misfit(readings, chain, text, limits)
    tool = np.eye(4)
    tool[:3, 3] = ball
    return tool


def _within_limits(readings: Readings, chain: Chain, strict: bool) -> Readings:
    """Return the readings with a note on joints beyond their limits; refuse them where that is `strict`."""
    there = {joint.name: joint for joint in chain.joints if joint.mimic is None}
    for k, name in enumerate(chain.driven):
        if (joint := there.get(name)) is None:
            continue
        values, column = readings.joints[:, k], readings.matched.joints[name]
        beyond = (values < joint.lower - _ROUND) | (values > joint.upper + _ROUND)
        if not beyond.any():
            continue
        rotary = joint.kind == "rotary"
        cure = "is the column that of this joint, and its unit right?"
        if rotary and _inside(np.deg2rad(values), joint) and np.abs(values).max() > TURNS:
            units = ",".join(f"{column}:deg" for column in columns_in_degrees(readings, chain))
            cure = f"as degrees all its rows lie within: units={units}"
        elif chain.source == "table" and rotary and _inside(np.deg2rad(values), joint):
            cure = "with limits in rad all its rows lie within: write lower [rad] and upper [rad]"
        elif not rotary and _inside(values / 1000, joint) and joint.upper > _LONGEST_RAIL:
            cure = f"as mm all its rows lie within: units={column}:mm"
        elif chain.source == "table" and not rotary and _inside(values / 1000, joint):
            cure = f"with limits in m all its rows lie within: write their unit in the cells, {joint.upper:g} m"
        row = readings.label(int(np.argmax(beyond)))
        text = (
            f"{row}: joint {name} stands at {values[np.argmax(beyond)]:.4g} {'rad' if rotary else 'mm'}, outside its "
            f"limits {joint.lower:.4g} to {joint.upper:.4g} in the {chain.source} "
            f"({counted(int(beyond.sum()), 'such row')}): {cure}"
        )
        note = Note(Code.BEYOND_LIMITS, text, (column,), (row,), {"joint": name, "rows": int(beyond.sum())})
        if strict:
            raise DataError(f"{text}; limits=false passes this over", note)
        readings = replace(readings, notes=(*readings.notes, note))
    return readings


def _inside(values: Array, joint: ChainJoint) -> bool:
    return bool(np.all((values >= joint.lower - _ROUND) & (values <= joint.upper + _ROUND)))


def _with_rotations(readings: Readings, frames: Frames, poses: Array, rotation: str) -> Start:
    """Return the start with the rotations in the order, sense and unit that is stated, or that alone fits the arm."""
    assert readings.angles is not None
    columns = list(readings.matched.rotation.values())
    listed = ", ".join(columns)
    tried = {
        meaning: (turns, *tool_rotation(poses[frames.near], frames.base, turns[frames.near]))
        for meaning, turns in _rotations(readings, columns, rotation).items()
    }
    ranked = sorted(tried, key=lambda meaning: tried[meaning][2])
    turns, tool, apart = tried[ranked[0]]
    if apart > _TURNED:
        still = [name for name, angle in zip(columns, readings.angles.T, strict=True) if not np.ptp(angle) > 0]
        beside = f"; {', '.join(still)} never {'varies' if len(still) == 1 else 'vary'}" if still else ""
        if len(still) == len(columns) and not rotation:
            text = f"{listed} never vary, though the arm turned its tool: they are left out"
        elif rotation:
            raise DataError(
                f"{listed}: rotations lie {plain(apart, 2)} rad from the nominal arm as rotation={rotation}{beside}; "
                "leave rotation= out to have the order found, or take machine.observe=position"
            )
        else:
            text = f"{listed} fit in no order of rotations ({plain(apart, 2)} rad apart{beside}) and are left out"
        readings = replace(readings, observed="position", angles=None)
        return Start(readings.with_note(Code.ROTATION_LEFT_OUT, text, columns), frames.base, frames.tool)
    if (
        len(ranked) > 1
        and tried[ranked[1]][2] < 2 * apart + 1e-9
        and not np.allclose(tried[ranked[1]][0], turns, atol=1e-3)
    ):
        raise DataError(f"{listed} may be {ranked[0]} or {ranked[1]}; rotation=rpy|xyz|vector states which")
    text = f"{listed} are read as {ranked[0]}, to {plain(np.rad2deg(apart), 2)}° of the nominal arm"
    frame = frames.tool.copy()
    frame[:3, :3] = tool
    readings = replace(readings, turns=turns).with_note(Code.ROTATION, text, columns)
    return Start(readings, frames.base, frame, ranked[0])


def _rotations(readings: Readings, columns: list[str], rotation: str) -> dict[str, Array]:
    """Return the possible meanings of the rotations, in words -> (n, 3, 3)."""
    assert readings.angles is not None
    stated = any(name in readings.table.units for name in columns) or readings.matched.figaroh
    large = float(np.abs(readings.angles).max()) > 2 * np.pi + 0.01
    units = {unit: _ANGLES[unit] for unit in (("rad",) if stated else ("degrees",) if large else _ANGLES)}
    by_meaning = meanings(readings.angles, rotation, units)
    return by_meaning if rotation else either_way(by_meaning)


def either_way(by_meaning: dict[str, Array]) -> dict[str, Array]:
    """Return the meanings of rotations, and of the same as those of the tracker in the target."""
    return by_meaning | {f"{one}, of the tracker in the target": t.swapaxes(1, 2) for one, t in by_meaning.items()}


def rotations_by(meaning: str, angles: Array) -> Array:
    """Return the rotations, (n, 3, 3), of angles (n, 3) or quaternions (n, 4) by a meaning that a start found."""
    return either_way(meanings(angles, "", _ANGLES))[meaning]


def meanings(angles: Array, rotation: str, units: Mapping[str, float]) -> dict[str, Array]:
    """Return what rotations may mean, in words -> (n, 3, 3): quaternions (n, 4), or angles (n, 3).

    `rotation` states the order of angles, "" for every order; `units` are those of angles, name -> rad.
    """
    if angles.shape[1] == 4:
        return {
            "quaternion": quaternion(*angles.T)[:, :3, :3],
            "quaternion whose first number is the real part": quaternion(*np.roll(angles, -1, axis=1).T)[:, :3, :3],
        }
    return {
        f"{_ORDERS[order]}, {unit}": rotations_of(size * angles, order)
        for order in ((rotation,) if rotation else ("rpy", "xyz", "vector"))
        for unit, size in units.items()
    }


def rotations_of(angles: Array, order: str) -> Array:
    """Return the rotations, (n, 3, 3), of angles (n, 3) [rad] in an order: rpy, xyz or vector."""
    if order == "vector":
        size = np.linalg.norm(angles, axis=1)
        unit = angles / np.where(size > 0, size, 1.0)[:, None]
        return np.stack([turn(axis, angle)[:3, :3] for axis, angle in zip(unit, size, strict=True)])
    about = [turn(axis, angles[:, k])[:, :3, :3] for k, axis in enumerate(np.eye(3))]
    return np.asarray(about[2] @ about[1] @ about[0] if order == "rpy" else about[0] @ about[1] @ about[2])
