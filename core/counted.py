"""Counts with their nouns (``1 run``, ``2 runs``), numbers and lengths of time, in the form that all messages use."""

from __future__ import annotations

from collections.abc import Sequence


def plural(what: str, n: float) -> str:
    """Return the word for `n` of `what`.

    >>> plural("run", 1), plural("run", 0)
    ('run', 'runs')
    """
    return what if n == 1 else f"{what}s"


def counted(n: int, what: str) -> str:
    """Return a count with what is counted; the last word of `what` takes the s.

    >>> counted(1, "finished run"), counted(12, "finished run")
    ('1 finished run', '12 finished runs')
    """
    return f"{n} {plural(what, n)}"


def listed(names: Sequence[str], most: int) -> str:
    """Return names one after another, of a long list the first `most` and how many more there are.

    >>> listed(["a", "b", "c", "d"], 2)
    'a, b and 2 more'
    """
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def grouped(n: int) -> str:
    """Return a whole number with its thousands apart.

    >>> grouped(1234567)
    '1 234 567'
    """
    return f"{n:,}".replace(",", " ")


def plain(value: float, digits: int = 3, sign: str = "") -> str:
    """Return a number with so many significant digits; with `sign` "+", a plus before one above 0.

    There is no exponent between .001 and 99999.

    >>> plain(1634.2, 2), plain(0.00123, 2), plain(-38.0), plain(2.5e7, sign="+")
    ('1600', '0.0012', '-38', '+2.5e+07')
    """
    told = f"{value:{sign}.{digits}g}"
    return f"{float(told):{sign}.0f}" if 10**digits <= abs(float(told)) < 1e5 else told


def span(seconds: float) -> str:
    """Return a length of time in two digits or so.

    >>> span(42), span(1500), span(9000), span(200_000)
    ('42 s', '25 min', '2.5 h', '2.3 d')
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 90 * 60:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 48 * 3600 else f"{seconds / 86400:.1f} d"
