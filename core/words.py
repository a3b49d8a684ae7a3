"""Checks of the words of a request, and how a message shows a word.

A parser calls itself for each nested bracket, and Python ends that after some hundred calls; a terminal obeys control
characters; a table holds no text that is not Unicode. All of it is refused here, in one line, before anything parses
the word.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping
from typing import TextIO

LONGEST_WORD = 100_000  # characters; Linux passes no word above 131 072 bytes
DEEPEST = 30  # brackets inside brackets: no option needs more than 3; Hydra's parser gives up at some 90
_MARGIN = 40  # characters of a long text that a message shows from its end
_SHOWN = 300  # characters of it in all
_LONGEST_LINE = 8_000  # characters of a message: the longest list of choices has half of that
_STEERING = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\u202a-\u202e\u2066-\u2069]")  # also text's direction
_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"', re.DOTALL)


def check_word(word: str) -> None:
    """Raise `ValueError` for a word that no option can be: too long, nested too deep, or no text.

    >>> check_word("problem.free=" + 99 * "[")
    Traceback (most recent call last):
        ...
    ValueError: problem.free=: brackets stand 99 deep in each other; at most 30 are read
    """
    key, equals, _ = word.partition("=")
    told = shortened(key) + equals
    if len(word) > LONGEST_WORD:
        raise ValueError(f"{told}: has {len(word)} characters; an argument has at most {LONGEST_WORD}")
    wrong = next((c for c in word if not c.isprintable() and _is_no_text(c)), None)
    if wrong is not None:
        what = "bytes that are no UTF-8" if "\ud800" <= wrong <= "\udfff" else f"the control character {wrong!a}"
        raise ValueError(f"{told}: holds {what}; an argument is plain text")
    deep = depth(word)
    if deep > DEEPEST:
        raise ValueError(f"{told}: brackets stand {deep} deep in each other; at most {DEEPEST} are read")


def depth(text: str) -> int:
    """Return how deep brackets and braces stand in each other, those in double quotes left out.

    >>> depth('{"a": [1, "[[["]}')
    2
    """
    deepest = now = 0
    for bracket in re.findall(r"[\[\](){}]", _QUOTED.sub("", text)):
        now = now + 1 if bracket in "[({" else max(0, now - 1)
        deepest = max(deepest, now)
    return deepest


def print_plain(
    *values: object, sep: str = " ", end: str = "\n", file: TextIO | None = None, flush: bool = False
) -> None:
    """Print as `print` does, with `printable` text: what names, rows and errors hold does not steer a terminal."""
    print(printable(sep.join(map(str, values))), end=end, file=file, flush=flush)


def printable(text: str) -> str:
    """Return `text` with control characters as Python writes them, but for ends of lines and tabulators.

    >>> print(printable(chr(27) + "[31m red"))
    \\x1b[31m red
    """
    return _STEERING.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def one_line(text: str) -> str:
    """Return a message as one line for a terminal, without control characters; long texts are cut in their middle."""
    line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in " ".join(text.split()))
    return shortened(re.sub(rf"\S{{{_SHOWN + 1},}}", lambda found: shortened(found[0]), line), _LONGEST_LINE)


def shortened(text: str, most: int = _SHOWN) -> str:
    """Return `text`, or its first and last characters where it has more than `most`."""
    return text if len(text) <= most else f"{text[: most - _MARGIN]}…{text[-_MARGIN:]}"


def as_columns(names: Mapping[str, str]) -> str:
    """Return the word that gives columns other names, as a shell reads it.

    >>> print(as_columns({"x": "Weg X", "y": "Weg Y"}))
    columns='{"x":"Weg X","y":"Weg Y"}'
    """
    return f"columns={shlex.quote(json.dumps(dict(names), ensure_ascii=False, separators=(',', ':')))}"


def _is_no_text(character: str) -> bool:
    """Tell a control character, or a half of a surrogate pair, from a space or a sign without a shape."""
    return character not in "\t\n\r" and (ord(character) < 0xA0 or "\ud800" <= character <= "\udfff")
