"""How a law is told to be broken: one line with the law, what was found, and what to do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from traceback import extract_tb
from typing import Any

Law = Callable[..., None]
Checks = list[tuple[str, Callable[[], None]]]


def require(kept: object, law: str, found: object, remedy: str) -> None:
    """Raise `AssertionError` of one line unless the law is kept."""
    if not kept:
        raise AssertionError(" ".join(f"{law}; found {found}; {remedy}".split()))


def checks_of(laws: Sequence[Law], *subject: Any) -> Checks:
    """Return (name, check) for each of `laws`; ``check()`` raises `AssertionError` where its law is broken."""
    return [(law.__name__, partial(_check, law, *subject)) for law in laws]


def _check(law: Law, *subject: Any) -> None:
    """Run a law; what is checked may raise whatever it likes, and is told in a line all the same."""
    try:
        law(*subject)
    except AssertionError:
        raise
    except Exception as error:
        asked = (law.__doc__ or law.__name__).partition("\n")[0].rstrip(".")
        place = extract_tb(error.__traceback__)[-1]
        found = f"{type(error).__name__}: {error}"
        require(False, asked, found, f"it was raised in {Path(place.filename).name}, line {place.lineno}: {place.line}")
