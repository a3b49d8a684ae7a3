"""A word that was typed, against the annotation of its option: what is annotated as text holds what was typed.

Hydra, YAML and JSON read 1.10 as a number, 2024_05_01 as another, null as nothing. Where an option is annotated as
text (`str`, a path, a `Literal` or an enumeration of texts; alone, in a union, a list, a mapping) none is asked:
Hydra gets the word in quotes (`bench.sweep.words.hydra_overrides`), and the verbs that Hydra does not compose read
it here (`read_word`).
"""

from __future__ import annotations

import json
import re
import types
from collections.abc import Iterator, Mapping
from enum import Enum
from os import PathLike
from typing import Any, Literal, Union, get_args, get_origin

from calibench.core.options import LISTS, coerce, dataclass_of, declared_options, shown, written_out
from calibench.core.words import shortened

_NUMBER = re.compile(r"[+-]?(?:\d+(?:_\d+)*)?\.?(?:\d+(?:_\d+)*)?(?:[eE][+-]?\d+)?", re.ASCII)
_POINT = re.compile(r"(?<![\w.])\.(?=\d)")  # of .05, which JSON does not know
_TOKEN = re.compile(r"""(?:^|(?<=[\s,:\[{(]))(?:'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*")|\\.|.""", re.DOTALL)
_CLOSED_BY = {"[": "]", "{": "}", "(": ")"}


def read_option(label: str, text: str, kind: Any) -> Any:
    """Return the value of the word ``label=text`` in the type `kind`; raise `ValueError`, which quotes the word."""
    value = read_word(text, kind)
    try:
        return coerce(label, value, kind)
    except ValueError as error:
        raise ValueError(as_typed(str(error), label, value, text)) from None


def as_typed(message: str, label: str, value: Any, text: str) -> str:
    """Return a message that begins with ``label=value:`` with the word as it was typed, quotes and all."""
    begin = f"{label}={shown(value)}:"
    return f"{label}={shortened(text)}:{message.removeprefix(begin)}" if message.startswith(begin) else message


def read_word(text: str, kind: Any = Any) -> Any:
    """Return what `text` says of an option of type `kind`: JSON, the same without its quotes, or the text itself.

    >>> read_word("1.10", str), read_word("1.10"), read_word("1_000", int), read_word("[1, .5, mm]")
    ('1.10', 1.1, 1000, [1, 0.5, 'mm'])
    >>> read_word("{enc_1: Winkel 1, 'enc_2': \\"1.10\\"}")
    {'enc_1': 'Winkel 1', 'enc_2': '1.10'}
    """
    word = text.strip()
    if (held := inside(word, "[")) is not None:
        parts = parts_of(held)
        return [read_word(part.strip(), item_type(kind, i)) for i, part in enumerate(parts)]
    if (held := inside(word, "{")) is not None:
        pairs = [pair_of(part) for part in parts_of(held)]
        if all(pair is not None for pair in pairs):
            named = [(unquoted(name.strip()), value) for name, value in filter(None, pairs)]
            return {name: read_word(value.strip(), field_type(kind, name)) for name, value in named}
    if _is_quoted(word):
        return unquoted(word)
    if is_text(kind, word):
        return text
    for written in (word, _POINT.sub("0.", word)):
        try:
            return json.loads(written)
        except (ValueError, RecursionError):
            pass
    return _number(word) if _takes_number(kind) and _is_number(word) else text


def is_text(kind: Any, word: str) -> bool:
    """Tell whether a bare `word` is the text of an option of type `kind`, and no number, truth value or null."""
    kind = written_out(kind)
    origin, args = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        if word.lower() == "null" and type(None) in args:
            return False
        for each in args:  # the first that takes it
            if is_text(each, word):
                return True
            if each is not type(None) and _takes(each, word):
                return False
        return False
    if origin is Literal:
        return word in args or all(isinstance(choice, str) for choice in args)
    if not isinstance(kind, type):
        return isinstance(origin, type) and issubclass(origin, PathLike)
    if issubclass(kind, Enum):
        return any(word in (member.name, member.value) for member in kind)
    return issubclass(kind, str | PathLike)


def parts_of(text: str, separator: str = ",") -> list[str]:
    """Return the parts between separators that stand in no quotes and no brackets; [] for nothing.

    >>> parts_of('a,[1,2],"x,y"')
    ['a', '[1,2]', '"x,y"']
    """
    return list(_parts(text, separator)) if text.strip() else []


def _parts(text: str, separator: str) -> Iterator[str]:
    depth, at = 0, 0
    for token in _TOKEN.finditer(text):
        sign = token[0]
        depth = max(0, depth + (sign in _CLOSED_BY) - (sign in _CLOSED_BY.values()))
        if sign == separator and depth == 0:
            yield text[at : token.start()]
            at = token.end()
    yield text[at:]


def inside(word: str, opening: str) -> str | None:
    """Return what stands in the brackets around the whole of `word`; None where they are not there."""
    if word[:1] != opening or word[-1:] != _CLOSED_BY[opening] or len(word) < 2:
        return None
    depth = 0
    for token in _TOKEN.finditer(word):
        depth += (token[0] in _CLOSED_BY) - (token[0] in _CLOSED_BY.values())
        if depth == 0 and token.end() < len(word):
            return None
    return word[1:-1] if depth == 0 else None


def pair_of(part: str) -> tuple[str, str] | None:
    """Return the name and the word of ``name: word``; None where it is no such pair."""
    name, *rest = parts_of(part, ":") or [""]
    word = part[len(name) + 1 :]
    return (name, word) if rest and name.strip() and word.strip() else None


def _is_quoted(word: str) -> bool:
    found = _TOKEN.match(word)
    return found is not None and found[0] == word and len(word) > 1 and word[0] in "'\""


def unquoted(word: str) -> str:
    """Return a word without the quotes around it."""
    if not _is_quoted(word):
        return word
    if word[0] == '"':
        try:
            return str(json.loads(word))
        except ValueError:  # a control character, or an escape that JSON does not know
            pass
    return word[1:-1].replace("\\" + word[0], word[0])


def item_type(kind: Any, at: int) -> Any:
    """Return the type of the item `at` of a list of type `kind`."""
    for each in _kinds(kind):
        origin, args = get_origin(each), get_args(each)
        if origin in LISTS and args:
            kinds = [arg for arg in args if arg is not Ellipsis]
            return kinds[min(at, len(kinds) - 1)] if origin is tuple else kinds[0]
    return Any


def field_type(kind: Any, name: str) -> Any:
    """Return the type of what a mapping or a dataclass of type `kind` has under a name."""
    fields = dataclass_of(kind)
    if fields is not None:
        declared = declared_options(fields)
        return declared[name].annotation if name in declared else Any
    for each in _kinds(kind):
        if get_origin(each) in (Mapping, dict):
            return get_args(each)[1]
    return Any


def _kinds(kind: Any) -> tuple[Any, ...]:
    kind = written_out(kind)
    return tuple(map(written_out, get_args(kind))) if get_origin(kind) in (Union, types.UnionType) else (kind,)


def _takes(kind: Any, word: str) -> bool:
    try:
        coerce("", read_word(word, kind), kind)
    except ValueError:
        return False
    return True


def _takes_number(kind: Any) -> bool:
    return any(each in (int, float) for each in _kinds(kind))


def _is_number(word: str) -> bool:
    return _NUMBER.fullmatch(word) is not None and any(c.isdigit() for c in word)


def _number(word: str) -> int | float:
    """Return a number as Python writes it, which may have underscores, a sign and zeros before it."""
    try:
        return int(word)
    except ValueError:
        return float(word)
