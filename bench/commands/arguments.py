"""The words after a verb: flags, KEY=VALUE, and the rest."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from calibench.core.options import suggest


def split_flags(argv: list[str], known: Iterable[str]) -> tuple[set[str], list[str]]:
    """Return the flags and the other words; an unknown flag is an error."""
    flags = {word for word in argv if word.startswith("-")}
    for flag in flags - set(known):
        raise ValueError(f"unknown flag {flag!r}; {suggest(flag, known)}")
    return flags, [word for word in argv if not word.startswith("-")]


def read_pairs(verb: str, words: Iterable[str], known: Mapping[str, str]) -> dict[str, str]:
    """Return KEY=VALUE words as a mapping; `known` has an example for each key.

    Raises `ValueError` at an unknown key, at one without a value, and at one that is given twice.
    """
    given: dict[str, str] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if key not in known:
            raise ValueError(f"{verb}: unknown argument {key!r}; {suggest(key, known)}")
        if not equals or not value:
            raise ValueError(f"{verb}: {key} needs a value, such as {key}={known[key]}")
        if key in given:
            raise ValueError(f"{verb}: {key} is given twice ({given[key]} and {value}); give it once")
        given[key] = value
    return given


def split_to(verb: str, words: Iterable[str], example: str) -> tuple[list[str], str]:
    """Return the words without ``--to OUT``, and OUT. Raises `ValueError`, with an `example`, where there is none."""
    rest = list(words)
    at = rest.index("--to") if "--to" in rest else len(rest)
    to = rest[at + 1 : at + 2]
    del rest[at : at + 2]
    if not to or "--to" in rest:
        raise ValueError(f"{verb}: one --to OUT is needed, such as {example}")
    return rest, to[0]
