"""Options of a registry's entries: declared by a signature, given as text or values, checked and described.

A value is accepted where it loses nothing in the annotated type. Hydra, YAML and JSON read 1.10 as a number, null as
nothing. Where an option is annotated as text (`str`, a path, a `Literal` or an enumeration of texts; alone, in a union,
a list, a mapping) none is asked: Hydra gets the word in quotes (`bench.sweep.composition`), and the verbs that Hydra
does not compose read it here (`read_word`).
"""

from __future__ import annotations

import difflib
import inspect
import json
import math
import re
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from enum import Enum
from itertools import islice
from numbers import Number, Real
from os import PathLike
from pathlib import PurePath
from typing import Annotated, Any, Literal, NewType, Optional, Union, final, get_args, get_origin, get_type_hints

import numpy as np

from calibench.core.words import shortened

FilePath = NewType("FilePath", str)  # of an option: the path of one file, which a command line takes to the letter
_TELLING = 3  # letters from which on a part of a name is taken for a hint
_LONG, _BEGINNING = 30, 8  # choices: so many are not all told, but the first ones
_FEW = 3  # choices that begin alike: more are no hint


@final
@dataclass(frozen=True)
class Range:
    """Where the numbers of an option lie, both ends included but for a low one that they are `above`.

    An annotation states it, ``Annotated[float, Range(0, 1)]``. `unit` is a word for the message.
    """

    low: float
    high: float = math.inf
    above: bool = False
    unit: str = ""

    def check(self, label: str, value: Any, numbers: Any) -> None:
        """Raise `ValueError` where one of `numbers`, for which `value` stands, lies elsewhere; a word lies nowhere."""
        for number in numbers if isinstance(numbers, tuple) else (numbers,):
            is_number = isinstance(number, int | float)
            if not is_number or (self.low <= number <= self.high and not (self.above and number == self.low)):
                continue
            rule = f"must be {f'above {self.low:g}' if self.above else f'{self.low:g} or more'}"
            if self.high < math.inf:
                rule = f"must lie in {self.low:g} .. {self.high:g}{f', above {self.low:g}' if self.above else ''}"
            raise ValueError(f"{label}={shown(value)}: {rule}{f' ({self.unit})' if self.unit else ''}")


@dataclass(frozen=True)
class Option:
    """One option of an entry: its name, type and range as annotated, and default (`required` where it has none)."""

    name: str
    type: Any
    default: Any
    required: bool
    range: Range | None = None

    @property
    def annotation(self) -> Any:
        """Return its type, and None beside it where that is the default."""
        or_none = self.default is None and not self.required
        return Optional[self.type] if or_none else self.type  # noqa: UP045 - a quoted annotation knows no |

    @property
    def takes_none(self) -> bool:
        """Return whether None is a value of its own here."""
        is_none = self.default is None and not self.required  # whatever type it was annotated with
        return is_none or self.type is Any or type(None) in get_args(written_out(self.type))

    @property
    def fields(self) -> dict[str, Option]:
        """Return the options inside it, where it is a dataclass; their defaults are those of its own default."""
        kind = dataclass_of(self.type) or dataclass_of(type(self.default))
        inside = {} if kind is None else declared_options(kind)
        if type(self.default) is not kind:
            return inside
        held = {name: getattr(self.default, name, option.default) for name, option in inside.items()}
        return {name: replace(option, default=held[name], required=False) for name, option in inside.items()}

    def taken(self, label: str, value: Any) -> Any:
        """Return `value` as `coerce` does; of a dataclass the fields that are not given are those of the default."""
        if value is None and self.default is None and not self.required:
            return None
        kind, own = self.type, self.default
        if isinstance(value, Mapping) and is_dataclass(own) and not isinstance(own, type):
            kind = type(own) if kind is Any else kind
            held = {f.name: getattr(own, f.name) for f in fields(own) if f.init}
            value = {**held, **value} if {*value} <= {*held, CLASS} else value
        taken = coerce(label, value, kind)
        if self.range is not None:
            self.range.check(label, value, taken)
        return taken

    def describe(self) -> str:
        """Return the option as the command line takes it, with its choices or type: ``error=J2 (J1|J2|J3)``."""
        default = "..." if self.required else shown(self.default)
        return f"{self.name}={default} ({_type_name(self.type)})"


def declared_options(factory: Callable[..., Any]) -> dict[str, Option]:
    """Return the options that the signature of `factory` declares."""
    target = factory.func if hasattr(factory, "func") else factory  # a functools.partial carries its hints inside
    try:
        hints = get_type_hints(target.__init__ if inspect.isclass(target) else target, include_extras=True)
    except NameError:  # annotations that only a type checker can resolve: take values as they come
        hints = {}
    of_class = fields(target) if isinstance(target, type) and is_dataclass(target) else ()
    made = {f.name: f.default_factory() for f in of_class if f.default_factory is not MISSING}
    options = {}
    for parameter in inspect.signature(factory).parameters.values():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        required = parameter.default is parameter.empty
        kind = hints.get(parameter.name, float if type(parameter.default) is float else Any)  # 1 is 1.0 there
        default = None if required else made.get(parameter.name, parameter.default)
        stated = next((one for one in getattr(kind, "__metadata__", ()) if isinstance(one, Range)), None)
        kind = kind.__origin__ if get_origin(kind) is Annotated else kind
        options[parameter.name] = Option(parameter.name, kind, default, required, stated)
    return options


def checked_options(label: str, declared: Mapping[str, Option], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options `given` for `label` in their types; raise `ValueError` for an unknown or a missing one too."""
    for key in given:
        if key not in declared:
            raise ValueError(f"{label} has no option {key!r}; {suggest(str(key), declared)}")
    checked = {key: declared[key].taken(f"{label}.{key}", value) for key, value in given.items()}
    if missing := [key for key, option in declared.items() if option.required and key not in given]:
        raise ValueError(f"{label} needs {', '.join(missing)}")
    return checked


def suggest(name: str, choices: Iterable[str]) -> str:
    """Return the advice on a misspelt name: the nearest one, or up to three that contain it, and the list.

    Of a long list only the choices that begin as the name does, up to its first underscore (``scipy_``), or else its
    beginning beside a name that is near.

    >>> suggest("nelder-mead", ["de", "nlopt_LN_NELDERMEAD"])
    "did you mean 'nlopt_LN_NELDERMEAD'? choices: de, nlopt_LN_NELDERMEAD"
    """
    listed = list(choices)
    if not listed:
        return "there are none"
    near = difflib.get_close_matches(name, listed, n=1)
    sought, *held = ("".join(c for c in each.casefold() if c.isalnum()) for each in (name, *listed))
    letters = dict(zip(listed, held, strict=True))
    alike = [choice for choice in listed if sought in letters[choice]] if len(sought) >= _TELLING else []
    if not near:
        # up to three that hold its letters and digits, or else the one whose own are nearest; where none is near, those
        # that begin as it does, if they are few: popsize is meant for population
        nearest = difflib.get_close_matches(sought, list(letters.values()), n=1)
        alike = alike[:3] or [choice for choice in listed if letters[choice] in nearest][:1]
        begin = [each for each in listed if len(sought) >= _TELLING and letters[each].startswith(sought[:_TELLING])]
        alike = alike or (begin if len(begin) <= _FEW else [])
    near += [choice for choice in alike if choice not in near] if not near or len(alike) == 1 else []
    library, apart, _ = name.partition("_")
    akin = [choice for choice in listed if apart and choice.casefold().startswith(f"{library.casefold()}_")]
    named = akin if len(akin) > 1 and len(listed) > _LONG else listed
    rest = f" and {len(named) - _BEGINNING} more" if near and len(named) > _LONG else ""
    named = named[:_BEGINNING] if rest else named
    meant = f"did you mean {' or '.join(repr(choice) for choice in near)}? " if near else ""
    return f"{meant}choices: {', '.join(named)}{rest}"


def coerce(label: str, value: Any, kind: Any) -> Any:
    """Return `value` in the type `kind`, where that loses nothing (1e4 is an integer); else raise `ValueError`."""
    kind = written_out(kind)
    origin, args = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin in (Union, types.UnionType):
        return _coerce_union(label, value, args)
    if origin is Literal:
        word = shown(value) if isinstance(value, list | tuple | dict) else str(value)
        for choice in args:  # 4.0 and the text 4 are the choice 4
            if str(choice) == word or (choice == value and not isinstance(value, bool)):
                return choice
        raise ValueError(f"{label}={shown(value)}: {suggest(word, [str(a) for a in args])}")
    if origin in LISTS or kind in LISTS:
        return _coerce_list(label, value, origin or kind, args)
    if origin in (Mapping, dict):
        if not isinstance(value, Mapping):
            raise ValueError(f"{label}={shown(value)}: names with values are needed, such as '{{\"NAME\": 1}}'")
        inside = args[1] if args else Any
        return {name: coerce(f"{label}.{name}", item, inside) for name, item in value.items()}
    if isinstance(kind, type) and issubclass(kind, Enum):  # given itself, by its name, its value, or as rows write it
        if isinstance(value, kind):
            return value
        names = {f"{kind.__module__}:{kind.__qualname__}.{member.name}": member for member in kind}
        names |= {str(member.value): member for member in reversed(kind)} | {member.name: member for member in kind}
        if str(value) in names:
            return names[str(value)]
        raise ValueError(f"{label}={shown(value)}: {suggest(str(value), [member.name for member in kind])}")
    if isinstance(kind, type) and is_dataclass(kind):
        # given itself, or its fields by name; what is not given is as it declares
        if isinstance(value, str | int | float | list | tuple) or value is None:
            fields_of = suggest("", declared_options(kind))
            raise ValueError(f"{label}={shown(value)}: names with values are needed; {fields_of}")
        if not isinstance(value, Mapping):
            return value
        given = {key: item for key, item in value.items() if key != CLASS}
        held = checked_options(label, declared_options(kind), given)
        try:
            return kind(**held)
        except (TypeError, ValueError) as error:  # what it says of its fields together
            raise ValueError(f"{label}={shown(given)}: {error}") from error
    if isinstance(kind, type) and issubclass(kind, PurePath):
        if not isinstance(value, str | int | float | PurePath) or isinstance(value, bool):
            raise ValueError(f"{label}={shown(value)}: a path is needed")
        return value if isinstance(value, kind) else kind(str(value))
    if kind is bool and isinstance(value, bool | np.bool_):
        return bool(value)
    if kind is int and is_number(value) and float(value).is_integer():
        if abs(int(value)) > LARGEST_WHOLE:
            raise ValueError(f"{label}={shown(value)}: a whole number of at most {LARGEST_WHOLE} is needed")
        return int(value)
    if kind is float and is_number(value):
        return float(value) + 0.0  # of -0.0 too
    if kind is str and isinstance(value, str | int | float) and not isinstance(value, bool):
        return str(value)
    if kind is str and callable(value):
        raise ValueError(f"{label}: a function in memory; a word is needed, FILE.py:NAME, its file and its name there")
    if kind in (bool, int, float, str):
        raise ValueError(f"{label}={shown(value)}: {_WORDS[kind]} is needed")
    _refuse_word(label, value, origin or kind)
    return value


CLASS = "class"  # what rows write beside the fields of an object: no field of Python is called so
_LEVELS, _ITEMS = 4, 20  # of a list in a message
LARGEST_WHOLE = 2**63 - 1  # what a column of a results table holds
_WORDS = {bool: "true or false", int: "a whole number", float: "a finite number", str: "a word"}


def _refuse_word(label: str, value: Any, kind: Any) -> None:
    """Refuse a word, number or flag where `kind` is a class whose objects nobody can type as one."""
    if not isinstance(value, str | int | float) or not isinstance(kind, type) or issubclass(kind, PathLike):
        return
    if issubclass(kind, Number) and is_number(value):
        return
    try:
        fits = isinstance(value, kind)
    except TypeError:  # a Protocol, a TypedDict: of those only that it is called can be seen
        fits = "__call__" not in vars(kind) or callable(value)
    if fits:
        return
    what = "a function" if kind is Callable else f"an object of {_type_name(kind)}"
    way = "to type it, annotate a Literal or an Enum and look it up in __init__"
    needed = f"{what}, which can be handed over in Python alone ({way}),"
    if kind.__module__ in ("builtins", "collections.abc") and issubclass(kind, Iterable):
        needed = "a list"
    raise ValueError(f"{label}={shown(value)}: {needed} is needed")


LISTS = (tuple, list, Sequence, np.ndarray)


def _coerce_list(label: str, value: Any, kind: Any, args: tuple[Any, ...]) -> Any:
    """Return a list in the `kind` that is annotated; of a tuple that says the type of each item, as many items."""
    items = value.replace(",", " ").split() if isinstance(value, str) else value
    if not isinstance(items, Iterable) or isinstance(items, Mapping):
        raise ValueError(f"{label}={shown(value)}: a list is needed")
    if kind is np.ndarray:  # of the floats or the whole numbers that are annotated
        scalar = next(iter(get_args(args[1])), None) if len(args) > 1 else None
        whole = isinstance(scalar, type) and issubclass(scalar, np.integer)
        if isinstance(items, np.ndarray) and (whole or items.dtype.kind not in "iu"):
            return items
        try:
            floats = np.array([float(item) if is_number(item) else item for item in items], dtype=float)
        except (TypeError, ValueError):
            raise ValueError(f"{label}={shown(items)}: a list of finite numbers is needed") from None
        if whole and not np.array_equal(floats, np.rint(floats)):
            raise ValueError(f"{label}={shown(items)}: a list of whole numbers is needed")
        return floats.astype(scalar) if whole else floats
    if kind is Sequence and not isinstance(items, Sequence):
        raise ValueError(f"{label}={shown(value)}: a list is needed")
    kinds = [arg for arg in args if arg is not Ellipsis]
    if kind is tuple and kinds and Ellipsis not in args:
        items = list(items)
        if len(items) != len(kinds):
            raise ValueError(f"{label}={shown(value)}: a list of {len(kinds)} is needed")
        return tuple(coerce(label, item, each) for item, each in zip(items, kinds, strict=True))
    checked = [coerce(label, item, kinds[0]) for item in items] if kinds else list(items)
    return tuple(checked) if kind is tuple else checked if kind is list else items


def dataclass_of(kind: Any) -> Any:
    """Return the dataclass that is annotated, alone or as one of several types; None where there is none."""
    return next((each for each in _kinds(kind) if isinstance(each, type) and is_dataclass(each)), None)


def _coerce_union(label: str, value: Any, kinds: tuple[Any, ...]) -> Any:
    if value is None and type(None) in kinds:
        return None
    errors = []
    for kind in kinds:
        if kind is type(None):
            continue
        try:
            return coerce(label, value, kind)
        except ValueError as error:
            errors.append(str(error))
    begin, end = f"{label}={shown(value)}: ", " is needed"
    needs = [one.removeprefix(begin).removesuffix(end) for one in errors]
    if any(f"{begin}{need}{end}" != one for need, one in zip(needs, errors, strict=True)):
        raise ValueError(errors[0])
    first, *others = dict.fromkeys([*needs, *(["null"] if type(None) in kinds else [])])
    raise ValueError(f"{begin}{first}{end}{''.join(f', or {other}' for other in others)}")


def is_number(value: Any) -> bool:
    """Tell whether `value` is a finite number, and no truth value."""
    if not isinstance(value, Real) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond all floats
        return False


def shown(value: Any, inside: int = 0) -> str:
    """Return a value as it is typed; of a long list its first items, and no list that stands deep in others."""
    if value is None:
        return "null"
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple | list | dict) and inside == _LEVELS:
        return "…"
    if isinstance(value, tuple | list):
        more = ",…" if len(value) > _ITEMS else ""
        return "[" + ",".join(shown(item, inside + 1) for item in value[:_ITEMS]) + more + "]"
    if isinstance(value, dict):
        more = ",…" if len(value) > _ITEMS else ""
        pairs = (f"{key}: {shown(item, inside + 1)}" for key, item in islice(value.items(), _ITEMS))
        return "{" + ",".join(pairs) + more + "}"
    try:
        return shortened(str(value))
    except ValueError:  # Python writes no whole number of more than 4300 digits
        return "a number of thousands of digits"


def written_out(kind: Any) -> Any:
    """Return what a `type` statement (Python 3.12; NumPy's NDArray is one from 2.5 on) or a `NewType` stands for."""
    alias: Any = getattr(typing, "TypeAliasType", ())
    while get_origin(kind) is Annotated:
        kind = kind.__origin__
    while isinstance(kind, typing.NewType):
        kind = kind.__supertype__
    while isinstance(kind, alias) or isinstance(get_origin(kind), alias):
        kind = kind.__value__ if isinstance(kind, alias) else get_origin(kind).__value__[get_args(kind)]
    return kind


def _type_name(kind: Any) -> str:
    kind = written_out(kind)
    origin, args = get_origin(kind), get_args(kind)
    if origin is Literal:
        return "|".join(str(choice) for choice in args)
    if origin in (Union, types.UnionType):
        return " or ".join(_type_name(arg) for arg in args)
    if np.ndarray in (origin, kind):
        return "list of numbers"
    if origin in LISTS:
        return "list of " + " and ".join(_type_name(arg) for arg in args if arg is not Ellipsis)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return "|".join(member.name for member in kind)
    return "null" if kind is type(None) else getattr(kind, "__name__", str(kind))


_POINT = re.compile(r"(?<![\w.])\.(?=\d)")  # of .05, which JSON does not know
_TOKEN = re.compile(r"""(?:^|(?<=[\s,:\[{(]))(?:'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*")|\\.|.""", re.DOTALL)
_CLOSED_BY = {"[": "]", "{": "}", "(": ")"}


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
    if (bare := unquoted(word)) != word:  # without quotes it is shorter
        return bare
    if is_text(kind, word):
        return text
    for written in (word, _POINT.sub("0.", word)):
        with suppress(ValueError, RecursionError):
            return json.loads(written)
    if any(each in (int, float) for each in _kinds(kind)) and any(c in "0123456789" for c in word):
        for number in (int, float):  # as Python writes it, perhaps with underscores, a sign and zeros before it
            with suppress(ValueError):
                return number(word)
    return text


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
            try:
                if each is not type(None):
                    coerce("", read_word(word, each), each)
                    return False
            except ValueError:
                continue
        return False
    if isinstance(kind, type) and issubclass(kind, Enum):
        origin, args = Literal, tuple(member.value for member in kind)
        if word in kind.__members__:
            return True
    if origin is Literal:
        return word in args or all(isinstance(choice, str) for choice in args)
    if not isinstance(kind, type):
        return isinstance(origin, type) and issubclass(origin, PathLike)
    return issubclass(kind, str | PathLike)


def parts_of(text: str, separator: str = ",") -> list[str]:
    """Return the parts between separators that stand in no quotes and no brackets; [] for nothing."""
    parts: list[str] = []
    depth, at = 0, 0
    for token in _TOKEN.finditer(text):
        sign = token[0]
        depth = max(0, depth + (sign in _CLOSED_BY) - (sign in _CLOSED_BY.values()))
        if sign == separator and depth == 0:
            parts.append(text[at : token.start()])
            at = token.end()
    return [*parts, text[at:]] if text.strip() else []


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


def unquoted(word: str) -> str:
    """Return a word without the quotes around it, or as it is."""
    token = _TOKEN.match(word)
    if token is None or token[0] != word or len(word) < 2 or word[0] not in "'\"":
        return word
    if word[0] == '"':
        with suppress(ValueError):  # a control character, or an escape that JSON does not know
            return str(json.loads(word))
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
