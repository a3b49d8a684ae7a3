"""A class or function in a user's own file: ``./mine.py:Class``.

A file is named in rows as it would be imported: by its file name, and inside a package by its path from the top of the
package. The folder from which it is imported goes to the end of `sys.path`: its neighbours can be imported, and of a
name that Python or an installed package has too, theirs is taken. A neighbour of such a name that the file means (it
has what the file takes from it) is refused.
"""

import ast
import importlib
import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path
from types import ModuleType
from typing import cast

from calibench.core import sources

LOADED: dict[Path, ModuleType] = {}  # file -> what it defines
KEPT: list[None] = []  # not empty: what is loaded is kept, whatever has become of its file


def is_file_path(name: str) -> bool:
    """Tell whether `name` is FILE.py:NAME."""
    return name.rpartition(":")[0].endswith(".py")


def place_of(name: str) -> Path:
    """Return the file of FILE.py:NAME, absolute."""
    file = Path(name.rpartition(":")[0])
    return file if file in LOADED else file.expanduser().resolve()  # which asks the system for each folder above it


def told_name(file: Path) -> str:
    """Return what rows call `file`: its path from where it is imported, such as ``mine.py`` or ``package/mine.py``."""
    return file.relative_to(sources.root_of(file)).as_posix()


def load(file: Path) -> ModuleType:
    """Return the module of `file`, loaded anew where it, or a local file it imports, has changed.

    What the import sets in the process acts in runs of its classes alone (`core.own_state`).
    Raises `ImportError` where a module that it imports by name is another file's, and what the file itself raises.
    """
    known = LOADED.get(file)
    if known is not None:
        if KEPT:
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
    for path in sources.closure(file):  # a name that Python or a package has too, where the file beside is meant
        for name, beside in sources.hidden_beside(path, sources.root_of(path)).items():
            try:
                tree, other = (ast.parse(each.read_bytes()) for each in (path, beside))
            except (OSError, SyntaxError, ValueError):
                continue
            nodes = list(ast.walk(tree))
            from_it = [n for n in nodes if isinstance(n, ast.ImportFrom) and n.module == name and not n.level]
            used = {part.name for node in from_it for part in node.names}
            imports = (part for node in nodes if isinstance(node, ast.Import) for part in node.names)
            called = {part.asname or part.name for part in imports if part.name == name}
            points = (n for n in nodes if isinstance(n, ast.Attribute) and isinstance(n.value, ast.Name))
            used |= {node.attr for node in points if cast(ast.Name, node.value).id in called}
            defined = {
                n.name for n in other.body if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
            }
            defined |= {n.id for n in ast.walk(other) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
            if both := sorted(used & defined):
                raise ImportError(
                    f"{path.name} takes {both[0]} from {name}, which is {beside} beside it, and also a module of "
                    "Python or of an installed package; rename the file"
                )
    from calibench.core.own_state import loaded_apart  # it needs NumPy, which most commands do without

    with no_bytecode():
        module = loaded_apart(lambda: _import(file))
    for path in sources.closure(file) - {file}:  # a file beside it is to be what Python has under its name
        name = sources.dotted(path)
        loaded = sources.file_of(name)
        if path.is_relative_to(root) and loaded is not None and loaded != path:
            raise ImportError(
                f"it imports {name}, which in this process is {loaded} and not {path}; "
                "rename one of the two, or run them one by one"
            )
    LOADED[file] = module
    return module


@contextmanager
def as_loaded() -> Iterator[None]:
    """Keep to the code that is loaded: a sweep does not change its code where a file is edited under it."""
    KEPT.append(None)
    try:
        yield
    finally:
        KEPT.pop()


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
        try:
            spec = importlib.util.find_spec(name) if loaded is None else None
        except (ImportError, ValueError, AttributeError):
            spec = None
        if spec is not None and spec.origin is not None and Path(spec.origin).resolve() == file:
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
