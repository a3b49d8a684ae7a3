"""Read statements about measured data as numbers.

They come from a file or a command line, so any value is possible: text, nested lists, a whole number too large for a
float. `DataError` names the key and shows its value.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite, nan
from typing import Any

from calibench.core.options import shown, suggest
from calibench.discrepancy.model.measured.data import DataError, MeasuredData

_SMALLEST, _LARGEST = 1e-15, 1e6  # of a noise or a resolution [rad, mm, N]: beyond these, squares lose their digits
_FARTHEST = 1e9  # of a length or a load [mm, rad, N]


def positive(data: MeasuredData, key: str, value: Any) -> float:
    """Return `value`, stated under `key`, as a noise or a resolution; raise `DataError` where it is none."""
    number = _float_of(value)
    if not _SMALLEST <= number <= _LARGEST:
        rule = f"a positive number is needed, from {_SMALLEST:g} to {_LARGEST:g}"
        raise DataError(f"{data.name}: metadata {key}={_told(value)}: {rule}")
    return number


def finite(data: MeasuredData, key: str, value: Any, unit: str = "mm, rad") -> float:
    """Return `value`, stated of `key`, as a finite number; raise `DataError` where it is none."""
    number = _float_of(value)
    if not abs(number) <= _FARTHEST:
        rule = f"at most {_FARTHEST:g} can be meant" if isfinite(number) else "a finite number is needed"
        raise DataError(f"{data.name}: metadata gives {key}={_told(value)}: {rule} [{unit}]")
    return number


def nominal_numbers(data: MeasuredData, known: tuple[str, ...]) -> dict[str, float]:
    """Return name -> number of what is stated under `nominal`; raise `DataError` for a name that is not `known`."""
    stated = data.metadata.get("nominal") or {}
    if not isinstance(stated, Mapping):
        raise DataError(
            f"{data.name}: metadata nominal={shown(stated)}: names with values are needed, such as {known[0]}"
        )
    for name in stated:
        if name not in known:
            raise DataError(f"{data.name}: metadata nominal names {shown(name)!r}; {suggest(shown(name), known)}")
    return {name: finite(data, name, value) for name, value in stated.items()}


def _told(value: Any) -> str:
    return repr(shown(value)) if isinstance(value, str) else shown(value)


def _float_of(value: Any) -> float:
    """Return a number, also one that is written as text; NaN for anything else."""
    if isinstance(value, bool):
        return nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return nan
