"""Tables of Denavit and Hartenberg's rows, Craig's modified ones, Hayati's where axes are parallel, and their arms.

    standard   Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)    the joint turns about z before the row
    modified   Rx(alpha) Ry(beta) Tx(a) Rz(theta) Tz(d)    the joint turns about z behind alpha and a
    arm        mount base (rows with their errors, joint J by motion(gain_J q_J)) tail tool

Lengths are mm, angles rad. theta of a row that turns, and d of one that slides, is the joint's zero. Two parallel axes
have their common normal anywhere, so beta is offered there and nowhere else (Hayati and Mirmirani 1985). All errors are
0 for the arm of the table, and 1 for a gain. Units stand in the headings of a file or sizes tell them; the convention
must be stated. (Denavit and Hartenberg 1955; Craig 1986.)
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import ceil, floor, inf, isfinite, pi
from pathlib import Path
from typing import Literal, final
from xml.sax.saxutils import quoteattr

import numpy as np

from calibench.calibration import kinematics
from calibench.calibration.rigid import Array, Index, cross, inverse, rpy, rpy_of, slide, turn
from calibench.core.options import suggest
from calibench.core.tables.cells import between, factor_to_base, is_unit
from calibench.core.tables.csv_table import Table, read_excel, read_table

Form = Literal["standard", "modified"]
RowKind = Literal["rotary", "sliding", "fixed"]
FORMS: tuple[Form, ...] = ("standard", "modified")
_X, _Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
NUMBERS = ("theta", "d", "a", "alpha", "beta")
BASE, TIP = "base", "flange"


@final
@dataclass(frozen=True)
class DhRow:
    """One row: its joint's name, its numbers [mm, rad] and the joint's limits (infinite where there is no stop)."""

    name: str
    kind: RowKind = "rotary"
    theta: float = 0.0
    d: float = 0.0
    a: float = 0.0
    alpha: float = 0.0
    beta: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf


@final
@dataclass(frozen=True, eq=False)
class DhTable:
    """Rows from base to flange, in the `form` "standard" or "modified" (Craig's).

    `length` and `angle` are the units in which its file has its numbers; `notes` say what was found and not stated.
    """

    rows: tuple[DhRow, ...]
    form: Form = "standard"
    name: str = "arm"
    length: str = "mm"
    angle: str = "rad"
    notes: tuple[str, ...] = ()

    @cached_property
    def chain(self) -> kinematics.Chain:
        """Return the chain from `base` to `flange`. Raises `ChainError` where no row moves, or two have one name."""
        theta, d, a, alpha, beta = np.array([[getattr(row, one) for one in NUMBERS] for row in self.rows]).T
        none, along_x, along_z = np.zeros(len(self.rows)), slide(_X, a), slide(_Z, d)  # of all rows
        turned, twisted, leant = rpy(none, none, theta) @ along_z, rpy(alpha, none, none), rpy(none, beta, none)
        if self.form == "modified":
            before, behind = twisted @ leant @ along_x, np.broadcast_to(np.eye(4), turned.shape)
        else:
            before, behind = None, along_x @ twisted @ leant  # the first two commute, as do those about and along z
        joints, held = [], np.eye(4)
        for k, row in enumerate(self.rows):
            origin = (held if before is None else held @ before[k]) @ turned[k]
            if row.kind == "fixed":
                held = origin @ behind[k]
                continue
            held = behind[k]
            joints.append(kinematics.ChainJoint(
                name=row.name, kind=row.kind, origin=origin, axis=_Z, lower=row.lower, upper=row.upper
            ))  # fmt: skip
        return kinematics.Chain(tuple(joints), np.asarray(held), self.name, BASE, TIP, source="table")


_PARALLEL = 0.05  # sine of the angle of two axes, below which their common normal is anywhere
_AXIS = {"theta": 2, "d": 2, "a": 0, "alpha": 0, "beta": 1}  # which of x, y, z a number turns about, or shifts along
_SHIFTS = ("d", "a")
_STEPS = {  # of a row, before its joint moves and behind it
    "standard": (("theta", "d"), ("a", "alpha", "beta")),
    "modified": (("alpha", "beta", "a", "theta", "d"), ()),
}


@final
@dataclass(frozen=True, eq=False)
class DhArm:
    """A table, and where base and target are taken to be before any fit: `mount` and `tool`, (4, 4) [mm]."""

    table: DhTable
    mount: Array
    tool: Array

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the names of all parameters, in the order of the vector: base, each joint's row, tool."""
        # a beta stands between two parallel axes
        rows, leaning = self.table.rows, set()
        moving = [k for k, row in enumerate(rows) if row.kind != "fixed"]
        for k, (one, other) in enumerate(pairwise(moving), start=1):
            cosine = self.table.chain.joints[k].origin[2, 2]  # both axes are z
            if other == one + 1 and 1 - cosine**2 < _PARALLEL**2:
                leaning.add(rows[one if self.table.form == "standard" else other].name)
        names = [f"base_{one}" for one in kinematics.PLACEMENT]
        for row in rows:
            if row.kind != "fixed":
                numbers = [number for number in NUMBERS if number != "beta" or row.name in leaning]
                names += [f"{number}_{row.name}" for number in (*numbers, "gain")]
        return (*names, *(f"tool_{one}" for one in kinematics.PLACEMENT))

    def corrected(self, p: Array) -> DhTable:
        """Return the table with the errors of `p`, in the order of `names`, added to its numbers.

        What a model has beside the table's numbers stands in `p` before the last six, those of the tool.
        """
        by = dict(zip(self.names[:-6], p.tolist(), strict=False))
        rows = []
        for row in self.table.rows:
            more = {one: getattr(row, one) + by.get(f"{one}_{row.name}", 0.0) for one in NUMBERS}
            rows.append(row if row.kind == "fixed" else replace(row, **more))
        return replace(self.table, rows=tuple(rows))

    def forward(self, p: Array, q: Array) -> Array:
        """Return where the target is and how it is turned, (n, 4, 4) [mm], at the readings q, (n, joints)."""
        chain, values = self._chain(p)
        return kinematics.forward(chain, values, q)

    def jacobian(self, p: Array, q: Array, free: Index | None = None, turns: bool = True) -> Array:
        """Return the derivative of the target's pose in the parameters `free`, as `kinematics.jacobian` has it."""
        chain, values = self._chain(p)
        # the derivative of the chain's parameters in those of the table: no posture changes it
        place = {name: k for k, name in enumerate(self.names)}
        ways = np.zeros((len(values), len(self.names)))
        ways[range(6), range(6)] = ways[range(-6, 0), range(-6, 0)] = 1.0
        for k, joint in enumerate(chain.joints):
            ways[13 + 8 * k, place[f"gain_{joint.name}"]] = 1.0

        # the steps (number, row, (4, 4)) before each joint, and those behind the last
        table = self.corrected(p)
        columns = {one: np.array([getattr(row, one) for row in table.rows]) for one in NUMBERS}
        made = {one: (slide if one in _SHIFTS else turn)(np.eye(3)[_AXIS[one]], columns[one]) for one in NUMBERS}
        before, behind = _STEPS[table.form]
        segments: list[list[tuple[str, str, Array]]] = [[]]
        for k, row in enumerate(table.rows):
            segments[-1] += [(one, row.name, made[one][k]) for one in before]
            if row.kind != "fixed":
                segments.append([])
            segments[-1] += [(one, row.name, made[one][k]) for one in behind]
        ends = [*(joint.origin for joint in chain.joints), chain.tail @ chain.tool]
        firsts = [*range(6, len(values) - 6, 8), len(values) - 6]
        for end, first, steps in zip(ends, firsts, segments, strict=True):
            at, six = inverse(end), values[first : first + 6]  # from the placement that stands behind the steps
            about = np.column_stack([rpy(0.0, six[4], six[5])[:3, 0], rpy(0.0, 0.0, six[5])[:3, 1], _Z])
            for number, name, step in steps:
                if f"{number}_{name}" in place:
                    along, column = at[:3, _AXIS[number]], ways[first : first + 6, place[f"{number}_{name}"]]
                    if number in _SHIFTS:
                        column[:3] = along
                    else:
                        column[:3] = cross(along, six[:3] - at[:3, 3])
                        column[3:] = np.linalg.solve(about, along)
                at = at @ step
        return np.asarray(
            kinematics.jacobian(chain, values, q, turns=turns) @ (ways if free is None else ways[:, free])
        )

    def _chain(self, p: Array) -> tuple[kinematics.Chain, Array]:
        """Return the chain of the corrected table, and the vector of what remains: base, tool, gains."""
        chain = self.corrected(p).chain.placed(self.mount, self.tool)
        values = kinematics.nominal(chain)
        values[:6], values[-6:] = p[:6], p[-6:]
        values[13:-6:8] = [value for name, value in zip(self.names, p, strict=True) if name.startswith("gain_")]
        return chain, values


CONVENTIONS: dict[str, Form] = {
    **{form: form for form in FORMS},
    "classic": "standard", "classical": "standard", "distal": "standard", "craig": "modified", "proximal": "modified",
    "khalil": "modified", "mdh": "modified",
}  # fmt: skip
_SPELT = {
    **dict.fromkeys(("a", "r", "linklength"), "a"), **dict.fromkeys(("alpha", "twist", "linktwist"), "alpha"),
    **dict.fromkeys(("d", "linkoffset"), "d"), **dict.fromkeys(("theta", "thetaoffset", "jointangle", "q"), "theta"),
    **dict.fromkeys(("offset", "jointoffset", "zero", "q0"), "offset"), "beta": "beta",
    **dict.fromkeys(("lower", "min", "qmin", "lowerlimit", "limitlower", "minimum"), "lower"),
    **dict.fromkeys(("upper", "max", "qmax", "upperlimit", "limitupper", "maximum"), "upper"),
    **dict.fromkeys(("joint", "name", "jointname", "i", "link", "axis", "no", "nr", "number", ""), "joint"),
    **dict.fromkeys(("gelenk", "achse", "articulation", "axe", "articulación", "eje", "giunto", "asse"), "joint"),
    **dict.fromkeys(("type", "kind", "jointtype", "sigma", "typ", "art", "tipo"), "type"),
}  # fmt: skip
_KINDS: dict[str, RowKind] = {
    **dict.fromkeys(("drehgelenk", "dreh", "drehend", "rotatorisch", "rotoide", "rotativa"), "rotary"),
    **dict.fromkeys(("schubgelenk", "schub", "schiebend", "translatorisch", "linearachse"), "sliding"),
    **dict.fromkeys(("prismatique", "prismática", "prismatica", "prismatisch"), "sliding"),
    **dict.fromkeys(("fest", "starr", "flansch", "werkzeug", "fixe", "fijo", "fisso"), "fixed"),
    **dict.fromkeys(("revolute", "rotary", "rotational", "rotation", "continuous", "r", "0"), "rotary"),
    **dict.fromkeys(("prismatic", "sliding", "linear", "translational", "p", "1"), "sliding"),
    **dict.fromkeys(("fixed", "none", "f", "-", "flange", "tool"), "fixed"),
}
_GREEK = str.maketrans({"α": "alpha", "θ": "theta", "ϑ": "theta", "β": "beta", "\\": "", "−": "-", "–": "-", "π": "pi"})
_MARKS = re.compile(r"[\s_.(){}]")
_BEFORE = re.compile(r"[ijkn]\s*-\s*1")
_INDEX = re.compile(r"(?:_|\b|(?<=[a-z]))[_ ({]*(?:([ijkn]\s*-\s*1)|[ijkn])[ )}]*$")
_PI = re.compile(r"([+-]?)\s*(\d*\.?\d*)\s*\*?\s*pi\s*(?:/\s*(\d+\.?\d*))?")
_OWN = re.compile(r"(?:q|theta|th|d|t)_?\{?\s*(?:\d+|[ijkn])?\s*\}?\*?")
_ANGLES, _LENGTHS = ("theta", "alpha", "beta"), ("a", "d")
_LONG, _SHORT = 20.0, 10.0  # m and mm: no arm is longer, or shorter
_TURN = 2 * pi + 0.01
_QUARTER = 2e-3  # rad: angles of a table that are multiples of a quarter turn are rounded by less


class DhError(kinematics.ChainError):
    """A table that cannot be used; the message is one line that says what to do."""


class ConventionError(DhError):
    """A table whose convention nobody states: the same numbers are two arms."""


def form_of(convention: str, option: str = "") -> Form | None:
    """Return the form that a user's word means, None for no word. Raises `DhError` for another word."""
    if not convention:
        return None
    if (form := CONVENTIONS.get(convention.strip().lower())) is None:
        raise DhError(f"{option}convention={convention}: {suggest(convention, FORMS)} (modified is Craig's)")
    return form


def read_dh(path: str | Path, convention: str = "", option: str = "") -> DhTable:
    """Return the table in a CSV or Excel file. `convention` goes before what the file says."""
    path = Path(path).expanduser()
    try:
        excel = path.suffix.lower() in (".xlsx", ".xlsm")
        table, notes = read_excel(path) if excel else (read_table(path), ())
        return _read(table, path.stem, form_of(convention, option), option, notes)
    except OSError as error:
        raise DhError(f"dh={path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        kind = ConventionError if isinstance(error, ConventionError) else DhError
        raise kind(f"{path.name}: {error}") from None


def text_of_dh(table: DhTable, comment: str = "", errors: Mapping[str, float] | None = None) -> str:
    """Return the table as CSV that `read_dh` reads, in its units, with standard `errors` in columns ``sd_``."""
    errors = errors or {}
    units = {one: table.length if one in _LENGTHS else table.angle for one in NUMBERS}
    sizes = {one: between(one, "mm" if one in _LENGTHS else "rad", units[one]) for one in NUMBERS}
    leaning = any(row.beta for row in table.rows) or any(name.startswith("beta_") for name in errors)
    shown = [one for one in NUMBERS if one != "beta" or leaning]
    tilt, screw = f"Rx(alpha){' Ry(beta)' if leaning else ''}", "Rz(theta) Tz(d)"
    product = f"{tilt} Tx(a) {screw}" if table.form == "modified" else f"{screw} Tx(a) {tilt}"
    lines = [f"# {comment}"] if comment else []
    lines += [f"# convention: {table.form}", f"# each row: {product}"]
    heads = ["joint", "type", *(f"{one} [{units[one]}]" for one in shown), "lower", "upper"]
    lines.append(",".join([*heads, *(f"sd_{one} [{units[one]}]" for one in shown if errors)]))
    for row in table.rows:
        sides = (row.lower, row.upper) if row.kind != "fixed" else (inf, inf)
        like = "d" if row.kind == "sliding" else "theta"
        known = [(one, errors.get(f"{one}_{row.name}")) for one in shown if errors]
        cells = [
            row.name,
            {"rotary": "revolute", "sliding": "prismatic", "fixed": "fixed"}[row.kind],
            *(f"{getattr(row, one) * sizes[one] + 0.0:.10g}" for one in shown),  # as in the file that it came from
            *(f"{side * sizes[like] + 0.0:.10g}" if isfinite(side) else "" for side in sides),
            *("" if error is None else f"{error * sizes[one]:.3g}" for one, error in known),
        ]
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


def _read(table: Table, name: str, form: Form | None, option: str, notes: Sequence[str]) -> DhTable:
    at, units, by_heads = _columns(table)
    stated = re.search(r"convention\s*[:=]\s*([A-Za-z]+)", table.comment)
    form = form or (form_of(stated[1]) if stated else None) or by_heads
    lost = [one for one in ("a", "alpha", "d") if one not in at]
    if lost:
        there = ", ".join(name for name in table.names if name) or "no heading"
        raise ValueError(
            f"no column {' and no column '.join(lost)} among {there}; a table has a, alpha, d and theta (its constant "
            "part), a row a joint, with units such as a [mm] and alpha [deg]"
        )
    for head, unit in units.items():
        wanted = "mm" if head in _LENGTHS else "rad" if head in _ANGLES else None
        if head in (*NUMBERS, "offset", "lower", "upper"):
            factor_to_base(table.names[at[head]], unit, wanted)
    cells = [_Cells(row, at, units, k, line, table.delimiter != ",") for k, (line, row) in enumerate(table.rows, 1)]
    cells = [one for one in cells if any(one.text(number) for number in (*NUMBERS, "offset"))]
    if not cells:
        raise ValueError("holds a header and no rows; a row for each joint is needed")
    names: list[str] = []
    for k, one in enumerate(cells):
        text = one.text("joint")
        names.append(f"joint_{int(float(text))}" if re.fullmatch(r"\d+(\.0)?", text) else text)
        names[k] = names[k] or f"joint_{one.number_}"
        if (first := names.index(names[k])) < k:
            both = f"rows {first + 1} and {k + 1} are both named {names[k]!r}"
            raise ValueError(f"{both}; give each a name of its own, or take one out")
    kinds = [one.kind() for one in cells]
    values = {n: [one.number(n, kind) for one, kind in zip(cells, kinds, strict=True)] for n in (*NUMBERS, "offset")}
    angle, noted = _angles(values, at, units, kinds)
    length, noted_too = _lengths(values, units, kinds)
    scale = {"rad": 1.0, "mm": 1.0, "deg": pi / 180, angle: factor_to_base("theta", angle, "rad")[1]}
    scale |= {length: factor_to_base("a", length, "mm")[1]}
    rows = []
    for k, (one, kind) in enumerate(zip(cells, kinds, strict=True)):
        numbers = {
            n: values[n][k].value * scale[values[n][k].unit or (length if n in _LENGTHS else angle)] for n in NUMBERS
        }
        zero, moving = values["offset"][k], "d" if kind == "sliding" else "theta"
        numbers[moving] += zero.value * scale[zero.unit or (length if kind == "sliding" else angle)]
        lower, upper = (one.limit(side, kind, length if kind == "sliding" else angle) for side in ("lower", "upper"))
        if lower > upper:
            raise ValueError(f"row {k + 1} has lower above upper; exchange them")
        rows.append(DhRow(names[k], kind, lower=lower, upper=upper, **numbers))
    if form is None:
        raise ConventionError(
            f"the convention is not stated, and the same numbers are two arms: {option}convention=standard (a and "
            f"alpha lead from a joint to the next one) or {option}convention=modified (Craig: they lead to the row's "
            "own joint)"
        )
    made = DhTable(
        rows=tuple(rows), form=form, name=name, length=length, angle=angle,
        notes=(*notes, *table.notes, *noted, *noted_too),
    )  # fmt: skip
    _ = made.chain  # that joints move
    return made


def _columns(table: Table) -> tuple[dict[str, int], dict[str, str], Form | None]:
    """Return place and unit of each column by its name of ours, and what the headings say of the convention."""
    at: dict[str, int] = {}
    units: dict[str, str] = {}
    before = behind = False
    for k, head in enumerate(table.names):
        unit = table.units.get(head, "").translate(_GREEK)
        plain = head.strip().lower().translate(_GREEK)
        if unit and re.fullmatch(r"[ijkn](\s*-\s*1)?", unit):  # a(i-1) is no unit
            plain, unit = f"{plain}_{unit}", ""
        index = None if _MARKS.sub("", plain) in _SPELT else _INDEX.search(plain)
        ours = _SPELT.get(_MARKS.sub("", plain if index is None else plain[: index.start()]))
        if ours is None:
            continue
        if ours in at:
            raise ValueError(f"columns {table.names[at[ours]]} and {head} are both {ours}; leave one out")
        at[ours] = k
        if unit:
            units[ours] = unit
        if ours in ("a", "alpha") and index is not None:
            before, behind = before or bool(_BEFORE.search(index[0])), behind or not _BEFORE.search(index[0])
    return at, units, None if before == behind else "modified" if before else "standard"


@final
@dataclass(frozen=True)
class _Value:
    """A number of a cell, in `unit`; "" where the cell does not say it. `own` marks the joint's variable beside it."""

    value: float
    unit: str = ""
    own: bool = False


@final
@dataclass(frozen=True)
class _Cells:
    """One row of the file: its cells, and row and line for messages."""

    row: tuple[str, ...]
    at: Mapping[str, int]
    units: Mapping[str, str]
    number_: int
    line: int
    comma: bool

    def text(self, name: str) -> str:
        at = self.at.get(name, len(self.row))
        return self.row[at].strip().translate(_GREEK) if at < len(self.row) else ""

    def kind(self) -> RowKind:
        """Return the kind of joint; where no cell says it, the one whose variable stands in the row, or rotary."""
        text = self.text("type").lower()
        if text:
            text = text.removesuffix(".0")
            if text not in _KINDS:
                known = ("revolute", "prismatic", "fixed")
                raise ValueError(f"row {self.number_}: type {text!r}; {suggest(text, known)}")
            return _KINDS[text]
        return "sliding" if self.number("d").own and not self.number("theta").own else "rotary"

    def number(self, name: str, kind: RowKind | None = None) -> _Value:
        """Return the number of a cell; the joint's own variable stands for 0 where it moves."""
        text = self.text(name).lower()
        unit = self.units.get(name, "")
        if not text:
            return _Value(0.0, unit)
        rest, variable = text, False
        if name in ("theta", "d"):
            if match := re.match(rf"{_OWN.pattern}\s*(?=$|[+-])", text):
                rest, variable = text[match.end() :].strip() or "0", True
            elif match := re.search(rf"\+\s*{_OWN.pattern}$", text):
                rest, variable = text[: match.start()].strip(), True
        moves = {"theta": "rotary", "d": "sliding"}.get(name)
        if variable and kind is not None and kind != moves:
            raise ValueError(f"row {self.number_}: {name} is {text}, and the joint is {kind}; correct its type")
        value = _parsed(re.sub(r"^([+-])\s+", r"\1", rest), self.comma)
        if value is None:
            raise ValueError(
                f"row {self.number_} (line {self.line}): {name} is {text!r}; a number such as 0.5, pi/2 or 90°"
            )
        return _Value(value.value, value.unit or unit, variable)

    def limit(self, side: str, kind: RowKind, unit: str) -> float:
        """Return a limit of the joint [mm, rad]; infinite where none is stated."""
        text = self.text(side).lower()
        if kind == "fixed" or not text:
            return -inf if side == "lower" else inf
        value = _parsed(text, self.comma)
        if value is None:
            raise ValueError(
                f"row {self.number_} (line {self.line}): {side} is {text!r}; a number, or nothing, is needed"
            )
        base, stated = "mm" if kind == "sliding" else "rad", value.unit or self.units.get(side, "")
        if stated and factor_to_base(side, stated)[0] != base:  # one heading for joints that turn and that slide
            stated = ""
        number = value.value * factor_to_base(side, stated or unit, base)[1]
        if base == "rad" and isfinite(number) and abs(number) > 8 * pi:
            raise ValueError(
                f"row {self.number_}: {side} is {number:.0f} rad; it looks like degrees: write {side} [deg]"
            )
        return number


def _parsed(text: str, comma: bool) -> _Value | None:
    """Return the number in a cell, with the unit that it says itself; None for no number."""
    if match := _PI.fullmatch(text):
        size = float(match[2] or 1) * pi / float(match[3] or 1)
        return _Value(-size if match[1] == "-" else size, "rad")
    unit = ""
    if match := re.fullmatch(r"(.*\d)\s*(°|deg|rad|mm|m)", text):
        text, unit = match[1].strip(), "deg" if match[2] == "°" else match[2]
    try:
        value = float(text.replace(",", ".") if comma else text)
    except ValueError:
        return None
    return _Value(value, unit) if isfinite(value) else None


def _open(
    values: Mapping[str, list[_Value]], names: Sequence[str], kinds: Sequence[RowKind], slide: bool
) -> list[float]:
    """Return the numbers of some columns whose unit nobody states; `slide`: and offsets of joints that slide."""
    offsets = [v for v, kind in zip(values["offset"], kinds, strict=True) if (kind == "sliding") == slide]
    every = [*(v for name in names for v in values[name]), *offsets]
    return [v.value for v in every if not v.unit and v.value]


def _angles(
    values: Mapping[str, list[_Value]], at: Mapping[str, int], units: Mapping[str, str], kinds: Sequence[RowKind]
) -> tuple[str, list[str]]:
    """Return the unit of angles, and a note where sizes tell it. Raises `ValueError` for what cannot be meant."""
    for name in _ANGLES:
        unit = units.get(name, "")
        sizes = [abs(v.value) for v in values[name] if v.unit == unit and v.value]
        if unit and factor_to_base(name, unit, "rad")[1] == 1.0 and max(sizes, default=0.0) > _TURN:
            raise ValueError(f"{name} is stated in rad and reaches {max(sizes):g}: degrees? then write {name} [deg]")
        small = is_unit(unit) and factor_to_base(name, unit)[1] == pi / 180 and max(sizes, default=inf) < _TURN
        if small and (quarters := [*filter(_is_quarter, sizes)]):
            raise ValueError(
                f"{name} is stated in deg, and {quarters[0]:.4f} is a quarter turn in rad: write {name} [rad]"
            )
    open_ = _open(values, _ANGLES, kinds, slide=False)
    stated = next((units[name] for name in _ANGLES if name in units), "")
    if stated or not open_:
        return stated or "rad", []
    names = ", ".join(n for n in (*_ANGLES, "offset") if n in at and n not in units)
    if max(map(abs, open_)) > _TURN:
        return "deg", [f"{names}: no unit is stated; numbers up to {max(map(abs, open_)):g} are degrees"]
    if all(map(_is_quarter, open_)):
        return "rad", [f"{names}: no unit is stated; {open_[0]:.4f} is a quarter turn in rad"]
    odd = next(v for v in open_ if not _is_quarter(v))
    raise ValueError(f"{names}: no unit is stated, and {odd:g} may be rad or degrees; write alpha [rad] or alpha [deg]")


def _is_quarter(value: float) -> bool:
    turns = abs(value) / (pi / 2)
    return turns > 0.5 and abs(turns - round(turns)) * pi / 2 < _QUARTER


def _lengths(
    values: Mapping[str, list[_Value]], units: Mapping[str, str], kinds: Sequence[RowKind]
) -> tuple[str, list[str]]:
    """Return the unit of lengths, and a note where sizes tell it. Raises `ValueError` for what cannot be meant."""
    every = [(n, v) for n in _LENGTHS for v in values[n]]
    stated = next((units[name] for name in _LENGTHS if name in units), "")
    known = sum(abs(v.value) * factor_to_base(n, v.unit, "mm")[1] for n, v in every if v.unit)
    if known > 1e3 * _LONG:
        raise ValueError(
            f"its links are {known / 1e3:.0f} m long together: these look like mm; write a [mm] and d [mm]"
        )
    open_ = _open(values, _LENGTHS, kinds, slide=True)
    if 0 < known < _SHORT and (stated or not open_):
        raise ValueError(f"its links are {known:.3g} mm long together: these look like m; write a [m] and d [m]")
    if stated or not open_:
        return stated or "mm", []
    size, names = sum(map(abs, open_)), ", ".join(n for n in _LENGTHS if n not in units)
    unit = "m" if size < _LONG else "mm"
    return unit, [f"{names}: no unit is stated; links of {size:g} together are {unit}"]


_MM = 1e-3  # metres
_FREE = 1.0  # metres that a joint without a stop slides, either way


def urdf_of_dh(table: DhTable, comment: str = "", used: Mapping[str, tuple[float, float]] | None = None) -> str:
    """Return the URDF of a table, from `base` to `flange`, with a comment that says `comment`.

    What a table does not tell and a URDF needs, effort and velocity, is 0; a joint that slides without a stop goes as
    far as it was `used`, name -> (least, most) [mm], or a metre either way.
    """
    chain, used = table.chain, used or {}
    lines = [f"<robot name={quoteattr(table.name)}>"]
    lines += [f"  <!-- {comment.replace('--', '- -')} -->"] if comment else []
    of_table = f"a {table.form} table of Denavit and Hartenberg"
    lines.append(f"  <!-- from {of_table}; effort and velocity are not known, and 0 -->")
    freely = [j.name for j in chain.joints if j.kind == "sliding" and not np.isfinite(j.upper - j.lower)]
    for name in freely:
        stand = "the range of its readings stands" if name in used else f"{_FREE:g} m either way stand"
        lines.append(f"  <!-- the table has no limits of {name.replace('--', '- -')}: {stand} for them -->")
    lines.append(f'  <link name="{BASE}"/>')

    steps: list[tuple[str, str, str, Array, list[str]]] = []  # name, type, link behind, origin, further lines
    named: list[str] = []
    for joint in chain.joints:
        named.append(_free(re.sub(r"[^A-Za-z0-9_-]", "_", joint.name), named))
        scale = _MM if joint.kind == "sliding" else 1.0
        sides = (scale * joint.lower, scale * joint.upper)
        kind = "prismatic" if joint.kind == "sliding" else "revolute"
        if joint.name in freely:
            least, most = used.get(joint.name, (-_FREE / _MM, _FREE / _MM))
            sides = (_MM * floor(least), _MM * ceil(most))
        elif not np.isfinite(joint.upper - joint.lower):
            kind = "continuous"
        more = ['    <axis xyz="0 0 1"/>']
        if np.isfinite(sides).all():
            more += [f'    <limit lower="{sides[0]:.12g}" upper="{sides[1]:.12g}" effort="0" velocity="0"/>']
        steps.append((named[-1], kind, f"{named[-1]}_link", joint.origin, more))
    steps.append((_free(f"{TIP}_joint", named), "fixed", TIP, chain.tail, []))

    above = BASE
    for name, kind, below, origin, more in steps:  # with the digits of a picometre or a picoradian
        xyz, rpy = (
            " ".join(f"{round(float(v), 12) + 0.0:.12g}" for v in values)
            for values in (_MM * origin[:3, 3], rpy_of(origin))
        )
        lines += [
            f'  <link name="{below}"/>', f'  <joint name="{name}" type="{kind}">',
            f'    <parent link="{above}"/><child link="{below}"/>', f'    <origin xyz="{xyz}" rpy="{rpy}"/>', *more,
            "  </joint>",
        ]  # fmt: skip
        above = below
    return "\n".join([*lines, "</robot>"]) + "\n"


def _free(name: str, taken: Sequence[str]) -> str:
    return _free(f"{name}_", taken) if name in taken else name
