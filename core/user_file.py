"""A class or function in a user's own file: ``./mine.py:Class``.

A file is named in rows as it would be imported: by its file name, and inside a package (folders with ``__init__.py``)
by its path from the top of the package. So the name depends neither on the folder one stands in nor on the machine.
The folder from which it is imported goes to the end of `sys.path`: its neighbours can be imported, and of a name that
Python or an installed package has too, theirs is taken, since they import it as well. A neighbour of such a name that
the file means (it has what the file takes from it) is refused.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path
from types import ModuleType

from calibench.core import sources

_SAFE, _OURS = "PYTHONSAFEPATH", "calibench"
_LOADED: dict[Path, ModuleType] = {}
_KEPT: list[None] = []  # not empty: what is loaded is kept, whatever has become of its file


def is_file_path(name: str) -> bool:
    """Tell whether `name` is FILE.py:NAME."""
    return name.rpartition(":")[0].endswith(".py")


def classes_beside(name: str) -> list[str]:
    """Return the public classes in the file ``NAME.py`` of the working folder, each as FILE.py:CLASS; none without one.

    The file is parsed, not run: nobody has asked for it yet.
    """
    file = Path(f"{name}.py")
    try:
        tree = ast.parse(file.read_bytes()) if name.isidentifier() and file.is_file() else None
    except (OSError, SyntaxError, ValueError):
        return []
    found = [node.name for node in tree.body if isinstance(node, ast.ClassDef)] if tree else []
    return [f"{file}:{one}" for one in found if not one.startswith("_")]


def place_of(name: str) -> Path:
    """Return the file of FILE.py:NAME, absolute."""
    file = Path(name.rpartition(":")[0])
    return file if file in _LOADED else file.expanduser().resolve()  # which asks the system for each folder above it


def told_name(file: Path) -> str:
    """Return what rows call `file`: its path from where it is imported, such as ``mine.py`` or ``package/mine.py``."""
    return file.relative_to(sources.root_of(file)).as_posix()


def load(file: Path) -> ModuleType:
    """Return the module of `file`, loaded anew where it, or a local file it imports, has changed.

    What the import sets in the process acts in runs of its classes alone (`core.own_state`).
    Raises `ImportError` where a module that it imports by name is another file's, and what the file itself raises.
    """
    known = _LOADED.get(file)
    if known is not None:
        if _KEPT:
            return known
        files = sources.closure(file)  # a tenth of a second where it imports much
        if not sources.changed(files):
            return known
        for name, module in list(sys.modules.items()):
            if getattr(module, "__file__", None) and sources.file_of(name) in files:
                del sys.modules[name]
        sources.forget(files)
    root = str(sources.root_of(file))
    if root not in sys.path:
        sys.path.append(root)
    importlib.invalidate_caches()
    _check_hidden(file)
    from calibench.core.own_state import loaded_apart  # it needs NumPy, which most commands do without

    with no_bytecode():
        module = loaded_apart(lambda: _import(file))
    _check_neighbours(file)
    _LOADED[file] = module
    return module


def put_last(folder: str) -> None:
    """Let the modules in `folder` be imported after all others of their names; our own folder stays where it is."""
    if not sources.is_home(folder):
        sys.path[:] = [entry for entry in sys.path if entry not in ("", folder)] + [folder]


@contextmanager
def safe_children() -> Iterator[None]:
    """Let Python processes that are begun here not look first in the working folder, until they call `as_usual`."""
    os.environ.setdefault(_SAFE, _OURS)
    try:
        yield
    finally:
        as_usual()


def as_usual() -> None:
    """Let what this process begins look first beside its own script, as Python does."""
    if os.environ.get(_SAFE) == _OURS:
        del os.environ[_SAFE]


@contextmanager
def as_loaded() -> Iterator[None]:
    """Keep to the code that is loaded: a sweep does not change its code where a file is edited under it."""
    _KEPT.append(None)
    try:
        yield
    finally:
        _KEPT.pop()


@contextmanager
def no_bytecode() -> Iterator[None]:
    """Let Python write no bytecode: of two edits in one second it would take the first for the second."""
    before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        yield
    finally:
        sys.dont_write_bytecode = before


def _import(file: Path) -> ModuleType:
    """Import `file` by its own name where that leads to it, so that it is one module with what its neighbours see."""
    name = sources.dotted(file)
    if all(part.isidentifier() for part in name.split(".")):
        loaded = sys.modules.get(name)
        if loaded is not None and sources.file_of(name) == file:
            return loaded
        if loaded is None and _leads_to(name, file):
            return importlib.import_module(name)
    if "." in name:
        raise ImportError(f"another {name} stands before it on Python's path; rename the package or the file")
    alias = f"_own_{blake2b(str(file).encode(), digest_size=6).hexdigest()}"
    spec = importlib.util.spec_from_file_location(alias, file)
    if spec is None or spec.loader is None:
        raise ImportError("Python cannot load it")
    module = importlib.util.module_from_spec(spec)
    sys.modules[alias] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[alias]
        raise
    return module


def _leads_to(name: str, file: Path) -> bool:
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError, AttributeError):
        return False
    return spec is not None and spec.origin is not None and Path(spec.origin).resolve() == file


def _check_hidden(file: Path) -> None:
    """Refuse where a file imports a name that Python or a package has too, and means the file beside it."""
    for path in sources.closure(file):
        root = sources.root_of(path)
        for name, beside in sources.hidden_beside(path, root).items():
            tree, other = _parsed(path), _parsed(beside)
            both = sorted(_taken(tree, name) & _defined(other)) if tree and other else []
            if both:
                raise ImportError(
                    f"{path.name} takes {both[0]} from {name}, which is {beside} beside it, and also a module of "
                    "Python or of an installed package; rename the file"
                )


def _parsed(file: Path) -> ast.Module | None:
    try:
        return ast.parse(file.read_bytes())
    except (OSError, SyntaxError, ValueError):
        return None


def _taken(tree: ast.Module, module: str) -> set[str]:
    """Return the names that a source takes from `module`, by from-imports or with a point."""
    taken: set[str] = set()
    called: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == module and not node.level:
            taken |= {one.name for one in node.names}
        elif isinstance(node, ast.Import):
            called |= {one.asname or one.name for one in node.names if one.name == module}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in called:
            taken.add(node.attr)
    return taken


def _defined(tree: ast.Module) -> set[str]:
    """Return the names that a source defines at its top, not those that it imports."""
    named = {n.name for n in tree.body if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)}
    stored = (n for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store))
    return named | {n.id for n in stored}


def _check_neighbours(file: Path) -> None:
    """Refuse where a file beside `file` that it imports is not what Python has under that name."""
    for path in sources.closure(file) - {file}:
        name = sources.dotted(path)
        loaded = sources.file_of(name)
        if path.is_relative_to(sources.root_of(file)) and loaded is not None and loaded != path:
            raise ImportError(
                f"it imports {name}, which in this process is {loaded} and not {path}; "
                "rename one of the two, or run them one by one"
            )
