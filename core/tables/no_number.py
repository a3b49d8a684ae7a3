"""Advice on a cell that should be a number and is not, by the way it is written."""

from __future__ import annotations

import re

_NUMBER = r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?"
_WAYS_OUT = (
    (re.compile(r"[+-]?\d{1,3}(([’'\s])\d{3}(\2\d{3})*([.,]\d*)?|(,\d{3}){2,}|(\.\d{3}){2,}|(,\d{3})+\.\d*|(\.\d{3})+,\d*)"),
     "write it without a mark between thousands"),
    (re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?"), "write the decimal point as a point"),
    (re.compile(r"[+-]?[\d.,]+[dD][+-]?\d+"), "write the exponent with E"),
    (re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}\b.*"), "write a time as 2026-03-01T12:30:05, or in seconds"),
    (re.compile(r"[+-]?\d+[:°hd]\s*\d+.*"),
     "write a time as 2026-03-01T12:30:05 or in seconds, an angle as one number of degrees"),
    (re.compile(rf"{_NUMBER}\s*[^\W\d_°%\"'′″].*|{_NUMBER}\s*[°%\"'′″µ]"),
     "write the number alone, and its unit in the heading: name [unit]"),
)  # fmt: skip
_ANY = "correct it, leave the cell empty, or leave the row out"


def way_out(cell: str, other: str = _ANY) -> str:
    """Return what to do about a cell that is no number, `other` where its form says nothing; a semicolon before it.

    >>> way_out("1'000.00")
    '; write it without a mark between thousands'
    """
    text = cell.strip()
    way = next((way for form, way in _WAYS_OUT if form.fullmatch(text)), other)
    return f"; {way}" if way else ""
