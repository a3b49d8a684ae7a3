"""KEY=VALUE words of a verb that Hydra does not compose, each once; `core.annotated` reads what they say."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from calibench.core.options import suggest


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
