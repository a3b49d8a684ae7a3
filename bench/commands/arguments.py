"""The words of a command that are not KEY=VALUE (`bench.sweep.words`): flags, and ``--to OUT``."""

from __future__ import annotations

from collections.abc import Iterable

from calibench.core.options import suggest


def split_flags(argv: list[str], known: Iterable[str]) -> tuple[set[str], list[str]]:
    """Return the flags and the other words; an unknown flag is an error."""
    flags = {word for word in argv if word.startswith("-")}
    for flag in flags - set(known):
        raise ValueError(f"unknown flag {flag!r}; {suggest(flag, known)}")
    return flags, [word for word in argv if not word.startswith("-")]


def split_to(verb: str, words: Iterable[str], example: str) -> tuple[list[str], str]:
    """Return the words without ``--to OUT``, and OUT. Raises `ValueError`, with an `example`, where there is none."""
    rest = list(words)
    at = rest.index("--to") if "--to" in rest else len(rest)
    to = rest[at + 1 : at + 2]
    del rest[at : at + 2]
    if not to or "--to" in rest:
        raise ValueError(f"{verb}: one --to OUT is needed, such as {example}")
    return rest, to[0]
