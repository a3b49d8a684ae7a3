"""`Table`, the columns of a measurement, and `Readings`: the same as poses of one chain, in rad and mm.

Joints are matched to the description, units that stand in names are turned, rows without a value are left out, and what
no arm can have read is refused in one line that says what to do. What only the arm can tell (`start`) is left open.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np
from scipy.spatial import KDTree

from calibench.calibration import loci as kinds
from calibench.calibration.columns import (
    ARM,
    DISTANCE_TO,
    PLANE,
    POSITION,
    STATED,
    TARGET,
    Matched,
    by_their_names,
    is_called_joint,
    match_columns,
    only_asked,
)
from calibench.calibration.frames import frames_of_positions
from calibench.calibration.kinematics import Chain, forward, nominal
from calibench.calibration.loci import Fixture, Loci
from calibench.calibration.rig import unfolded
from calibench.calibration.rigid import Array, Index, Mask, rpy_of
from calibench.core.notes import Code, DataError, Note
from calibench.core.tables.cells import split_rows, valid_rows
from calibench.core.tables.columns import in_base_units, is_table, named_columns, rename, with_seconds
from calibench.core.words import as_columns, as_units, counted, listed, plain

OBSERVED = ("position", "pose", "sockets")
_LEAST = {"position": 10, "pose": 6, "sockets": 12}  # poses at least: with fewer there are as many unknowns as readings
_MOVING = 3  # joints at the least, where the arm has as many
_ALIKE = 1e-3  # rad or mm by which joints differ at most where a pose is taken again
_HUGE = 1e12  # a value that no instrument gives
_ROUNDED = 1e-3  # by which the length of a quaternion may differ from one
_LISTED = 8  # columns that a note names
_WORDS = ("socket", "place", TARGET, DISTANCE_TO, PLANE, "split", "valid")  # columns that are no numbers beside a pose
_LENGTH = 0.5  # the most by which a quaternion's length may differ from 1
TURNS = 4 * np.pi  # rad: no joint turns further


@final
@dataclass(frozen=True, eq=False)
class Table:
    """Columns name -> (n,), in mm or rad where `units` has one for them; `stated` is what is known beside them.

    `file` and `row` (n,) say which reading of which file a row is, for messages; `name` is the case.
    """

    columns: Mapping[str, Any]
    units: Mapping[str, str]
    stated: Mapping[str, Any]
    file: Any
    row: Any
    name: str
    notes: tuple[Note, ...] = ()

    @classmethod
    def of(
        cls, columns: Mapping[str, Any], name: str = "data", *, units: Mapping[str, str] | None = None,
        stated: Mapping[str, Any] | None = None, notes: Iterable[Note] = (), row: Any = None,
    ) -> Table:  # fmt: skip
        """Return the table of one file, whose rows are counted from 1 where `row` does not number them."""
        n = len(next(iter(columns.values()), ()))
        row = np.arange(1, n + 1) if row is None else row
        return cls(
            columns=columns, units=units or {}, stated=stated or {}, file=np.full(n, name), row=row, name=name,
            notes=tuple(notes),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.row)

    def label(self, i: int) -> str:
        """Return how a message names a row: its number, and its file where there are several."""
        several = len(set(self.file.tolist())) > 1
        return f"{self.file[i]} row {self.row[i]}" if several else f"row {self.row[i]}"


def table_of(
    readings: Any, *, columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None,
    names: Sequence[str] = (), name: str = "readings",
) -> Table:  # fmt: skip
    """Return the table of a mapping of columns, of a DataFrame, or of an array (n, k) with the `names` of its columns.

    A unit may stand in a column's name, ``x [m]``, or in `units`. `columns` renames, {"x": "Weg X"}.
    """
    if isinstance(readings, Table):
        return readings
    given = readings
    if not is_table(readings):
        numbers = np.asarray(readings)
        if numbers.ndim != 2 or len(names) not in (0, numbers.shape[1]):
            raise DataError(
                f"{name}: columns by name are needed, a DataFrame, or an array (n, k) with names= for its k columns"
            )
        names = names or [f"column_{k}" for k in range(1, numbers.shape[1] + 1)]
        given = dict(zip(names, numbers.T, strict=True))
    content = in_base_units(rename(named_columns(given, name, declared=ARM), columns or {}, units or {}, of=name))
    return Table.of(content.columns, name, units=content.units)


@final
@dataclass(frozen=True, eq=False)
class Readings:
    """n poses: `joints` (n, j) [rad | mm] and what was read at them.

    `position` (n, 3) [mm], `turns` (n, 3, 3); `angles` (n, 3 | 4) are the rotations as the file has them. `socket` (n,)
    counts the sockets of all places from 0, `place` (n,) the places, `target` (n,) those of `targets` on the flange,
    of which the first is read most. `hold` (n,) marks what the file keeps back. `rows`
    (n,) are those of the table. `sliding` names the joints that are read in mm. Where less than places was read,
    `loci` says what each reading is, and `position` is NaN where an axis was not.
    """

    observed: str
    joints: Array
    position: Array | None
    angles: Array | None
    socket: Index
    place: Index
    target: Index
    hold: Mask | None
    rows: Index
    table: Table
    matched: Matched
    other: Mapping[str, Array] = field(default_factory=dict)
    turns: Array | None = None
    notes: tuple[Note, ...] = ()
    sliding: frozenset[str] = frozenset()
    targets: tuple[str, ...] = ()
    loci: Loci | None = None

    def __len__(self) -> int:
        return len(self.joints)

    def label(self, i: int) -> str:
        """Return how a message names pose i in the file, and what was read there where less than a place was."""
        fixture = -1 if self.loci is None else int(self.loci.fixture[i])
        beside = "" if self.loci is None or fixture < 0 else f", {self.loci.fixtures[fixture].words}"
        return self.table.label(int(self.rows[i])) + beside

    def with_note(self, code: Code, text: str, columns: Iterable[str] = (), **values: Any) -> Readings:
        """Return the same readings with one more note."""
        return replace(self, notes=(*self.notes, Note(code, text, tuple(columns), values=values)))

    def where(self, keep: Mask | Index) -> Readings:
        """Return the poses that `keep`, a mask or places, names."""
        cut: dict[str, Any] = {
            key: getattr(self, key)[keep]
            for key in ("joints", "position", "angles", "socket", "place", "target", "hold", "rows", "turns")
            if getattr(self, key) is not None
        }
        loci = None if self.loci is None else self.loci.at(keep)
        return replace(self, **cut, loci=loci, other={name: column[keep] for name, column in self.other.items()})

    @property
    def train(self) -> Mask:
        """Return which poses are fitted, (n,): all but those that the file keeps back."""
        return np.ones(len(self), dtype=bool) if self.hold is None else ~self.hold


def columns_of(readings: Readings, distance: float = 0.0) -> tuple[dict[str, Any], dict[str, str], dict[str, Any]]:
    """Return the readings in the columns that every arm has, in mm and rad, their units, and what is stated of them."""
    columns: dict[str, Any] = {f"q_{name}": readings.joints[:, k] for k, name in enumerate(readings.matched.joints)}
    units = {f"q_{name}": "mm" if name in readings.sliding else "rad" for name in readings.matched.joints}
    if readings.position is not None:
        columns |= dict(zip("xyz", readings.position.T, strict=True))
        units |= dict.fromkeys("xyz", "mm")
    if readings.turns is not None:
        columns |= dict(zip(("rx", "ry", "rz"), rpy_of(readings.turns).T, strict=True))
        units |= dict.fromkeys(("rx", "ry", "rz"), "rad")
    if readings.observed == "sockets":
        first = {place: readings.socket[readings.place == place].min() for place in np.unique(readings.place)}
        columns["socket"] = readings.socket - np.array([first[place] for place in readings.place])
        columns["place"] = readings.place
    if readings.loci is not None:
        names = np.array(["", *(one.name for one in readings.loci.fixtures)])[readings.loci.fixture + 1]
        is_distance = readings.loci.kind == kinds.DISTANCE
        columns |= {"distance": readings.loci.length, DISTANCE_TO: np.where(is_distance, names, "")}
        columns[PLANE] = np.where(readings.loci.kind == kinds.PLANE, names, "")
        units["distance"] = "mm"
    if readings.targets:
        columns[TARGET] = np.array(readings.targets)[readings.target]
    columns |= readings.other
    of_joints = {name: readings.matched.other.get(name, name) for name in readings.other}
    units |= {name: unit for name, column in of_joints.items() if (unit := readings.table.units.get(column))}
    if readings.hold is not None:
        columns["split"] = np.where(readings.hold, "hold", "train")
    stated: dict[str, Any] = {"rotation": "rpy"} if readings.turns is not None else {}
    return columns, units, stated | ({"socket_distance_mm": distance} if distance else {})


def read_readings(
    table: Table, chain: Chain, observe: str = "", *, copies: bool = False, option: str = "machine."
) -> Readings:
    """Return the poses of `table` for `chain`, without rows that equal others but with `copies`."""
    try:
        return _readings(table, chain, observe, copies, option)
    except ValueError as error:
        text = str(error) if str(error).startswith(table.name) else f"{table.name}: {error}"
        raise DataError(text, getattr(error, "note", None)) from None


def _readings(table: Table, chain: Chain, observe: str, copies: bool, option: str) -> Readings:
    given = readable(table)
    table, matched, _ = by_target(table, match_columns(given, chain.driven, option, chain.source))
    given = [name for name in given if name in table.columns]
    sliding = frozenset(joint.name for joint in chain.joints if joint.kind == "sliding")
    bases = {column: "mm" if name in sliding else "rad" for name, column in matched.joints.items()}
    stated_places = {name: matched.other[name] for name in STATED if name in matched.other}
    bases |= dict.fromkeys((*matched.position.values(), *matched.distance.values(), *stated_places.values()), "mm")
    bases |= dict.fromkeys(matched.rotation.values(), "rad") if len(matched.rotation) == 3 else {}
    for column, base in bases.items():
        if (unit := table.units.get(column, base)) != base:
            turned = (n.values.get("stated") for n in table.notes if n.code is Code.UNIT_TURNED and column in n.columns)
            raise DataError(f"column {column} is in {next(turned, unit)}, and {base} or a like unit is needed")
    beside = _beside(given, matched)
    names = [name for name in beside if is_called_joint(name, matched.joints.values())]
    if chain.source == "table" and names:
        rows = counted(len(matched.joints), "row")
        raise DataError(
            f"the table has {rows} that move{'s' if len(matched.joints) == 1 else ''} ({', '.join(matched.joints)}), "
            f"and {listed(names, _LISTED)} {'is a joint' if len(names) == 1 else 'are joints'} beside them: add the "
            "row, or leave the column out"
        )
    joints, angles = (
        np.column_stack([np.asarray(table.columns[one], dtype=float) for one in part.values()]) if part else None
        for part in (matched.joints, matched.rotation)
    )
    assert joints is not None
    position, loci, of = (None, None, np.arange(len(table))) if observe == "sockets" else _read_of(table, matched)
    observe = observe or (
        "sockets" if "socket" in matched.other and not matched.position else "pose" if matched.rotation else "position"
    )
    notes = [*table.notes, *matched.notes]
    if loci is not None:
        assert position is not None
        if TARGET in matched.other:
            raise DataError(f"column {matched.other[TARGET]}: several targets go with x, y and z alone; leave it out")
        if matched.rotation:
            text = f"{', '.join(matched.rotation.values())}: rotations are left out beside {loci.words(position)}"
            notes.append(Note(Code.ROTATION_LEFT_OUT, text, tuple(matched.rotation.values())))
        observe, angles = "position", None
    elif observe == "sockets":
        position = angles = None
        if "socket" not in matched.other:
            raise DataError("a column socket (0, 1, ...) is needed, or a folder of places with hole_0.csv, hole_1.csv")
    elif position is None:
        raise DataError(
            f"no measured x, y and z were found among {', '.join(given)}, and no distance or plane; "
            f"{as_columns({'x': 'NAME', 'y': 'NAME', 'z': 'NAME'})} names them, or machine.observe=sockets for a ball "
            "in sockets"
        )
    elif observe == "pose" and angles is None:
        raise DataError(
            "no measured rotation was found: rx, ry, rz or qx, qy, qz, qw; machine.observe=position does without"
        )
    if observe == "position":
        angles = None
    if loci is None:
        values = np.column_stack([joints, *(part for part in (position, angles) if part is not None)])
    else:  # what was read of the joints of a row, 0 where nothing was, and no number where nothing at all
        assert position is not None
        values = np.column_stack([joints, np.zeros((len(joints), 3 + len(loci.fixtures)))])
        there = loci.fixture >= 0
        values[of[there], joints.shape[1] + 3 + loci.fixture[there]] = loci.length[there]
        values[of[~there], joints.shape[1] : joints.shape[1] + 3] = position[~there]
        values = (
            np.nan_to_num(values, nan=0.0, posinf=np.inf)
            + np.where(np.isin(np.arange(len(joints)), of), 0, np.nan)[:, None]
        )
    whole = _whole_rows(table, matched, values, angles, notes)
    if beside:
        text = f"not read: {listed(beside, _LISTED)}{'' if matched.rotation else _like_a_rotation(table, beside)}"
        notes.append(Note(Code.COLUMNS_UNREAD, text, tuple(beside)))
    if observe != "sockets" and not copies:
        notes += without_copies(table, values, whole)
    hold = held_back(table, matched, whole)
    socket = place = np.full(len(table), -1, dtype=np.int64)
    if observe == "sockets":  # counted among those of all places
        seat = np.unique(table.columns[matched.other["socket"]], return_inverse=True)[1].ravel()
        places = table.columns[matched.other["place"]] if "place" in matched.other else np.zeros(len(table), dtype=int)
        place = np.unique(places, return_inverse=True)[1].astype(np.int64)
        socket = np.unique(np.column_stack([place, seat]), axis=0, return_inverse=True)[1].ravel().astype(np.int64)
    targets, target = np.zeros(0, dtype=str), np.zeros(len(table), dtype=np.int64)
    if observe != "sockets" and TARGET in matched.other:
        targets, which = np.unique(np.asarray(table.columns[matched.other[TARGET]]).astype(str), return_inverse=True)
        order = np.argsort(-np.bincount(which.ravel()[whole], minlength=len(targets)), kind="stable")
        targets, target = targets[order], np.argsort(order)[which.ravel()]
    readings = Readings(
        observed=observe, joints=joints, position=position, angles=angles, socket=socket, place=place, hold=hold,
        target=target, targets=tuple(map(str, targets.tolist())),
        rows=np.arange(len(table), dtype=np.int64), table=table, matched=matched,
        other={n: np.asarray(table.columns[c], dtype=float) for n, c in matched.other.items() if n not in _WORDS}
        | {name: np.asarray(table.columns[name], dtype=float) for name in beside},
        notes=tuple(notes), sliding=sliding,
    )  # fmt: skip
    if loci is None:
        readings = readings.where(whole)
    else:
        assert position is not None
        kept = replace(readings, position=None).where(of[whole[of]])
        readings = replace(kept, position=position[whole[of]], loci=loci.at(whole[of]))
    _check(readings, whole, chain)
    return readings


def _read_of(table: Table, matched: Matched) -> tuple[Array | None, Loci | None, Index]:
    """Return what was read of the target, (m, 3), what each such reading allows, and its row; no loci for places.

    A row may hold several: axes, distances from fixed points, and the plane that the target touches.
    """
    n = len(table)
    axes, columns = np.full((n, 3), np.nan), table.columns
    for axis, column in matched.position.items():
        axes[:, POSITION.index(axis)] = columns[column]
    plane = _labels(columns[matched.other[PLANE]]) if PLANE in matched.other else np.full(n, "")
    beside = bool(matched.distance) or PLANE in matched.other
    some, whole = np.isfinite(axes).any(axis=1), np.isfinite(axes).all(axis=1)
    if not beside and (not matched.position or whole.any() or not some.any()):
        return (axes if matched.position else None), None, np.arange(n)
    if whole.any() and len(matched.position) == 3:
        some = whole  # what lacks an axis of three is left out
    fixtures: list[Fixture] = []
    rows, fixture, length = [np.flatnonzero(some)], [np.full(int(some.sum()), -1)], [np.full(int(some.sum()), np.nan)]

    def add(name: str, kind: int, there: Mask, far: Array, at: Array | None = None) -> None:
        frame = np.eye(4)
        frame[:3, 3] = 0.0 if at is None else at
        fixtures.append(Fixture(name, kind, frame, at is not None))
        rows.append(np.flatnonzero(there))
        fixture.append(np.full(int(there.sum()), len(fixtures) - 1))
        length.append(far[there])

    stated = [matched.other[name] for name in STATED if name in matched.other]
    places = np.column_stack([columns[c] for c in stated]).astype(float) if len(stated) == 3 else None
    for name, column in matched.distance.items():
        far = np.asarray(columns[column], dtype=float)
        labels = np.full(n, name or "1")
        if not name and places is not None:
            labels = np.array([" ".join(map(plain, one)) for one in places])
        if not name and DISTANCE_TO in matched.other:
            labels = _labels(columns[matched.other[DISTANCE_TO]])
        for label in dict.fromkeys(labels[np.isfinite(far) & (labels != "")].tolist()):
            there = np.isfinite(far) & (labels == label)
            at = None if name or places is None else np.median(places[there], axis=0)
            add(label, kinds.DISTANCE, there, far, at if at is not None and np.isfinite(at).all() else None)
    for label in dict.fromkeys(plane[plane != ""].tolist()):
        add(label, kinds.PLANE, plane == label, np.full(n, np.nan))
    names = [one.name for one in fixtures]
    if len({*names}) < len(names):
        raise DataError(
            f"{listed(sorted({one for one in names if names.count(one) > 1}), 5)}: two fixtures of one name"
        )
    of = np.concatenate(rows)
    order = np.argsort(of, kind="stable")
    loci = Loci(np.concatenate(fixture).astype(np.int64)[order], np.concatenate(length)[order], tuple(fixtures))
    read = np.where((loci.fixture < 0)[:, None], axes[of[order]], np.nan)
    return read, loci, of[order]


def _labels(column: Any) -> Any:
    """Return the cells of a column of names as words, (n,), "" where there is none."""
    words = np.array([str(one).strip() for one in np.asarray(column).tolist()])
    return np.where(np.isin(words, ("nan", "None")), "", words)


def readable(table: Table) -> list[str]:
    """Return the columns that hold numbers, or words that are known."""
    return [name for name in table.columns if table.columns[name].dtype.kind in "iufb" or name.lower() in _WORDS]


def by_target(table: Table, matched: Matched) -> tuple[Table, Matched, Index | None]:
    """Return the table with one target of the flange in a row, without drift, and the row of each, None for as before.

    Units that names state are turned before, and times that are no seconds.
    """
    if (clock := matched.other.get("t_s", "")) and clock not in table.units:
        columns, of_times = with_seconds(table.columns, clock)
        table = replace(table, columns=columns, notes=(*table.notes, *of_times))
        if clock not in columns:
            matched = replace(matched, other={name: c for name, c in matched.other.items() if name != "t_s"})
    places = [*matched.position.values(), *(c for group in matched.targets.values() for c in group.values())]
    lengths = [*matched.distance.values(), *(matched.other[name] for name in STATED if name in matched.other)]
    used = dict.fromkeys((*matched.joints.values(), *places, *matched.rotation.values(), *lengths))
    turned, units, notes = by_their_names(table.columns, used, table.units)
    table = replace(
        table, columns={**table.columns, **turned}, units={**table.units, **units}, notes=(*table.notes, *notes)
    )
    if len(matched.position) < 3 or matched.distance or not (matched.targets or TARGET in matched.other):
        return table, matched, None
    of_places = {table.units.get(name, "") for name in places}
    if len(of_places) > 1:
        raise DataError(f"{listed(places, _LISTED)} are in several units; units= states one for all of them")
    unit = of_places.pop() or ("mm" if set(matched.position.values()) == set("xyz") else "")
    columns, rows, of_targets = unfolded(table.columns, matched, unit)
    if matched.rotation:
        text = f"{', '.join(matched.rotation.values())}: rotations are left out beside several targets"
        of_targets.append(Note(Code.ROTATION_LEFT_OUT, text, tuple(matched.rotation.values())))
    other = {name: column for name, column in matched.other.items() if name != TARGET}
    row = table.row[rows]
    if TARGET in columns:
        other[TARGET] = TARGET
        row = np.array([f"{i}, target {name}" for i, name in zip(row.tolist(), columns[TARGET], strict=True)])
    table = replace(table, columns=columns, file=table.file[rows], row=row, notes=(*table.notes, *of_targets))
    return table, replace(matched, targets={}, rotation={}, other=other), rows


def _check(readings: Readings, whole: Mask, chain: Chain) -> None:
    """Refuse too few poses, joints that turn further than any does, and poses in which too few joints move."""
    used, observe, hold = readings.joints[readings.train], readings.observed, readings.hold
    poses = len(used) if observe == "sockets" or not len(used) else len(np.unique(poses_of(used)))
    arm = "machine.dh=TABLE" if chain.source == "table" else "machine.urdf=FILE"
    design = f"bench design machine=arm {arm} plan.n=40 says which"
    least = _LEAST[observe]
    fitted = readings.where(readings.train)
    if fitted.loci is not None and fitted.position is not None and poses:
        each = fitted.loci.counted(fitted.position)[first_of_each(fitted)].sum() / poses
        least = int(np.ceil(3 * least / min(max(each, 1.0), 3.0)))
    if poses < least:
        without = "" if whole.all() else f", as {int((~whole).sum())} of {len(whole)} rows are left out,"
        without += "" if hold is None else f" beside the {int(hold.sum())} that column split holds back"
        text = (
            f"{counted(poses, 'pose')}{without} {'is' if poses == 1 else 'are'} too few: {least} at the least, "
            f"and some 40 that differ much in every joint; {design}"
        )
        raise DataError(text, Note(Code.FEW_POSES, text, values={"poses": poses, "least": least}))
    for k, name in enumerate(chain.driven):
        largest = float(np.abs(readings.joints[:, k]).max(initial=0.0))
        column = readings.matched.joints[name]
        if name not in readings.sliding and largest > TURNS and column not in readings.table.units:
            columns = columns_in_degrees(readings, chain)
            text = (
                f"joint {name} reaches {largest:.0f}, and no joint turns so many rad: are they degrees? "
                f"{as_units(columns, 'deg')}"
            )
            raise DataError(text, Note(Code.JOINT_UNIT, text, tuple(columns), values={"unit": "deg"}))
    moves = [name for k, name in enumerate(chain.driven) if np.ptp(used[:, k]) > _ALIKE]
    if observe != "sockets" and len(moves) < min(_MOVING, len(chain.driven)):
        text = (
            f"only {' and '.join(moves)} {'moves' if len(moves) == 1 else 'move'} in these poses, and base and target "
            f"are told by poses that differ in every joint; {design}"
        )
        raise DataError(text, Note(Code.JOINT_STILL, text))


def _whole_rows(table: Table, matched: Matched, values: Array, angles: Array | None, notes: list[Note]) -> Mask:
    """Return which rows can be used, (n,): with a number in all `values`, a rotation, and the mark valid. Add notes."""
    whole: Mask = np.asarray((np.abs(values) < _HUGE).all(axis=1))  # nor is what is no number
    if angles is not None and angles.shape[1] == 4:
        size = np.linalg.norm(angles, axis=1)
        near: Mask = np.asarray(np.abs(size - 1) < _LENGTH)
        seen = size[size > 0]  # nothing was seen where all four are 0
        if len(seen) < len(size) / 2:
            raise DataError(
                f"{', '.join(matched.rotation.values())} are all 0 in {len(size) - len(seen)} of {len(size)} rows, "
                "which is no rotation; machine.observe=position does without"
            )
        if near.sum() < len(seen) / 2:
            raise DataError(
                f"{', '.join(matched.rotation.values())}: their squares sum to "
                f"{plain(float(np.median(seen)) ** 2, 3)}, and those of a rotation to 1: are these the columns of a "
                "quaternion? machine.observe=position does without"
            )
        whole &= near
    if "valid" in matched.other:
        marked = valid_rows(table.columns[matched.other["valid"]])
        if not marked.all():
            text = f"{np.sum(~marked)} rows are marked as not valid and left out"
            notes.append(Note(Code.ROWS_LEFT_OUT, text, values={"rows": int(np.sum(~marked))}))
        whole &= marked
    if not whole.all():
        rows = tuple(table.label(int(i)) for i in np.flatnonzero(~whole))
        text = f"{len(rows)} of {len(whole)} rows are without a value or not valid, and left out: {listed(rows, 5)}"
        notes.append(Note(Code.ROWS_LEFT_OUT, text, rows=rows, values={"rows": len(rows)}))
    return whole


def first_of_each(readings: Readings) -> Index:
    """Return the first reading of each target, axis or distance in each pose; all others are repeats of these."""
    parts = [poses_of(readings.joints), readings.target]
    parts += [] if readings.loci is None else [readings.loci.fixture]
    parts += [] if readings.position is None else [*np.isfinite(readings.position).T]
    return np.asarray(np.unique(np.column_stack(parts), axis=0, return_index=True)[1], dtype=np.int64)


def poses_of(joints: Array) -> Index:
    """Return the number of each row's pose, (n,), from 0 in the order of the rows; repeats agree to a thousandth."""
    near, first = KDTree(joints), np.arange(len(joints))  # row of each pose
    for i in np.flatnonzero(near.query_ball_point(joints, _ALIKE, p=np.inf, return_length=True) > 1):
        if first[i] == i:
            alike = np.array(near.query_ball_point(joints[i], _ALIKE, p=np.inf))
            first[alike[(first[alike] == alike) & (alike > i)]] = i
    return np.unique(first, return_inverse=True)[1].astype(np.int64)


def _like_a_rotation(table: Table, beside: Sequence[str]) -> str:
    """Return, for the end of a note, how unread columns are read as a rotation: four of length one, or a KUKA's."""
    named = {name.casefold(): name for name in beside}
    if {"a", "b", "c"} <= {*named}:
        cure = as_columns({"rx": named["c"], "ry": named["b"], "rz": named["a"]})
        return f"; if A, B, C are turns about z, y, x: {cure}"
    for k in range(len(beside) - 3):
        four = beside[k : k + 4]
        lengths = np.linalg.norm([np.asarray(table.columns[name], dtype=float) for name in four], axis=0)
        known = lengths[np.isfinite(lengths)]
        if len(known) and np.abs(known - 1).max() < _ROUNDED:
            return f"; if {', '.join(four)} are a quaternion: {as_columns(dict(zip(('qx', 'qy', 'qz', 'qw'), four)))}"
    return ""


def joints_beside(readings: Readings, chain: Chain) -> str:
    """Return, for the end of a refusal, which columns may be of joints that the description lacks; "" for none."""
    table, matched = readings.table, readings.matched
    names = _beside([name for name in table.columns if table.columns[name].dtype.kind in "iuf"], matched)
    if chain.source == "table":
        lacks = "is read by no row: if it is a joint, its row is missing in the table"
        return f"; column {names[0]} {lacks}" if names else ""
    names = [name for name in names if is_called_joint(name, matched.joints.values())]
    if not names:
        return ""
    return (
        f"; {listed(names, _LISTED)} {'belongs' if len(names) == 1 else 'belong'} to no joint of the URDF that "
        "moves by itself: take the whole arm's URDF, without <mimic> there, or a machine.tip= behind that joint"
    )


def _beside(given: Sequence[str], matched: Matched) -> list[str]:
    """Return the columns of numbers that nothing reads; commanded values and scatter are none of them."""
    parts = (matched.joints, matched.position, matched.rotation, matched.other, matched.distance)
    used = {column for part in parts for column in part.values()}
    return [name for name in given if name not in used and not only_asked(name)]


def without_copies(table: Table, values: Array, whole: Mask, what: str = "joint and reading") -> list[Note]:
    """Leave rows out of `whole` that equal an earlier one in `values` (n, k), called `what`; return a note."""
    rows = np.flatnonzero(whole)
    _, first, alike = np.unique(values[rows], axis=0, return_index=True, return_inverse=True)
    again = np.flatnonzero(first[alike.reshape(-1)] != np.arange(len(rows)))
    if not len(again):
        return []
    whole[rows[again]] = False
    pairs = [f"{table.label(int(rows[i]))} of {table.label(int(rows[first[alike.reshape(-1)[i]]]))}" for i in again]
    text = f"{len(again)} rows are copies of others in every {what}, and left out: {listed(pairs, 4)}"
    return [Note(Code.ROWS_COPIED, text, rows=tuple(table.label(int(rows[i])) for i in again))]


def held_back(table: Table, matched: Matched, whole: Mask) -> Mask | None:
    """Return which rows the file holds back, (n,), some of the `whole` ones; None where it does not say."""
    if "split" not in matched.other or not whole.any():
        return None
    held: Mask = split_rows(table.columns[matched.other["split"]]) == "hold"
    if not held[whole].any() or held[whole].all():
        every = "every" if held.any() and held[whole].all() else "no"
        raise DataError(f"column split holds back {every} row; leave it out, or hold some")
    return held


def columns_in_degrees(readings: Readings, chain: Chain) -> list[str]:
    """Return the columns of joints in degrees: all rotary ones, or those beyond all turns where degrees fit."""
    turning = [k for k, name in enumerate(chain.driven) if name not in readings.sliding]
    beyond = [k for k in turning if np.abs(readings.joints[:, k]).max() > TURNS]
    if (position := readings.position) is None or readings.loci is not None:
        return [readings.matched.joints[chain.driven[k]] for k in turning]
    apart = []
    for those in (turning, beyond):
        joints = readings.joints.copy()
        joints[:, those] = np.deg2rad(joints[:, those])
        apart.append(frames_of_positions(forward(chain, nominal(chain), joints), position).apart)
    chosen = beyond if apart[1] < apart[0] else turning
    return [readings.matched.joints[chain.driven[k]] for k in chosen]
