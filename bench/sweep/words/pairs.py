"""KEY=VALUE words of a verb that Hydra does not compose: read once, and each value as JSON has it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from typing import Any

from calibench.core.options import suggest

_POINT = re.compile(r"(?<![\w.])\.(?=\d)")  # of .05, which JSON does not know


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


def json_or_text(text: str) -> Any:
    """Return a value as JSON has it, or with numbers that begin with a point, or the text.

    >>> json_or_text("[1, 2]"), json_or_text("-.05"), json_or_text("mm")
    ([1, 2], -0.05, 'mm')
    """
    for written in (text, _POINT.sub("0.", text)):
        try:
            return json.loads(written)
        except ValueError:
            pass
    return text
