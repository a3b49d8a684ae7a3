"""Which column of a measured file is which: the joints of a chain, what was measured at its end, and the rest.

A file says it in its own words: `q_elbow_joint`, `joint_1`, `measurement_x`, `phix1` (FIGAROH), seven columns without a
name. What was only asked for, and scatter, is no measurement. What fits twice, or not at all, is refused.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np

from calibench.calibration.rigid import Array
from calibench.core.notes import Code, Note
from calibench.core.options import suggest
from calibench.core.tables.cells import factor_to_base
from calibench.core.tables.columns import Declared, Quantity
from calibench.core.words import as_columns, listed

POSITION = ("x", "y", "z")
EULER = ("rx", "ry", "rz")
QUATERNION = ("qx", "qy", "qz", "qw")
OF_A_JOINT = ("direction", "velocity", "torque")  # what a file may tell of each joint, beside its reading
WARMTH, PAYLOAD, SOCKET, SITE, TARGET = "temp_K", "payload_kg", "socket", "place", "target"
DISTANCE, DISTANCE_TO, PLANE = "distance", "distance_to", "plane"
STATED = tuple(f"{DISTANCE_TO}_{axis}" for axis in POSITION)  # where the point is that a distance is from
WAYS = {
    **{axis: ("mm", f"place along {axis}") for axis in POSITION},
    **{f"r{axis}": ("rad", f"turn about {axis}") for axis in POSITION},
}
_BY_BEGIN = {  # before the name of a joint or of a socket: unit and words; what its reading is depends on its role
    **{f"{one}_": (unit, f"{words} of") for one, (unit, words) in WAYS.items()},
    "zero_": ("rad", "zero of"), "length_": ("mm", "length of the link to"), "q_": ("", ""),
    "direction_": ("", "direction of"), "velocity_": ("rad/s", "velocity of"), "torque_": ("N mm", "torque of"),
    "pair": ("mm", "sockets"), "socket": ("mm", "socket"), "distance_": ("mm", "distance from"),
    **{f"tool_{one}_": ("mm", f"place along {one} of target") for one in POSITION},
}  # fmt: skip


def _of_a_joint(name: str) -> Quantity | None:
    """Return what a quantity is whose name ends with that of a joint, or of a socket."""
    for begin, (unit, words) in _BY_BEGIN.items():
        rest = name.removeprefix(begin)
        if rest in ("", name):
            continue
        if begin in ("pair", "socket"):
            return Quantity(name, "rad" if rest.endswith(("_u", "_v")) else unit, f"{words} {rest.replace('_', ', ')}")
        return Quantity(name, unit, f"{words} {rest}" if words else "", rest if begin[:-1] in OF_A_JOINT else "")
    return None


ARM = Declared(  # of the files of an arm, for a calibration and for a search
    machine="arm",
    columns=(
        *(Quantity(name, "mm", f"the tracker's {name}") for name in POSITION),
        *(Quantity(name, "rad", f"measured turn {name}") for name in EULER),
        *(Quantity(name, "1") for name in QUATERNION), Quantity("t_s", "s", "time"),
        Quantity("temperature_C", "K", "temperature"), Quantity(WARMTH, "K", "temperature above its middle"),
        Quantity(PAYLOAD, "kg", "payload"), Quantity(SOCKET, "", "socket", text=True),
        Quantity(SITE, "", "place", text=True), Quantity(TARGET, "", "target", text=True),
        Quantity(DISTANCE, "mm", "distance from a fixed point"), Quantity(DISTANCE_TO, text=True),
        Quantity(PLANE, text=True), Quantity("split", text=True),
    ),
    named=_of_a_joint,
)  # fmt: skip
_SPELT = {
    **{f"{lead}{axis}": axis for axis in POSITION for lead in ("", "p", "t", "pos", "position")},
    **{f"{lead}{axis}": f"r{axis}" for axis in POSITION for lead in ("r", "phi", "rot", "rotation")},
    **{name: name for name in QUATERNION},
    "roll": "rx", "pitch": "ry", "yaw": "rz", "height": "z",
}  # fmt: skip
_NOT_MEASURED = {
    "goal", "target", "command", "commanded", "cmd", "desired", "nominal", "setpoint", "reference", "ref", "std",
    "sigma", "sd", "stdev", "error", "err", "cov", "flange",
}  # fmt: skip
_SAID = {"actual", "measured", "meas", "feedback", "encoder", "position", "pos", "angle", "state", "value", "q"}
_STEMS = {
    "q", "j", "joint", "axis", "achse", "gelenk", "a", "theta", "angle", "joints", "jointangle", "actualq", "column",
}  # fmt: skip
_PLACES = ("xyz", "position", "pos", "place", "point", "p")
_LISTED = 20  # joints or columns that a refusal names
_UNIT = re.compile(r"(.*[a-z0-9])[_ .-](mm|cm|um|m|inch|in|deg|degrees|rad|mrad)", re.IGNORECASE)
TIMES = {"t_s", "t", "time", "timestamp", "stamp", "__time", "%time"}


@final
@dataclass(frozen=True)
class Matched:
    """The columns of a file by what they are.

    `targets` has the places of all targets by name where a row holds several, `position` that of the first of them.
    `distance` has fixed points by name, "" where a column names them.
    """

    joints: Mapping[str, str]
    position: Mapping[str, str]
    rotation: Mapping[str, str]
    other: Mapping[str, str]
    notes: tuple[Note, ...] = ()
    targets: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    distance: Mapping[str, str] = field(default_factory=dict)


_NO_JOINT = "or take its row out, or give it the type fixed"


def match_columns(
    names: Sequence[str], joints: Sequence[str], option: str = "machine.", source: str = "URDF"
) -> Matched:
    """Return which of the columns `names` is which, for `joints` in order; `option` stands before tip= in messages."""
    count, door = len(joints), _Door(option, source)
    if len(names) > 1 and len(names) != count and list(names) == [f"column_{k}" for k in range(1, len(names) + 1)]:
        # of a file without names: the joints of the arm, the place behind them, and its rotation
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
        in_order = dict(zip(joints, names, strict=False))
        return Matched(in_order, place, turned, {}, notes=(Note(Code.COLUMNS_MATCHED, text, tuple(names)),))

    by_joint, notes = _joint_columns(names, joints, door)
    used = set(by_joint.values())
    distance = {of: name for name in names if name not in used and (of := _far_from(name)) is not None}
    used |= {*distance.values(), *(name for name in names if name.lower() in STATED)}
    targets, turns = _measured_columns([name for name in names if name not in used], door)
    unnamed = [name for name in names if name not in used and re.fullmatch(r"column_\d+", name)]
    if not targets and len(unnamed) in (3, 6, 7):  # of a file without a header beside one of joints
        targets = {"1": dict(zip(POSITION, unnamed, strict=False))}
        turns = dict(zip(EULER if len(unnamed) == 6 else QUATERNION, unnamed[3:], strict=False))
        taken = ", ".join((*POSITION, *turns))
        text = f"no header: {unnamed[0]} to {unnamed[-1]} are taken for {taken}, in this order"
        notes = (*notes, Note(Code.COLUMNS_MATCHED, text, tuple(unnamed)))
    position = next(iter(targets.values()), {})
    used |= {*turns.values()}.union(*(target.values() for target in targets.values()))
    other = {name.lower(): name for name in names if name.lower() in STATED}
    rest = [name for name in names if name not in used]
    for name in rest:
        tokens, plain = _tokens(name), name.strip().lower()
        if plain in (SOCKET, SITE, TARGET, DISTANCE_TO, PLANE, "split", "valid", PAYLOAD, "temperature_c"):
            other.setdefault("temperature_C" if plain == "temperature_c" else plain, name)
        elif plain in TIMES:
            other.setdefault("t_s", name)
        elif "temperature" in tokens or tokens == ["temp"]:
            other.setdefault("temperature_C", name)
        elif tokens[:1] == ["payload"]:
            other.setdefault("payload_kg", name)
    wanted = {_plain(quantity + joint): f"{quantity}_{joint}" for quantity in OF_A_JOINT for joint in joints}
    for name in rest:
        if (ours := wanted.get(_plain(name))) is not None:
            other.setdefault(ours, name)
    return Matched(
        joints=by_joint, position=position, rotation=turns, other=other, notes=notes,
        targets=targets if len(targets) > 1 else {}, distance=distance,
    )  # fmt: skip


def measured_axes(names: Sequence[str]) -> bool:
    """Tell whether `names` have a place of a target, or an axis of it, a distance or a plane."""
    if any(name.lower() == PLANE or _far_from(name) is not None for name in names):
        return True
    try:
        return bool(_measured_columns(names, _Door("machine.", "URDF"))[0])
    except ValueError:  # several
        return True


def by_their_names(
    columns: Mapping[str, Array], used: Iterable[str], units: Mapping[str, str]
) -> tuple[dict[str, Array], dict[str, str], tuple[Note, ...]]:
    """Return the `used` columns whose names end in a unit in rad or mm, their units, and a note for each unit.

    A column that stands in `units` has stated its own.

    >>> columns, units, [note] = by_their_names({"x_m": np.array([0.5])}, ["x_m"], {})
    >>> columns, units, note.text
    ({'x_m': array([500.])}, {'x_m': 'mm'}, 'x_m: the name says m, turned into mm')
    """
    turned, bases, by_unit = {}, {}, dict[tuple[str, str], list[str]]()
    for name in used:
        parted = _UNIT.fullmatch(name)
        if name in units or parted is None:
            continue
        unit = parted[2].lower()
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
        return "or correct the rows of the table" if self.source == "table" else f"{of_urdf} {self.option}tip="

    def column(self, target: str, name: str) -> str:
        """Return how a column is said to be what is called `target` here."""
        if self.option == "machine.":
            return f"{as_columns({target: name})} names it"
        return f"call its column {target}" if name == "NAME" else f"call the column {name} {target}"


def _joint_columns(names: Sequence[str], joints: Sequence[str], door: _Door) -> tuple[dict[str, str], tuple[Note, ...]]:
    by_joint = {joint: column for joint in joints if (column := _named(joint, names, door)) is not None}
    if len(by_joint) == len(joints):
        for name in names:  # readings of a longer arm than was asked for
            if name.startswith("q_") and name not in by_joint.values():
                raise ValueError(
                    f"column {name}: the {door.source} has no joint {name[2:]} between base and tip; its joints: "
                    f"{', '.join(joints)}; {door.other('take another').removeprefix('or ')}, or leave the column out"
                )
        return by_joint, ()
    if not by_joint:  # q1 ... q6: numbered 0 or 1 onwards, and as many as the joints
        rows: dict[str, dict[int, str]] = {}
        for name in names:
            parted = re.fullmatch(r"(.*?)[\s_.\[(]*(\d+)[\])]?", _bare(name))
            if parted and _plain(parted[1]) in _STEMS:
                rows.setdefault(_plain(parted[1]), {})[int(parted[2])] = name
        counted = ([*range(len(joints))], [*range(1, len(joints) + 1)])
        numbered = [[row[k] for k in sorted(row)] for row in rows.values() if sorted(row) in counted]
        if len(numbered) > 1:
            rows_named = " and ".join(f"{row[0]} to {row[-1]}" for row in numbered)
            how = door.column(f"q_{joints[0]}", numbered[0][0])
            raise ValueError(f"{rows_named} could be the {len(joints)} joints; {how}")
        if numbered:
            row = numbered[0]
            text = f"{row[0]} to {row[-1]} are taken for {', '.join(joints)}, in this order"
            return dict(zip(joints, row, strict=True)), (Note(Code.COLUMNS_MATCHED, text, tuple(row)),)
    lost = [joint for joint in joints if joint not in by_joint]
    called = [name for name in names if name.startswith("q_") or {"joint", "axis"} & set(_tokens(name))]
    strangers = [name for name in called if name not in by_joint.values() and not only_asked(name)]
    if strangers:
        raise ValueError(
            f"column {strangers[0]}: the {door.source} has no such joint between base and tip; its joints: "
            f"{', '.join(joints)}; {door.column(f'q_{lost[0]}', strangers[0])}, {door.other('or take another')}"
        )
    if not by_joint and door.option == "machine.":
        raise ValueError(
            f"joint {lost[0]} of the {door.source} has no column, nor has any other among {listed(names, _LISTED)}; "
            f"{door.column(f'q_{lost[0]}', 'NAME')}, and bench calibrate joins joints in a file of their own to what "
            "was measured, data=joints.csv,tracker.csv"
        )
    raise ValueError(
        f"joint {lost[0]} of the {door.source} has no column; {suggest(lost[0], names)}; "
        f"{door.column(f'q_{lost[0]}', 'NAME')}, "
        f"{door.other('or') + ' a link before that joint' if door.source == 'URDF' else _NO_JOINT}"
    )


def _named(joint: str, names: Sequence[str], door: _Door) -> str | None:
    """Return the column of a joint by its name, spelt in any way; None where there is none."""
    for wanted in (joint, f"q_{joint}"):
        if wanted in names:
            return wanted
    alike = [name for name in names if _plain(joint) in (_plain(name), _plain(_bare(name)))]
    if not alike:  # a path, as PlotJuggler writes topics of ROS: /joint_states/elbow_joint/position
        paths = ((name, name.split("/")) for name in names if name.startswith("/"))
        alike = [name for name, parts in paths if joint in parts and parts[-1] in (joint, "position")]
    if not alike:
        words = _tokens(joint)
        alike = [name for name in names if [t for t in _tokens(_bare(name)) if t not in _SAID] == words]
    if len(alike) > 1:
        raise ValueError(f"{' and '.join(alike)} could both be joint {joint}; {door.column(f'q_{joint}', alike[0])}")
    return alike[0] if alike else None


def is_called_joint(name: str, others: Iterable[str]) -> bool:
    """Tell whether a column is called as a joint's reading: by its own words, or as `others` with another number.

    >>> [is_called_joint(name, ["A1", "A2"]) for name in ("A3", "wrist_3_joint", "velocity_joint_1", "B3", "z")]
    [True, True, False, False, False]
    """
    if name.startswith(tuple(f"{quantity}_" for quantity in OF_A_JOINT)):
        return False
    stems = {stem for other in others if (stem := re.sub(r"\d+", "#", _bare(other).lower())) != _bare(other).lower()}
    by_words = name.startswith("q_") or bool({"joint", "axis"} & set(_tokens(name)))
    return by_words or re.sub(r"\d+", "#", _bare(name).lower()) in stems


def _measured_columns(names: Sequence[str], door: _Door) -> tuple[dict[str, dict[str, str]], dict[str, str]]:
    """Return the columns of each target's place by its name, and of the first one's rotation."""
    groups: dict[tuple[str, str], dict[str, str]] = {}  # (before the axis, the number behind it) -> axis -> column
    for stem in _PLACES:  # numbered axes, such as xyz_1, xyz_2, xyz_3
        numbered = {name: re.fullmatch(rf"{stem}[\s_.\[(]*(\d)[\])]?", _bare(name).lower()) for name in names}
        by_number = {int(parted[1]): name for name, parted in numbered.items() if parted}
        if sorted(by_number) in ([0, 1, 2], [1, 2, 3]):
            groups["", ""] = dict(zip(POSITION, (by_number[k] for k in sorted(by_number)), strict=True))
            break
    for name in names:
        tokens = _tokens(_bare(name))
        if "orientation" in tokens:  # of ROS, whose x is that of a quaternion
            tokens = [*("position" if one == "orientation" else one for one in tokens[:-1]), f"q{tokens[-1]}"]
        if len(tokens) > 1 and tokens[-1].isdigit():  # x_1 as x1
            tokens[-2:] = ["".join(tokens[-2:])]
        last = re.fullmatch(r"([a-z]+)(\d*)", tokens[-1]) if tokens else None
        axis = _SPELT.get(last[1]) if last else None
        if last is None or axis is None or only_asked(name):
            continue
        group = groups.setdefault((" ".join(tokens[:-1]), last[2]), {})
        if axis in group:
            raise ValueError(f"{group[axis]} and {name} could both be {axis}; {door.column(axis, name)}")
        group[axis] = name

    whole = {key: group for key, group in groups.items() if all(axis in group for axis in POSITION)}
    fixed = {key: group for key, group in whole.items() if re.search(r"\bbase", key[0])}
    whole = {key: group for key, group in whole.items() if key not in fixed} or whole
    if ("", "") in whole:  # called by the names of ours
        whole = {("", ""): whole["", ""]}
    # targets of one rig are called alike but for a number: ("smr #", "") of smr 1 and smr 2
    alike = [(re.sub(r"\d+", "#", before), "#" if number else "") for before, number in whole]
    if len(whole) > 1 and (len({*alike}) > 1 or alike[0] in whole):
        of_x = [group["x"] for group in whole.values()]
        how = f"{door.column('x', of_x[0])}, and y and z alike"
        raise ValueError(f"{' and '.join(of_x)} could both be the measured x; {how}")
    if not whole:
        some = [{axis: g[axis] for axis in POSITION if axis in g} for g in groups.values()]
        some = [part for part in some if part]
        if len(some) > 1:
            listed_ = " and ".join(next(iter(part.values())) for part in some)
            raise ValueError(
                f"{listed_} are of places that are not whole; {door.column('x', 'NAME')}, and y and z alike"
            )
        return ({"1": some[0]} if some else {}), {}
    group = next(iter(whole.values()))
    wanted = next((names for names in (QUATERNION, EULER) if all(axis in group for axis in names)), ())
    targets = {
        " ".join(filter(None, key)) or "1": {axis: group[axis] for axis in POSITION}
        for key, group in {**whole, **fixed}.items()
    }
    return targets, {axis: group[axis] for axis in wanted}


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _far_from(name: str) -> str | None:
    """Return the point that a distance is from: of `distance_A` A, of `Distance` none, ""; None for other columns."""
    parted = re.fullmatch(rf"{DISTANCE}(?:[\s_.-]+(?!to\b|to_)(.+))?", _bare(name).strip(), re.IGNORECASE)
    return (parted[1] or "") if parted and not only_asked(name) else None


def only_asked(name: str) -> bool:
    """Tell whether a column is what was asked for, or how readings scatter: no measurement."""
    return bool(set(_tokens(name)) & _NOT_MEASURED)


def _bare(name: str) -> str:
    """Return a name without the unit at its end: of `x_mm` x."""
    return parted[1] if (parted := _UNIT.fullmatch(name)) else name


def _tokens(name: str) -> list[str]:
    """Return the words of a name: of `measurement_std_x` measurement, std and x; of `posX` pos and x."""
    return re.findall(r"[a-z0-9]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower())
