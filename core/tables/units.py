"""The units that a file may state, and the factor to the base units: mm, rad, s, N, N mm, K, and rates."""

from __future__ import annotations

from math import pi

from calibench.core.options import suggest

_DEGREE = pi / 180
_TO_BASE = {
    "rad": ("rad", 1.0), "mrad": ("rad", 1e-3), "urad": ("rad", 1e-6), "deg": ("rad", _DEGREE),
    "arcmin": ("rad", _DEGREE / 60), "arcsec": ("rad", _DEGREE / 3600), "rev": ("rad", 2 * pi),
    "mdeg": ("rad", _DEGREE / 1000), "gon": ("rad", pi / 200),
    "mm": ("mm", 1.0), "um": ("mm", 1e-3), "cm": ("mm", 10.0), "m": ("mm", 1e3), "inch": ("mm", 25.4),
    "nm": ("mm", 1e-6),
    "s": ("s", 1.0), "us": ("s", 1e-6), "ms": ("s", 1e-3), "min": ("s", 60.0), "h": ("s", 3600.0),
    "N": ("N", 1.0), "kN": ("N", 1e3), "N mm": ("N mm", 1.0), "N m": ("N mm", 1e3),
    "K": ("K", 1.0), "mK": ("K", 1e-3),
    "mm/s": ("mm/s", 1.0), "m/s": ("mm/s", 1e3), "mm/min": ("mm/s", 1 / 60),
    "rad/s": ("rad/s", 1.0), "mrad/s": ("rad/s", 1e-3), "deg/s": ("rad/s", _DEGREE), "rpm": ("rad/s", pi / 30),
    "V": ("V", 1.0), "mV": ("V", 1e-3), "A": ("A", 1.0), "mA": ("A", 1e-3), "Hz": ("Hz", 1.0), "kg": ("kg", 1.0),
    "g": ("kg", 1e-3), "%": ("%", 1.0), "hPa": ("hPa", 1.0), "bar": ("hPa", 1e3),
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


def is_unit(word: str) -> bool:
    """Return whether `word` is a unit that is known, in one of its spellings."""
    return bool(word.strip()) and _SPELT.get(word.strip(), word.strip()) in _TO_BASE


def between(column: str, unit: str, wanted: str) -> float:
    """Return the factor that turns `unit` into `wanted`, both known and of one kind; raise `ValueError` elsewhere.

    >>> between("x", "mm", "m")
    0.001
    """
    base, scale = factor_to_base(column, wanted)
    return factor_to_base(column, unit, base)[1] / scale


def factors_near(unit: str) -> dict[str, float]:
    """Return what numbers may be in where they should be in `unit`: other unit -> the factor that turns it into `unit`.

    >>> round(factors_near("rad")["deg"], 4)
    0.0175
    """
    if not is_unit(unit):
        return {}
    base, scale = _TO_BASE[_SPELT.get(unit.strip(), unit.strip())]
    return {u: factor / scale for u, (b, factor) in _TO_BASE.items() if b == base and factor != scale}


def factor_to_base(column: str, unit: str, needed: str | None = None) -> tuple[str, float]:
    """Return the unit in which `column` is kept, `needed` if that is stated, and the factor that turns `unit` into it.

    >>> factor_to_base("x", "m")
    ('mm', 1000.0)

    Hours of an angle are 15 degrees each.

    Raises `ValueError` with the column, the unit and the choices for one that is unknown or of another kind.
    """
    known = _SPELT.get(unit.strip(), unit.strip())
    if known.casefold() == "grad":
        raise ValueError(f"column {column}: unit {unit!r} may be degrees or gon (400 a turn); write deg or gon")
    if known not in _TO_BASE:
        choices = [u for u, (base, _) in _TO_BASE.items() if needed in (None, base)]
        raise ValueError(f"column {column}: unit {unit!r} is unknown; {suggest(known, choices)}")
    base, scale = _TO_BASE[known]
    if (known, needed) == ("h", "rad"):  # of right ascension, or an hour angle
        return "rad", pi / 12
    if needed not in (None, base):
        choices = [u for u, (b, _) in _TO_BASE.items() if b == needed]
        raise ValueError(f"column {column}: unit {unit!r} cannot be turned into {needed}; write {', '.join(choices)}")
    return base, scale
