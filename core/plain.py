"""Values as JSON can hold them, and bounds of the JSON and YAML in a user's file.

A few hundred bytes of YAML whose aliases name aliases are gigabytes as lists; brackets that stand a thousand deep in
each other end Python's stack. Every reader of such a file asks here first. A refusal is one line.
"""

import json
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from math import isfinite, nan
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from calibench.core.words import DEEPEST


def finite(value: Any) -> Any:
    """Return what JSON can hold: NaN as null, NumPy's values as Python's, a dataclass as a mapping of its fields."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: finite(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def value_of(hint: Any, written: Any) -> Any:
    """Return the value of a type that `finite` wrote: the fields of a dataclass by name, null for no number as NaN.

    What is missing of a dataclass has its default; without one it is NaN, an empty tuple or mapping, or a dataclass
    of such. Raises `KeyError` for a missing word or code, `ValueError` for a code that is unknown.
    """
    kind, inner = get_origin(hint), get_args(hint)
    if kind in (Union, UnionType):
        return None if written is None else value_of(next(one for one in inner if one is not NoneType), written)
    if is_dataclass(hint) and isinstance(hint, type):
        hints, given, values = get_type_hints(hint), written or {}, {}
        for f in fields(hint):
            of = hints[f.name]
            if given.get(f.name) is not None:
                values[f.name] = value_of(of, given[f.name])
            elif f.default is MISSING and f.default_factory is MISSING:
                if of is str or (isinstance(of, type) and issubclass(of, Enum)):
                    raise KeyError(f.name)
                values[f.name] = value_of(of, None)
        return hint(**values)
    if kind is tuple and inner[-1] is not Ellipsis:
        return tuple(value_of(one, each) for one, each in zip(inner, written or [None] * len(inner), strict=True))
    if kind is tuple:
        return tuple(value_of(inner[0], each) for each in written or ())
    if kind is Mapping:
        return {str(key): value_of(inner[1], item) for key, item in (written or {}).items()}
    if hint is float:
        return nan if written is None else float(written)
    if isinstance(hint, type) and issubclass(hint, Enum):
        known = {member.value: member for member in hint}
        if written not in known:
            raise ValueError(f"{written!r} is no {hint.__name__}")
        return known[written]
    return written if hint is Any or kind is Literal else hint(written)


LARGEST_YAML = 100_000  # characters, with each alias written out: a study that ships has 2000
LONGEST_WORD_OF_YAML = 10_000  # of them in one word: all optimisers in a row have 3000


def json_of(text: str | bytes) -> Any:
    """Return what JSON holds. Raises `ValueError`, also where a parser gives up because it is nested too deep."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("is nested too deep") from None


def check_yaml(text: str, largest: int = LARGEST_YAML) -> None:
    """Raise `ValueError` for YAML nested too deep, or too large with its aliases; `yaml.YAMLError` for none at all."""
    import yaml

    size = 0  # of what stands before, written out
    sizes: dict[str, int] = {}  # of what has an anchor
    within: list[tuple[str | None, int]] = []  # anchors of what is open, and the size before it
    for event in yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
        before, anchor = size, getattr(event, "anchor", None)
        if isinstance(event, yaml.AliasEvent):
            if anchor not in sizes:
                raise ValueError(f"the alias *{anchor} stands inside of what it names, or names nothing")
            size += sizes[anchor]
        elif isinstance(event, yaml.ScalarEvent):
            size += 1 + len(event.value)
            if len(event.value) > LONGEST_WORD_OF_YAML:
                raise ValueError(f"a word has {len(event.value)} characters; at most {LONGEST_WORD_OF_YAML} are read")
        elif isinstance(event, yaml.CollectionStartEvent):
            size += 1
            within.append((anchor, before))
            sizes.pop(anchor or "", None)  # of the same name before
            if len(within) > DEEPEST:
                raise ValueError(f"lists and mappings stand more than {DEEPEST} deep in each other; no more is read")
            continue
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = within.pop()
        if anchor is not None:
            sizes[anchor] = size - before
        if size > largest:
            raise ValueError(f"has more than {largest} characters with its aliases written out; no more are read")
