"""The start of a hand-eye calibration: pairs of poses from a table, and both frames in closed form.

With A the arm's poses and B the board's, B = M A T: rotations solve a linear system (as Shah 2013), places are linear
after that. Handfuls of pairs are tried, against wild ones, and so are other orders, inverse poses and rows out of step.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from typing import Literal, final

import numpy as np

from calibench.calibration.columns import Matched, by_their_names, match_columns
from calibench.calibration.frames import angle_between, handfuls, nearest_rotation
from calibench.calibration.hand_eye_fit import Track
from calibench.calibration.readings import Table, held_back, without_copies
from calibench.calibration.rigid import Array, Index, Mask, inverse
from calibench.calibration.start import UNITS, meanings
from calibench.core.notes import Code, DataError, Note
from calibench.core.options import suggest
from calibench.core.tables import mistakes
from calibench.core.tables.cells import valid_rows
from calibench.core.tables.mistakes import Kind, Mistake
from calibench.core.words import as_columns, as_units, listed, plain

Mounting = Literal["eye_in_hand", "eye_to_hand"]
Flange = Literal["flange_in_base", "base_in_flange"]
Read = Literal["", "board_in_camera", "camera_in_board"]
SIDES = ("flange", "board")
_CALLED = {
    "flange": ("flange", "tcp", "hand", "gripper", "robot"),
    "board": ("board", "marker", "tag", "target"),
    "camera": ("camera", "cam"),
}
_LENGTH = 0.01  # by which a quaternion's length may differ from 1: three digits leave a thousandth
_TURNED = 4 * np.pi  # rad
_TIMES_OF = ("t", "time", "stamp", "timestamp")
_NO_POSE = ("split", "valid", *_TIMES_OF)
_UNITS_OF_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
_SINCE_1970 = {1e17: "ns", 1e14: "us", 1e11: "ms"}  # numbers beyond, where no unit is stated
_SMALL = 5.0  # mm: places of flange and board of any robot reach further
_HUGE = 1e9  # mm: a place that no instrument gives


@final
@dataclass(frozen=True, kw_only=True)
class Setup:
    """What is stated on a camera on the hand, or beside the robot, and on how its pairs of poses are read.

    `read` is what the camera's columns hold, "" where their names say it; `flange` what the robot's do. `board_scale`
    is how many times as far as the file says the board is; with `free_scale` that is fitted. `rotation` is the order of
    angles of the poses of `flange` and `board`, where it is stated. `sigma` [mm] and `sigma_rotation` [rad] are the
    noise of the board's pose on each axis; 0 where it is to be learned from the data.
    """

    hand_eye: Mounting = "eye_in_hand"
    read: Read = ""
    rotation: Mapping[str, str] = field(default_factory=dict)
    sigma: float = 0.0
    sigma_rotation: float = 0.0
    flange: Flange = "flange_in_base"
    board_scale: float = 1.0
    free_scale: bool = False


@final
@dataclass(frozen=True, eq=False)
class Pose:
    """One side of the pairs: `place` (n, 3) [mm], and what its rotations may mean, in words -> (n, 3, 3).

    The first meaning is what the names of the columns say. `columns` are theirs, place first. `inverted` says that they
    hold the base in the flange, or the camera in the board.
    """

    place: Array
    meanings: Mapping[str, Array]
    columns: tuple[str, ...]
    inverted: bool

    def poses(self, meaning: str) -> Array:
        """Return the flange in the base, or the board in the camera, (n, 4, 4) [mm], with the rotations' `meaning`."""
        made = np.tile(np.eye(4), (len(self.place), 1, 1))
        made[:, :3, :3], made[:, :3, 3] = self.meanings[meaning], self.place
        return np.asarray(inverse(made)) if self.inverted else made


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Pairs:
    """n pairs, `hold` (n,) kept from the fit or None, table `rows` (n,); `still`: columns of one value, "" for none.

    Of two streams the poses of the board are at `time` (n,), those of the flange (m,) at `stamps` (m,) [s].
    """

    flange: Pose
    board: Pose
    read: str
    hold: Mask | None
    rows: Index
    still: str
    table: Table
    notes: tuple[Note, ...]
    board_scale: float
    time: Array | None = None
    stamps: Array | None = None


def read_pairs(table: Table, setup: Setup, columns: Mapping[str, str]) -> Pairs:
    """Return the pairs of poses in `table`; `columns` are names of ours -> names of the table."""
    lost = [(target, name) for target, name in columns.items() if name not in table.columns]
    if lost:
        raise DataError(f"columns: {lost[0][0]} is to be {lost[0][1]!r}; {suggest(lost[0][1], list(table.columns))}")
    sides = _sides(table, {name: target for target, name in columns.items()})
    if not setup.read and "board" not in sides:
        raise DataError(
            "columns of camera_ may be the camera in the board, or the board in the camera: read=camera_in_board or "
            "read=board_in_camera says which"
        )
    seen = "camera" if "board" not in sides else "board"
    both = {"flange": sides["flange"], "board": sides[seen]}
    table, unit_notes = _in_base_units(table, both)
    used = [name for side in both.values() for name in (*side.position.values(), *side.rotation.values())]
    angles = {pose for pose, side in both.items() if len(side.rotation) == 3}
    if setup.rotation and not angles & set(setup.rotation):
        raise DataError(
            "rotation= is the order of angles, and the rotations it speaks of are quaternions; leave it out"
        )
    values = np.column_stack([np.asarray(table.columns[name], dtype=float) for name in used])
    there = np.abs(values) < _HUGE
    first = len(both["flange"].position) + len(both["flange"].rotation)
    by_flange, by_board = there[:, :first].all(axis=1), there[:, first:].all(axis=1)
    stamps = _time_of(table)
    clock = np.zeros(len(values)) if stamps is None else stamps
    streams = stamps is not None and min((by_flange & ~by_board).sum(), (by_board & ~by_flange).sum()) > LEAST_STREAM
    whole: Mask = np.asarray((by_flange | by_board) & np.isfinite(clock) if streams else by_flange & by_board)
    for side in (one for one in both.values() if len(one.rotation) == 4):
        read = whole & (by_flange if side is both["flange"] else by_board)
        parts = [np.where(read, np.asarray(table.columns[name], dtype=float), 0) for name in side.rotation.values()]
        size = np.where(read, np.linalg.norm(parts, axis=0), np.nan if streams else 0.0)
        wrong = np.flatnonzero(read & (size > 0) & (np.abs(size - 1) > _LENGTH))
        if len(wrong):
            raise DataError(
                f"{table.label(int(wrong[0]))}: {', '.join(side.rotation.values())} have the length "
                f"{plain(float(size[wrong[0]]), 3)}, and the quaternion of a rotation has 1 ({len(wrong)} of "
                f"{len(size)} rows): are these its columns, and in full digits?"
            )
        whole &= ~(size <= 0) if streams else size > 0  # a quaternion of zeros is no rotation
    notes = [*table.notes, *unit_notes]
    if "valid" in table.columns:
        whole &= valid_rows(table.columns["valid"])
    if not whole.all():
        rows = tuple(table.label(int(i)) for i in np.flatnonzero(~whole))
        text = f"{len(rows)} of {len(whole)} rows are without a value or not valid, and left out: {listed(rows, 5)}"
        notes.append(Note(Code.ROWS_LEFT_OUT, text, rows=rows, values={"rows": len(rows)}))
    if not whole.any():
        raise DataError(f"no row has a value in every column that makes its poses: {', '.join(used)}")
    still = [
        name for name, column in zip(used, values[whole].T, strict=True) if not np.ptp(column[np.isfinite(column)]) > 0
    ]
    never = ""
    if 0 < len(still) < len(used):  # else all are one pose, which is refused as that
        never = f"{', '.join(still)} never {'varies' if len(still) == 1 else 'vary'}"
        text = f"{never}: true of a robot that was held so, else it was not read"
        notes.append(Note(Code.JOINT_STILL, text, tuple(still)))
    notes += () if streams else without_copies(table, values, whole, "number")
    other = replace(sides["flange"], other={"split": "split"} if "split" in table.columns else {})
    hold = held_back(table, other, whole)
    rows_of = {"flange": np.flatnonzero(whole & by_flange), "board": np.flatnonzero(whole & by_board)}
    if streams and stamps is not None:  # the robot's rise, one at a time
        there_ = rows_of["flange"]
        rows_of["flange"] = there_[np.unique(stamps[there_], return_index=True)[1]]
    rows_used = rows_of["board"]
    read, poses = setup.read or "board_in_camera", []
    for name, side in both.items():
        place, turns = (
            np.column_stack([np.asarray(table.columns[column], dtype=float)[rows_of[name]] for column in part.values()])
            for part in (side.position, side.rotation)
        )
        inverted = setup.flange == "base_in_flange" if name == "flange" else read == "camera_in_board"
        place = place if name == "flange" else setup.board_scale * place
        names = (*side.position.values(), *side.rotation.values())
        by_meaning = meanings(turns, setup.rotation.get(name, ""), {"rad": 1.0})
        poses.append(Pose(place, by_meaning, names, inverted))
    return Pairs(
        flange=poses[0], board=poses[1], read=read, hold=None if hold is None else hold[rows_used], rows=rows_used,
        still=never, table=table, notes=tuple(notes), board_scale=setup.board_scale,
        time=stamps[rows_used] if streams and stamps is not None else None,
        stamps=stamps[rows_of["flange"]] if streams and stamps is not None else None,
    )  # fmt: skip


def _time_of(table: Table) -> Array | None:
    """Return the column of time [s] from its first moment on, (n,); None where there is none."""
    for name, column in table.columns.items():
        if column.dtype.kind in "iuf" and is_time(name):
            begin, unit = np.nanmin(column), name.strip().lower().partition("_")[2]
            unit = table.units.get(name) or unit
            unit = unit or next((u for least, u in _SINCE_1970.items() if begin > least), "s")
            if unit not in _UNITS_OF_TIME:
                raise DataError(f"column {name} is in {unit}, and {', '.join(_UNITS_OF_TIME)} are times")
            return np.asarray((column - begin) * _UNITS_OF_TIME[unit], dtype=float)
    return None


def is_time(name: str) -> bool:
    """Return whether a column's name says time: t, time, stamp, timestamp, and a unit after it, as in time_ms."""
    bare, _, unit = name.strip().lower().partition("_")
    return bare in _TIMES_OF and (not unit or unit in _UNITS_OF_TIME)


LEAST_STREAM, _FEW_SOME = 3, 8
_SEARCH, _COARSE, _SOME = 1.0, 0.05, 120  # s to both sides, by steps, with so many pairs


def in_step(pairs: Pairs, mounting: str) -> tuple[Pairs, float]:
    """Return pairs whose flange is where it was when the board was seen, and the offset of the camera's clock [s].

    The offset is the one of a coarse search under which the rotations of both fit best; `fit` refines it.
    """
    if pairs.time is None or pairs.stamps is None:
        return pairs, 0.0
    some = np.unique(np.linspace(0, len(pairs.time) - 1, _SOME).astype(int))
    best, chosen = np.inf, None
    for offset in np.arange(-_SEARCH, _SEARCH + _COARSE / 2, _COARSE):
        inside = some[track_of(pairs, next(iter(pairs.flange.meanings))).has(pairs.time[some] - offset)]
        if len(inside) < max(_FEW_SOME, len(some) // 2):
            continue
        for flange, board in product(pairs.flange.meanings, pairs.board.meanings):
            moved = track_of(pairs, flange).at(pairs.time[inside] - offset)
            misfit = _rotations(arm_poses(moved, mounting), pairs.board.poses(board)[inside])[2]
            if misfit < best:
                best, chosen = misfit, float(offset)
    if chosen is None:
        raise DataError(
            "less than half of the camera's time stamps lie between those of the robot: are both clocks in one unit, "
            f"and within {plain(_SEARCH)} s of each other?"
        )
    kept = track_of(pairs, next(iter(pairs.flange.meanings))).has(pairs.time - chosen)
    at = pairs.time[kept] - chosen
    by_meaning = {name: track_of(pairs, name).at(at) for name in pairs.flange.meanings}
    if pairs.flange.inverted:
        by_meaning = {name: np.asarray(inverse(poses)) for name, poses in by_meaning.items()}
    meaning = {name: poses[:, :3, :3] for name, poses in by_meaning.items()}
    place = next(iter(by_meaning.values()))[:, :3, 3]
    seen = replace(
        pairs.board, place=pairs.board.place[kept], meanings={k: v[kept] for k, v in pairs.board.meanings.items()}
    )  # fmt: skip
    return replace(
        pairs, flange=replace(pairs.flange, place=place, meanings=meaning), board=seen, rows=pairs.rows[kept],
        hold=None if pairs.hold is None else pairs.hold[kept], time=pairs.time[kept],
    ), chosen  # fmt: skip


def track_of(pairs: Pairs, meaning: str) -> Track:
    """Return where the flange was by two streams, if its rotations have this `meaning`."""
    assert pairs.stamps is not None
    return Track(pairs.stamps, pairs.flange.poses(meaning))


def _in_base_units(table: Table, both: Mapping[str, Matched]) -> tuple[Table, tuple[Note, ...]]:
    """Return the table in mm and rad, and notes on units; refuse those that nobody states, or that cannot be."""
    for side in both.values():
        stated = [name for name in side.rotation.values() if table.units.get(name) == "rad"]
        values = np.abs([np.asarray(table.columns[name], dtype=float) for name in stated])
        largest = float(np.max(values, where=values < _HUGE, initial=0.0))
        if largest > _TURNED:
            raise DataError(
                f"{', '.join(stated)}: rad are stated, and they hold {plain(largest, 4)}, more than two turns: state "
                f"deg in the heading, or {as_units(stated, 'deg')}"
            )
    used = [name for side in both.values() for name in (*side.position.values(), *side.rotation.values())]
    turned, units, notes = by_their_names(table.columns, used, table.units)
    table = replace(table, columns={**table.columns, **turned}, units={**table.units, **units})
    places = [name for side in both.values() for name in side.position.values()]
    angles = [name for side in both.values() if len(side.rotation) == 3 for name in side.rotation.values()]
    for names, base, example in ((places, "mm", "m"), (angles, "rad", "deg")):
        open_ = [name for name in names if name not in table.units]
        if open_:
            raise DataError(
                f"{', '.join(open_)}: no unit is stated; write it in the heading, such as {open_[0]} [{example}], "
                f"or state {as_units(open_, base)} or {as_units(open_, example)}"
            )
        other = next((name for name in names if table.units[name] != base), None)
        if other is not None:
            raise DataError(f"column {other} is in {table.units[other]}, and {base} or {example} is needed")
    values = np.abs([np.asarray(table.columns[name], dtype=float) for name in places])
    largest = float(np.max(values, where=values < _HUGE, initial=0.0))
    if 0 < largest < _SMALL:
        raise DataError(
            f"{', '.join(places)} are {plain(largest, 2)} mm at most, and no robot is so small: are they in m? "
            f"{as_units(places, 'm')}"
        )
    return table, notes


def side_of(name: str) -> tuple[str, str]:
    """Return whose pose a column is of by its name, flange, board, camera, or "" for none, and the rest of the name."""
    first, _, rest = name.strip().replace(" ", "_").replace(".", "_").partition("_")
    side = next((side for side, words in _CALLED.items() if first.lower() in words), "")
    return side if rest else "", rest


def _sides(table: Table, ours: Mapping[str, str]) -> dict[str, Matched]:
    """Return the columns of flange, and of board or camera; `ours` are names of the file -> names of ours."""
    by_side: dict[str, dict[str, str]] = {}
    for name, column in table.columns.items():
        if column.dtype.kind not in "iuf":
            continue
        side, rest = side_of(ours.get(name, name))
        if side:
            if rest in by_side.setdefault(side, {}):
                raise DataError(f"{by_side[side][rest]} and {name} could both be {side}_{rest}; leave one of them out")
            by_side[side][rest] = name
    sides: dict[str, Matched] = {}
    for side, names in by_side.items():
        made = match_columns(list(names), ())
        place, turn = ({axis: names[axis_] for axis, axis_ in part.items()} for part in (made.position, made.rotation))
        sides[side] = Matched({}, place, turn, {})
    for side, other in (("flange", "flange"), ("board", "camera")):
        if not sides.get(side, sides.get(other)):
            also = " (or camera_ for the camera in the board)" if side == "board" else ""
            raise DataError(
                f"no pose of the {side} is found among {', '.join(table.columns)}: {side}_x, {side}_y, {side}_z and "
                f"{side}_qx ... {side}_qw or {side}_rx ... {side}_rz are needed{also}; {_proposed(table, ours)}"
            )
    if "board" in sides and "camera" in sides:
        raise DataError("the file has columns of board_ and of camera_; leave out those that are not to be read")
    for side, made in sides.items():
        for part, needed in ((made.position, "x, y and z"), (made.rotation, "rx, ry and rz, or qx, qy, qz and qw")):
            if not part:
                raise DataError(f"the pose of the {side} lacks {side}_ with {needed}; {_proposed(table, ours)}")
    return sides


def _proposed(table: Table, ours: Mapping[str, str]) -> str:
    """Return `columns=` to copy: of all columns if they are as many as two poses have, else an example of one.

    Columns whose names say whose pose they are stay with it, and the others are the other pose; `ours` as in `_sides`.
    """
    names = [name for name, column in table.columns.items() if column.dtype.kind in "iuf" and name not in _NO_POSE]
    whose = {name: side_of(ours.get(name, name))[0] for name in names}
    seen = "camera" if "camera" in whose.values() else "board"
    free, flange, board = ([name for name in names if whose[name] == side] for side in ("", "flange", seen))
    half = 7 if len(names) == 14 else 6
    if len(names) == 13:
        size = np.linalg.norm([np.asarray(table.columns[name], dtype=float) for name in names[3:7]], axis=0)
        half = 7 if abs(np.nanmedian(size) - 1) < _LENGTH else 6
    for both in ((names[:half], names[half:]), (free, board), (flange, free)):
        kept = not {seen} & {whose[name] for name in both[0]} and not {"flange"} & {whose[name] for name in both[1]}
        if kept and {*map(len, both)} <= {6, 7} and len(both[0] + both[1]) == len(names):
            break
    else:
        return f"{as_columns({'flange_x': 'NAME'})} names one"
    called: dict[str, str] = {}
    for side, part in zip(("flange", seen), both, strict=True):
        last = [re.split(r"[ _.]", ours.get(name, name).strip().lower())[-1] for name in part]
        turns = ["rz", "ry", "rx"] if last[3:] == ["a", "b", "c"] else ["rx", "ry", "rz"]  # A B C of a KUKA: z, y, x
        if len(last) == 7:  # by their names, or in the order of ROS
            ends = [name[-1:] for name in last[3:]]
            turns = [f"q{end}" for end in (ends if sorted(ends) == sorted("wxyz") else "xyzw")]
        axes = ["x", "y", "z", *turns]
        axes = last if sorted(last) == sorted(axes) else axes
        called |= {f"{side}_{axis}": name for axis, name in zip(axes, part, strict=True) if name != f"{side}_{axis}"}
    first = ", flange first" if len({side_of(name)[0] for name in called}) == 2 else ""
    return f"if the columns stand in this order{first}: {as_columns(called)}"


_HANDFUL, _HANDFULS = 3, 200
_DRAWN = (_HANDFULS, _HANDFUL, 18)  # and their seed
_NEAR_PART = 0.35  # of the pairs are sound at the least: what they leave ranks the handfuls
_TIMES = 10.0  # times better: no chance, but another meaning of the same numbers
_TWICE = 2.0  # times better: one order of angles beside another
_APART = 0.12  # rad: the middle rotation further off belongs to no such frames, whatever the noise
_MISTAKEN = 0.03  # rad and part of the board's distance: pairs that leave less are noise, or a model's error
_ROUNDING = 1e-6  # rad or mm: less is no misfit of rotations or places that files hold
_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
_SETTLE = 8
_FAR = 6.0  # times the median: a place beyond has no say
_ALIKE = 1e-3  # part of a column: a scale that others explain so far is not told
_NEAR = 0.1


def start_of_pairs(
    pairs: Pairs, mounting: str, train: Mask, *, free_scale: bool = False, sides: Sequence[str] = SIDES
) -> tuple[Array, Array, Array, Array, Mask, tuple[Note, ...]]:
    """Return both poses (n, 4, 4), mount and tool (4, 4) [mm], pairs of `train` that are near (k,), and remarks.

    Columns of `sides` come from a file, where they may stand under each other's names.
    """
    tried = {  # the poses of arm and board for each meaning of both rotations
        (flange, board): (arm_poses(pairs.flange.poses(flange), mounting)[train], pairs.board.poses(board)[train])
        for flange, board in product(pairs.flange.meanings, pairs.board.meanings)
    }
    apart_by = {key: _misfit(*both) for key, both in tried.items()}

    # poses that fit far better with one side inverted or mirrored, or with rows out of step, in some meaning
    n, misfit = int(train.sum()), min(apart_by.values())
    read = "camera_in_board" if pairs.read == "board_in_camera" else "board_in_camera"
    flange = "flange_in_base" if pairs.flange.inverted else "base_in_flange"
    other = "eye_to_hand" if mounting == "eye_in_hand" else "eye_in_hand"
    inverted = (
        f"with one side inverted: the camera's columns are read={read}, or the camera is mounted hand_eye={other}, or "
        f"the flange's columns hold the base in the flange: flange={flange}"
    )
    mirrored = (
        "if the frames of flange or board are left-handed: an axis points the other way, in places and rotations; "
        "write both in right-handed frames"
    )
    shifted = "if the board's pose of each row stands in the row {}: the rows of one of both are out of step by one"
    changes: list[tuple[int, str, Callable[[Array, Array], tuple[Array, Array]]]] = [
        (3, inverted, lambda arm, seen: (arm, np.asarray(inverse(seen)))),
        (3, mirrored, lambda arm, seen: (arm, _MIRROR @ seen @ _MIRROR)),
        (5, shifted.format("below"), lambda arm, seen: (arm[:-1], seen[1:])),
        (5, shifted.format("above"), lambda arm, seen: (arm[1:], seen[:-1])),
    ]
    for _, how, change in (one for one in changes if n > one[0]):
        better = max(min(_misfit(*change(*both), misfit / _TIMES) for both in tried.values()), _ROUNDING)
        if misfit > _TIMES * better:
            raise DataError(f"the poses fit {plain(misfit / better, 2)} times better {how}")

    flange, board, notes = _meaning(pairs, apart_by)
    if n > 5 and misfit > _MISTAKEN and pairs.time is None:
        _refuse_mistaken(pairs, misfit, mounting, train, sides)
    arm, seen = arm_poses(pairs.flange.poses(flange), mounting), pairs.board.poses(board)
    here = arm[train], seen[train]
    mount, tool, apart, near = _rotations(*here)
    if apart > _APART:
        raise DataError(
            f"rotations of flange and board lie {plain(float(np.rad2deg(apart)), 2)}° apart, wherever camera and board "
            "are: do both poses of a row belong together, and is rotation= right?"
        )
    placed = _places(here[0][near], here[1][near], mount, tool, pairs, free_scale)
    near[near] = placed[2]
    return arm, seen, *placed[:2], near, notes


def _refuse_mistaken(pairs: Pairs, misfit: float, mounting: str, train: Mask, sides: Sequence[str]) -> None:
    """Raise `DataError` where poses fit far better with one mistake less in the columns of one of `sides`, or of both.

    A mistake is two columns that are exchanged, a sign, or the unit of one column.
    """
    poses = {"flange": pairs.flange, "board": pairs.board}
    found = {side: _mistakes(pairs, poses[side]) for side in sides}
    tried: list[dict[str, Mistake]] = [{side: one} for side, some in found.items() for one in some]
    tried += [dict(zip(found, both)) for both in zip(*found.values())] if len(found) == len(poses) else []

    def left(cure: Mapping[str, Mistake]) -> float:
        flange, board = (_without(cure[side], pairs, side) if side in cure else pose for side, pose in poses.items())
        fits = (
            _misfit(arm_poses(flange.poses(one), mounting)[train], board.poses(other)[train], misfit / _TIMES)
            for one, other in product(flange.meanings, board.meanings)
        )
        return max(min(fits), _ROUNDING)

    best, cures = mistakes.likely(((left(cure), cure) for cure in tried), _TWICE)
    if misfit > _TIMES * best:
        ways = f"{mistakes.OR_AS_NEAR}if ".join(_words(cure, pairs) for cure in cures)
        raise DataError(f"the poses fit {plain(misfit / best, 2)} times better if {ways}")


def _mistakes(pairs: Pairs, pose: Pose) -> list[Mistake]:
    """Return what may be wrong in the columns of one side: two exchanged, a sign, or the unit of one."""
    table, names = pairs.table, pose.columns
    read = {name: np.asarray(table.columns[name], dtype=float)[pairs.rows] for name in names}
    turned = (note for note in table.notes + pairs.notes if note.code is Code.UNIT_TURNED)
    stated = {name: str(note.values.get("stated", "mm")) for note in turned for name in note.columns}
    of_two = (*combinations(names[:3], 2), *combinations(names[3:], 2))
    found = [*(mistakes.exchanged(read, *two) for two in of_two), *(mistakes.reversed_in(read, [n]) for n in names)]
    for name in names[:3]:
        factors = {unit: size / UNITS[stated.get(name, "mm")] for unit, size in UNITS.items()}
        found += mistakes.in_units(read, [name], ((unit, by) for unit, by in factors.items() if by != 1))
    return found


def _without(mistake: Mistake, pairs: Pairs, side: str) -> Pose:
    """Return the pose of a side as it would be without a mistake."""
    pose = pairs.flange if side == "flange" else pairs.board
    read = {name: np.asarray(pairs.table.columns[name], dtype=float)[pairs.rows] for name in pose.columns}
    made = np.column_stack([*{**read, **mistake.columns}.values()])
    every = {k: v for k, v in meanings(made[:, 3:], "", {"rad": 1.0}).items() if k in pose.meanings}
    known = dict([*every.items()][:1]) if made.shape[1] == 7 else every  # one mistake, and not the order as well
    return replace(pose, place=(pairs.board_scale if side == "board" else 1.0) * made[:, :3], meanings=known)


def _words(by_side: Mapping[str, Mistake], pairs: Pairs) -> str:
    """Return a mistake of a side, or one of each, as the end of "the poses fit 20 times better if ..."."""
    words, columns = [], dict[str, str]()
    for side, mistake in by_side.items():
        pose, names = pairs.flange if side == "flange" else pairs.board, [*mistake.columns]
        if mistake.kind is Kind.EXCHANGED:
            axes = ("x", "y", "z", *(("rx", "ry", "rz") if len(pose.columns) == 6 else ("qx", "qy", "qz", "qw")))
            ours = dict(zip(pose.columns, axes))
            columns |= {f"{side_of(a)[0] or side}_{ours[a]}": b for a, b in zip(names, reversed(names))}
            words.append(f"{names[0]} and {names[1]} are exchanged")
        else:
            in_unit = f"is in {mistake.unit}: {as_units(names, mistake.unit)}"
            words.append(f"{names[0]} {in_unit if mistake.unit else 'has the other sign'}")
    return " and ".join(words) + (f": {as_columns(columns)}" if columns else "")


def arm_poses(flange: Array, mounting: str) -> Array:
    """Return what stands between mount and tool, (n, 4, 4): the flange's poses, or their inverse with the eye in it."""
    return np.asarray(inverse(flange)) if mounting == "eye_in_hand" else flange


def _meaning(pairs: Pairs, apart: Mapping[tuple[str, str], float]) -> tuple[str, str, tuple[Note, ...]]:
    """Return what the rotations of flange and board mean, and remarks; `apart` is what each meaning of both leaves."""
    ranked, notes = sorted(apart, key=lambda key: apart[key]), []
    chosen = ranked[0]
    for k, pose in enumerate((pairs.flange, pairs.board)):
        named, names = next(iter(pose.meanings)), pose.columns[3:]
        if len(names) == 4:
            kept = [key for key in ranked if key[k] == named and key[1 - k] == chosen[1 - k]]
            if chosen[k] != named and apart[kept[0]] > _TIMES * max(apart[chosen], _ROUNDING):
                more = plain(apart[kept[0]] / max(apart[chosen], _ROUNDING), 2)
                side = names[0].rpartition("_")[0] or "board"
                order = {f"{side}_{q}": name for q, name in zip(("qw", "qx", "qy", "qz"), names, strict=True)}
                raise DataError(
                    f"{', '.join(names)} fit {more} times better if the first of them "
                    f"is the real part of the quaternion: {as_columns(order)}"
                )
            chosen = (named, chosen[1]) if k == 0 else (chosen[0], named)
            continue
        for other in ranked:
            if other[k] == chosen[k] or other[1 - k] != chosen[1 - k]:
                continue
            a, b = pose.meanings[chosen[k]], pose.meanings[other[k]]
            if apart[other] < _TWICE * max(apart[chosen], _ROUNDING) and not np.allclose(a, b, atol=1e-3):
                side = ("flange", "board")[k]
                raise DataError(
                    f"{', '.join(names)} may be {chosen[k]}, or {other[k]}: rotation={side}:vector (or rpy, xyz) "
                    "states which"
                )
        if len(pose.meanings) > 1:
            text = f"{', '.join(names)} are read as {chosen[k]}, which alone fits"
            notes.append(Note(Code.ROTATION, text, names))
    return (*chosen, tuple(notes))


def _misfit(arm: Array, seen: Array, far: float = np.inf) -> float:
    """Return what rotations leave of the middle pair [rad], and places beside the board's distance, in any unit.

    Of rotations that leave more than `far` alone, the places are not looked for: it is what the rotations leave.
    """
    mount, _, apart, near = _rotations(arm, seen)
    if apart > far:
        return apart
    rows, wanted = _linear(arm[near], seen[near], mount)
    distance = float(np.median(np.linalg.norm(seen[:, :3, 3], axis=1))) + _ROUNDING
    scales = [by for size in UNITS.values() for by in {size, 1 / size}]
    by_handful = _by_handful(rows[:, :, :6])
    apart_by = (_nearest(rows[:, :, :6], wanted - by * rows[:, :, 6], by_handful)[1] / (by * distance) for by in scales)
    return apart + min(apart_by)


def _rotations(arm: Array, seen: Array) -> tuple[Array, Array, float, Mask]:
    """Return the rotations of mount and tool, (3, 3), the angle [rad] of the middle near pair, and which are near."""
    arm, seen, n = arm[:, :3, :3], seen[:, :3, :3], len(arm)
    rows = np.zeros((n, 9, 18))
    for i, j in product(range(3), range(3)):  # (U B)_ij - (A V)_ij, of U and V by rows
        rows[:, 3 * i + j, 3 * i : 3 * i + 3] = seen[:, :, j]
        rows[:, 3 * i + j, 9 + j : 18 : 3] = -arm[:, i, :]
    best, near = _solved(rows.reshape(1, -1, 18)), np.ones(n, dtype=bool)
    angles = _angles(arm, seen, best)[0]
    if n > 2 * _HANDFUL:
        tried = np.concatenate([best, _solved(rows[handfuls(n, n, *_DRAWN)].reshape(_HANDFULS, -1, 18))])
        by_handful = _angles(arm, seen, tried)
        k = int(np.argmin(np.quantile(by_handful, _NEAR_PART, axis=1)))
        best, angles = tried[[k]], by_handful[k]
        middle = float(np.quantile(angles, _NEAR_PART))
        for _ in range(_SETTLE):
            before, near = near, angles <= max(_FAR * middle, _ROUNDING)
            best = _solved(rows[near].reshape(1, -1, 18))
            angles = _angles(arm, seen, best)[0]
            middle = float(np.median(angles[near]))
            if np.array_equal(near, before):
                break
    return best[0, 0].T, best[0, 1], float(np.median(angles[near])), near


def _solved(rows: Array) -> Array:
    """Return U and V, (k, 2, 3, 3), rotations nearest to the null vectors of `rows`, (k, m, 18)."""
    vectors = np.linalg.eigh(rows.swapaxes(1, 2) @ rows)[1][:, :, 0].reshape(-1, 2, 3, 3)
    senses = np.sign(np.linalg.det(vectors[:, 0]) + np.linalg.det(vectors[:, 1]))
    vectors = vectors * np.where(senses == 0, 1.0, senses)[:, None, None, None]
    return nearest_rotation(vectors)


def _angles(arm: Array, seen: Array, rotations: Array) -> Array:
    """Return the angle [rad] that rotations `rotations`, (k, 2, 3, 3), leave of each pair, (k, n)."""
    by_board, by_arm = rotations[:, 0, None] @ seen, arm @ rotations[:, 1, None]
    return angle_between(by_board.reshape(-1, 3, 3), by_arm.reshape(-1, 3, 3)).reshape(len(rotations), -1)


def _places(
    arm: Array, seen: Array, mount: Array, tool: Array, pairs: Pairs, free_scale: bool
) -> tuple[Array, Array, Mask]:
    """Return mount and tool, (4, 4) [mm], from their rotations, and near pairs; refuse units that do not fit."""
    rows, wanted = _linear(arm, seen, mount)
    placed, apart, near = _nearest(rows[:, :, :6], wanted - rows[:, :, 6], _by_handful(rows[:, :, :6]))
    scaled, free, near_scaled = _nearest(rows, wanted, _by_handful(rows))
    others, column = rows[:, :, :6].reshape(-1, 6), rows[:, :, 6].ravel()
    beside = column - others @ np.linalg.lstsq(others, column, rcond=1e-9)[0]
    known = np.linalg.norm(beside) > _ALIKE * np.linalg.norm(column)
    if free_scale:
        placed, near = scaled / scaled[6], near_scaled
        placed[:3] = scaled[:3]
    elif known and scaled[6] > 0 and apart > _TIMES * max(free, _ROUNDING) and len(arm) > 3:
        by_flange, at_best = float(scaled[6]), plain(max(free, _ROUNDING))
        text = f"places of flange and board lie {plain(apart)} mm apart, and {at_best} mm if those of the"
        for side, other, pose, by in (
            ("board", "flange", pairs.board, by_flange), ("flange", "board", pairs.flange, 1 / by_flange)
        ):  # fmt: skip
            unit = next((u for u, size in UNITS.items() if by > 1 and abs(by / size - 1) < _NEAR), "mm")
            if unit != "mm":
                raise DataError(
                    f"{text} {side} are {plain(by, 3)} times as far: {as_units(pose.columns[:3], unit)} if they are "
                    f"{unit}, or the unit of the {other}'s is another"
                )
        size = pairs.board_scale * by_flange
        raise DataError(
            f"{text} board are {plain(by_flange, 5)} times as far: is the size of its squares or markers the true one? "
            f"If they are {plain(size, 4)} times as large as the camera was told: board_scale={plain(size, 5)}"
        )
    made = np.tile(np.eye(4), (2, 1, 1))
    made[0, :3, :3], made[1, :3, :3] = mount, tool
    made[0, :3, 3], made[1, :3, 3] = placed[3:6], placed[:3]
    return made[0], made[1], near


def _linear(arm: Array, seen: Array, mount: Array) -> tuple[Array, Array]:
    """Return the equations of the places, (n, 3, 7) and (n, 3): for tool, mount, and the scale of the board's."""
    rows = np.zeros((len(arm), 3, 7))
    rows[:, :, :3] = mount @ arm[:, :3, :3]
    rows[:, :, 3:6] = np.eye(3)
    rows[:, :, 6] = -seen[:, :3, 3]
    return rows, -(arm[:, :3, 3] @ mount.T)


def _by_handful(rows: Array) -> Array:
    """Return what solves `rows`, (n, 3, k), for each handful of them, (h, k, m); none where there are few pairs."""
    n, k = len(rows), rows.shape[2]
    if n <= 2 * _HANDFUL:
        return np.empty((0, k, 0))
    return np.asarray(np.linalg.pinv(rows[handfuls(n, n, *_DRAWN)].reshape(_HANDFULS, -1, k), rcond=1e-6))


def _nearest(rows: Array, wanted: Array, by_handful: Array) -> tuple[Array, float, Mask]:
    """Return the solution of `rows` (n, 3, k) without far pairs, what the middle near pair leaves, and those near."""
    n, k = len(rows), rows.shape[2]
    near = np.ones(n, dtype=bool)
    solved = np.linalg.lstsq(rows.reshape(-1, k), wanted.ravel(), rcond=1e-9)[0]
    apart = np.linalg.norm(rows @ solved - wanted, axis=1)
    middle = float(np.median(apart))
    if n > 2 * _HANDFUL:
        tried = (by_handful @ wanted[handfuls(n, n, *_DRAWN)].reshape(_HANDFULS, -1, 1))[:, :, 0]
        tried = np.concatenate([solved[None], tried])
        left = np.linalg.norm(np.einsum("nck,hk->hnc", rows, tried) - wanted, axis=2)
        best = int(np.argmin(np.quantile(left, _NEAR_PART, axis=1)))
        apart = left[best]
        middle = float(np.quantile(apart, _NEAR_PART))
    for _ in range(_SETTLE):
        before, near = near, apart <= max(_FAR * middle, _ROUNDING)
        solved = np.linalg.lstsq(rows[near].reshape(-1, k), wanted[near].ravel(), rcond=1e-9)[0]
        apart = np.linalg.norm(rows @ solved - wanted, axis=1)
        middle = float(np.median(apart[near]))
        if np.array_equal(near, before):  # and so is all that follows from it
            break
    return np.asarray(solved, dtype=float), middle, near
