"""Public names of a package that are loaded when they are first asked for: a start pays for what it uses."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from typing import Any


def loader(package: str, homes: Mapping[str, str], modules: Collection[str] = ()) -> Callable[[str], Any]:
    """Return a ``__getattr__`` for `package`; `homes` is public name -> the module of the package that has it.

    `modules` are those of the package that are loaded when they are asked for as its attributes.

    >>> load = loader("calibench.core", {"shown": "options"})
    >>> load("shown")(True)
    'true'
    """

    def load(name: str) -> Any:
        if name in modules:
            return import_module(f"{package}.{name}")
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{homes[name]}"), name)

    return load
