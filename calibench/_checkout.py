"""In a checkout, `import bench` and `from calibench import bench` are one module, not two copies.

The folders bench/, problems/, ... of a checkout are the packages `calibench.bench`, `calibench.problems`, ... A script
that stands in the checkout may import them by their short names: those become other names of the same modules, so
that there is one registry and one cache. An installed wheel has no short names.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import CodeType, ModuleType
from typing import Any, final


def one_module(name: str) -> None:
    """Make the package that is being imported under its short `name` the module ``calibench.<name>``."""
    if "." in name:
        return
    whole = import_module(f"calibench.{name}")
    whole.__class__ = _Package
    sys.modules[name] = whole
    if not any(isinstance(finder, _ShortNames) for finder in sys.meta_path):
        sys.meta_path.insert(0, _ShortNames())


@final
class _Package(ModuleType):
    """A package that keeps its public names: `discrepancy.explain` is the function, whatever imports its module."""

    def __setattr__(self, name: str, value: object) -> None:
        """Ignore a submodule of the name of something public, which a second import would put in its place."""
        if not isinstance(value, ModuleType) or isinstance(self.__dict__.get(name, value), ModuleType):
            super().__setattr__(name, value)


@final
class _ShortNames(MetaPathFinder, Loader):
    """Find ``bench.store`` as ``calibench.bench.store``, for the packages that `one_module` was told of."""

    def __init__(self) -> None:
        self._specs: dict[str, ModuleSpec | None] = {}

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        top, dot, _ = name.partition(".")
        whole = sys.modules.get(f"calibench.{top}")
        if not dot or whole is None or sys.modules.get(top) is not whole:
            return None
        found = find_spec(f"calibench.{name}")
        if found is None:
            return None
        return ModuleSpec(name, self, origin=found.origin, is_package=found.submodule_search_locations is not None)

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = import_module(f"calibench.{spec.name}")
        self._specs[spec.name] = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give the module back its own spec: it has been executed under its whole name."""
        short = module.__spec__
        assert short is not None
        module.__spec__ = self._specs.pop(short.name)

    def get_code(self, name: str) -> CodeType | None:
        """Return the code of a module, for ``python -m bench``."""
        found = find_spec(f"calibench.{name}")
        loader: Any = found and found.loader
        code: CodeType | None = loader and loader.get_code(f"calibench.{name}")
        return code
