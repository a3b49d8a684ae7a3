"""A table of Denavit and Hartenberg from a CSV or Excel file, as makers and papers print it; and written out again.

A row a joint, from the base on. Columns: a, alpha, d, theta (its constant part, the joint's zero; `offset` is added to
it, or to d where the joint slides), and joint, type, beta, lower, upper where there are any. Cells may hold pi/2, 90°,
or the joint's own variable (`q2 - 90°`). Units stand in the headings: one of a length is that of all lengths, one of an
angle that of all angles; without any, sizes tell them, or the file is refused. The convention must be stated: by an
option, a line ``# convention: modified``, or headings such as a_{i-1}.

A table of Denavit and Hartenberg as a URDF: the same arm for ROS and simulators, without meshes or masses.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, floor, inf, isfinite, pi
from pathlib import Path
from typing import final
from xml.sax.saxutils import quoteattr

import numpy as np

from calibench.calibration.dh import BASE, FORMS, NUMBERS, TIP, DhRow, DhTable, Form, RowKind
from calibench.calibration.kinematics import ChainError, ChainJoint
from calibench.calibration.rigid import Array, rpy_of
from calibench.core.options import suggest
from calibench.core.tables.cells import between, factor_to_base, is_unit
from calibench.core.tables.csv_table import Table, read_excel, read_table

CONVENTIONS: dict[str, Form] = {
    **{form: form for form in FORMS},
    "classic": "standard", "classical": "standard", "distal": "standard", "craig": "modified", "proximal": "modified",
    "khalil": "modified", "mdh": "modified",
}  # fmt: skip
_SPELT = {
    **dict.fromkeys(("a", "r", "linklength"), "a"),
    **dict.fromkeys(("alpha", "twist", "linktwist"), "alpha"),
    **dict.fromkeys(("d", "linkoffset"), "d"),
    **dict.fromkeys(("theta", "thetaoffset", "jointangle", "q"), "theta"),
    **dict.fromkeys(("offset", "jointoffset", "zero", "q0"), "offset"),
    "beta": "beta",
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
_BEFORE = re.compile(r"[ijkn]\s*-\s*1")
_INDEX = re.compile(r"(?:_|\b|(?<=[a-z]))[_ ({]*(?:([ijkn]\s*-\s*1)|[ijkn])[ )}]*$")
_PI = re.compile(r"([+-]?)\s*(\d*\.?\d*)\s*\*?\s*pi\s*(?:/\s*(\d+\.?\d*))?")
_OWN = re.compile(r"(?:q|theta|th|d|t)_?\{?\s*(?:\d+|[ijkn])?\s*\}?\*?")
_ANGLES, _LENGTHS = ("theta", "alpha", "beta"), ("a", "d")
_LONG, _SHORT = 20.0, 10.0  # m and mm: no arm is longer, or shorter
_TURN = 2 * pi + 0.01
_QUARTER = 2e-3  # rad: angles of a table that are multiples of a quarter turn are rounded by less


class DhError(ChainError):
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
    """Return the table in a CSV or Excel file. `convention` goes before what the file says.

    `option` is what its user writes before convention=, for messages. Raises `DhError`, one line that begins with the
    file's name.
    """
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
    """Return the table as CSV that `read_dh` reads, in the units that it came in, under a comment that says `comment`.

    `errors`, parameter (``alpha_elbow``) -> its standard error [mm, rad], fill columns ``sd_alpha`` and so on; they are
    empty where a number is not determined.
    """
    errors = errors or {}
    units = {one: table.length if one in _LENGTHS else table.angle for one in NUMBERS}
    shown = [one for one in NUMBERS if one != "beta" or any(row.beta for row in table.rows) or _has(errors, "beta_")]
    lines = [f"# {comment}"] if comment else []
    lines += [f"# convention: {table.form}", f"# each row: {product(table.form, 'beta' in shown)}"]
    heads = ["joint", "type", *(f"{one} [{units[one]}]" for one in shown), "lower", "upper"]
    lines.append(",".join([*heads, *(f"sd_{one} [{units[one]}]" for one in shown if errors)]))
    for row in table.rows:
        words = {"rotary": "revolute", "sliding": "prismatic", "fixed": "fixed"}
        cells = [row.name, words[row.kind]]
        cells += [_number(getattr(row, one), one, units[one]) for one in shown]
        of_joint = units["d"] if row.kind == "sliding" else units["theta"]
        sides = (row.lower, row.upper) if row.kind != "fixed" else (inf, inf)
        like = "d" if row.kind == "sliding" else "theta"
        cells += [_number(side, like, of_joint) if isfinite(side) else "" for side in sides]
        known = [errors.get(f"{one}_{row.name}") for one in shown if errors]
        cells += [
            "" if e is None else f"{e * between(one, _base(one), units[one]):.3g}" for one, e in zip(shown, known)
        ]
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


def product(form: Form, leaning: bool = True) -> str:
    """Return what a row of a table stands for, from left to right; `leaning`: with beta.

    >>> product("standard"), product("modified")
    ('Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)', 'Rx(alpha) Ry(beta) Tx(a) Rz(theta) Tz(d)')
    """
    lean = " Ry(beta)" if leaning else ""
    return {
        "standard": f"Rz(theta) Tz(d) Tx(a) Rx(alpha){lean}",
        "modified": f"Rx(alpha){lean} Tx(a) Rz(theta) Tz(d)",
    }[form]


def _has(errors: Mapping[str, float], begins: str) -> bool:
    return any(name.startswith(begins) for name in errors)


def _base(number: str) -> str:
    return "mm" if number in _LENGTHS else "rad"


def _number(value: float, number: str, unit: str) -> str:
    """Return a number in `unit` with ten digits: those of the file that it came from, where nothing changed it."""
    return f"{value * between(number, _base(number), unit) + 0.0:.10g}"


@final
@dataclass(frozen=True)
class _Columns:
    """Place and unit of each column by its name of ours, and what the headings say of the convention."""

    at: Mapping[str, int]
    units: Mapping[str, str]
    form: Form | None


def _read(table: Table, name: str, form: Form | None, option: str, notes: Sequence[str]) -> DhTable:
    columns = _columns(table)
    form = form or _stated(table.comment) or columns.form
    _check_columns(columns, table)
    cells = [_Cells(row, columns, k, line, table.delimiter != ",") for k, (line, row) in enumerate(table.rows, 1)]
    cells = [one for one in cells if not one.empty]
    if not cells:
        raise ValueError("holds a header and no rows; a row for each joint is needed")
    _check_names([one.name() for one in cells])
    kinds = [one.kind() for one in cells]
    values = {n: [one.number(n, kind) for one, kind in zip(cells, kinds, strict=True)] for n in (*NUMBERS, "offset")}
    angle, noted = _angles(values, columns, kinds)
    length, noted_too = _lengths(values, columns, kinds)
    scale = {"rad": 1.0, "mm": 1.0, "deg": pi / 180, angle: factor_to_base("theta", angle, "rad")[1]}
    scale |= {length: factor_to_base("a", length, "mm")[1]}
    rows = []
    for k, (one, kind) in enumerate(zip(cells, kinds, strict=True)):
        numbers = {
            n: values[n][k].value * scale[values[n][k].unit or (length if n in _LENGTHS else angle)] for n in NUMBERS
        }
        zero = values["offset"][k]
        moving = "d" if kind == "sliding" else "theta"
        numbers[moving] += zero.value * scale[zero.unit or (length if kind == "sliding" else angle)]
        lower, upper = (one.limit(side, kind, length if kind == "sliding" else angle) for side in ("lower", "upper"))
        if lower > upper:
            raise ValueError(f"row {k + 1} has lower above upper; exchange them")
        rows.append(DhRow(one.name(), kind, lower=lower, upper=upper, **numbers))
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


def _check_names(names: Sequence[str]) -> None:
    """Raise `ValueError` for two rows of one name."""
    for k, name in enumerate(names):
        if (first := names.index(name)) < k:
            raise ValueError(
                f"rows {first + 1} and {k + 1} are both named {name!r}; give each a name of its own, or take one out"
            )


def _columns(table: Table) -> _Columns:
    at: dict[str, int] = {}
    units: dict[str, str] = {}
    before = behind = False
    for k, head in enumerate(table.names):
        unit = table.units.get(head, "").translate(_GREEK)
        plain = head.strip().lower().translate(_GREEK)
        if unit and re.fullmatch(r"[ijkn](\s*-\s*1)?", unit):  # a(i-1) is no unit
            plain, unit = f"{plain}_{unit}", ""
        index = None if _bare(plain) in _SPELT else _INDEX.search(plain)
        ours = _SPELT.get(_bare(plain if index is None else plain[: index.start()]))
        if ours is None:
            continue
        if ours in at:
            raise ValueError(f"columns {table.names[at[ours]]} and {head} are both {ours}; leave one out")
        at[ours] = k
        if unit:
            units[ours] = unit
        if ours in ("a", "alpha") and index is not None:
            before, behind = before or bool(_BEFORE.search(index[0])), behind or not _BEFORE.search(index[0])
    return _Columns(at, units, None if before == behind else "modified" if before else "standard")


def _bare(head: str) -> str:
    return re.sub(r"[\s_.(){}]", "", head)


def _stated(comment: str) -> Form | None:
    match = re.search(r"convention\s*[:=]\s*([A-Za-z]+)", comment)
    return form_of(match[1]) if match else None


def _check_columns(columns: _Columns, table: Table) -> None:
    lost = [one for one in ("a", "alpha", "d") if one not in columns.at]
    if lost:
        there = ", ".join(name for name in table.names if name) or "no heading"
        raise ValueError(
            f"no column {' and no column '.join(lost)} among {there}; a table has a, alpha, d and theta (its constant "
            "part), a row a joint, with units such as a [mm] and alpha [deg]"
        )
    for one, unit in columns.units.items():
        wanted = "mm" if one in _LENGTHS else "rad" if one in _ANGLES else None
        if one in (*NUMBERS, "offset", "lower", "upper"):
            factor_to_base(table.names[columns.at[one]], unit, wanted)


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
    columns: _Columns
    number_: int
    line: int
    comma: bool

    @property
    def empty(self) -> bool:
        """Tell whether nothing but a name stands in the row."""
        return not any(self.text(one) for one in (*NUMBERS, "offset"))

    def text(self, name: str) -> str:
        at = self.columns.at.get(name, len(self.row))
        return self.row[at].strip().translate(_GREEK) if at < len(self.row) else ""

    def name(self) -> str:
        """Return the joint's name; joint_2 for 2, or where there is none."""
        text = self.text("joint")
        if re.fullmatch(r"\d+(\.0)?", text):
            return f"joint_{int(float(text))}"
        return text or f"joint_{self.number_}"

    def kind(self) -> RowKind:
        """Return the kind of joint; where no cell says it, the one whose variable stands in the row, or rotary."""
        text = self.text("type").lower()
        if text:
            text = text.removesuffix(".0")
            if text not in _KINDS:
                raise ValueError(
                    f"row {self.number_}: type {text!r}; {suggest(text, ('revolute', 'prismatic', 'fixed'))}"
                )
            return _KINDS[text]
        return "sliding" if self.number("d").own and not self.number("theta").own else "rotary"

    def number(self, name: str, kind: RowKind | None = None) -> _Value:
        """Return the number of a cell; the joint's own variable stands for 0 where it moves."""
        text = self.text(name).lower()
        unit = self.columns.units.get(name, "")
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
        base, stated = "mm" if kind == "sliding" else "rad", value.unit or self.columns.units.get(side, "")
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


def _angles(values: Mapping[str, list[_Value]], columns: _Columns, kinds: Sequence[RowKind]) -> tuple[str, list[str]]:
    """Return the unit of angles, and a note where sizes tell it. Raises `ValueError` for what cannot be meant."""
    for name in _ANGLES:
        unit = columns.units.get(name, "")
        sizes = [abs(v.value) for v in values[name] if v.unit == unit and v.value]
        if unit and factor_to_base(name, unit, "rad")[1] == 1.0 and max(sizes, default=0.0) > _TURN:
            raise ValueError(f"{name} is stated in rad and reaches {max(sizes):g}: degrees? then write {name} [deg]")
        small = is_unit(unit) and factor_to_base(name, unit)[1] == pi / 180 and max(sizes, default=inf) < _TURN
        if small and (quarters := [*filter(_is_quarter, sizes)]):
            raise ValueError(
                f"{name} is stated in deg, and {quarters[0]:.4f} is a quarter turn in rad: write {name} [rad]"
            )
    open_ = _open(values, _ANGLES, kinds, slide=False)
    stated = next((columns.units[name] for name in _ANGLES if name in columns.units), "")
    if stated or not open_:
        return stated or "rad", []
    names = ", ".join(n for n in (*_ANGLES, "offset") if n in columns.at and n not in columns.units)
    if max(map(abs, open_)) > _TURN:
        return "deg", [f"{names}: no unit is stated; numbers up to {max(map(abs, open_)):g} are degrees"]
    if all(map(_is_quarter, open_)):
        return "rad", [f"{names}: no unit is stated; {open_[0]:.4f} is a quarter turn in rad"]
    odd = next(v for v in open_ if not _is_quarter(v))
    raise ValueError(f"{names}: no unit is stated, and {odd:g} may be rad or degrees; write alpha [rad] or alpha [deg]")


def _is_quarter(value: float) -> bool:
    turns = abs(value) / (pi / 2)
    return turns > 0.5 and abs(turns - round(turns)) * pi / 2 < _QUARTER


def _lengths(values: Mapping[str, list[_Value]], columns: _Columns, kinds: Sequence[RowKind]) -> tuple[str, list[str]]:
    """Return the unit of lengths, and a note where sizes tell it. Raises `ValueError` for what cannot be meant."""
    every = [(n, v) for n in _LENGTHS for v in values[n]]
    stated = next((columns.units[name] for name in _LENGTHS if name in columns.units), "")
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
    size = sum(map(abs, open_))
    unit = "m" if size < _LONG else "mm"
    names = ", ".join(n for n in _LENGTHS if n not in columns.units)
    return unit, [f"{names}: no unit is stated; links of {size:g} together are {unit}"]


_MM = 1e-3  # metres
_FREE = 1.0  # metres that a joint without a stop slides, either way


def urdf_of_dh(table: DhTable, comment: str = "", used: Mapping[str, tuple[float, float]] | None = None) -> str:
    """Return the URDF of a table, from `base` to `flange`, with a comment that says `comment`.

    Joints with limits are revolute, those without continuous. What a table does not tell and a URDF needs, effort and
    velocity, is 0. A joint that slides without a stop goes as far as it was `used`, name -> (least, most) [mm], or a
    metre either way, as a URDF must have limits for it; a comment says so. In names stand letters, digits, _ and -
    only, as ROS wants them; others become _.
    """
    chain = table.chain
    used, named = used or {}, _names(chain.driven)
    lines = [f"<robot name={quoteattr(table.name)}>"]
    lines += [f"  <!-- {comment.replace('--', '- -')} -->"] if comment else []
    lines += [
        f"  <!-- from a {table.form} table of Denavit and Hartenberg; effort and velocity are not known, and 0 -->",
    ]
    for name in (joint.name for joint in chain.joints if _slides_freely(joint)):
        stand = "the range of its readings stands" if name in used else f"{_FREE:g} m either way stand"
        lines.append(f"  <!-- the table has no limits of {name.replace('--', '- -')}: {stand} for them -->")
    lines.append(f'  <link name="{BASE}"/>')
    above = BASE
    for joint in chain.joints:
        below = f"{named[joint.name]}_link"
        lines += [
            f'  <link name="{below}"/>',
            f'  <joint name="{named[joint.name]}" type="{_type(joint)}">',
            f'    <parent link="{above}"/><child link="{below}"/>',
            _origin(joint.origin),
            '    <axis xyz="0 0 1"/>',
            *_limit(joint, used),
            "  </joint>",
        ]
        above = below
    lines += [
        f'  <link name="{TIP}"/>',
        f'  <joint name="{_free(f"{TIP}_joint", list(named.values()))}" type="fixed">',
        f'    <parent link="{above}"/><child link="{TIP}"/>',
        _origin(chain.tail),
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def _names(joints: Sequence[str]) -> dict[str, str]:
    """Return each joint's name in the URDF."""
    names: dict[str, str] = {}
    for name in joints:
        names[name] = _free(re.sub(r"[^A-Za-z0-9_-]", "_", name), list(names.values()))
    return names


def _free(name: str, taken: Sequence[str]) -> str:
    """Return a name that is not `taken`."""
    return _free(f"{name}_", taken) if name in taken else name


def _type(joint: ChainJoint) -> str:
    if joint.kind == "sliding":
        return "prismatic"
    return "revolute" if np.isfinite(joint.upper - joint.lower) else "continuous"


def _slides_freely(joint: ChainJoint) -> bool:
    return joint.kind == "sliding" and not np.isfinite(joint.upper - joint.lower)


def _limit(joint: ChainJoint, used: Mapping[str, tuple[float, float]]) -> list[str]:
    scale = _MM if joint.kind == "sliding" else 1.0
    sides = (scale * joint.lower, scale * joint.upper)
    if _slides_freely(joint):
        least, most = used.get(joint.name, (-_FREE / _MM, _FREE / _MM))
        sides = (_MM * floor(least), _MM * ceil(most))
    elif not np.isfinite(sides).all():
        return []
    return [f'    <limit lower="{sides[0]:.12g}" upper="{sides[1]:.12g}" effort="0" velocity="0"/>']


def _origin(origin: Array) -> str:
    xyz = " ".join(_digits(_MM * v) for v in origin[:3, 3])
    rpy = " ".join(_digits(v) for v in rpy_of(origin))
    return f'    <origin xyz="{xyz}" rpy="{rpy}"/>'


def _digits(value: float) -> str:
    """Return a number with the digits of a picometre or a picoradian, and no more."""
    return f"{round(float(value), 12) + 0.0:.12g}"
