"""Which column of a measured file is which: the joints of a chain, what was measured at its end, and the rest.

A file says it in its own words: `q_elbow_joint` or `Elbow Joint`, `joint_1` to `joint_6`, seven columns without a name;
`x`, `measurement_x`, `x1` and `phix1` (FIGAROH), `qx qy qz qw`. What was only asked for (`Goal x`), and scatter
(`measurement_std_x`), is no measurement. Nothing is guessed: what fits twice, or not at all, is refused in one line.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.calibration.rigid import Array
from calibench.core.notes import Code, Note
from calibench.core.options import suggest
from calibench.core.tables.cells import factor_to_base
from calibench.core.words import as_columns, listed

POSITION = ("x", "y", "z")
EULER = ("rx", "ry", "rz")
QUATERNION = ("qx", "qy", "qz", "qw")
OF_A_JOINT = ("direction", "velocity", "torque")  # what a file may tell of each joint, beside its reading
_SPELT = {
    **{f"{lead}{axis}": axis for axis in POSITION for lead in ("", "p", "t", "pos", "position")},
    **{f"{lead}{axis}": f"r{axis}" for axis in POSITION for lead in ("r", "phi", "rot", "rotation")},
    **{name: name for name in QUATERNION},
    "roll": "rx", "pitch": "ry", "yaw": "rz",
}  # fmt: skip
_NOT_MEASURED = {
    "goal", "target", "command", "commanded", "cmd", "desired", "nominal", "setpoint", "reference", "ref", "std",
    "sigma", "sd", "stdev", "error", "err", "cov", "flange",
}  # fmt: skip
_SAID = {"actual", "measured", "meas", "feedback", "encoder", "position", "pos", "angle", "state", "value", "q"}
_STEMS = {"q", "j", "joint", "axis", "a", "theta", "angle", "joints", "jointangle", "actualq", "column"}
_PLACES = ("xyz", "position", "pos", "place", "point", "p")
_LISTED = 20  # joints or columns that a refusal names
_FIRST_MARKER = ("", "1")
_UNIT = re.compile(r"(.*[a-z0-9])[_ .-](mm|cm|um|m|inch|in|deg|degrees|rad|mrad)", re.IGNORECASE)
_TIMES = {"t_s", "t", "time", "timestamp"}


@final
@dataclass(frozen=True)
class Matched:
    """The columns of a file by what they are: `joints` joint -> column, the others name of ours -> column.

    `position` is x y z, `rotation` rx ry rz or qx qy qz qw; empty where nothing of the kind was measured. `figaroh`:
    they are called as FIGAROH calls them, whose unit is the metre. `notes` say what was matched otherwise than by name.
    """

    joints: Mapping[str, str]
    position: Mapping[str, str]
    rotation: Mapping[str, str]
    other: Mapping[str, str]
    figaroh: bool = False
    notes: tuple[Note, ...] = ()


_NO_JOINT = "or take its row out, or give it the type fixed"


def match_columns(
    names: Sequence[str], joints: Sequence[str], option: str = "machine.", source: str = "URDF"
) -> Matched:
    """Return which of the columns `names` is which, for a chain of `joints` in their order.

    >>> match_columns(["x1", "y1", "z1", "elbow", "Wrist [deg]".split()[0]], ["elbow", "wrist"]).joints
    {'elbow': 'elbow', 'wrist': 'Wrist'}

    `option` is what the user writes before tip=, as messages say it: "machine.", or "problem." where columns= is no
    option. `source` is what describes the chain: "URDF", or "table".

    Raises `ValueError` for a joint without a column, a column of a joint that the chain has not, and for two columns
    that could be the same thing.
    """
    door = _Door(option, source)
    if _nameless(names) and len(names) != len(joints):
        return _in_order(names, joints)
    by_joint, notes = _joint_columns(names, joints, door)
    taken = set(by_joint.values())
    groups = _measured_groups([name for name in names if name not in taken], door)
    position, rotation, figaroh = _chosen(groups, door)
    taken |= {*position.values(), *rotation.values()}
    rest = [name for name in names if name not in taken]
    other = {**_others(rest), **_of_joints(rest, joints)}
    return Matched(joints=by_joint, position=position, rotation=rotation, other=other, figaroh=figaroh, notes=notes)


def in_base_units(
    columns: Mapping[str, Array], used: Iterable[str], units: Mapping[str, str]
) -> tuple[dict[str, Array], dict[str, str], tuple[Note, ...]]:
    """Return the `used` columns whose names end in a unit in rad or mm, their units, and a note for each unit.

    A column that stands in `units` has stated its own.

    >>> columns, units, [note] = in_base_units({"x_m": np.array([0.5])}, ["x_m"], {})
    >>> columns, units, note.text
    ({'x_m': array([500.])}, {'x_m': 'mm'}, 'x_m: the name says m, turned into mm')
    """
    turned, bases, by_unit = {}, {}, dict[tuple[str, str], list[str]]()
    for name in used:
        unit = unit_of(name)
        if name in units or not unit:
            continue
        bases[name], scale = factor_to_base(name, unit)
        turned[name] = columns[name] if scale == 1 else scale * np.asarray(columns[name], dtype=float)
        if scale != 1:
            by_unit.setdefault((unit, bases[name]), []).append(name)
    notes = []
    for (unit, base), names in by_unit.items():
        whose = "the name says" if len(names) == 1 else "their names say"
        text = f"{', '.join(names)}: {whose} {unit}, turned into {base}"
        notes.append(Note(Code.UNIT, text, tuple(names), values={"unit": unit}))
    return turned, bases, tuple(notes)


@final
@dataclass(frozen=True)
class _Door:
    """How the options that mend a file are called where it was read."""

    option: str
    source: str

    def other(self, of_urdf: str) -> str:
        """Return what else may be done about a joint: `of_urdf` and the option that says where the arm ends."""
        if self.source == "table":
            return "or correct the rows of the table"
        return f"{of_urdf} {self.option}tip="

    def joint(self, joint: str, name: str) -> str:
        """Return how a column is said to be a joint's."""
        return self.column(f"q_{joint}", name)

    def column(self, target: str, name: str) -> str:
        """Return how a column is said to be what is called `target` here."""
        if self.option == "machine.":
            return f"{as_columns({target: name})} names it"
        return f"call its column {target}" if name == "NAME" else f"call the column {name} {target}"


def _nameless(names: Sequence[str]) -> bool:
    """Tell whether a file without a header gave these names."""
    return len(names) > 1 and list(names) == [f"column_{k}" for k in range(1, len(names) + 1)]


def _in_order(names: Sequence[str], joints: Sequence[str]) -> Matched:
    """Return the columns of a file without names: the joints of the arm, the place behind them, and its rotation."""
    count = len(joints)
    sized = {count + len(POSITION) + len(r): r for r in ((), EULER, QUATERNION)}
    if len(names) not in sized:
        raise ValueError(
            f"{len(names)} columns without a header, and {count} joints ({', '.join(joints)}) with x, y and z are "
            f"{count + len(POSITION)}, with a rotation {' or '.join(map(str, [*sized][1:]))}; write a header with "
            f"their names, such as {','.join((*joints, *POSITION))} and a name for each of the others"
        )
    rotation = sized[len(names)]
    taken = ", ".join((*joints, *POSITION, *rotation))
    text = f"no header: {names[0]} to {names[-1]} are taken for {taken}, in this order"
    behind = iter(names[count:])
    place, turned = ({name: next(behind) for name in each} for each in (POSITION, rotation))
    return Matched(
        dict(zip(joints, names, strict=False)), place, turned, {},
        notes=(Note(Code.COLUMNS_MATCHED, text, tuple(names)),),
    )  # fmt: skip


def _joint_columns(names: Sequence[str], joints: Sequence[str], door: _Door) -> tuple[dict[str, str], tuple[Note, ...]]:
    by_joint: dict[str, str] = {}
    for joint in joints:
        if (column := _named(joint, names, door)) is not None:
            by_joint[joint] = column
    if len(by_joint) == len(joints):
        _refuse_strangers(names, joints, set(by_joint.values()), door)
        return by_joint, ()
    if not by_joint:
        numbered = _numbered(names, len(joints))
        if len(numbered) > 1:
            rows_named = " and ".join(f"{row[0]} to {row[-1]}" for row in numbered)
            raise ValueError(f"{rows_named} could be the {len(joints)} joints; {door.joint(joints[0], numbered[0][0])}")
        if numbered:
            row = numbered[0]
            text = f"{row[0]} to {row[-1]} are taken for {', '.join(joints)}, in this order"
            return dict(zip(joints, row, strict=True)), (Note(Code.COLUMNS_MATCHED, text, tuple(row)),)
    lost = [joint for joint in joints if joint not in by_joint]
    strangers = [
        name for name in names if _looks_like_joint(name) and name not in by_joint.values() and not only_asked(name)
    ]
    if strangers:
        raise ValueError(
            f"column {strangers[0]}: the {door.source} has no such joint between base and tip; its joints: "
            f"{', '.join(joints)}; {door.joint(lost[0], strangers[0])}, {door.other('or take another')}"
        )
    if not by_joint and door.option == "machine.":
        raise ValueError(
            f"joint {lost[0]} of the {door.source} has no column, nor has any other among {listed(names, _LISTED)}; "
            f"{door.joint(lost[0], 'NAME')}, and bench calibrate joins joints in a file of their own to what was "
            "measured, data=joints.csv,tracker.csv"
        )
    raise ValueError(
        f"joint {lost[0]} of the {door.source} has no column; {suggest(lost[0], names)}; "
        f"{door.joint(lost[0], 'NAME')}, "
        f"{door.other('or') + ' a link before that joint' if door.source == 'URDF' else _NO_JOINT}"
    )


def _named(joint: str, names: Sequence[str], door: _Door) -> str | None:
    """Return the column of a joint by its name, spelt in any way; None where there is none."""
    for wanted in (joint, f"q_{joint}"):
        if wanted in names:
            return wanted
    alike = [name for name in names if _plain(joint) in (_plain(name), _plain(_bare(name)))]
    if not alike:
        words = _tokens(joint)
        alike = [name for name in names if [t for t in _tokens(_bare(name)) if t not in _SAID] == words]
    if len(alike) > 1:
        raise ValueError(f"{' and '.join(alike)} could both be joint {joint}; {door.joint(joint, alike[0])}")
    return alike[0] if alike else None


def _numbered(names: Sequence[str], count: int) -> list[list[str]]:
    """Return the rows of columns that are numbered 0 or 1 onwards and are as many as the joints: q1 ... q6."""
    rows: dict[str, dict[int, str]] = {}
    for name in names:
        parted = re.fullmatch(r"(.*?)[\s_.\[(]*(\d+)[\])]?", _bare(name))
        if parted and _plain(parted[1]) in _STEMS:
            rows.setdefault(_plain(parted[1]), {})[int(parted[2])] = name
    whole = [[row[k] for k in sorted(row)] for row in rows.values() if sorted(row) in _counted(count)]
    return [row for row in whole if len(row) == count]


def _counted(count: int) -> tuple[list[int], list[int]]:
    return list(range(count)), list(range(1, count + 1))


def _looks_like_joint(name: str) -> bool:
    tokens = _tokens(name)
    return name.startswith("q_") or bool({"joint", "axis"} & set(tokens))


def is_called_joint(name: str, others: Iterable[str]) -> bool:
    """Tell whether a column is called as a joint's reading: by its own words, or as `others` with another number.

    >>> [is_called_joint(name, ["A1", "A2"]) for name in ("A3", "wrist_3_joint", "velocity_joint_1", "B3", "z")]
    [True, True, False, False, False]
    """
    if name.startswith(tuple(f"{quantity}_" for quantity in OF_A_JOINT)):
        return False
    stems = {stem for other in others if (stem := re.sub(r"\d+", "#", _bare(other).lower())) != _bare(other).lower()}
    return _looks_like_joint(name) or re.sub(r"\d+", "#", _bare(name).lower()) in stems


def _refuse_strangers(names: Sequence[str], joints: Sequence[str], taken: set[str], door: _Door) -> None:
    """Refuse a joint of the file that the chain has not: the readings are of a longer arm than was asked for."""
    for name in names:
        if name.startswith("q_") and name not in taken:
            raise ValueError(
                f"column {name}: the {door.source} has no joint {name[2:]} between base and tip; its joints: "
                f"{', '.join(joints)}; {door.other('take another').removeprefix('or ')}, or leave the column out"
            )


def _measured_groups(names: Iterable[str], door: _Door) -> dict[tuple[str, str], dict[str, str]]:
    """Return (what stands before the axis, the number behind it) -> axis -> column."""
    names = list(names)
    groups: dict[tuple[str, str], dict[str, str]] = {("", ""): three} if (three := _numbered_place(names)) else {}
    for name in names:
        tokens = _tokens(_bare(name))
        last = re.fullmatch(r"([a-z]+)(\d*)", tokens[-1]) if tokens else None
        axis = _SPELT.get(last[1]) if last else None
        if last is None or axis is None or only_asked(name):
            continue
        group = groups.setdefault((" ".join(tokens[:-1]), last[2]), {})
        if axis in group:
            raise ValueError(f"{group[axis]} and {name} could both be {axis}; {door.column(axis, name)}")
        group[axis] = name
    return groups


def _numbered_place(names: Sequence[str]) -> dict[str, str]:
    """Return the axes of a position whose three columns are numbered, such as xyz_1, xyz_2, xyz_3; {} without any."""
    for stem in _PLACES:
        numbered = {name: re.fullmatch(rf"{stem}[\s_.\[(]*(\d)[\])]?", _bare(name).lower()) for name in names}
        by_number = {int(parted[1]): name for name, parted in numbered.items() if parted}
        if sorted(by_number) in ([0, 1, 2], [1, 2, 3]):
            return dict(zip(POSITION, (by_number[k] for k in sorted(by_number)), strict=True))
    return {}


def _chosen(
    groups: Mapping[tuple[str, str], Mapping[str, str]], door: _Door
) -> tuple[dict[str, str], dict[str, str], bool]:
    """Return the columns of the position and of the rotation that were measured, of the first marker where several."""
    whole = {key: group for key, group in groups.items() if all(axis in group for axis in POSITION)}
    numbers = {number for _, number in whole}
    if len(whole) > 1 and "1" in numbers:  # FIGAROH's markers
        whole = {key: group for key, group in whole.items() if key[1] in _FIRST_MARKER}
    if ("", "") in whole:  # called by the names of ours
        whole = {("", ""): whole["", ""]}
    if len(whole) > 1:
        names_of_x = " and ".join(group["x"] for group in whole.values())
        first = next(iter(whole.values()))
        raise ValueError(
            f"{names_of_x} could both be the measured x; {door.column('x', first['x'])}, and y and z alike"
        )
    if not whole:
        part = next((g for g in groups.values() if any(axis in g for axis in POSITION)), None)
        if part:
            lost = next(axis for axis in POSITION if axis not in part)
            there = next(part[axis] for axis in POSITION if axis in part)
            raise ValueError(f"{there} is there and no {lost}; a position has x, y and z; {door.column(lost, 'NAME')}")
        return {}, {}, False
    [(key, group)] = whole.items()
    turned: dict[str, str] = {}
    for wanted in (QUATERNION, EULER):
        if all(axis in group for axis in wanted):
            turned = {axis: group[axis] for axis in wanted}
            break
    return {axis: group[axis] for axis in POSITION}, turned, key == ("", "1")


def _others(names: Sequence[str]) -> dict[str, str]:
    """Return what else a file tells of a reading: its time, temperature, load, socket and place, split and validity."""
    known: dict[str, str] = {}
    for name in names:
        tokens = _tokens(name)
        plain = name.strip().lower()
        if plain in ("socket", "place", "split", "valid", "payload_kg", "temperature_c"):
            known.setdefault("temperature_C" if plain == "temperature_c" else plain, name)
        elif plain in _TIMES:
            known.setdefault("t_s", name)
        elif "temperature" in tokens or tokens == ["temp"]:
            known.setdefault("temperature_C", name)
        elif tokens[:1] == ["payload"]:
            known.setdefault("payload_kg", name)
    return known


def _of_joints(names: Sequence[str], joints: Sequence[str]) -> dict[str, str]:
    """Return what else a file tells of a joint, `direction_J`, `velocity_J` or `torque_J` -> column."""
    wanted = {_plain(quantity + joint): f"{quantity}_{joint}" for quantity in OF_A_JOINT for joint in joints}
    by_quantity: dict[str, str] = {}
    for name in names:
        if (ours := wanted.get(_plain(name))) is not None:
            by_quantity.setdefault(ours, name)
    return by_quantity


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def only_asked(name: str) -> bool:
    """Tell whether a column is what was asked for, or how readings scatter: no measurement."""
    return bool(set(_tokens(name)) & _NOT_MEASURED)


def unit_of(name: str) -> str:
    """Return the unit at the end of a column's name: of `x_mm` mm; "" where there is none."""
    parted = _UNIT.fullmatch(name)
    return parted[2].lower() if parted else ""


def _bare(name: str) -> str:
    """Return a name without the unit at its end: of `x_mm` x."""
    parted = _UNIT.fullmatch(name)
    return parted[1] if parted else name


def _tokens(name: str) -> list[str]:
    """Return the words of a name: of `measurement_std_x` measurement, std and x; of `posX` pos and x."""
    parted = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    return re.findall(r"[a-z0-9]+", parted.lower())
