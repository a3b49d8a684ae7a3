"""Which code made a row: a digest of the problem's, of the optimiser's, and of the gate between them.

``code_digest`` is three groups of twelve digits, ``problem.optimizer.gate``; where the problem is given files, their
content stands behind the first, ``problem-files.optimizer.gate``. It is no part of a run's id nor of its seed. A group
covers the module of the class and the local modules that it imports (`core.sources`); of what is defined in a notebook,
the bytecode; and the version of the library that is called. Files are options of type `Path`, unless the problem has a
`data_id`; a relative one is searched for in the working folder, then beside the module of the class. Of a folder all
files count, at any depth; hidden ones and `__pycache__` do not.
"""

import os
import stat
import sys
import types
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import lru_cache
from hashlib import blake2b, file_digest
from itertools import product
from pathlib import Path, PurePath
from typing import Any, TypedDict

from calibench.bench.provenance.environment import library_version
from calibench.bench.provenance.run_id import code_of, made_as, plain, seen_options
from calibench.core import sources

GATE = tuple(f"calibench.bench.gate.{name}" for name in ("evaluator", "calls", "face"))
PARTS = ("problem", "optimizer", "gate", "files")


def code_digest(problem: Any, optimizer: Any) -> str:
    """Return the digest of the code that runs `optimizer` on `problem`; a class has its object's."""
    return f"{digest_of_problem(problem)}.{digest_of_method(optimizer)}"


def digest_of_problem(problem: Any) -> str:
    """Return the group of the problem, with that of its files."""
    task, package = digest_of(problem), getattr(problem, "library", None)
    if isinstance(package, str):  # whose function it is
        task = _digest([task, package, library_version(package)])
    files = digest_of_files(problem)
    return f"{task}{files and f'-{files}'}"


def digest_of_method(optimizer: Any) -> str:
    """Return the groups of the optimiser and of the gate."""
    library = library_of(optimizer)
    return f"{_digest([digest_of(optimizer), library['library'], library['library_version']])}.{gate_digest()}"


def gate_digest() -> str:
    return _digest([sources.module_digest(module) for module in GATE])


def changed_parts(before: str, now: str) -> list[str]:
    """Return which parts differ between two digests: some of `PARTS`; files are no part of an old one."""
    parts = []
    for digest in (before, now):
        problem, *others = digest.split(".")
        code, _, files = problem.partition("-")
        parts.append([code, *others, files])
    return [part for part, a, b in zip(PARTS, *parts, strict=False) if a != b and (a and b)]


class Library(TypedDict):
    """The package whose code searches, and its version."""

    library: str
    library_version: str


def library_of(optimizer: Any) -> Library:
    """Return library and library_version: those of what the optimiser says, or of the package its class stands in."""
    kind = optimizer if isinstance(optimizer, type) else type(optimizer)
    library = getattr(optimizer, "library", None) or kind.__module__.partition(".")[0]
    library = "calibench" if library == "optimizers" else library
    return {"library": library, "library_version": library_version(library)}


def digest_of(thing: Any) -> str:
    """Return 12 digits for the code of a thing's class, and of the factory that made it."""
    made = made_as(thing)
    targets: list[Any] = [thing if isinstance(thing, types.FunctionType | type) else type(thing)]
    if made is not None:
        targets.append(made.factory)
    digests = set()
    for target in targets:
        inner = getattr(target, "func", target)  # a partial stands where its function does
        module = getattr(inner, "__module__", None) or type(inner).__module__
        digests.add(sources.module_digest(module) or _digest(_of_live_code(inner, module, set())))
    return digests.pop() if len(digests) == 1 else _digest(sorted(digests))


def _of_live_code(target: Any, module: str, seen: set[int]) -> list[Any]:
    """Return the code of a class or function without a source file: its functions, and the names that they use."""
    if id(target) in seen:
        return []
    seen.add(id(target))
    if not isinstance(target, type):
        return [_of_member(target, module, seen)]
    parts: list[Any] = [target.__qualname__]
    for base in target.__bases__:
        parts.append(sources.module_digest(base.__module__) or _of_live_code(base, module, seen))
    for name, value in sorted(vars(target).items()):
        if isinstance(value, types.FunctionType) or not name.startswith("__"):
            parts.append([name, _of_member(value, module, seen)])
    return parts


def _of_member(value: Any, module: str, seen: set[int]) -> Any:
    members = [value, *(getattr(value, part, None) for part in ("__func__", "fget", "func", "__wrapped__"))]
    functions = [one for one in members if isinstance(one, types.FunctionType)]
    if not functions:
        try:
            return plain(value)
        except Exception:  # whatever a foreign value does when it is looked at
            return type(value).__qualname__
    parts = []
    for function in functions:
        try:
            parts.append(code_of(function))
        except Exception:  # it closes over what cannot be told, or over nothing yet
            parts.append([function.__code__.co_code.hex()])
        for name in _names(function.__code__):
            used = function.__globals__.get(name)
            if isinstance(used, type | types.FunctionType) and used.__module__ == module:
                parts.append([name, _of_live_code(used, module, seen)])
            elif isinstance(used, types.ModuleType):
                file = sources.file_of(used.__name__)
                is_local = file is not None and sources.is_local(file) and used.__name__ in sys.modules
                parts.append([name, sources.module_digest(used.__name__) if is_local else ""])
            elif isinstance(used, int | float | str | tuple):
                parts.append([name, repr(used)])
    return parts


def _names(code: types.CodeType) -> list[str]:
    inner = [name for c in code.co_consts if isinstance(c, types.CodeType) for name in _names(c)]
    return sorted({*code.co_names, *inner})


def _digest(value: Any) -> str:
    return blake2b(repr(value).encode(), digest_size=6).hexdigest()


_DEPTH = 12  # of objects in objects, as in `plain`
_MOST = 10_000  # files and folders in a folder: to look through them takes some 50 ms, with every run


def digest_of_files(problem: Any) -> str:
    """Return 12 digits for the content of the files that the options of `problem` name; '' where none is there."""
    if isinstance(problem, type) or getattr(problem, "data_id", None) is not None:
        return ""
    made = made_as(problem)
    options = seen_options(problem) if made is None else made.arguments
    home = sources.file_of(type(problem).__module__)
    digests = []
    for path in _paths(options):
        places = [Path(path), *([] if home is None else [home.parent / path])]
        for is_folder, place in product((False, True), places):
            with suppress(OSError):
                if is_folder and place.is_dir():
                    digests.append(_digest_of_folder(place.absolute(), _files_of(place)))
                    break
                if not is_folder and place.is_file():
                    status = place.stat()
                    digests.append(_digest_of_file(place.absolute(), status.st_size, status.st_mtime_ns))
                    break
    return blake2b("".join(digests).encode(), digest_size=6).hexdigest() if digests else ""


def _paths(value: Any, depth: int = 0) -> Iterator[PurePath]:
    if isinstance(value, PurePath):
        yield value
    elif depth < _DEPTH:
        if isinstance(value, Mapping):
            inner = [value[key] for key in sorted(value, key=str)]
        elif is_dataclass(value) and not isinstance(value, type):
            inner = [getattr(value, field.name, None) for field in fields(value)]
        else:
            inner = list(value) if isinstance(value, list | tuple) else []
        for each in inner:
            yield from _paths(each, depth + 1)


def _files_of(folder: Path) -> tuple[tuple[str, int, int], ...]:
    """Return name, size and time of all files in a folder, sorted; a folder that links lead to again counts once."""
    found: list[tuple[str, int, int]] = []
    entries, seen = 0, set[tuple[int, int]]()
    for inside, folders, files in os.walk(folder, followlinks=True):
        about = os.stat(inside)
        new = (about.st_dev, about.st_ino) not in seen
        seen.add((about.st_dev, about.st_ino))
        folders[:] = sorted(name for name in folders if new and name[0] != "." and name != "__pycache__")
        shown = [Path(inside, name) for name in files if new and name[0] != "."]
        entries += len(folders) + len(shown)
        if entries > _MOST:
            raise ValueError(
                f"the folder {folder} holds more than {_MOST} files and folders, too many to notice a change in; "
                "let an option name the folder of the data alone, or give the problem a data_id"
            )
        for path in shown:
            with suppress(OSError):  # a link to nothing
                status = path.stat()
                if stat.S_ISREG(status.st_mode):
                    found.append((path.relative_to(folder).as_posix(), status.st_size, status.st_mtime_ns))
    return tuple(sorted(found))


@lru_cache(maxsize=64)
def _digest_of_folder(folder: Path, files: tuple[tuple[str, int, int], ...]) -> str:
    digest = blake2b(digest_size=12)
    for name, size, changed in files:
        try:
            content = _digest_of_file(folder / name, size, changed)
        except OSError:
            content = ""
        digest.update(f"{name}\0{content}\0".encode("utf-8", "surrogateescape"))
    return digest.hexdigest()


@lru_cache(maxsize=_MOST)
def _digest_of_file(file: Path, size: int, changed: int) -> str:
    with file.open("rb") as stream:
        return file_digest(stream, lambda: blake2b(digest_size=12)).hexdigest()
