"""Values of options as JSON, so that every difference between two runs is kept.

Numbers, texts, lists and mappings stay as they are, a dataclass becomes its fields; a large array, another object or a
nameless function is represented by a digest of its content. A value without such content, such as a random generator or
an open file, is refused.
"""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from hashlib import blake2b
from json import dumps
from pathlib import PurePath
from sys import modules
from typing import Any

import numpy as np

from calibench.core.options import CLASS

_WHOLE = 256  # numbers of an array that are still written out
_DEPTH = 12  # of objects in objects; deeper is taken for a circle


class NotPlain(ValueError):
    """A value that cannot be told from others of its kind."""


def plain(value: Any, depth: int = 0) -> Any:
    """Return `value` as JSON; equal values give equal JSON. Raises `NotPlain` for indistinguishable values."""
    if isinstance(value, Enum):
        return f"{_path_of(type(value))}.{value.name}"
    if isinstance(value, np.ndarray) and (value.size > _WHOLE or value.dtype.kind not in "biuf"):
        return _array(value, depth)
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, str | int | float | bool):
        return value
    if depth > _DEPTH:
        raise NotPlain("an object that contains itself")
    if isinstance(value, Mapping):
        named = {k if isinstance(k, str) else str(plain(k, depth + 1)): plain(v, depth + 1) for k, v in value.items()}
        if len(named) < len(value):
            raise NotPlain("two keys of a mapping that are written alike, such as 1 and '1'")
        return named
    if isinstance(value, list | tuple):
        return [plain(item, depth + 1) for item in value]
    if isinstance(value, set | frozenset):
        return sorted((plain(item, depth + 1) for item in value), key=_text)
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, complex | range | slice):
        return repr(value)
    if isinstance(value, bytes | bytearray):
        return f"bytes {_digest(bytes(value).hex())}"
    return _object(value, depth + 1)


def code_of(value: Any, depth: int = 0) -> Any:
    """Return the code of the function `value` as JSON: its bytecode, constants, defaults, and its closure."""
    closed = [cell.cell_contents for cell in value.__closure__ or ()]
    bound = [value.__defaults__ or (), value.__kwdefaults__ or {}, closed]
    return [_code(value.__code__, value.__doc__), plain(bound, depth + 1)]


def _object(value: Any, depth: int) -> Any:
    """Return a function or class by its module and name, and another object by its class and attributes."""
    if isinstance(value, type | types.BuiltinFunctionType | np.ufunc) or _is_importable(value):
        return _path_of(value)
    if isinstance(value, types.FunctionType):
        return f"{_path_of(value)} {_digest(code_of(value, depth))}"
    if isinstance(value, types.MethodType):
        return [plain(value.__self__, depth), value.__func__.__qualname__]
    if callable(getattr(value, "func", None)) and isinstance(getattr(value, "keywords", None), Mapping):  # a partial
        return [plain(part, depth) for part in (value.func, value.args, value.keywords)]
    options = getattr(value, "options", None)
    if isinstance(options, Mapping):
        return {"class": _path_of(type(value)), **plain(options, depth)}
    if hasattr(value, "__array__"):
        columns = [str(name) for name in getattr(value, "columns", ())]
        return f"{_path_of(type(value))} {_digest([columns, _array(np.asarray(value), depth)])}"
    held = _held(value)
    if held is None:
        raise NotPlain(f"a {type(value).__name__} has nothing to tell it from another")
    if is_dataclass(value) and {*held} == {f.name for f in fields(value) if f.init}:  # they are all that it is
        return {CLASS: _path_of(type(value)), **plain(held, depth)}
    return f"{_path_of(type(value))} {_digest(plain(held, depth))}" if held else _path_of(type(value))


def _held(value: Any) -> dict[str, Any] | None:
    """Return the attributes of an object; None where Python gives no access to its content."""
    slots = [
        name
        for kind in type(value).__mro__
        for name in ((kind.__dict__["__slots__"],) if isinstance(kind.__dict__.get("__slots__"), str)
                     else kind.__dict__.get("__slots__", ()))
        if name not in ("__dict__", "__weakref__")
    ]  # fmt: skip
    if not hasattr(value, "__dict__") and not slots:
        return None
    if isinstance(value, types.ModuleType):
        return {"module": value.__name__}
    return {**getattr(value, "__dict__", {}), **{name: getattr(value, name, None) for name in slots}}


def _array(array: np.ndarray[Any, Any], depth: int) -> str:
    if array.dtype.hasobject:
        told = _digest(plain(array.tolist(), depth + 1))
    else:
        told = blake2b(np.ascontiguousarray(array).tobytes(), digest_size=8).hexdigest()
    return f"array {array.dtype.str}{list(array.shape)} {told}"


def _code(code: types.CodeType, doc: str | None) -> list[Any]:
    constants = code.co_consts[1:] if doc is not None and code.co_consts[:1] == (doc,) else code.co_consts
    held = [_code(c, None) if isinstance(c, types.CodeType) else _constant(c) for c in constants]
    return [code.co_code.hex(), list(code.co_names), held]


def _constant(value: Any) -> str:
    if isinstance(value, frozenset):  # in an order that Python draws anew for each process
        return f"set {sorted(map(repr, value))}"
    return repr(value)


def _is_importable(value: Any) -> bool:
    found: Any = modules.get(getattr(value, "__module__", None) or "")
    for part in str(getattr(value, "__qualname__", "")).split("."):
        found = getattr(found, part, None)
    return found is value and value is not None and callable(value)


def _path_of(value: Any) -> str:
    return f"{value.__module__}:{value.__qualname__}" if hasattr(value, "__qualname__") else f"numpy:{value.__name__}"


def _digest(value: Any) -> str:
    return blake2b(_text(value).encode(), digest_size=8).hexdigest()


def _text(value: Any) -> str:
    return dumps(value, sort_keys=True, separators=(",", ":"))
