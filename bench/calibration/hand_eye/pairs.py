"""`Pairs`: a table as pairs of poses, of the flange in the base and of the board in the camera, in mm and as matrices.

A pose is three columns of a place and a rotation, which the first word of their names tells apart: `flange_x`,
`board_qw`. What an angle or a length is in must be stated: no arm is known here that could tell it. In which order
angles turn is left open, for the poses themselves tell it (`start`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.bench.calibration.files import Table, read_table
from calibench.bench.calibration.hand_eye.request import HandEyeRequest
from calibench.bench.calibration.readings import Index, Mask, held_back, without_copies
from calibench.bench.calibration.start import meanings
from calibench.bench.measured.files import pairs_of
from calibench.core.options import suggest
from calibench.core.tables.cells import valid_rows
from calibench.core.words import as_columns, listed, plain
from calibench.discrepancy import DataError
from calibench.problems.arm.chains.rigid import inverse
from calibench.problems.arm.columns import Matched, in_base_units, match_columns
from calibench.problems.base import Array

_CALLED = {
    "flange": ("flange", "tcp", "hand", "gripper", "robot"),
    "board": ("board", "marker", "tag", "target"),
    "camera": ("camera", "cam"),
}
_LENGTH = 0.01  # by which a quaternion's length may differ from 1: three digits leave a thousandth
_TURNED = 4 * np.pi  # rad
_NO_POSE = ("split", "valid")
_HUGE = 1e9  # mm: a place that no instrument gives


@final
@dataclass(frozen=True, eq=False)
class Pose:
    """One side of the pairs: `place` (n, 3) [mm], and what its rotations may mean, in words -> (n, 3, 3).

    The first meaning is what the names of the columns say. `columns` are theirs, place first.
    """

    place: Array
    meanings: Mapping[str, Array]
    columns: tuple[str, ...]

    def as_matrices(self, meaning: str) -> Array:
        """Return the poses, (n, 4, 4) [mm], with their rotations by `meaning`."""
        made = np.tile(np.eye(4), (len(self.place), 1, 1))
        made[:, :3, :3], made[:, :3, 3] = self.meanings[meaning], self.place
        return made


@final
@dataclass(frozen=True, eq=False)
class Pairs:
    """n pairs: `flange` in the base, and `board` as `read` says; `hold` (n,) are kept from the fit, None for none.

    `rows` (n,) are those of the table; `still` says which columns hold one value alone, "" for none. `inverted` says
    that the robot's columns hold the base in the flange; `board` is `board_scale` times as far as in the file.
    """

    flange: Pose
    board: Pose
    read: str
    hold: Mask | None
    rows: Index
    still: str
    table: Table
    notes: tuple[str, ...]
    inverted: bool
    board_scale: float

    def __len__(self) -> int:
        return len(self.rows)

    def told(self, i: int) -> str:
        """Return how a message names pair i in the file."""
        return self.table.told(int(self.rows[i]))

    @property
    def other_flange(self) -> str:
        """Return what `flange=` would be for the inverse poses."""
        return "flange_in_base" if self.inverted else "base_in_flange"

    def moved(self, meaning: str) -> Array:
        """Return the poses of the flange in the base, (n, 4, 4) [mm]."""
        made = self.flange.as_matrices(meaning)
        return np.asarray(inverse(made)) if self.inverted else made

    def seen(self, meaning: str) -> Array:
        """Return the poses of the board in the camera, (n, 4, 4) [mm]."""
        made = self.board.as_matrices(meaning)
        return np.asarray(inverse(made)) if self.read == "camera_in_board" else made


def read_pairs_of_poses(request: HandEyeRequest) -> Pairs:
    """Return the pairs of poses of `request.data`. Raises `DataError` with the file's name, in one line."""
    stated = dict(request.stated)
    table = read_table(request.data, {key: value for key, value in stated.items() if key != "columns"})
    try:
        return _pairs(table, pairs_of("columns", stated.get("columns", {})), request)
    except ValueError as error:
        text = str(error)
        raise DataError(text if text.startswith(table.name) else f"{table.name}: {text}") from None


def _pairs(table: Table, columns: Mapping[str, str], request: HandEyeRequest) -> Pairs:
    lost = [(target, name) for target, name in columns.items() if name not in table.columns]
    if lost:
        raise DataError(f"columns: {lost[0][0]} is to be {lost[0][1]!r}; {suggest(lost[0][1], list(table.columns))}")
    sides = _sides(table, {name: target for target, name in columns.items()})
    read = _read(sides, request.read)
    seen = "camera" if "board" not in sides else "board"
    used = [name for side in ("flange", seen) for name in _columns_of(sides[side])]
    _check_radians(table, *(sides[side].rotation.values() for side in ("flange", seen)))
    turned, units, notes = in_base_units(table.columns, used, table.units)
    table = replace(table, columns={**table.columns, **turned}, units={**table.units, **units})
    _check_units(table, sides["flange"], sides[seen])
    angles = {pose for pose, side in (("flange", "flange"), ("board", seen)) if len(sides[side].rotation) == 3}
    if request.rotation and not angles & set(request.rotation):
        raise DataError(
            "rotation= is the order of angles, and the rotations it speaks of are quaternions; leave it out"
        )
    values = np.column_stack([np.asarray(table.columns[name], dtype=float) for name in used])
    whole: Mask = np.asarray((np.abs(values) < _HUGE).all(axis=1))
    for side in ("flange", seen):
        whole &= _of_length_one(table, sides[side], whole)
    said = [*table.notes, *notes]
    if "valid" in table.columns:
        whole &= valid_rows(table.columns["valid"])
    if not whole.all():
        rows = [table.told(int(i)) for i in np.flatnonzero(~whole)]
        left = f"{len(rows)} of {len(whole)} rows are without a value or not valid, and left out"
        said.append(f"{left}: {listed(rows, 5)}")
    if not whole.any():
        raise DataError(f"no row has a value in every column that makes its poses: {', '.join(used)}")
    still = [name for name, column in zip(used, values[whole].T, strict=True) if not np.ptp(column) > 0]
    never = ""
    if 0 < len(still) < len(used):  # else all are one pose, which is refused as that
        never = f"{', '.join(still)} never {'varies' if len(still) == 1 else 'vary'}"
        said.append(f"{never}: true of a robot that was held so, else it was not read")
    said += without_copies(table, values, whole, "number")
    other = replace(sides["flange"], other={"split": "split"} if "split" in table.columns else {})
    hold = held_back(table, other, whole)
    rows_of = np.flatnonzero(whole)
    flange, board = (_pose(table, sides[side], rows_of, request.rotation.get(name, "")) for side, name in (
        ("flange", "flange"), (seen, "board")
    ))  # fmt: skip
    board = replace(board, place=request.board_scale * board.place)
    return Pairs(
        flange, board, read, None if hold is None else hold[rows_of], rows_of, never, table, tuple(said),
        request.flange == "base_in_flange", request.board_scale,
    )  # fmt: skip


def _sides(table: Table, ours: Mapping[str, str]) -> dict[str, Matched]:
    """Return the columns of flange, and of board or camera; `ours` are names of the file -> names of ours."""
    found: dict[str, dict[str, str]] = {}
    for name, column in table.columns.items():
        if column.dtype.kind not in "iuf":
            continue
        first, _, rest = ours.get(name, name).strip().replace(" ", "_").replace(".", "_").partition("_")
        side = next((side for side, words in _CALLED.items() if first.lower() in words), None)
        if side and rest:
            if rest in found.setdefault(side, {}):
                raise DataError(f"{found[side][rest]} and {name} could both be {side}_{rest}; leave one of them out")
            found[side][rest] = name
    sides: dict[str, Matched] = {}
    for side, names in found.items():
        made = match_columns(list(names), ())
        place, turn = ({axis: names[own] for axis, own in part.items()} for part in (made.position, made.rotation))
        sides[side] = Matched({}, place, turn, {})
    for side, other in (("flange", "flange"), ("board", "camera")):
        if not sides.get(side, sides.get(other)):
            also = " (or camera_ for the camera in the board)" if side == "board" else ""
            raise DataError(
                f"no pose of the {side} is found among {', '.join(table.columns)}: {side}_x, {side}_y, {side}_z and "
                f"{side}_qx ... {side}_qw or {side}_rx ... {side}_rz are needed{also}; {_proposed(table)}"
            )
    if "board" in sides and "camera" in sides:
        raise DataError("the file has columns of board_ and of camera_; leave out those that are not to be read")
    for side, made in sides.items():
        for part, needed in ((made.position, "x, y and z"), (made.rotation, "rx, ry and rz, or qx, qy, qz and qw")):
            if not part:
                raise DataError(f"the pose of the {side} lacks {side}_ with {needed}; {_proposed(table)}")
    return sides


def _proposed(table: Table) -> str:
    """Return `columns=` to copy: for all columns if there are as many as two poses have, else an example of one."""
    names = [name for name, column in table.columns.items() if column.dtype.kind in "iuf" and name not in _NO_POSE]
    half = 7 if len(names) == 14 or (len(names) == 13 and _of_unit_length(table, names[3:7])) else 6
    if not 12 <= len(names) <= 14:
        return f"{as_columns({'flange_x': 'NAME'})} names one"
    called = {
        f"{side}_{own}": name
        for side, part in (("flange", names[:half]), ("board", names[half:]))
        for own, name in zip(("x", "y", "z", *_turns_of(part[3:])), part, strict=True)
    }
    return f"if the columns stand in this order, flange first: {as_columns(called)}"


def _of_unit_length(table: Table, names: Sequence[str]) -> bool:
    size = np.linalg.norm([np.asarray(table.columns[name], dtype=float) for name in names], axis=0)
    return bool(abs(np.nanmedian(size) - 1) < _LENGTH)


def _turns_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return our names for columns of a rotation; A B C of a KUKA turn about z, y and x."""
    if len(names) == 4:
        return ("qx", "qy", "qz", "qw")
    last = [re.split(r"[ _.]", name.strip().lower())[-1] for name in names]
    return ("rz", "ry", "rx") if last == ["a", "b", "c"] else ("rx", "ry", "rz")


def _read(sides: Mapping[str, Matched], stated: str) -> str:
    if stated:
        return stated
    if "board" in sides:
        return "board_in_camera"
    raise DataError(
        "columns of camera_ may be the camera in the board, or the board in the camera: read=camera_in_board or "
        "read=board_in_camera says which"
    )


def _columns_of(side: Matched) -> list[str]:
    return [*side.position.values(), *side.rotation.values()]


def _check_units(table: Table, *sides: Matched) -> None:
    """Refuse a length or an angle whose unit nobody states."""
    for side in sides:
        angles = side.rotation.values() if len(side.rotation) == 3 else ()
        for names, base, example in ((side.position.values(), "mm", "m"), (angles, "rad", "deg")):
            open_ = [name for name in names if name not in table.units]
            if open_:
                ways = [",".join(f"{name}:{unit}" for name in open_) for unit in (base, example)]
                raise DataError(
                    f"{', '.join(open_)}: no unit is stated; write it in the heading, such as {open_[0]} [{example}], "
                    f"or state units={ways[0]} or units={ways[1]}"
                )
            other = next((name for name in names if table.units[name] != base), None)
            if other is not None:
                raise DataError(f"column {other} is in {table.units[other]}, and {base} or {example} is needed")


def _check_radians(table: Table, *sides: Iterable[str]) -> None:
    """Refuse angles that are stated in rad and hold more than two turns: they are degrees."""
    for side in sides:
        names = [name for name in side if table.units.get(name) == "rad"]
        values = np.abs([np.asarray(table.columns[name], dtype=float) for name in names])
        largest = float(np.max(values, where=values < _HUGE, initial=0.0))
        if largest > _TURNED:
            raise DataError(
                f"{', '.join(names)}: rad are stated, and they hold {plain(largest, 4)}, more than two turns: state "
                f"deg in the heading, or units={','.join(f'{name}:deg' for name in names)}"
            )


def _of_length_one(table: Table, side: Matched, whole: Mask) -> Mask:
    """Return which rows hold a rotation, (n,): a quaternion of zeros is none. Refuse one of another length than 1."""
    if len(side.rotation) == 3:
        return whole
    parts = [np.where(whole, np.asarray(table.columns[name], dtype=float), 0) for name in side.rotation.values()]
    size = np.linalg.norm(parts, axis=0)
    seen = whole & (size > 0)
    wrong = np.flatnonzero(seen & (np.abs(size - 1) > _LENGTH))
    if len(wrong):
        raise DataError(
            f"{table.told(int(wrong[0]))}: {', '.join(side.rotation.values())} have the length "
            f"{plain(float(size[wrong[0]]), 3)}, and the quaternion of a rotation has 1 ({len(wrong)} of {len(size)} "
            "rows): are these its columns, and in full digits?"
        )
    return np.asarray(seen)


def _pose(table: Table, side: Matched, rows: Index, rotation: str) -> Pose:
    place, turns = (
        np.column_stack([np.asarray(table.columns[name], dtype=float)[rows] for name in part.values()])
        for part in (side.position, side.rotation)
    )
    return Pose(place, meanings(turns, rotation, {"rad": 1.0}), tuple(_columns_of(side)))
