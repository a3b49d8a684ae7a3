"""Words of a request and of messages: what is refused before anything parses it, and how all messages write things.

A parser calls itself for each nested bracket, and Python ends that after some hundred calls; a terminal obeys control
characters; a table holds no text that is not Unicode.
"""

import json
import re
import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from html import escape
from typing import TextIO

LONGEST_WORD = 100_000  # characters; Linux passes no word above 131 072 bytes
DEEPEST = 30  # brackets inside brackets: no option needs more than 3; Hydra's parser gives up at some 90
_MARGIN = 40  # characters of a long text that a message shows from its end
_SHOWN = 300  # characters of it in all
_LONGEST_LINE = 8_000  # characters of a message: the longest list of choices has half of that
_STEERING = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\u202a-\u202e\u2066-\u2069]")  # also text's direction
_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"', re.DOTALL)


def check_word(word: str) -> None:
    """Raise `ValueError` for a word that no option can be: too long, nested too deep, or no text."""
    key, equals, _ = word.partition("=")
    beginning = shortened(key) + equals
    if len(word) > LONGEST_WORD:
        raise ValueError(f"{beginning}: has {len(word)} characters; an argument has at most {LONGEST_WORD}")
    controls = (c for c in word if not c.isprintable() and c not in "\t\n\r")  # or a space, a sign without a shape
    wrong = next((c for c in controls if ord(c) < 0xA0 or "\ud800" <= c <= "\udfff"), None)
    if wrong is not None:
        what = "bytes that are no UTF-8" if "\ud800" <= wrong <= "\udfff" else f"the control character {wrong!a}"
        raise ValueError(f"{beginning}: holds {what}; an argument is plain text")
    deep = depth(word)
    if deep > DEEPEST:
        raise ValueError(f"{beginning}: brackets stand {deep} deep in each other; at most {DEEPEST} are read")


def depth(text: str) -> int:
    """Return how deep brackets and braces stand in each other, those in double quotes left out."""
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
    """Return `text` with control characters as Python writes them, but for ends of lines and tabulators."""
    return _STEERING.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def one_line(text: str) -> str:
    """Return a message as one line for a terminal, without control characters; long texts are cut in their middle."""
    line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in " ".join(text.split()))
    return shortened(re.sub(rf"\S{{{_SHOWN + 1},}}", lambda found: shortened(found[0]), line), _LONGEST_LINE)


def shortened(text: str, most: int = _SHOWN) -> str:
    """Return `text`, or its first and last characters where it has more than `most`."""
    return text if len(text) <= most else f"{text[: most - _MARGIN]}…{text[-_MARGIN:]}"


def as_columns(names: Mapping[str, str]) -> str:
    """Return the word that gives columns other names, `columns='{"x":"Weg X"}'`, as a shell reads it."""
    return f"columns={shlex.quote(json.dumps(dict(names), ensure_ascii=False, separators=(',', ':')))}"


def as_units(names: Iterable[str], unit: str) -> str:
    """Return the word that states the unit of columns, `units=x:mm,y:mm`."""
    return f"units={','.join(f'{name}:{unit}' for name in names)}"


def plural(what: str, n: float) -> str:
    """Return the word for `n` of `what`: run, runs."""
    return what if n == 1 else f"{what}s"


def counted(n: int, what: str) -> str:
    """Return a count with what is counted, 12 finished runs; the last word of `what` takes the s."""
    return f"{n} {plural(what, n)}"


def listed(names: Sequence[str], most: int) -> str:
    """Return names one after another, of a long list the first `most` and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def as_sentence(text: str, names: Collection[str] = ()) -> str:
    """Return a remark as a sentence: a stop last, and a capital where it opens with a word that is none of `names`."""
    first = text.partition(" ")[0]
    begins = text[:1].upper() if first.isalpha() and first not in names else text[:1]
    return f"{begins}{text[1:]}{'' if text.endswith(('.', '?')) else '.'}"


def plain(value: float, digits: int = 3, sign: str = "") -> str:
    """Return a number with so many significant digits; with `sign` "+", a plus before one above 0.

    There is no exponent between .001 and 99999.

    >>> plain(1634.2, 2), plain(0.00123, 2), plain(-38.0), plain(2.5e7, sign="+")
    ('1600', '0.0012', '-38', '+2.5e+07')
    """
    short = f"{value:{sign}.{digits}g}"
    return f"{float(short):{sign}.0f}" if 10**digits <= abs(float(short)) < 1e5 else short


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


def html_table(title: str, heads: Sequence[str], rows: Iterable[Sequence[object]], most: int = 30) -> str:
    """Return a table with its title above; floats in six digits, and of many rows the first `most`."""

    def cell(value: object) -> str:
        if value is None or value != value:
            return "<td>–</td>"
        return f"<td>{value:.6g}</td>" if isinstance(value, float) else f"<td>{escape(str(value))}</td>"

    listed = list(rows)
    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    body = "".join(f"<tr>{''.join(map(cell, row))}</tr>" for row in listed[:most])
    more = f"and {len(listed) - most} more" if len(listed) > most else ""
    return f"<div><b>{escape(title)}</b><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}</div>"
