"""Cells of a table: units and their factors to mm, rad, s, N, N mm, K; numbers; and the words of marks.

A number with a comma in a file with decimal points may be one with a mark between thousands, so nobody guesses. The
words that say that there is no value are the same for numbers and for the names of poses.
"""

import re
from collections.abc import Mapping, Sequence
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import suggest

Array = NDArray[np.float64]

_DEGREE, _HOUR = pi / 180, pi / 12
_TO_BASE = {
    "rad": ("rad", 1.0), "mrad": ("rad", 1e-3), "urad": ("rad", 1e-6), "deg": ("rad", _DEGREE),
    "arcmin": ("rad", _DEGREE / 60), "arcsec": ("rad", _DEGREE / 3600), "rev": ("rad", 2 * pi),
    "mdeg": ("rad", _DEGREE / 1000), "gon": ("rad", pi / 200),
    "mm": ("mm", 1.0), "um": ("mm", 1e-3), "cm": ("mm", 10.0), "m": ("mm", 1e3), "inch": ("mm", 25.4),
    "nm": ("mm", 1e-6), "ft": ("mm", 304.8),
    "s": ("s", 1.0), "us": ("s", 1e-6), "ms": ("s", 1e-3), "min": ("s", 60.0), "h": ("s", 3600.0),
    "N": ("N", 1.0), "kN": ("N", 1e3), "kgf": ("N", 9.80665), "lbf": ("N", 4.448222),
    "N mm": ("N mm", 1.0), "N m": ("N mm", 1e3),
    "K": ("K", 1.0), "mK": ("K", 1e-3),
    "mm/s": ("mm/s", 1.0), "m/s": ("mm/s", 1e3), "mm/min": ("mm/s", 1 / 60),
    "rad/s": ("rad/s", 1.0), "mrad/s": ("rad/s", 1e-3), "deg/s": ("rad/s", _DEGREE), "rpm": ("rad/s", pi / 30),
    "V": ("V", 1.0), "mV": ("V", 1e-3), "A": ("A", 1.0), "mA": ("A", 1e-3), "Hz": ("Hz", 1.0), "kg": ("kg", 1.0),
    "g": ("kg", 1e-3), "%": ("%", 1.0), "hPa": ("hPa", 1.0), "Pa": ("hPa", 1e-2),
    "kPa": ("hPa", 10.0), "MPa": ("hPa", 1e4), "mbar": ("hPa", 1.0), "bar": ("hPa", 1e3), "psi": ("hPa", 68.94757),
    "px": ("px", 1.0), "1": ("1", 1.0),
}  # fmt: skip
_SPELT = {
    "°": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "µrad": "urad", "μrad": "urad",
    "'": "arcmin", '"': "arcsec", "turn": "rev", "turns": "rev", "µm": "um", "μm": "um", "micron": "um", "in": "inch",
    "″": "arcsec", "′": "arcmin", "µs": "us", "μs": "us", "sec": "s", "seconds": "s",
    "Nm": "N m", "N*m": "N m", "N·m": "N m", "Nmm": "N mm", "N*mm": "N mm", "N·mm": "N mm",
    "°C": "K", "degC": "K", "C": "K", "°/s": "deg/s", "-": "1", "": "1",
    "MM": "mm", "RAD": "rad", "Rad": "rad", "DEG": "deg", "Deg": "deg", "Degrees": "deg", "Radians": "rad",
    "pixel": "px", "pixels": "px", "Pixel": "px",
}  # fmt: skip  # a temperature is above a reference, so degrees Celsius are kelvins
_CHANGED = (  # what people take for each other
    ("cm", "mm"), ("m", "cm"), ("m", "mm"), ("m", "um"), ("min", "s"), ("h", "s"), ("rad", "deg"), ("inch", "mm"),
    ("kgf", "N"), ("lbf", "N"), ("psi", "kPa"), ("ft", "m"),
)  # fmt: skip


def is_unit(word: str) -> bool:
    """Return whether `word` is a unit that is known, in one of its spellings."""
    return bool(word.strip()) and _SPELT.get(word.strip(), word.strip()) in _TO_BASE


def between(column: str, unit: str, wanted: str, absolute: bool = False) -> float:
    """Return the factor that turns `unit` into `wanted`, both known and of one kind; raise `ValueError` elsewhere.

    There is none between kelvins and degrees Celsius where temperatures are `absolute`, and not above a reference.
    """
    if absolute and len({"K", _SPELT.get(unit, unit), _SPELT.get(wanted, wanted)}) == 1 and "K" in (unit, wanted):
        raise ValueError(f"column {column}: {unit} and {wanted} have their zeros apart")
    base, scale = factor_to_base(column, wanted)
    return factor_to_base(column, unit, base)[1] / scale


def factors_near(unit: str) -> dict[str, float]:
    """Return the other units of the kind of `unit` -> the factor that turns them into it; none of an unknown one."""
    if not is_unit(unit):
        return {}
    base, scale = _TO_BASE[_SPELT.get(unit.strip(), unit.strip())]
    units = {u: factor for u, (b, factor) in _TO_BASE.items() if b == base} | ({"h": _HOUR} if base == "rad" else {})
    return {u: factor / scale for u, factor in units.items() if factor != scale}


def factor_to_base(column: str, unit: str, needed: str | None = None) -> tuple[str, float]:
    """Return the unit in which `column` is kept, `needed` if that is stated, and the factor that turns `unit` into it.

    Hours of an angle are 15 degrees each. Raises `ValueError` with the choices for one that is unknown or of another
    kind.
    """
    known = _SPELT.get(unit.strip(), unit.strip())
    if known.casefold() == "grad":
        raise ValueError(f"column {column}: unit {unit!r} may be degrees or gon (400 a turn); write deg or gon")
    if known not in _TO_BASE:
        choices = [u for u, (base, _) in _TO_BASE.items() if needed in (None, base)]
        raise ValueError(f"column {column}: unit {unit!r} is unknown; {suggest(known, choices)}")
    base, scale = _TO_BASE[known]
    if (known, needed) == ("h", "rad"):  # of right ascension, or an hour angle
        return "rad", _HOUR
    if needed not in (None, base):
        choices = [u for u, (b, _) in _TO_BASE.items() if b == needed]
        raise ValueError(f"column {column}: unit {unit!r} cannot be turned into {needed}; write {', '.join(choices)}")
    return base, scale


_NUMBER = r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?"
NUMBER = re.compile(rf"\s*{_NUMBER}\s*")  # a cell with a number, with a point or a comma
_COMMA = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?")
_POINT = re.compile(r"[+-]?(\d+\.\d*|\.\d+)([eE][+-]?\d+)?")


def number_of(cell: str) -> float | None:
    """Return the number in a cell; None for no number, to which 1_2 belongs, the name of something."""
    try:
        return float("words" if "_" in cell else cell)
    except ValueError:
        return None


def with_points(columns: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    """Return name -> cells with a point for the decimal comma; raise `ValueError` where numbers have both."""

    def first(mark: re.Pattern[str]) -> str:
        places = (
            (n, i, cell) for n, column in columns.items() for i, cell in enumerate(column) if mark.fullmatch(cell)
        )
        return next((f"column {name}, reading {i + 1}: {cell!r}" for name, i, cell in places), "")

    if not (comma := first(_COMMA)):
        return {name: list(column) for name, column in columns.items()}
    if point := first(_POINT):
        raise ValueError(f"{comma} has a decimal comma, and {point} a decimal point; write one of them throughout")
    return {
        name: [cell.replace(",", ".") if _COMMA.fullmatch(cell) else cell for cell in column]
        for name, column in columns.items()
    }


_WAYS_OUT = (
    (re.compile(r"[+-]?\d{1,3}(([’'\s])\d{3}(\2\d{3})*([.,]\d*)?|(,\d{3}){2,}|(\.\d{3}){2,}|(,\d{3})+\.\d*|(\.\d{3})+,\d*)"),
     "write it without a mark between thousands"),
    (_COMMA, "write the decimal point as a point"),
    (re.compile(r"[+-]?[\d.,]+[dD][+-]?\d+"), "write the exponent with E"),
    (re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}\b.*"), "write a time as 2026-03-01T12:30:05, or in seconds"),
    (re.compile(r"[+-]?\d+[:°hd]\s*\d+.*"),
     "write a time as 2026-03-01T12:30:05 or in seconds, an angle as one number of degrees"),
    (re.compile(rf"{_NUMBER}\s*[^\W\d_°%\"'′″].*|{_NUMBER}\s*[°%\"'′″µ]"),
     "write the number alone, and its unit in the heading: name [unit]"),
)  # fmt: skip
_ANY = "correct it, leave the cell empty, or leave the row out"


def way_out(cell: str, other: str = _ANY) -> str:
    """Return what to do about a cell that is no number, `other` where its form says nothing; a semicolon before it."""
    text = cell.strip()
    way = next((way for form, way in _WAYS_OUT if form.fullmatch(text)), other)
    return f"; {way}" if way else ""


NO_VALUE = frozenset({
    "", "nan", "na", "n/a", "n.a.", "#n/a", "#nv", "#div/0!", "#value!", "#wert!", "#num!", "#ref!", "null", "none",
    "nil", "missing", "-", "--", "---", "?", ".", "k.a.", "-nan", "nan(ind)", "1.#qnan", "<na>",
})  # fmt: skip


def no_value(cell: str) -> bool:
    """Return whether a cell, as it is written, says that there is no value."""
    return cell.strip().lower() in NO_VALUE


_VALID, _NOT = ("true", "1", "1.0", "yes", "y", "t", "ok"), ("false", "0", "0.0", "no", "n", "f", "", "nan", "none")
_SPLIT, _EMPTY = ("train", "hold"), ("", "nan", "none")


def valid_rows(words: Any) -> NDArray[np.bool_]:
    """Return which rows the words of a column `valid` mark, (n,), an empty cell none; `ValueError` for others."""
    marks = _marks("valid", words, (*_VALID, *_NOT), "true or false (1 or 0, yes or no, y or n, t or f, ok)")
    return np.isin(marks, _VALID)


def split_rows(words: Any) -> NDArray[np.str_]:
    """Return the part of each row by the words of a column `split`, (n,): train, hold, or "" for an empty cell.

    Raises `ValueError` for any other word, because rows that were kept for checking must not be fitted.
    """
    marks = _marks("split", words, (*_SPLIT, *_EMPTY), "train (fitted) or hold (kept back)")
    return np.where(np.isin(marks, _SPLIT), marks, "")


def _marks(column: str, words: Any, known: tuple[str, ...], needed: str) -> NDArray[np.str_]:
    marks = np.char.lower(np.char.strip(np.asarray(words).astype(str)))
    if other := sorted(set(marks.tolist()) - set(known)):
        raise ValueError(f"column {column} holds {other[0]!r}; {needed} is needed")
    return marks


# the factors between units that people take for each other, both ways, whatever the kind
USUAL_FACTORS = tuple(
    f for one, other in _CHANGED for factor in [between("", one, other)] for f in (factor, 1 / factor)
)
