"""`Readings`: a table as the poses of one chain, joints in rad and mm, positions in mm, rotations as matrices.

All checks of a calibration's data are here: joints are matched to the URDF, units and the order of rotations are found
or asked for, and readings that no arm can have are refused in one line that says what to do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from calibench.bench.calibration.files import Table
from calibench.core.tables.cells import split_rows, valid_rows
from calibench.core.words import as_columns, counted, listed, plain
from calibench.discrepancy import DataError
from calibench.problems.arm.chains.chain import Chain, ChainJoint
from calibench.problems.arm.chains.kinematics import forward, nominal
from calibench.problems.arm.columns import Matched, in_base_units, is_called_joint, match_columns, only_asked
from calibench.problems.arm.frames import frames_of_positions
from calibench.problems.base import Array

Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

OBSERVED = ("position", "pose", "sockets")
_LEAST = {"position": 10, "pose": 6, "sockets": 12}  # poses at least: with fewer there are as many unknowns as readings
_MOVING = 3  # joints at the least, where the arm has as many
_ALIKE = 1e-3  # rad or mm by which joints differ at most where a pose is taken again
_HUGE = 1e12  # a value that no instrument gives
_LISTED = 8  # columns that a remark names
_OWN_WORDS = ("socket", "place", "split", "valid")  # columns that are no numbers beside a pose
_LENGTH = 0.5  # the most by which a quaternion's length may differ from 1
_TURNS = 4 * np.pi  # rad: no joint turns further
_LONGEST_RAIL = 20.0  # m: a limit with a larger number is no number of metres
_ROUND = 1e-3  # rad or mm beyond a limit that a rounded number may be


@final
@dataclass(frozen=True, eq=False)
class Readings:
    """n poses: `joints` (n, j) [rad | mm] and what was read at them.

    `position` (n, 3) [mm] and `turns` (n, 3, 3), None where they were not read; `angles` (n, 3 | 4) are the rotations
    as the file has them. `socket` (n,) counts the sockets of all places from 0, `place` (n,) the places; -1 elsewhere.
    `hold` (n,) marks what the file keeps back, None where it does not say. `rows` (n,) are those of the table.
    `sliding` names the joints that are read in mm.
    """

    observed: str
    joints: Array
    position: Array | None
    angles: Array | None
    socket: Index
    place: Index
    hold: Mask | None
    rows: Index
    table: Table
    matched: Matched
    other: Mapping[str, Array] = field(default_factory=dict)
    turns: Array | None = None
    notes: tuple[str, ...] = ()
    sliding: frozenset[str] = frozenset()

    def __len__(self) -> int:
        return len(self.joints)

    def told(self, i: int) -> str:
        """Return how a message names pose i in the file."""
        return self.table.told(int(self.rows[i]))

    def noted(self, *notes: str) -> Readings:
        """Return the same readings with more remarks."""
        return replace(self, notes=(*self.notes, *notes))

    def where(self, keep: Mask) -> Readings:
        """Return the poses that `keep`, a mask or places, names."""
        cut: dict[str, Any] = {
            key: getattr(self, key)[keep]
            for key in ("joints", "position", "angles", "socket", "place", "hold", "rows", "turns")
            if getattr(self, key) is not None
        }
        return replace(self, **cut, other={name: column[keep] for name, column in self.other.items()})


def read_readings(table: Table, chain: Chain, observed: str = "", limits: bool = True) -> Readings:
    """Return the poses of `table` for `chain`; with `limits` joints must stand inside those of the URDF.

    Raises `DataError` with the file's name, in one line.
    """
    try:
        return _readings(table, chain, observed, limits)
    except ValueError as error:
        text = str(error)
        raise DataError(text if text.startswith(table.name) else f"{table.name}: {text}") from None


def _readings(table: Table, chain: Chain, observed: str, limits: bool) -> Readings:
    names = chain.driven
    given = [name for name in table.columns if table.columns[name].dtype.kind in "iufb" or name.lower() in _OWN_WORDS]
    matched = match_columns(given, names, told=chain.told)
    table = _in_base_units(table, matched)
    if chain.told == "table" and (more := longer_than_table(given, matched)):
        raise DataError(more)
    observed = observed or _observed(matched)
    joints = np.column_stack([_numbers(table, matched.joints[name]) for name in names])
    position = _together(table, matched.position)
    angles = _together(table, matched.rotation)
    if observed == "sockets":
        position = angles = None
        if "socket" not in matched.other:
            raise DataError("a column socket (0, 1, ...) is needed, or a folder of places with hole_0.csv, hole_1.csv")
    elif position is None:
        raise DataError(
            f"no measured x, y and z were found among {', '.join(given)} (a distance alone is not read); "
            f"{as_columns({'x': 'NAME', 'y': 'NAME', 'z': 'NAME'})} names them, or machine.observe=sockets for a ball "
            "in sockets"
        )
    elif observed == "pose" and angles is None:
        raise DataError(
            "no measured rotation was found: rx, ry, rz or qx, qy, qz, qw; machine.observe=position does without"
        )
    if observed == "position":
        angles = None
    used = [joints, *(part for part in (position, angles) if part is not None)]
    whole: Mask = np.asarray((np.abs(np.column_stack(used)) < _HUGE).all(axis=1))  # nor is what is no number
    if angles is not None and angles.shape[1] == 4:
        whole &= _of_length_one(angles, list(matched.rotation.values()))
    notes = [*(note for note in table.notes if not (matched.notes and note.startswith("no header"))), *matched.notes]
    if "valid" in matched.other:
        marked = valid_rows(table.columns[matched.other["valid"]])
        notes += [f"{np.sum(~marked)} rows are marked as not valid and left out"] if not marked.all() else []
        whole &= marked
    if not whole.all():
        lost = [table.told(int(i)) for i in np.flatnonzero(~whole)]
        said = f"{len(lost)} of {len(whole)} rows are without a value or not valid, and left out"
        notes.append(f"{said}: {listed(lost, 5)}")
    notes += _not_read(given, matched)
    if observed != "sockets":
        notes += without_copies(table, np.column_stack(used), whole)
    hold = held_back(table, matched, whole)
    used_rows = whole if hold is None else whole & ~hold
    poses = _count(joints[used_rows], observed)
    if poses < _LEAST[observed]:
        lost_too = "" if whole.all() else f", as {int((~whole).sum())} of {len(whole)} rows are left out,"
        lost_too += "" if hold is None else f" beside the {int((hold & whole).sum())} that column split holds back"
        raise DataError(
            f"{counted(poses, 'pose')}{lost_too} {'is' if poses == 1 else 'are'} too few: {_LEAST[observed]} at the "
            "least, and some 40 that differ much in every joint; bench design machine=arm plan.n=40 says which"
        )
    socket, place = _sockets(table, matched, observed)
    made = Readings(
        observed, joints, position, angles, socket, place, hold,
        np.arange(len(table), dtype=np.int64), table, matched, _others(table, matched), None, tuple(notes),
        _sliding(chain),
    ).where(whole)  # fmt: skip
    _check_joints(made, chain, limits)
    if observed != "sockets":
        _check_moves(made if hold is None else made.where(~hold[whole]), chain)
    return made


def _count(joints: Array, observed: str) -> int:
    """Return how many different poses rows (n, j) are; every posture of a ball in a socket is one."""
    return len(joints) if observed == "sockets" or not len(joints) else len(np.unique(poses_of(joints)))


def _in_base_units(table: Table, matched: Matched) -> Table:
    """Return the table with the columns whose names end in a unit, such as x_m, in rad or mm."""
    used = (*matched.joints.values(), *matched.position.values(), *matched.rotation.values())
    columns, units, notes = in_base_units(table.columns, used, table.units)
    return replace(
        table, columns={**table.columns, **columns}, units={**table.units, **units}, notes=(*table.notes, *notes)
    )


def _of_length_one(quaternions: Array, names: Sequence[str]) -> Mask:
    """Return which quaternions (n, 4) are rotations, (n,): nothing was seen where all four are 0."""
    size = np.linalg.norm(quaternions, axis=1)
    near: Mask = np.asarray(np.abs(size - 1) < _LENGTH)
    seen = size[size > 0]
    if near.sum() < len(seen) / 2:
        raise DataError(
            f"{', '.join(names)}: their squares sum to {plain(float(np.median(seen)) ** 2, 3)}, and those of a "
            "rotation to 1: are these the columns of a quaternion? machine.observe=position does without"
        )
    return near


def poses_of(joints: Array) -> Index:
    """Return the number of each row's pose, (n,), from 0 in the order of the rows (n, j) [rad | mm].

    Repeats of a pose agree with its first row within a thousandth in every joint.
    """
    number = np.full(len(joints), -1, dtype=np.int64)
    near = KDTree(joints)
    count = 0
    for i in range(len(joints)):
        if number[i] < 0:
            alike = np.array(near.query_ball_point(joints[i], _ALIKE, p=np.inf))
            number[alike[number[alike] < 0]] = count
            count += 1
    return number


def longer_than_table(given: Sequence[str], matched: Matched) -> str:
    """Return which columns are of joints that the table has no row for; "" for none."""
    left = [name for name in _beside(given, matched) if is_called_joint(name, matched.joints.values())]
    if not left:
        return ""
    rows = counted(len(matched.joints), "row")
    return (
        f"the table has {rows} that move{'s' if len(matched.joints) == 1 else ''} ({', '.join(matched.joints)}), and "
        f"{listed(left, _LISTED)} {'is a joint' if len(left) == 1 else 'are joints'} beside them: add the row, or "
        "leave the column out"
    )


def joints_beside(readings: Readings, chain: Chain) -> str:
    """Return, for the end of a refusal, which columns may be of joints that the description lacks; "" for none."""
    table, matched = readings.table, readings.matched
    if chain.told != "table":
        return longer_than_urdf(table, matched)
    left = _beside([name for name in table.columns if table.columns[name].dtype.kind in "iuf"], matched)
    if not left:
        return ""
    return f"; column {left[0]} is read by no row: if it is a joint, its row is missing in the table"


def longer_than_urdf(table: Table, matched: Matched) -> str:
    """Return, for the end of a refusal, which columns are of joints that the URDF lacks; "" for none."""
    given = [name for name in table.columns if table.columns[name].dtype.kind in "iuf"]
    left = [name for name in _beside(given, matched) if is_called_joint(name, matched.joints.values())]
    if not left:
        return ""
    return (
        f"; {listed(left, _LISTED)} {'belongs' if len(left) == 1 else 'belong'} to no joint of the URDF that "
        "moves by itself: take the whole arm's URDF, without <mimic> there, or a machine.tip= behind that joint"
    )


def _not_read(given: Sequence[str], matched: Matched) -> list[str]:
    """Return a remark on columns of numbers that nothing reads; commanded values and scatter get no remark."""
    left = _beside(given, matched)
    return [f"not read: {listed(left, _LISTED)}"] if left else []


def _beside(given: Sequence[str], matched: Matched) -> list[str]:
    used = {*matched.joints.values(), *matched.position.values(), *matched.rotation.values(), *matched.other.values()}
    return [name for name in given if name not in used and not only_asked(name)]


def without_copies(table: Table, values: Array, whole: Mask, what: str = "joint and reading") -> list[str]:
    """Leave rows out of `whole` that equal an earlier one in `values` (n, k), told as `what`; return a remark.

    Two readings of a pose differ by noise, so equal rows are copies: a held-out copy would be among the fitted rows,
    too.
    """
    rows = np.flatnonzero(whole)
    _, first, alike = np.unique(values[rows], axis=0, return_index=True, return_inverse=True)
    again = np.flatnonzero(first[alike.reshape(-1)] != np.arange(len(rows)))
    if not len(again):
        return []
    whole[rows[again]] = False
    told = [f"{table.told(int(rows[i]))} of {table.told(int(rows[first[alike.reshape(-1)[i]]]))}" for i in again]
    return [f"{len(again)} rows are copies of others in every {what}, and left out: {listed(told, 4)}"]


def _observed(matched: Matched) -> str:
    if "socket" in matched.other and not matched.position:
        return "sockets"
    return "pose" if matched.rotation else "position"


def _numbers(table: Table, name: str) -> Array:
    return np.asarray(table.columns[name], dtype=float)


def _together(table: Table, columns: Mapping[str, str]) -> Array | None:
    return np.column_stack([_numbers(table, name) for name in columns.values()]) if columns else None


def _sockets(table: Table, matched: Matched, observed: str) -> tuple[Index, Index]:
    """Return the number of each row's socket among those of all places, and of its place, (n,); -1 without sockets."""
    n = len(table)
    if observed != "sockets":
        return np.full(n, -1, dtype=np.int64), np.full(n, -1, dtype=np.int64)
    socket = table.columns[matched.other["socket"]].astype(int)
    told = table.columns[matched.other["place"]] if "place" in matched.other else np.zeros(n, dtype=int)
    _, place = np.unique(told, return_inverse=True)
    _, both = np.unique(np.column_stack([place, socket]), axis=0, return_inverse=True)
    return both.ravel().astype(np.int64), place.astype(np.int64)


def held_back(table: Table, matched: Matched, whole: Mask) -> Mask | None:
    """Return which rows the file holds back, (n,), some of the `whole` ones; None where it does not say."""
    if "split" not in matched.other or not whole.any():
        return None
    held: Mask = split_rows(table.columns[matched.other["split"]]) == "hold"
    if not held[whole].any() or held[whole].all():
        every = "every" if held.any() and held[whole].all() else "no"
        raise DataError(f"column split holds back {every} row; leave it out, or hold some")
    return held


def _others(table: Table, matched: Matched) -> dict[str, Array]:
    found = {name: column for name, column in matched.other.items() if name not in _OWN_WORDS}
    return {name: _numbers(table, column) for name, column in found.items()}


def _sliding(chain: Chain) -> frozenset[str]:
    return frozenset(joint.name for joint in chain.joints if joint.kind == "sliding")


def _check_joints(readings: Readings, chain: Chain, limits: bool) -> None:
    """Refuse joints that no such arm can have: in degrees, and beyond their limits."""
    there = {joint.name: joint for joint in chain.joints}
    for k, name in enumerate(chain.driven):
        joint, values, column = there.get(name), readings.joints[:, k], readings.matched.joints[name]
        if joint is None:
            continue
        rotary = joint.kind == "rotary"
        if rotary and np.abs(values).max() > _TURNS and column not in readings.table.units:
            raise DataError(
                f"joint {name} reaches {np.abs(values).max():.0f}, and no joint turns so many rad: are they degrees? "
                f"units={','.join(f'{column}:deg' for column in _degrees(readings, chain))}"
            )
        beyond = (values < joint.lower - _ROUND) | (values > joint.upper + _ROUND)
        if limits and beyond.any():
            unit = "rad" if rotary else "mm"
            turned = np.deg2rad(values)
            way_out = "is the column that of this joint, and its unit right?"
            if rotary and _within(turned, joint) and np.abs(values).max() > _TURNS:
                units = ",".join(f"{column}:deg" for column in _degrees(readings, chain))
                way_out = f"as degrees all its rows lie within: units={units}"
            elif chain.told == "table" and rotary and _within(turned, joint):
                way_out = "with limits in rad all its rows lie within: write lower [rad] and upper [rad]"
            elif not rotary and _within(values / 1000, joint) and joint.upper > _LONGEST_RAIL:
                way_out = f"as mm all its rows lie within: units={column}:mm"
            elif chain.told == "table" and not rotary and _within(values / 1000, joint):
                way_out = f"with limits in m all its rows lie within: write their unit in the cells, {joint.upper:g} m"
            raise DataError(
                f"{readings.told(int(np.argmax(beyond)))}: joint {name} stands at {values[np.argmax(beyond)]:.4g} "
                f"{unit}, outside its limits {joint.lower:.4g} to {joint.upper:.4g} in the {chain.told} "
                f"({counted(int(beyond.sum()), 'such row')}): {way_out}; limits=false passes this over"
            )


def _within(values: Array, joint: ChainJoint) -> bool:
    return bool(np.all((values >= joint.lower - _ROUND) & (values <= joint.upper + _ROUND)))


def _check_moves(readings: Readings, chain: Chain) -> None:
    """Refuse poses in which so few joints move that base and target are not determined."""
    moves = [name for k, name in enumerate(chain.driven) if np.ptp(readings.joints[:, k]) > _ALIKE]
    if len(moves) < min(_MOVING, len(chain.driven)):
        raise DataError(
            f"only {' and '.join(moves)} {'moves' if len(moves) == 1 else 'move'} in these poses, and base and target "
            "are told by poses that differ in every joint; bench design machine=arm plan.n=40 says which"
        )


def _degrees(readings: Readings, chain: Chain) -> list[str]:
    """Return the columns of joints in degrees: all rotary ones, or those beyond all turns where degrees fit."""
    turning = [k for k, name in enumerate(chain.driven) if name not in readings.sliding]
    beyond = [k for k in turning if np.abs(readings.joints[:, k]).max() > _TURNS]

    def left(those: list[int]) -> float:
        joints = readings.joints.copy()
        joints[:, those] = np.deg2rad(joints[:, those])
        assert readings.position is not None
        return frames_of_positions(forward(chain, nominal(chain), joints), readings.position).left

    chosen = turning if readings.position is None else min((turning, beyond), key=left)
    return [readings.matched.joints[chain.driven[k]] for k in chosen]


def in_unit(readings: Readings, chain: Chain, unit: str = "deg") -> str:
    """Return what `units=` says of joints that turn, where they are in `unit`."""
    sliding = _sliding(chain)
    return ",".join(f"{readings.matched.joints[name]}:{unit}" for name in chain.driven if name not in sliding)
