"""Who a run is: canonical names and options, the digest that names it, and the seeds that follow from the names.

Nothing here depends on the order of jobs, on the machine, or on Python's `hash`: an optimiser added to a sweep leaves
every other row as it was, to the last bit.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from hashlib import blake2b
from typing import Any

import numpy as np

from bedrock.registry import Option, Registry

_BASE = 2008  # the first word of every seed sequence


def name_of(thing: Any) -> str:
    """Return the registry name of a problem or optimiser, or where its class stands if it has none."""
    name = getattr(thing, "name", None)
    if isinstance(name, str):
        return name
    kind = thing if isinstance(thing, type) or hasattr(thing, "__qualname__") else type(thing)
    return f"{kind.__module__}:{kind.__qualname__}"


def options_of(thing: Any) -> dict[str, Any]:
    """Return the options of a problem or optimiser that JSON can hold: its `options`, or its dataclass fields."""
    options = getattr(thing, "options", None)
    if not isinstance(options, Mapping):
        if not dataclasses.is_dataclass(thing) or isinstance(thing, type):
            return {}
        options = {f.name: getattr(thing, f.name) for f in dataclasses.fields(thing) if f.init}
    plain = {str(key): _plain(value) for key, value in options.items()}
    return {key: value for key, value in plain.items() if value is not _NOT_PLAIN}


def canonical(options: Mapping[str, Any]) -> str:
    """Return options as JSON with sorted keys: equal options, equal text."""
    return json.dumps(options, sort_keys=True, separators=(",", ":"), default=list)


def chosen_options(registry: Registry[Any], name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that differ from what `name` declares, so that a new option with a default changes no id."""
    if name not in registry.names():  # a class by its path, or an object: all its options count
        return dict(options)
    declared = registry.options(name)
    return {k: v for k, v in options.items() if k not in declared or not _is_default(v, declared[k])}


def digest(*parts: Any) -> str:
    """Return 16 hexadecimal digits that stand for `parts`."""
    return blake2b(json.dumps(parts, sort_keys=True, default=list).encode(), digest_size=8).hexdigest()


def seed_sequence(*names: Any, repetition: int) -> np.random.SeedSequence:
    """Return the seed sequence of these names and the repetition."""
    return np.random.SeedSequence([_BASE, *(int(digest(name), 16) for name in names), repetition])


def _is_default(value: Any, option: Option) -> bool:
    return not option.required and canonical({"": value}) == canonical({"": option.default})


_NOT_PLAIN = object()


def _plain(value: Any) -> Any:
    """Return `value` as JSON has it: NumPy's numbers and arrays, lists and mappings of such too; else `_NOT_PLAIN`."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        items: Any = {str(key): _plain(item) for key, item in value.items()}
        return _NOT_PLAIN if any(item is _NOT_PLAIN for item in items.values()) else items
    if isinstance(value, list | tuple):
        listed = [_plain(item) for item in value]
        return _NOT_PLAIN if any(item is _NOT_PLAIN for item in listed) else listed
    return value if value is None or isinstance(value, str | int | float | bool) else _NOT_PLAIN
