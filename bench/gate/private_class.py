"""A class of its own for one object, so that nobody who imports the public class can change what the object does.

``Evaluator._exhausted = lambda self: None`` would take the wall from every gate. The gate of a run of foreign code is
made by a copy of the class: the same code, bound to a copy of the module's names, and named nowhere.
"""

from __future__ import annotations

import builtins
import sys
from types import FunctionType
from typing import Any, TypeVar

T = TypeVar("T")


def private_copy(kind: type[T]) -> type[T]:
    """Return a class like `kind`, which must have no base of its own, whose methods nobody else can replace."""
    names = dict(vars(sys.modules[kind.__module__]))
    names["__builtins__"] = dict(vars(builtins))  # `min` too is a name that can be given another meaning
    members = {name: _rebound(value, names) for name, value in vars(kind).items()}
    for name in ("__dict__", "__weakref__", *getattr(kind, "__slots__", ())):
        members.pop(name, None)
    copy: Any = type(kind.__name__, (), members)
    names[kind.__name__] = copy
    return copy  # type: ignore[no-any-return]


def _rebound(value: Any, names: dict[str, Any]) -> Any:
    if isinstance(value, property):
        return property(*(part and _rebound(part, names) for part in (value.fget, value.fset, value.fdel)))
    if not isinstance(value, FunctionType):
        return value
    rebound = FunctionType(value.__code__, names, value.__name__, value.__defaults__, value.__closure__)
    rebound.__kwdefaults__ = value.__kwdefaults__
    return rebound
