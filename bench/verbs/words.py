"""The words after a verb: flags apart from the rest."""

from __future__ import annotations

from collections.abc import Iterable

from bedrock.registry import suggest


def split_flags(argv: list[str], known: Iterable[str]) -> tuple[set[str], list[str]]:
    """Return the flags and the other words; an unknown flag is an error."""
    flags = {word for word in argv if word.startswith("-")}
    for flag in flags - set(known):
        raise ValueError(f"unknown flag {flag!r}; {suggest(flag, known)}")
    return flags, [word for word in argv if not word.startswith("-")]
