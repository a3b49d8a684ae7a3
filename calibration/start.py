"""The start of a calibration: frames in closed form, and with them units and orders that the file does not state.

A wrong unit, order of rotations or left-handed frame each has its own pattern of differences, whatever the frames. What
the file states is kept; what contradicts the arm is refused, with the mistake without which the readings fit.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from math import inf, pi
from typing import Any, final

import numpy as np
from scipy.optimize import minimize_scalar

from calibench.calibration import frames as solve
from calibench.calibration.columns import POSITION, STATED
from calibench.calibration.dh import FORMS, NUMBERS, DhRow, DhTable
from calibench.calibration.frames import Frames
from calibench.calibration.kinematics import Chain, ChainError, ChainJoint, forward, nominal
from calibench.calibration.loci import place
from calibench.calibration.readings import TURNS, Readings, Table, columns_in_degrees, joints_beside, read_readings
from calibench.calibration.rigid import Array, Index, quaternion, turn
from calibench.core.notes import Code, DataError, Note
from calibench.core.options import suggest
from calibench.core.tables import mistakes
from calibench.core.tables.cells import between
from calibench.core.tables.mistakes import Kind, Mistake
from calibench.core.words import as_columns, as_units, counted, plain

DOUBTFUL = 0.01  # part of the reach: arms that are not calibrated lie nearer to their descriptions
_TURNED = 0.12  # rad: rotations further off are not of this arm
_AGAIN = 0.5  # of what is left: rails in m must leave less than this to be taken for it
_LONGEST_RAIL = 20.0  # m: a limit with a larger number is no number of metres
_ROUND = 1e-2  # rad or mm beyond a limit: controllers stop a little behind it, and numbers are rounded
ROTATIONS = ("rpy", "xyz", "vector", "quaternion")
_CHOICE = {"URDF": "machine.tip= the right arm of it", "table": "convention= the one it was written in"}
ANGLES = {"rad": 1.0, "degrees": np.pi / 180}
_ORDERS = {
    "rpy": "roll, pitch and yaw (rotation=rpy)", "xyz": "turns about the moving x, y and z (rotation=xyz)",
    "vector": "a rotation vector (rotation=vector)", "quaternion": "a quaternion",
}  # fmt: skip


@final
@dataclass(frozen=True, eq=False)
class Start:
    """Readings in mm, frames (4, 4) of base and target, and the `meaning` of rotations, "" where none are read."""

    readings: Readings
    base: Array
    tool: Array
    meaning: str = ""


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
    """Return the readings as the arm says they are meant, and frames by the fitted ones; joints must obey `limits`."""
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
        ball, apart, most = apart_in_sockets(forward(chain, nominal(chain), readings.joints), readings.socket)
        if apart > most:
            text = f"the ball is {plain(apart, 3)} mm away from its sockets, wherever it sits on the last link"
            raise _misfit(readings, chain, text, limits)
        tool = np.eye(4)
        tool[:3, 3] = ball
        return Start(_within_limits(readings, chain, limits), np.eye(4), tool)

    if readings.loci is not None:
        return _of_loci(readings, chain, limits)
    if readings.target.any():  # by the target that is read most; the others are found from it
        first = _start(readings.where(readings.target == 0), chain, rotation, limits)
        known = {name: UNITS[note.values["unit"]] for note in first.readings.notes for name in note.columns
                 if note.code is Code.UNIT_FOUND}  # fmt: skip
        scale = np.array([known.get(readings.matched.joints[name], 1.0) for name in chain.driven])
        position = readings.position * known.get(next(iter(readings.matched.position.values())), 1.0)
        every = replace(readings, joints=readings.joints * scale, position=position, notes=first.readings.notes)
        return replace(first, readings=every)

    columns = readings.matched.position
    source = "mm" if set(columns.values()) == {"x", "y", "z"} else ""  # of the unit; "" for none
    if any(name in readings.table.units for name in columns.values()):
        source = "stated"
    readings, poses, frames = slid(readings, chain)
    if np.mean(frames.near) < _SOUND and (found := _cured(readings, chain, of=_in_part)):
        lie = f"{np.sum(~frames.near)} of {len(poses)} poses lie far from where the others have the arm"
        text = f"{lie}, and all within {plain(found[0], 2)} mm {found[1].text}"
        raise DataError(text, replace(found[1], text=text))
    readings, frames = _in_mm(readings, frames, poses, chain, source, limits)
    readings = _within_limits(readings, chain, limits)
    assert readings.position is not None
    far, what = solve.moved(poses, readings.position, frames)
    if what:
        there = np.flatnonzero(far)
        text = (
            f"{len(there)} of {len(far)} poses, {readings.label(int(there[0]))} to {readings.label(int(there[-1]))}, "
            f"fit the arm by themselves only: {what}"
        )
        raise DataError(text, Note(Code.TWO_STANDS, text, rows=tuple(readings.label(int(i)) for i in there)))
    if readings.observed != "pose":
        return Start(readings, frames.base, frames.tool)
    return _with_rotations(readings, frames, poses, rotation)


_ENOUGH = 10  # whole places, of which base and target are found as ever


def _of_loci(readings: Readings, chain: Chain, limits: bool) -> Start:
    """Return the start of readings of less than places; units that nothing states are those that fit the arm best."""
    loci, read = readings.loci, readings.position
    assert loci is not None
    assert read is not None
    whole = np.asarray(np.isfinite(read).all(axis=1))
    frames, known = None, dict[str, str]()
    if whole.sum() >= _ENOUGH:
        first = _start(replace(readings.where(whole), loci=None), chain, "", limits)
        frames = first.base, first.tool
        known = {c: n.values["unit"] for n in first.readings.notes if n.code is Code.UNIT_FOUND for c in n.columns}
        readings = replace(readings, notes=first.readings.notes)
    columns = [*readings.matched.position.values(), *readings.matched.distance.values()]
    columns += [readings.matched.other[name] for name in STATED if name in readings.matched.other]
    stated = {*readings.table.units, *known} | ({*"xyz"} & {*columns} if frames is not None else set())
    open_ = [column for column in columns if column not in stated]

    def scale(column: str, unit: str) -> float:
        return UNITS[known.get(column, unit if column in open_ else "mm")]

    poses = forward(chain, nominal(chain), readings.joints)
    reach = _reach(poses)
    found: list[tuple[float, str, Readings, Array, Array]] = []
    for unit in UNITS if open_ else ("mm",):
        axes = [scale(readings.matched.position[a], unit) if a in readings.matched.position else 1.0 for a in POSITION]
        far = scale(next(iter(readings.matched.distance.values()), ""), unit)
        fixtures = []
        for one in loci.fixtures:
            frame = one.frame.copy()
            frame[:3, 3] *= scale(columns[-1], unit) if one.stated else 1.0
            fixtures.append(replace(one, frame=frame))
        scaled = replace(loci, length=loci.length * far, fixtures=tuple(fixtures))
        base, tool, placed, apart = place(poses, read * axes, scaled, frames)
        of_points = {name: scale(columns[-1], unit) for name in STATED if name in readings.other}
        other = {name: column * of_points.get(name, 1.0) for name, column in readings.other.items()}
        meant = replace(readings, position=read * axes, loci=placed, other=other)
        found.append((apart, unit, meant, base, tool))
        if apart < DOUBTFUL * reach:
            break
    apart, unit, readings, base, tool = min(found, key=lambda one: one[0])
    if apart > APART * reach:
        assert readings.position is not None
        assert readings.loci is not None
        text = f"readings of {readings.loci.words(readings.position)} and nominal arm lie {plain(apart, 3)} mm apart"
        raise _misfit(readings, chain, f"{text}, wherever base, target and fixtures are", limits)
    readings = _within_limits(readings, chain, limits)
    if open_:
        how = "no unit is stated; it fits" if len(open_) == 1 else "no unit is stated; they fit"
        readings = readings.with_note(Code.UNIT_FOUND, f"{', '.join(open_)}: {how} the arm in {unit}", open_, unit=unit)
    return Start(readings, base, tool)


def slid(readings: Readings, chain: Chain) -> tuple[Readings, Array, Frames]:
    """Return readings, nominal poses and frames; sliding joints are taken for m where only that fits the arm."""
    assert readings.position is not None
    poses = forward(chain, nominal(chain), readings.joints)
    frames = solve.frames_of_positions(poses, readings.position)
    columns = {name: readings.matched.joints[name] for name in readings.sliding if name in chain.driven}
    open_ = [k for k, name in enumerate(chain.driven) if columns.get(name, "") not in {"", *readings.table.units}]
    if not open_:
        return readings, poses, frames
    joints = readings.joints.copy()
    joints[:, open_] *= UNITS["m"]
    there = forward(chain, nominal(chain), joints)
    tried = solve.frames_of_positions(there, readings.position)
    if tried.apart / tried.reach > _AGAIN * frames.apart / frames.reach:
        return readings, poses, frames
    names = [columns[chain.driven[k]] for k in open_]
    text = f"{', '.join(names)}: no unit is stated; {'it fits' if len(open_) == 1 else 'they fit'} the arm in m"
    return replace(readings, joints=joints).with_note(Code.UNIT_FOUND, text, names, unit="m"), there, tried


def _in_mm(
    readings: Readings, frames: Frames, poses: Array, chain: Chain, source: str, limits: bool
) -> tuple[Readings, Frames]:
    """Return positions in mm and their frames; refuse what no unit explains."""
    assert readings.position is not None
    names, unit = readings.matched.position, unit_of(frames)
    listed = ", ".join(names.values())
    if frames.mirrored:
        other = solve.frames_of_positions(poses, readings.position * [-1.0, 1.0, 1.0])
        if other.apart < APART * other.reach:
            text = f"x, y and z fit the arm as a left-handed frame only: {_left_handed(names)}"
            raise DataError(text, Note(Code.LEFT_HANDED, text, tuple(names.values())))
    if unit is not None:
        frames = solve.frames_of_positions(poses, readings.position, UNITS[unit])
    if unit is None and source == "stated" and frames.apart <= APART * frames.reach:
        pairs = (
            (really, of)
            for really, a in UNITS.items()
            for of, b in UNITS.items()
            if abs(frames.scale * b / a - 1) < NEAR
        )
        for really, of in pairs:
            cure = as_units(names.values(), really)
            text = f"{listed} are stated in {of}, and fit the arm when they are {really}: {cure}"
            raise DataError(text, Note(Code.POSITION_UNIT, text, tuple(names.values()), values={"unit": really}))
    if unit is None or frames.apart > APART * frames.reach:
        apart = f"readings and nominal arm lie {plain(frames.apart, 3)} mm apart, wherever the frames are"
        raise _misfit(readings, chain, apart, limits)
    if source and unit == "mm":
        return readings, frames
    if source:
        really = "mm" if source == "stated" and unit == "um" else unit  # metres were stated
        taken = "mm" if source == "mm" else "what the file states"
        units = as_units(names.values(), really)
        text = f"{listed} are taken for {taken}, and fit the arm when they are {really}: {units}"
        raise DataError(text, Note(Code.POSITION_UNIT, text, tuple(names.values()), values={"unit": really}))
    readings = replace(readings, position=UNITS[unit] * readings.position)
    text = f"{listed}: no unit is stated; they fit the arm in {unit}"
    return readings.with_note(Code.UNIT_FOUND, text, names.values(), unit=unit), frames


def _left_handed(names: Mapping[str, str]) -> str:
    exchanged = as_columns({"x": names["y"], "y": names["x"]})
    return f"an axis points the other way, or two are exchanged; {exchanged} exchanges x and y"


def _misfit(readings: Readings, chain: Chain, apart: str, limits: bool) -> DataError:
    """Return the refusal of readings that do not fit the arm, with the mistake that explains them where one does."""
    if found := _cured(readings, chain):
        far, cure = found
        text = f"{apart}, and {plain(far, 2)} mm {cure.text}"
        return DataError(text, replace(cure, text=text))
    if limits:
        _within_limits(readings, chain, strict=True)  # a better reason than none
    still = [name for k, name in enumerate(chain.driven) if not np.ptp(readings.joints[:, k]) > 0]
    if still:
        column = readings.matched.joints[still[0]]
        text = f"{apart}; column {column} is the same in every row: is it that of joint {still[0]}?"
        return DataError(text, Note(Code.JOINT_STILL, text, (column,), values={"joint": still[0]}))
    rows = f"are the joints' zeros and senses those of the {chain.source}"
    rows = "does each file hold one socket" if readings.position is None else rows
    text = f"{apart}: is this the {chain.source} of the arm, {_CHOICE[chain.source]}, and {rows}?"
    text += joints_beside(readings, chain)
    return DataError(text, Note(Code.OTHER_ARM, text))


def mistake_in(readings: Readings, chain: Chain) -> str:
    """Return, for the end of a refusal, the mistake without which these readings fit the nominal arm; "" for none."""
    now = _apart(readings, chain)[0]
    found = _cured(readings, chain, _BETTER * now)
    return f"; they lie {plain(now, 3)} mm apart, and {plain(found[0], 2)} mm {found[1].text}" if found else ""


def _cured(
    readings: Readings, chain: Chain, most: float = inf,
    of: Callable[[Readings, Chain], Iterator[Sequence[Mistake]]] | None = None,
) -> tuple[float, Note] | None:  # fmt: skip
    """Return the mistake without which the readings fit the arm, to `most` mm, and how well; None where none is."""
    best: tuple[float, Note] | None = None
    ways = [readings]  # and with sliding joints in m where no unit is stated: beside a mistake neither need fit
    known = {*readings.table.units, *(c for n in readings.notes if n.code is Code.UNIT_FOUND for c in n.columns)}
    rails = [k for k, name in enumerate(chain.driven) if name in readings.sliding]
    if open_ := [k for k in rails if readings.matched.joints[chain.driven[k]] not in known]:
        in_m = readings.joints.copy()
        in_m[:, open_] *= UNITS["m"]
        ways.append(replace(readings, joints=in_m))
    for meant in ways:
        some = meant if meant.loci is None else _some(meant)  # a start of these is a search
        for group in (of or _mistakes)(some, chain):
            kept = [one.kept(len(some)) for one in group]
            without = [_meant(one.columns, some, chain).where(rows) for one, rows in zip(group, kept)]
            tried = [(*_apart(so, chain), one) for so, one in zip(without, group)]
            far, found = mistakes.likely(((far, (one, unit)) for far, unit, one in tried if unit), _AS_NEAR)
            if found and far < (most if best is None else _AGAIN * best[0]):
                simpler = [one for one in found if one[1] == "mm"]
                notes = [_told(one, some, chain, unit) for one, unit in simpler or found]
                best = far, replace(notes[0], text=mistakes.OR_AS_NEAR.join(note.text for note in notes))
                break
    return best


def _apart(readings: Readings, chain: Chain) -> tuple[float, str]:
    """Return how far readings and nominal arm lie apart [mm], and the unit of positions in which they fit, or ""."""
    poses = forward(chain, nominal(chain), readings.joints)
    if readings.position is None:
        _, far, most = apart_in_sockets(poses, readings.socket)
        return far, "mm" if far < 0.5 * most else ""
    if readings.loci is not None:
        *_, far = place(poses, readings.position, readings.loci, followed=1)
        return far, "mm" if far < 0.5 * APART * _reach(poses) else ""
    frames = solve.frames_of_positions(poses, readings.position)
    sound = np.mean(frames.near) >= _SOUND and frames.apart < 0.5 * (APART * frames.reach)
    return frames.apart, (unit_of(frames) or "") if sound else ""


def _reach(poses: Array) -> float:
    """Return how far from their middle the tips of poses (n, 4, 4) are, rms [mm]."""
    return float(np.sqrt(((poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0)) ** 2).sum(axis=1).mean()))


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
            cure = f"as degrees all its rows lie within: {as_units(columns_in_degrees(readings, chain), 'deg')}"
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
    stated = any(name in readings.table.units for name in columns)
    large = float(np.abs(readings.angles).max()) > 2 * np.pi + 0.01
    units = {unit: ANGLES[unit] for unit in (("rad",) if stated else ("degrees",) if large else ANGLES)}
    tried = {
        meaning: (turns, *solve.tool_rotation(poses[frames.near], frames.base, turns[frames.near]))
        for meaning, turns in meanings(readings.angles, rotation, units, either_way=not rotation).items()
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
    second = tried[ranked[1]] if len(ranked) > 1 else None
    if second and second[2] < 2 * apart + 1e-9 and not np.allclose(second[0], turns, atol=1e-3):
        raise DataError(f"{listed} may be {ranked[0]} or {ranked[1]}; rotation=rpy|xyz|vector states which")
    text = f"{listed} are read as {ranked[0]}, to {plain(np.rad2deg(apart), 2)}° of the nominal arm"
    frame = frames.tool.copy()
    frame[:3, :3] = tool
    readings = replace(readings, turns=turns).with_note(Code.ROTATION, text, columns)
    return Start(readings, frames.base, frame, ranked[0])


def meanings(angles: Array, rotation: str, units: Mapping[str, float], *, either_way: bool = False) -> dict[str, Array]:
    """Return what rotations may mean, in words -> (n, 3, 3): quaternions (n, 4), or angles (n, 3).

    `rotation` states the order of angles, "" for every order; `units` are those of angles, name -> rad. `either_way`:
    and the same as those of the tracker in the target.
    """
    if angles.shape[1] == 4:
        by_meaning = {
            "quaternion": quaternion(*angles.T)[:, :3, :3],
            "quaternion whose first number is the real part": quaternion(*np.roll(angles, -1, axis=1).T)[:, :3, :3],
        }
    else:
        by_meaning = {
            f"{_ORDERS[order]}, {unit}": rotations_of(size * angles, order)
            for order in ((rotation,) if rotation else ("rpy", "xyz", "vector"))
            for unit, size in units.items()
        }
    inverted = {f"{one}, of the tracker in the target": turns.swapaxes(1, 2) for one, turns in by_meaning.items()}
    return by_meaning | inverted if either_way else by_meaning


def rotations_of(angles: Array, order: str) -> Array:
    """Return the rotations, (n, 3, 3), of angles (n, 3) [rad] in an order: rpy, xyz or vector."""
    if order == "vector":
        size = np.linalg.norm(angles, axis=1)
        unit = angles / np.where(size > 0, size, 1.0)[:, None]
        return np.stack([turn(axis, angle)[:3, :3] for axis, angle in zip(unit, size, strict=True)])
    about = [turn(axis, angles[:, k])[:, :3, :3] for k, axis in enumerate(np.eye(3))]
    return np.asarray(about[2] @ about[1] @ about[0] if order == "rpy" else about[0] @ about[1] @ about[2])


UNITS = {"mm": 1.0, "m": 1e3, "cm": 10.0, "inch": 25.4, "um": 1e-3}
_MIXED = tuple(  # what a rail or an axis is really in, and by how much that is larger than what it was taken for
    (unit, UNITS[unit] / UNITS[taken])
    for pair in (("m", "mm"), ("cm", "mm"), ("inch", "mm"), ("m", "cm"))
    for unit, taken in (pair, pair[::-1])
)
NEAR = 0.2  # part of a unit: few poses of an arm that is not calibrated tell it no better
APART = 0.08  # part of the arm's reach: readings further off are not of this arm
_LEAST_APART = 1.0  # mm, of a ball in sockets
_SCAN = np.deg2rad(np.arange(-165, 181, 15))  # of a joint's zero
_SCANNED = 200  # rows that a scan looks at
_WHOLE = 0.3  # degrees: a zero that is nearer to a whole number of them is one


def unit_of(frames: Frames) -> str | None:
    """Return the unit in which the readings fit the arm; None where there is none."""
    return next((unit for unit, size in UNITS.items() if abs(frames.scale / size - 1) < NEAR), None)


def apart_in_sockets(poses: Array, socket: Index) -> tuple[Array, float, float]:
    """Return the ball (3,) on the last link, how far it is from its sockets, and how far it may be [mm]."""
    ball, _, apart = solve.ball_in_sockets(poses, socket)
    return ball, apart, max(APART * _reach(poses), _LEAST_APART)


def _mistakes(readings: Readings, chain: Chain) -> Iterator[Sequence[Mistake]]:
    """Yield what is tried, in groups: of a group the best is taken, and a group comes before the later ones."""
    columns, (angles, rails) = _columns(readings, chain), _kinds_of(readings, chain)
    every, places = [readings.matched.joints[name] for name in chain.driven], [*readings.matched.position.values()]
    stated = bool({*angles} & {*readings.table.units})
    turned = [("deg", np.pi / 180), *[("rad", 180 / np.pi)] * stated, ("rev", 360.0 if stated else 2 * np.pi)]
    for names, units in ((angles, turned), (rails, _MIXED)):
        yield from ([one] for one in mistakes.in_units(columns, names, units) if names)
    if readings.position is not None and readings.loci is None:
        yield from ([mistakes.a_row_off(columns, every, rows)] for rows in (1, -1))
        yield [mistakes.reversed_in(columns, [readings.matched.position["x"]])]

    # single joints, which turn the other way or from another zero, and two exchanged
    of_joints = []
    for k, column in enumerate(every):
        of_joints.append(mistakes.reversed_in(columns, [column]))
        if column in rails or readings.loci is not None:
            continue
        of_joints.append(mistakes.moved(columns, column, np.deg2rad(_zero_of(readings, chain, k))))
        if stated and len(angles) > 1:  # one that is in degrees where rad are stated is refused by its size
            of_joints += mistakes.in_units(columns, [column], turned[1:2])
    yield of_joints + [mistakes.exchanged(columns, *both) for both in combinations(every, 2)]
    if readings.position is not None and places:
        yield [one for name in places for one in mistakes.in_units(columns, [name], _MIXED)]
    yield from _in_part(readings, chain)


def _in_part(readings: Readings, chain: Chain) -> Iterator[Sequence[Mistake]]:
    """Yield mistakes of the last rows, or the first: units, and rows that are out of step after one was lost."""
    n, columns, (angles, rails) = len(readings), _columns(readings, chain), _kinds_of(readings, chain)
    if readings.position is None or readings.loci is not None or n < _PARTS * mistakes.FEW:
        return
    every, places = [*angles, *rails], [*readings.matched.position.values()]
    turned = [("deg", np.pi / 180), ("rad", 180 / np.pi)]
    whole = [*mistakes.in_units(columns, angles, turned), *mistakes.in_units(columns, places, _MIXED)]
    whole += [mistakes.a_row_off(columns, every, rows) for rows in (1, -1)]
    poses, found = forward(chain, nominal(chain), readings.joints), []
    for some in (slice(n // _PARTS), slice(n - n // _PARTS, n)):  # of the rows the part that is sound
        frames = solve.frames_of_positions(poses[some], readings.position[some])

        def left(changed: Mapping[str, Array], frames: Frames = frames) -> Array:
            meant = _meant(changed, readings, chain)
            there = (frames.base @ forward(chain, nominal(chain), meant.joints) @ frames.tool)[:, :3, 3]
            assert meant.position is not None
            return np.asarray(np.sqrt(((frames.scale * meant.position - there) ** 2).sum(axis=1)))

        as_read = left({})
        for one in whole:
            found += mistakes.in_part(one, columns, as_read, left(one.columns), bool(some.start))
    yield found


def _told(mistake: Mistake, readings: Readings, chain: Chain, unit: str) -> Note:
    """Return what a mistake is, its text as the end of "readings and arm lie 300 mm apart, and 1 mm ..."; positions
    that were taken for mm are in this `unit` besides.
    """
    (note, units), names = _of_one(mistake, readings, chain), [*readings.matched.position.values()]
    if unit == "mm" or not {*names} & {*"xyz", *readings.table.units}:
        return replace(note, text=f"{note.text}: {units}") if units else note
    beside, theirs = f"{', '.join(names)} in {unit}", as_units(names, unit)
    both = f"{note.text} and {beside}: {units},{theirs.removeprefix('units=')}"
    return replace(note, text=both if units else f"{note.text}; with {beside} besides: {theirs}")


def _of_one(mistake: Mistake, readings: Readings, chain: Chain) -> tuple[Note, str]:
    """Return what one mistake is, and the word units= that cures it; "" where another cure stands in the note."""
    names, unit, matched = tuple(mistake.columns), mistake.unit, readings.matched
    first, end = mistake.rows or (0, len(readings))
    some = f"from {readings.label(first)} on" if first else f"up to {readings.label(end - 1)}"
    rows = (readings.label(first), readings.label(end - 1)) if mistake.rows else ()
    if mistake.rows and mistake.kind is Kind.UNIT:
        code = Code.JOINT_UNIT if {*names} & {*matched.joints.values()} else Code.POSITION_UNIT
        text = f"with {', '.join(names)} in {unit} {some}, and as they are in the other rows: bring all to one unit"
        return Note(code, text, names, rows, {"unit": unit}), ""
    if mistake.kind is Kind.ROWS:
        text = f"if the readings of each row's joints stand in the row {'below' if mistake.by > 0 else 'above'}"
        text += f" {some}: there a row is missing, or one too many" if mistake.rows else ""
        return Note(Code.ROWS_OUT_OF_STEP, text, rows=rows, values={"rows": int(mistake.by)}), ""
    axis = next((axis for axis, name in matched.position.items() if name in names), None)
    if axis and mistake.kind is Kind.SIGN:
        text = f"if x, y and z are those of a left-handed frame: {_left_handed(matched.position)}"
        return Note(Code.LEFT_HANDED, text, tuple(matched.position.values())), ""
    if axis:
        other = next(one for one, size in UNITS.items() if np.isclose(mistake.by * size, UNITS[unit]))
        text = f"if {names[0]} is in {unit} where the others are in {other}"
        return Note(Code.POSITION_UNIT, text, names, values={"axis": axis, "unit": unit}), f"units={names[0]}:{unit}"

    joint, *others = [next(joint for joint, name in matched.joints.items() if name == one) for one in names]
    angles, rails = _kinds_of(readings, chain)
    by_table, slides = chain.source == "table", joint in readings.sliding
    if mistake.kind is Kind.UNIT:
        how = f"joint {joint} alone in {unit}" if len(names) < len(angles) else f"joints in {_IN[unit]}"
        how = f"{', '.join(rails)} in {unit}" if slides else how
        return Note(Code.JOINT_UNIT, f"with {how}", names, values={"unit": unit}), as_units(names, unit)
    if mistake.kind is Kind.ZERO:
        degrees = round(float(np.rad2deg(mistake.by)), 9)
        text = f"if {degrees:g}° are added to joint {joint}: its zero is not that of the {chain.source}"
        return Note(Code.JOINT_SHIFTED, text, names, values={"joint": joint, "degrees": degrees}), ""
    if mistake.kind is Kind.SIGN:
        cure = "change the sign of its column, or the alphas that point its axis"
        cure = cure if by_table else "turn its axis, or its readings"
        text = f"if joint {joint} {'slides' if slides else 'turns'} the other way than in the {chain.source}: {cure}"
        return Note(Code.JOINT_REVERSED, text, names, values={"joint": joint}), ""
    by_order = any(note.code is Code.COLUMNS_MATCHED and {*names} <= {*note.columns} for note in matched.notes)
    every = {f"q_{name}": column for name, column in matched.joints.items()} if by_order else {}
    cure = as_columns(every | {f"q_{joint}": names[1], f"q_{others[0]}": names[0]})
    or_names = ", or their names in the table" if by_table else ""
    text = f"if the columns of joints {joint} and {others[0]} are exchanged{or_names}: {cure}"
    return Note(Code.JOINTS_EXCHANGED, text, names[::-1], values={"joints": [joint, *others]}), ""


def _columns(readings: Readings, chain: Chain) -> dict[str, Array]:
    """Return the columns of joints and of positions, by their names in the file."""
    columns = {readings.matched.joints[name]: readings.joints[:, k] for k, name in enumerate(chain.driven)}
    if readings.position is not None:
        columns |= {name: readings.position[:, POSITION.index(a)] for a, name in readings.matched.position.items()}
    return columns


def _kinds_of(readings: Readings, chain: Chain) -> tuple[list[str], list[str]]:
    """Return the columns of joints that turn, and of those that slide."""
    named = readings.matched.joints
    slide = [named[name] for name in chain.driven if name in readings.sliding]
    return [named[name] for name in chain.driven if name not in readings.sliding], slide


def _meant(changed: Mapping[str, Array], readings: Readings, chain: Chain) -> Readings:
    """Return the readings with some columns changed."""
    columns, position = {**_columns(readings, chain), **changed}, readings.position
    joints = np.column_stack([columns[readings.matched.joints[name]] for name in chain.driven])
    if position is not None:
        position = position.copy()
        for axis, name in readings.matched.position.items():
            position[:, POSITION.index(axis)] = columns[name]
    return replace(readings, joints=joints, position=position)


def _some(readings: Readings) -> Readings:
    """Return rows for a scan, without a step that could fall in with kinds of readings that come in turn."""
    return readings.where(np.sort(np.random.default_rng(0).permutation(len(readings))[:_SCANNED]))


def _zero_of(readings: Readings, chain: Chain, k: int) -> float:
    """Return by how many degrees joint k has to be turned for the readings to be nearest to the nominal arm."""
    some = _some(readings)
    read = np.zeros((len(some), 3))
    if some.position is not None:
        read = some.position - np.median(some.position, axis=0)
        read = read / (float(np.median(np.sqrt((read**2).sum(axis=1)))) or 1.0)

    def apart(angle: float) -> float:
        joints = some.joints.copy()
        joints[:, k] += angle
        poses = forward(chain, nominal(chain), joints)
        if some.position is None:
            return solve.ball_in_sockets(poses, some.socket)[2]
        # the median distance [mm] that the linear equations of the frames leave, wild or not
        rows, wanted = solve.equations(poses, read), poses[:, :3, 3]
        solved = np.linalg.lstsq(rows.reshape(-1, 15), wanted.ravel(), rcond=1e-9)[0]
        return float(np.median(np.sqrt(((rows @ solved - wanted) ** 2).sum(axis=1))))

    best = _SCAN[int(np.argmin([apart(angle) for angle in _SCAN]))]
    step = float(_SCAN[1] - _SCAN[0])
    zero = minimize_scalar(apart, bounds=(best - step, best + step), method="bounded", options={"xatol": 1e-4}).x
    degrees = float(np.rad2deg(zero))
    degrees = degrees - 360 if degrees > 180 + _WHOLE else degrees
    return float(round(degrees)) if abs(degrees - round(degrees)) < _WHOLE else float(plain(degrees, 4))


LENGTHS = ("a", "d")
_ROUNDS, _FAR = 4, 6.0  # times the median of what is left: a reading beyond has no influence, as it may be wild
_BETTER = 0.2  # of the misfit of the table as it stands: one change of an arm that is merely not calibrated gains less
_AS_WELL = 2.0  # times the misfit of the best change: one that leaves less may be meant as well
_SOUND = 0.85  # of the poses must lie near to where the others have the arm
_PARTS = 3  # of the rows the first or the last is sound where a part is mistaken
_IN = {"deg": "degrees", "rad": "rad, and not in degrees as the file states", "rev": "turns"}
_AS_NEAR = 1.2  # times what the best cure of a file leaves: one that leaves less may be meant as well
_STRAIGHT = 1e-3  # rad: an alpha that is nearer to a multiple of a quarter turn is one


def misfit_of_table(table: DhTable, data: Table, how: HowRead) -> float:
    """Return how far readings and nominal arm lie apart, as a part of its reach; infinite where it is not this arm."""
    try:
        chain = table.chain
        readings = read_readings(data, chain, how.observe)
        if readings.position is None:
            poses = forward(chain, nominal(chain), readings.joints)
            _, apart, most = apart_in_sockets(poses, readings.socket)
            if apart > most:
                return inf  # before `start_of` looks for the reason
        elif readings.loci is None:
            frames = slid(readings, chain)[2]
            if frames.apart > APART * frames.reach or unit_of(frames) is None:
                return inf
        start_of(readings, chain, how.rotation, how.limits)
    except (DataError, ChainError):
        return inf
    return 0.0 if readings.position is None or readings.loci is not None else frames.apart / frames.reach


def mistake_of_table(table: DhTable, data: Table, how: HowRead) -> str:
    """Return which one change of `table` makes the readings fit the arm; "" where none does, or several would."""
    now = misfit_of_table(table, data, how)
    if now < DOUBTFUL:
        return ""
    with suppress(DataError, ChainError):
        if read_readings(data, table.chain, how.observe).loci is not None:
            return ""
    cures: list[tuple[float, str]] = []  # what each change leaves that cures the misfit, the best first
    for changed in (_changed(table), _other_lengths(table, data, how)):
        tried = [(misfit_of_table(other, data, how), text) for other, text in changed]
        cures = sorted([*cures, *(one for one in tried if one[0] < min(APART / 2, _BETTER * now))])
        if cures and cures[0][0] <= DOUBTFUL:
            break
    alike = [text for apart, text in cures if apart <= _AS_WELL * cures[0][0]]
    return ", or ".join(alike) if 0 < len(alike) <= mistakes.MOST else ""


def _changed(table: DhTable) -> Iterator[tuple[DhTable, str]]:
    """Yield tables with one thing changed, and the change as the end of "the readings fit the arm ..."."""
    for form in FORMS:
        if form != table.form:
            yield replace(table, form=form), f"as {form}: convention={form}"
    rows = table.rows
    for k, row in enumerate(rows):
        if row.kind != "fixed":
            slides = row.kind == "rotary"
            other = replace(row, kind="sliding" if slides else "rotary", lower=-inf, upper=inf)
            how = "slides: type prismatic" if slides else "turns: type revolute"
            yield _with(table, {k: other}), f"if row {k + 1} ({row.name}) {how}"
    for i, j in combinations(range(len(rows)), 2):
        one, other = rows[i], rows[j]
        pair = f"rows {i + 1} ({one.name}) and {j + 1} ({other.name})"
        yield _with(table, {i: other, j: one}), f"if {pair} are exchanged"
        numbers, theirs = ({key: getattr(row, key) for key in ("kind", *NUMBERS)} for row in (one, other))
        exchanged = {i: replace(one, **theirs), j: replace(other, **numbers)}
        yield _with(table, exchanged), f"if {pair} exchange their numbers, and keep their names"
    for first, second in (("a", "d"), ("alpha", "theta")):
        columns = {
            k: replace(row, **{first: getattr(row, second), second: getattr(row, first)}) for k, row in enumerate(rows)
        }
        yield _with(table, columns), f"if columns {first} and {second} are exchanged"
    scale = between("alpha", "rad", table.angle)
    for k, row in enumerate(rows):
        # of the other sign, or a quarter turn for none, or none for one
        meant = [pi / 2, -pi / 2] if abs(row.alpha) < _STRAIGHT else []
        meant += [-row.alpha] if not meant and pi - abs(row.alpha) > _STRAIGHT else []
        meant += [0.0] if abs(abs(row.alpha) - pi / 2) < _STRAIGHT else []
        for alpha in meant:
            was, now = (f"{plain(scale * v, 4)} {table.angle}" for v in (row.alpha, alpha))
            text = f"if alpha of row {k + 1} ({row.name}) is {now}, not {was}"
            yield _with(table, {k: replace(row, alpha=alpha)}), text


def _other_lengths(table: DhTable, data: Table, how: HowRead) -> Iterator[tuple[DhTable, str]]:
    """Yield tables with one length as the readings have it, and the change, as `_changed` does."""
    try:
        readings = read_readings(data, table.chain, how.observe)
    except (DataError, ChainError):
        return
    if readings.position is None:
        return
    places, middle = readings.position, np.median(readings.position, axis=0)
    size = float(np.median(np.abs(places - middle))) or 1.0
    for k, row in enumerate(table.rows):
        for one in LENGTHS:
            # the length by the equations of the frames: of B, c, t and by how far it is longer
            numbers: list[dict[str, Any]] = [{one: 0.0}, {one: 1.0}]
            chains = [_with(table, {k: replace(row, **number)}).chain for number in numbers]
            here, there = (forward(chain, nominal(chain), readings.joints) for chain in chains)
            along = there[:, :3, 3] - here[:, :3, 3]
            reach = float(np.abs(here[:, :3, 3]).max()) or 1.0
            rows = np.concatenate([solve.equations(here, (places - middle) / size), -along[:, :, None]], axis=2)
            wanted = here[:, :3, 3] / reach
            near = np.ones(len(places), dtype=bool)
            for _ in range(_ROUNDS):
                solved, _, rank, _ = np.linalg.lstsq(rows[near].reshape(-1, 16), wanted[near].ravel(), rcond=1e-6)
                rest = np.sqrt(((rows @ solved - wanted) ** 2).sum(axis=1))
                near = rest <= max(_FAR * float(np.median(rest)), 1e-9)
            without = np.linalg.matrix_rank(rows[near][:, :, :15].reshape(-1, 15), rtol=1e-6)
            if rank > without:
                length = float(solved[15] * reach)
                was, now = (plain(between(one, "mm", table.length) * v, 3) for v in (getattr(row, one), length))
                text = f"if {one} of row {k + 1} ({row.name}) is about {now} {table.length}, not {was}"
                longer: dict[str, Any] = {one: length}
                yield _with(table, {k: replace(row, **longer)}), text


def _with(table: DhTable, rows: dict[int, DhRow]) -> DhTable:
    return replace(table, rows=tuple(rows.get(k, row) for k, row in enumerate(table.rows)))
