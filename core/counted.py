"""A count with what is counted: ``1 run``, ``2 runs``. All messages, tables and pages have it from here."""

from __future__ import annotations


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
