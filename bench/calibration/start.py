"""The start of a calibration: frames in closed form, and with them units and orders that the file does not state.

The unit of positions, the order and unit of rotations, a left-handed frame, joints in degrees, reversed or exchanged:
each causes its own pattern of differences between the nominal arm and the readings, whatever the frames. A statement of
the file, or the usual meaning of its column names, is kept. What contradicts the arm is refused in a line that says
what to do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import final

import numpy as np

from calibench.bench.calibration.readings import Readings, in_unit, joints_beside
from calibench.core.options import suggest
from calibench.core.words import as_columns, plain
from calibench.discrepancy import DataError
from calibench.problems.arm.chains.chain import Chain
from calibench.problems.arm.chains.kinematics import forward, nominal
from calibench.problems.arm.chains.rigid import quaternion, turn
from calibench.problems.arm.frames import Frames, ball_in_sockets, frames_of_positions, tool_rotation
from calibench.problems.arm.stands import moved
from calibench.problems.base import Array

_UNITS = {"mm": 1.0, "m": 1e3, "cm": 10.0, "inch": 25.4, "um": 1e-3}
_RAILS = (  # what a rail is really in, and what it was taken for
    ("m", "mm"), ("mm", "m"), ("cm", "mm"), ("mm", "cm"), ("inch", "mm"), ("mm", "inch"), ("m", "cm"), ("cm", "m"),
)  # fmt: skip
_NEAR = 0.2  # part of a unit: few poses of an arm that is not calibrated tell it no better
APART = 0.08  # part of the arm's reach: readings further off are not of this arm
DOUBTFUL = 0.01  # part of the reach: arms that are not calibrated lie nearer to their descriptions
_TURNED = 0.12  # rad: the same of rotations
ROTATIONS = ("rpy", "xyz", "vector", "quaternion")
_CHOICE = {"URDF": "machine.tip= the right arm of it", "table": "convention= the one it was written in"}
_AXES = {"x": np.array([1.0, 0, 0]), "y": np.array([0, 1.0, 0]), "z": np.array([0, 0, 1.0])}


@final
@dataclass(frozen=True, eq=False)
class Start:
    """Readings in mm with their rotations, and the frames (4, 4): tracker's to base, tip to target."""

    readings: Readings
    base: Array
    tool: Array


def started(readings: Readings, chain: Chain, rotation: str = "") -> Start:
    """Return where the calibration starts. Raises `DataError` where the readings are not of this arm."""
    if rotation and rotation not in ROTATIONS:
        raise DataError(f"rotation={rotation}: {suggest(rotation, ROTATIONS)}")
    poses = forward(chain, nominal(chain), readings.joints)
    if readings.position is None:
        return _in_sockets(readings, chain, poses)
    readings, scale = _in_metres(readings)
    readings, poses, start = slid(readings, chain, poses)
    readings, found = _in_mm(readings, start, poses, chain, scale)
    _check_one_stand(readings, found, poses)
    if readings.observed != "pose":
        return Start(readings, found.base, found.tool)
    return _with_rotations(readings, found, poses, rotation)


def _check_one_stand(readings: Readings, found: Frames, poses: Array) -> None:
    """Refuse poses that were read from two stands of the tracker."""
    assert readings.position is not None
    far, said = moved(poses, readings.position, found)
    if said:
        there = np.flatnonzero(far)
        raise DataError(
            f"{len(there)} of {len(far)} poses, {readings.told(int(there[0]))} to {readings.told(int(there[-1]))}, fit "
            f"the arm by themselves only: {said}; calibrate what was read from one stand"
        )


def slid(readings: Readings, chain: Chain, poses: Array) -> tuple[Readings, Array, Frames]:
    """Return readings, nominal poses and frames; sliding joints are taken for m where only that fits the arm."""
    assert readings.position is not None
    found = frames_of_positions(poses, readings.position)
    columns = {name: readings.matched.joints[name] for name in readings.sliding if name in chain.driven}
    open_ = [k for k, name in enumerate(chain.driven) if columns.get(name, "") not in {"", *readings.table.units}]
    if not open_:
        return readings, poses, found
    joints = readings.joints.copy()
    joints[:, open_] *= _UNITS["m"]
    there = forward(chain, nominal(chain), joints)
    tried = frames_of_positions(there, readings.position)
    if tried.left / tried.reach > 0.5 * found.left / found.reach:
        return readings, poses, found
    names = ", ".join(columns[chain.driven[k]] for k in open_)
    note = f"{names}: no unit is stated; {'it fits' if len(open_) == 1 else 'they fit'} the arm in m"
    return replace(readings, joints=joints).noted(note), there, tried


def _in_metres(readings: Readings) -> tuple[Readings, str]:
    """Return positions in mm where FIGAROH's names mean metres, and the source of the unit ("": none)."""
    assert readings.position is not None
    columns = readings.matched.position
    if any(name in readings.table.units for name in columns.values()):
        return readings, "stated"
    if readings.matched.figaroh:
        note = f"{', '.join(columns.values())}: FIGAROH's names, so metres"
        return replace(readings, position=1e3 * readings.position).noted(note), "m"
    return readings, "mm" if set(columns.values()) == {"x", "y", "z"} else ""


def _in_mm(readings: Readings, found: Frames, poses: Array, chain: Chain, said: str) -> tuple[Readings, Frames]:
    """Return positions in mm and their frames; refuse what no unit explains."""
    assert readings.position is not None
    names = readings.matched.position
    unit = unit_of(found)
    if found.mirrored:
        other = frames_of_positions(poses, readings.position * [-1.0, 1.0, 1.0])
        if other.left < APART * other.reach:
            x, y = names["x"], names["y"]
            raise DataError(
                "x, y and z fit the arm as a left-handed frame only: an axis points the other way, or two are "
                f"exchanged; {as_columns({'x': y, 'y': x})} exchanges x and y"
            )
    if unit is not None:
        found = frames_of_positions(poses, readings.position, _UNITS[unit])
    if unit is None or found.left > APART * found.reach:
        raise DataError(_why(readings, found, chain))
    if said and unit == "mm":
        return readings, found
    if said:
        size = _UNITS[unit] * (1e3 if said == "m" else 1.0)
        really = next((u for u, other in _UNITS.items() if abs(size / other - 1) < _NEAR), unit)
        really = "mm" if said == "stated" and really == "um" else really  # metres were stated
        told = {"m": "metres, as FIGAROH's names say", "mm": "mm", "stated": "what the file states"}[said]
        named = ",".join(f"{name}:{really}" for name in names.values())
        raise DataError(
            f"{', '.join(names.values())} are taken for {told}, and fit the arm when they are {really}: units={named}"
        )
    note = f"{', '.join(names.values())}: no unit is stated; they fit the arm in {unit}"
    return replace(readings, position=_UNITS[unit] * readings.position).noted(note), found


def unit_of(found: Frames) -> str | None:
    """Return the unit in which the readings fit the arm; None where there is none."""
    return next((unit for unit, size in _UNITS.items() if abs(found.scale / size - 1) < _NEAR), None)


def _why(readings: Readings, found: Frames, chain: Chain) -> str:
    """Return what is wrong with readings that do not fit the arm, as far as trials can find it."""
    assert readings.position is not None
    left = f"readings and nominal arm lie {plain(found.left, 3)} mm apart, wherever the frames are"
    turning = [k for k, name in enumerate(chain.driven) if name not in readings.sliding]
    stated = bool({readings.matched.joints[chain.driven[k]] for k in turning} & set(readings.table.units))
    for unit, size in (("deg", np.pi / 180), ("rad", 180 / np.pi if stated else 1.0)):
        scaled = readings.joints.copy()
        scaled[:, turning] *= size
        tried = _fit(chain, scaled, readings)
        if _fits(tried):
            told = {"deg": "degrees", "rad": "rad, and not in degrees as the file states"}[unit]
            return (
                f"{left}, and {plain(tried.left, 2)} mm with joints in {told}: units={in_unit(readings, chain, unit)}"
            )
    if told := _rail_unit(readings, chain):
        return f"{left}, and {told}"
    for lag in (1, -1):
        kept = readings.where(np.arange(len(readings)) != (0 if lag > 0 else len(readings) - 1))
        tried = _fit(chain, readings.joints[max(-lag, 0) : len(readings) - max(lag, 0)], kept)
        if _fits(tried):
            at = "below" if lag > 0 else "above"
            return f"{left}, and {plain(tried.left, 2)} mm if the readings of each row's joints stand in the row {at}"
    best, said = found, ""
    for k, name in enumerate(chain.driven):
        turned = readings.joints.copy()
        turned[:, k] *= -1
        tried = _fit(chain, turned, readings)
        if tried.left < best.left:
            best, said = (
                tried,
                _other_way(name, readings, chain),
            )
        for degrees in (-90, 90, 180) if k in turning else ():
            shifted = readings.joints.copy()
            shifted[:, k] += np.deg2rad(degrees)
            tried = _fit(chain, shifted, readings)
            if tried.left < best.left:
                best, said = tried, f"{degrees}° are added to joint {name}: its zero is not that of the {chain.told}"
    for a, b in combinations(range(len(chain.driven)), 2):
        order = list(range(len(chain.driven)))
        order[a], order[b] = b, a
        tried = _fit(chain, readings.joints[:, order], readings)
        if tried.left < best.left:
            one, other = chain.driven[a], chain.driven[b]
            columns = readings.matched.joints[other], readings.matched.joints[one]
            best, said = (
                tried,
                (
                    f"the columns of joints {one} and {other} are exchanged{_or_names(chain)}: "
                    f"{as_columns({f'q_{one}': columns[0], f'q_{other}': columns[1]})}"
                ),
            )
    if said and _fits(best):
        return f"{left}, and {plain(best.left, 2)} mm if {said}"
    still = [name for k, name in enumerate(chain.driven) if not np.ptp(readings.joints[:, k]) > 0]
    if still:
        one = readings.matched.joints[still[0]]
        return f"{left}; column {one} is the same in every row: is it that of joint {still[0]}?"
    return (
        f"{left}: is this the {chain.told} of the arm, {_CHOICE[chain.told]}, and are the joints' zeros and senses "
        f"those of the {chain.told}?{joints_beside(readings, chain)}"
    )


def _rail_unit(readings: Readings, chain: Chain) -> str:
    """Return in which other unit the joints that slide fit the arm, as the end of a refusal; "" for none."""
    sliding = [k for k, name in enumerate(chain.driven) if name in readings.sliding]
    columns = [readings.matched.joints[chain.driven[k]] for k in sliding]
    for really, taken in _RAILS if sliding else ():
        scaled = readings.joints.copy()
        scaled[:, sliding] *= _UNITS[really] / _UNITS[taken]
        tried = _fit(chain, scaled, readings)
        if _fits(tried):
            units = ",".join(f"{column}:{really}" for column in columns)
            return f"{plain(tried.left, 2)} mm with {', '.join(columns)} in {really}: units={units}"
    return ""


def _other_way(joint: str, readings: Readings, chain: Chain) -> str:
    moves = "slides" if joint in readings.sliding else "turns"
    cure = "turn its axis, or its readings"
    if chain.told == "table":
        cure = "change the sign of its column, or the alphas that point its axis"
    return f"joint {joint} {moves} the other way than in the {chain.told}: {cure}"


def _or_names(chain: Chain) -> str:
    return ", or their names in the table" if chain.told == "table" else ""


def _fit(chain: Chain, joints: Array, readings: Readings) -> Frames:
    assert readings.position is not None
    return frames_of_positions(forward(chain, nominal(chain), joints), readings.position)


def _fits(found: Frames) -> bool:
    return unit_of(found) is not None and found.left < 0.5 * APART * found.reach


def _with_rotations(readings: Readings, found: Frames, poses: Array, rotation: str) -> Start:
    """Return the start with the rotations in the order, sense and unit that is stated, or that alone fits the arm."""
    assert readings.angles is not None
    columns = list(readings.matched.rotation.values())
    tried = {
        said: (made, *tool_rotation(poses[found.near], found.base, made[found.near]))
        for said, made in _rotations(readings, columns, rotation).items()
    }
    ranked = sorted(tried, key=lambda said: tried[said][2])
    best = ranked[0]
    made, tool, apart = tried[best]
    if apart > _TURNED:
        still = [name for name, angle in zip(columns, readings.angles.T, strict=True) if not np.ptp(angle) > 0]
        if len(still) == len(columns) and not rotation:
            note = f"{', '.join(columns)} never vary, though the arm turned its tool: they are left out"
            return Start(replace(readings, observed="position", angles=None).noted(note), found.base, found.tool)
        of_these = f"; {', '.join(still)} never {'varies' if len(still) == 1 else 'vary'}" if still else ""
        if rotation:
            raise DataError(
                f"{', '.join(columns)}: rotations lie {plain(apart, 2)} rad from the nominal arm as "
                f"rotation={rotation}{of_these}; "
                "leave rotation= out to have the order found, or take machine.observe=position"
            )
        names = ", ".join(columns)
        note = f"{names} fit in no order of rotations ({plain(apart, 2)} rad apart{of_these}) and are left out"
        return Start(replace(readings, observed="position", angles=None).noted(note), found.base, found.tool)
    if (
        len(ranked) > 1
        and tried[ranked[1]][2] < 2 * apart + 1e-9
        and not np.allclose(tried[ranked[1]][0], made, atol=1e-3)
    ):
        raise DataError(f"{', '.join(columns)} may be {best} or {ranked[1]}; rotation=rpy|xyz|vector states which")
    note = f"{', '.join(columns)} are read as {best}, to {plain(np.rad2deg(apart), 2)}° of the nominal arm"
    frame = found.tool.copy()
    frame[:3, :3] = tool
    return Start(replace(readings, turns=made).noted(note), found.base, frame)


def _rotations(readings: Readings, columns: list[str], rotation: str) -> dict[str, Array]:
    """Return the possible meanings of the rotations, in words -> (n, 3, 3)."""
    assert readings.angles is not None
    angles = readings.angles
    stated = any(name in readings.table.units for name in columns)
    large = float(np.abs(angles).max()) > 2 * np.pi + 0.01
    units = {"rad": 1.0} if stated or readings.matched.figaroh else {"degrees": np.pi / 180}
    if not large and not stated and not readings.matched.figaroh:
        units = {"rad": 1.0, **units}
    found = meanings(angles, rotation, units)
    if not rotation:
        found |= {f"{said}, of the tracker in the target": made.swapaxes(1, 2) for said, made in found.items()}
    return found


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
        f"{_WORDS[order]}, {unit}": _matrices(size * angles, order)
        for order in ((rotation,) if rotation else ("rpy", "xyz", "vector"))
        for unit, size in units.items()
    }


_WORDS = {
    "rpy": "roll, pitch and yaw (rotation=rpy)",
    "xyz": "turns about the moving x, y and z (rotation=xyz)",
    "vector": "a rotation vector (rotation=vector)",
    "quaternion": "a quaternion",
}


def _matrices(angles: Array, order: str) -> Array:
    about = [turn(_AXES[axis], angles[:, k])[:, :3, :3] for k, axis in enumerate("xyz")]
    if order == "rpy":
        return np.asarray(about[2] @ about[1] @ about[0])
    if order == "xyz":
        return np.asarray(about[0] @ about[1] @ about[2])
    size = np.linalg.norm(angles, axis=1)
    unit = angles / np.where(size > 0, size, 1.0)[:, None]
    return np.stack([turn(axis, angle)[:3, :3] for axis, angle in zip(unit, size, strict=True)])


def _in_sockets(readings: Readings, chain: Chain, poses: Array) -> Start:
    ball, _, left = ball_in_sockets(poses, readings.socket)
    reach = float(np.sqrt(((poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0)) ** 2).sum(axis=1).mean()))
    if left > max(APART * reach, 1.0):
        degrees = forward(chain, nominal(chain), np.deg2rad(readings.joints))
        better = ball_in_sockets(degrees, readings.socket)[2]
        if better < 0.2 * left:
            raise DataError(
                f"the ball is {left:.0f} mm away from its sockets, and {plain(better, 2)} mm with joints in degrees: "
                f"units={in_unit(readings, chain)}"
            )
        raise DataError(
            f"the ball is {left:.0f} mm away from its sockets wherever it sits on the last link: is this the "
            f"{chain.told} of the arm, and does each file hold one socket?"
        )
    tool = np.eye(4)
    tool[:3, 3] = ball
    return Start(readings, np.eye(4), tool)
