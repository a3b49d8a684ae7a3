"""A private class for one object, so that nobody who imports the public class can change the object.

``Evaluator._exhausted = lambda self: None`` would remove the budget from every gate. The gate of a run of foreign code
is made by a copy of the class: the same code, bound to a copy of the module's names, and named nowhere. The copy is of
the class as it was when this package was imported, so a change by one run does not reach the next.
"""

from __future__ import annotations

import builtins
import sys
from collections.abc import Callable
from types import FunctionType
from typing import Any, TypeVar

from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.guard.wall import walled

T = TypeVar("T")


def copier(kind: type[T]) -> Callable[[], type[T]]:
    """Return a function that makes a class like `kind`, which has no base; nobody else can replace its methods."""
    own_names = dict(vars(sys.modules[kind.__module__]))
    own_builtins = dict(vars(builtins))  # `min` too is a name that can be given another meaning
    slots = ("__dict__", "__weakref__", *getattr(kind, "__slots__", ()))
    members = {name: value for name, value in vars(kind).items() if name not in slots}
    functions = [(name, _parts(value)) for name, value in members.items() if isinstance(value, FunctionType)]
    properties = [(name, _parts(value.fget)) for name, value in members.items() if isinstance(value, property)]

    def make() -> Any:
        names = {**own_names, "__builtins__": {**own_builtins}}
        copied = {**members}
        for name, parts in functions:
            copied[name] = _bound(parts, names)
        for name, parts in properties:
            copied[name] = property(_bound(parts, names))
        return type(kind.__name__, (), copied)

    wall: Callable[[], type[T]] = walled(make)
    return wall


def _parts(function: Any) -> tuple[Any, ...]:
    return function.__code__, function.__name__, function.__defaults__, function.__kwdefaults__


def _bound(parts: tuple[Any, ...], names: dict[str, Any]) -> FunctionType:
    code, name, defaults, by_name = parts
    function = FunctionType(code, names, name, defaults)
    if by_name:
        function.__kwdefaults__ = {**by_name}
    return function


private_evaluator = copier(Evaluator)
