"""What the sweep's own machine has and every worker must have: the same versions, the same code, the user's files.

Versions and the digests of code are compared, and a worker that differs is refused: its rows would carry the id of a
run that is another one there. The sources of a user's classes (``FILE.py:Class``) with the local files that they import
are sent along, and put where their names and digests are the same as here. Where the worker finds the very same files
in the same place, as on this machine or a shared drive, it takes those: data files beside them are found too. A class
``package.module:Class`` must be installed where the workers are.
"""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

from calibench.bench.execution.run import Spec
from calibench.bench.provenance.code_digest import GATE
from calibench.bench.provenance.environment import provenance
from calibench.bench.workers.packs import Pack
from calibench.core import sources, user_file

_NOT_IN_RUNS = ("python", "pandas", "pyarrow", "hydra-core")  # they compose and keep, and are no part of a run
OURS = ("calibench.problems", "calibench.optimizers", "calibench.bench.execution.run", *GATE)  # what a run goes through


@final
@dataclass(frozen=True)
class SourceFile:
    """A file of a user's: absolute path, the folder from which it is imported, what rows call it, its content."""

    path: str
    root: str
    name: str | None  # where it stands in our own folder; None elsewhere
    content: bytes


@final
@dataclass(frozen=True)
class Home:
    """Versions, digests of modules by name, a user's files, and Python's path of the sweep's own process."""

    versions: Mapping[str, str]
    code: Mapping[str, str]
    files: tuple[SourceFile, ...]
    path: tuple[str, ...]


def home_of(specs: Iterable[Spec]) -> Home:
    """Return what the runs `specs` need of this machine. Their classes were loaded here."""
    names = {name for spec in specs for name in (spec.problem, spec.optimizer) if ":" in name}
    own = {user_file.place_of(name) for name in names if user_file.is_file_path(name)}
    modules = {name.partition(":")[0] for name in names if not user_file.is_file_path(name)}
    files = tuple(
        SourceFile(str(path), str(sources.root_of(path)), sources.name_at_home(path), path.read_bytes())
        for path in sorted(_with_packages(own))
    )
    code = {module: _digest(module) for module in (*OURS, *sorted(modules))}
    return Home(_versions(), code, files, tuple(sys.path))


def difference(home: Home) -> str:
    """Return in words what this process has otherwise than `home`; "" where nothing. To be called after `settle`."""
    here = _versions()
    for package, wanted in home.versions.items():
        if wanted and here.get(package) != wanted:
            return f"it has {package} {here.get(package) or '(none)'}, here it is {wanted}"
    for module, wanted in home.code.items():
        try:
            found = _digest(module)
        except Exception as error:  # whatever a user's module raises as it is loaded
            return f"it cannot import {module}: {type(error).__name__}: {error}"
        if found != wanted:
            return f"its code of {module} is another than here"
    return ""


def settle(home: Home, folder: Path) -> dict[str, str]:
    """Put the user's files under `folder`, where they are not in place; return {path at home: path here}."""
    places: dict[str, str] = {}
    called: dict[Path, str] = {}
    roots = list(dict.fromkeys(file.root for file in home.files))
    settled = []
    for number, root in enumerate(roots):
        mine = [file for file in home.files if file.root == root]
        in_place = all(_is_here(file) for file in mine)
        top = Path(root) if in_place else (folder / str(number)).resolve()
        settled.append(str(top))
        for file in mine:
            path = top / Path(file.path).relative_to(root)
            places[file.path] = str(path)
            if in_place:
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(file.content)
            if file.name is not None:
                called[path] = file.name
    sources.call(called)
    sys.path[:] = dict.fromkeys([*sys.path, *settled, *(entry for entry in home.path if entry not in roots)])
    return places


def moved(pack: Pack, places: Mapping[str, str]) -> Pack:
    """Return the pack with its user's files where they are here."""
    jobs = tuple(
        replace(job, spec=replace(job.spec, problem=_moved(job.spec.problem, places),
                                  optimizer=_moved(job.spec.optimizer, places)))
        for job in pack.jobs
    )  # fmt: skip
    return replace(pack, jobs=jobs)


def _moved(name: str, places: Mapping[str, str]) -> str:
    if not user_file.is_file_path(name):
        return name
    file = str(user_file.place_of(name))
    return f"{places[file]}:{name.rpartition(':')[2]}" if file in places else name


def _is_here(file: SourceFile) -> bool:
    try:
        return Path(file.path).read_bytes() == file.content
    except OSError:
        return False


def _versions() -> dict[str, str]:
    found = json.loads(provenance()["versions"])
    python = f"{sys.version_info.major}.{sys.version_info.minor}"  # rows are the same within a minor version
    return {"Python": python, **{name: version for name, version in found.items() if name not in _NOT_IN_RUNS}}


def _digest(module: str) -> str:
    with user_file.no_bytecode():
        importlib.import_module(module)
    return sources.module_digest(module)


def _with_packages(files: Iterable[Path]) -> set[Path]:
    """Return `files`, the local ones that they import, and the ``__init__.py`` of the packages that these stand in."""
    found: set[Path] = set()
    left = list(files)
    while left:
        for path in sources.closure(left.pop()) - found:
            if sources.is_ours(path):
                continue
            found.add(path)
            folder = path.parent
            while (folder / "__init__.py").is_file() and folder != folder.parent:
                left.append(folder / "__init__.py")
                folder = folder.parent
    return found
