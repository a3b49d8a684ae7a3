"""Public names of a package: loaded when they are first asked for, so that a start pays for what it uses, and listed.

`dir()` of a package, and so the tab key, shows what its ``__all__`` says and no import of its own.
"""

from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from typing import Any


def public_names(names: Collection[str]) -> Callable[[], list[str]]:
    """Return a ``__dir__`` for a package whose ``__all__`` is `names`."""
    return lambda: sorted(names)


def loader(package: str, homes: Mapping[str, str], modules: Collection[str] = ()) -> Callable[[str], Any]:
    """Return a ``__getattr__`` for `package`; `homes` is public name -> the module of the package that has it.

    `modules` are those of the package that are loaded when they are asked for as its attributes.
    """

    def load(name: str) -> Any:
        if name in modules:
            return import_module(f"{package}.{name}")
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{homes[name]}"), name)

    return load
