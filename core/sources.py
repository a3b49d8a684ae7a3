"""The digest of a module's code: its own source and the local modules that it imports.

Only what Python runs counts: comments, layout and docstrings do not. Imports are read from the source and not from what
happens to be loaded, so the digest is the same in every process. Installed packages (site-packages, the standard
library) are told by their versions elsewhere and are left out. Not seen: modules that are imported by a computed name,
and data files that the code reads (those that options name: `bench.provenance.code_digest`).
"""

import ast
import sys
import sysconfig
from collections.abc import Mapping, Set
from dataclasses import dataclass, replace
from functools import cache
from hashlib import blake2b
from importlib.util import find_spec
from os.path import isfile
from pathlib import Path
from typing import Any, NamedTuple, final

from calibench.core.kept import kept

_HOME = Path(__file__).resolve().parent.parent
_FACES = (_HOME / "calibench" / "__init__.py", _HOME / "__init__.py")  # of a checkout, and installed
# here and not when it is asked for: that may be within an import, and `sysconfig` imports what it reads
_STANDARD = tuple({Path(sysconfig.get_paths()[key]).resolve() for key in ("stdlib", "platstdlib")})
_OURS = ("core", "calibration", "problems", "optimizers", "discrepancy")  # what a run can go through, beside its gate
_READER = Path(__file__).read_bytes()  # another way to read a source is another meaning
_Specs = tuple[tuple[str, Any], ...]  # modules, and their specs: a module that is loaded again has another


class _Import(NamedTuple):
    """One import statement: module (absolute, dotted) and the name taken from it; none for ``import module``."""

    module: str
    name: str | None


@final
@dataclass(frozen=True)
class _Source:
    """A file as it was when its module was loaded: what it means, and what it imports."""

    loaded_as: Any  # the spec of the module: another one after a reload
    stamp: tuple[int, int]  # time and size of the file
    digest: str
    imports: tuple[_Import, ...]
    provides: dict[str, str]  # name -> the module it comes from, of what the file imports by name


_SEEN: dict[Path, _Source] = {}
# the files that a file leads to, how many modules were loaded when they were looked for, and theirs: a file of ours
# leads to hundreds, and a request asks a dozen times
_REACHED: dict[Path, tuple[frozenset[Path], int, _Specs]] = {}
_SENT: dict[Path, str] = {}  # a file that came from another machine -> what it is called there
_DIGESTS: dict[str, tuple[str, _Specs]] = {}  # one is asked for with every run, and its files cost a tenth of a second


def module_digest(module: str) -> str:
    """Return 12 hexadecimal digits for the code that `module` (dotted name) was loaded from; "" without a source."""
    if module in _DIGESTS:
        digest, loaded_as = _DIGESTS[module]
        if all(was is None or _spec(name) is was for name, was in loaded_as):
            return digest
    file = file_of(module)
    if file is None:
        return ""
    modules = dict.fromkeys((module, *map(dotted, closure(file))))
    _DIGESTS[module] = file_digest(file), tuple((name, _spec(name)) for name in modules)
    return _DIGESTS[module][0]


def file_digest(file: Path) -> str:
    """Return likewise 12 hexadecimal digits for the code of a file and of the local files that it leads to."""
    root, names = root_of(file), {}
    for path in closure(file):  # a path that is the same on every machine
        base = next((base for base in (_HOME, root) if path.is_relative_to(base)), None)
        names[path] = _SENT.get(path) or (dotted(path) if base is None else path.relative_to(base).as_posix())
    whole = blake2b(digest_size=6)
    for path in sorted(names, key=names.__getitem__):
        whole.update(f"{names[path]}:{_source(path).digest};".encode())
    return whole.hexdigest()


def closure(file: Path) -> frozenset[Path]:
    """Return `file` and all local files that it imports, directly or through others."""
    if file in _REACHED:
        files, modules, loaded_as = _REACHED[file]
        if len(sys.modules) == modules and all(_spec(name) is was for name, was in loaded_as):
            return files
    reached: set[Path] = set()
    leads: dict[tuple[_Import, Path], list[Path]] = {}
    ahead = [file]
    while ahead:
        path = ahead.pop()
        if path in reached:
            continue
        reached.add(path)
        root = root_of(path)
        for one in dict.fromkeys(_source(path).imports):
            if (one, root) not in leads:  # most files import what others do
                leads[one, root] = _files_of(one, root)
            ahead += leads[one, root]
    files = frozenset(reached)
    _REACHED[file] = files, len(sys.modules), tuple((name, _spec(name)) for name in map(dotted, files))
    return files


def hidden_beside(file: Path, root: Path) -> dict[str, Path]:
    """Return what `file` imports from its own folder by name, if Python or a package has a module of that name too."""
    tops = {one.module for one in _source(file).imports}
    by_top = {top: _search(top, root) for top in tops if top and "." not in top and _is_installed(top, root)}
    return {top: beside for top, beside in by_top.items() if beside is not None and not is_ours(beside)}


def name_at_home(file: Path) -> str | None:
    """Return the path of `file` inside our own folder; None for a file elsewhere."""
    return file.relative_to(_HOME).as_posix() if file.is_relative_to(_HOME) else None


def call(files: Mapping[Path, str]) -> None:
    """Give these files, which came from another machine, the names that `name_at_home` has there; so digests agree."""
    _SENT.update(files)


def file_of(module: str) -> Path | None:
    """Return the file of a loaded module; None where it has none (a notebook, a built-in)."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return _resolved(file) if isinstance(file, str) else None


@cache
def _resolved(file: str) -> Path | None:
    return Path(file).resolve() if isfile(file) else None


@cache
def root_of(file: Path) -> Path:
    """Return the folder from which `file` is imported: the first one upwards that is no package."""
    folder = file.parent
    while _is_package(folder) and folder != folder.parent:
        folder = folder.parent
    return folder


@cache
def _is_package(folder: Path) -> bool:
    return (folder / "__init__.py").is_file()


@cache
def dotted(file: Path) -> str:
    """Return the name that `file` has when it is imported from its root."""
    parts = file.relative_to(root_of(file)).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def forget(files: Set[Path]) -> None:
    """Read these files again when they are next asked for."""
    _DIGESTS.clear()
    _REACHED.clear()
    for path in files:
        _SEEN.pop(path, None)


def changed(files: Set[Path]) -> bool:
    """Tell whether the code of some of `files` differs from the code that was loaded."""
    loaded = {path: _SEEN[path] for path in files if path in _SEEN}
    return any(_stamp(path) != was.stamp and _read(path).digest != was.digest for path, was in loaded.items())


def _spec(module: str) -> Any:
    return getattr(sys.modules.get(module), "__spec__", None)


def _source(path: Path) -> _Source:
    spec = _spec(dotted(path))
    known = _SEEN.get(path)
    if known is None or (known.loaded_as is not spec and known.loaded_as is not None):
        known = _read(path)
    if known.loaded_as is not spec:
        known = replace(known, loaded_as=spec)
    _SEEN[path] = known
    return known


def _stamp(path: Path) -> tuple[int, int]:
    try:
        about = path.stat()
    except OSError:
        return 0, -1
    return about.st_mtime_ns, about.st_size


def _read(path: Path) -> _Source:
    stamp = _stamp(path)
    try:
        raw = path.read_bytes()
    except OSError:
        return _Source(None, stamp, "", (), {})
    package = dotted(path) if path.name == "__init__.py" else dotted(path).rpartition(".")[0]
    about = (raw, package.encode(), sys.version.encode(), _READER)
    digest, imports, provides = kept("sources", about, lambda: _meaning(raw, package))
    return _Source(None, stamp, digest, tuple(_Import(*one) for one in imports), provides)


def _meaning(raw: bytes, package: str) -> tuple[str, list[tuple[str, str | None]], dict[str, str]]:
    """Return the digest of a source, its imports as (module, name), and name -> module of what it imports by name."""
    try:
        tree = ast.parse(raw)
    except (SyntaxError, ValueError):  # a compiled extension, or what Python itself will refuse
        return blake2b(raw, digest_size=8).hexdigest(), [], {}

    def absolute(node: ast.ImportFrom) -> str:
        parts = package.split(".") if node.level and package else []
        base = parts[: len(parts) - (node.level - 1)] if node.level else []
        return ".".join([*base, *([node.module] if node.module else [])])

    imports: list[tuple[str, str | None]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports += [(name.name, None) for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            imports += [(absolute(node), name.name) for name in node.names]
    provides = {
        name.asname or name.name: absolute(node)
        for node in [*tree.body, *(one for block in tree.body if isinstance(block, ast.If) for one in block.body)]
        if isinstance(node, ast.ImportFrom)  # in a block as well: names that are loaded when they are asked for
        for name in node.names
    }
    for node in ast.walk(tree):  # without docstrings
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and type(first.value.value) is str:
                node.body = node.body[1:] or [ast.Pass()]
    return blake2b(ast.unparse(tree).encode(errors="replace"), digest_size=8).hexdigest(), imports, provides


def _files_of(one: _Import, root: Path) -> list[Path]:
    """Return the local files that an import statement, in a file that is imported from `root`, runs."""
    if _is_installed(one.module.partition(".")[0], root):
        return []
    target = _find(one.module, root)
    if target is None or not is_ours(target):
        parts = one.module.split(".")
        names = [".".join(parts[:i]) for i in range(1, len(parts) + 1)]
        names += [] if one.name is None else [f"{one.module}.{one.name}"]
        files = [_find(name, root) for name in names]
        return [file for file in files if file is not None and not is_ours(file) and is_local(file)]
    if target in _FACES:  # from calibench import problems
        whole = f"{one.module}.{one.name}"
        return [] if one.name is None or _find(whole, root) is None else _files_of(_Import(whole, None), root)
    if target.relative_to(_HOME).parts[0] not in _OURS and not target.match("_*_kernels.py"):
        return []
    if target.name != "__init__.py":
        return [target]
    if one.name in (None, "*"):
        return sorted(target.parent.rglob("*.py"))
    inside = _find(f"{one.module}.{one.name}", root)
    if inside is not None:
        return [inside]
    home = _source(target).provides.get(one.name or "")
    return [] if home is None else _files_of(_Import(home, one.name), root)


@cache
def _search(name: str, root: Path) -> Path | None:
    if not _begins_in(root, name.partition(".")[0]):
        return None
    parts = name.split(".")
    paths = [root.joinpath(*parts)]
    if root == _HOME and parts[0] == "calibench":  # a checkout, with links in calibench/ or without
        paths.append(root.joinpath(*parts[1:]))
    for path in paths:
        for file in (path.with_name(f"{path.name}.py"), path / "__init__.py"):
            if file.is_file():
                return file.resolve()
    return None


@cache
def _begins_in(root: Path, top: str) -> bool:
    return (root / top).is_dir() or (root / f"{top}.py").is_file()


def _find(name: str, root: Path) -> Path | None:
    """Return the file of the module `name`: beside the importing file, or where it was loaded from."""
    if not name:
        return None
    top, _, inside = name.partition(".")
    is_elsewhere = bool(inside) and not _is_package(root / top) and file_of(top) is not None  # a package of that name
    return (None if is_elsewhere else _search(name, root)) or file_of(name)


def _is_installed(top: str, root: Path) -> bool:
    """Tell whether the package or module `top` is installed, or Python's own: those stand before the folder `root`."""
    file = file_of(top)
    if file is None and _begins_in(root, top) and top not in sys.modules:
        try:
            spec = find_spec(top)
        except (ImportError, ValueError):
            spec = None
        file = _resolved(spec.origin) if spec is not None and spec.origin is not None else None
    return top in sys.stdlib_module_names if file is None else not is_local(file)


@cache
def is_ours(file: Path) -> bool:
    """Tell whether `file` is of this package."""
    if not file.is_relative_to(_HOME):
        return False
    parts = file.relative_to(_HOME).parts
    return parts[0] in (*_OURS, "bench", "conf", "calibench") or file in _FACES


def is_foreign(thing: Any) -> bool:
    """Tell whether the class of a problem or optimiser, or the module of a name, is not this package's."""
    file = file_of(thing if isinstance(thing, str) else type(thing).__module__)
    return file is None or not is_ours(file)


@cache
def is_local(file: Path) -> bool:
    """Tell whether `file` is neither installed nor of the standard library."""
    if {"site-packages", "dist-packages"} & set(file.parts):
        return False
    return not any(file.is_relative_to(folder) for folder in _STANDARD)
