"""``bench doctor``: what a bug report needs, and what is wrong here: versions, compiled kernels, machine, extras."""

import os
import platform
import re
import shutil
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

from calibench.bench.commands.console import print_json
from calibench.bench.gate.processes import CAN_FORK
from calibench.bench.provenance.environment import library_version, provenance
from calibench.bench.words import split_flags
from calibench.core.compilation import lanes, shipped
from calibench.core.compilation.compiled import cache_folder, kernel_folder
from calibench.core.kept import cache_root
from calibench.core.process import libraries
from calibench.core.words import print_plain as print

_NEEDED = {  # the module of each package that a part of this one cannot do without
    "numpy": "numpy", "scipy": "scipy", "numba": "numba", "pandas": "pandas", "pyarrow": "pyarrow",
    "hydra-core": "hydra", "nlopt": "nlopt", "pygmo": "pygmo", "matplotlib": "matplotlib", "rich": "rich",
}  # fmt: skip
_FOR_DEVELOPERS = ("dev", "docs", "oracles")


def doctor(argv: list[str]) -> int:
    """Print it; return 1 where a package that is needed cannot be imported."""
    flags, words = split_flags(argv, ("--json",))
    if words:
        raise ValueError(f"doctor {words[0]}: it takes no words, only --json")
    found = examined()
    if "--json" in flags:
        print_json(found)
    else:
        for name, lines in found.items():
            for first, line in zip([name, *[""] * len(lines)], lines, strict=False):
                print(f"{first:<10}  {line}".rstrip())
    return 1 if found["wrong"] else 0


def examined() -> dict[str, list[str]]:
    """Return lines by what they are of; those of ``wrong`` say what cannot work here."""
    origin, home = provenance(), str(Path.home())
    commit = f", commit {origin['git_commit'][:10]}" if origin["git_commit"] else ""
    changed = " with changes" if origin["git_dirty"] else ""
    here = Path(__file__).resolve().parents[2]
    versions, wrong = [], []
    for package, module in _NEEDED.items():
        versions.append(f"{package} {library_version(package) or 'is missing'}")
        try:
            import_module(module)
        except Exception as error:  # whatever a broken library raises as it is loaded
            wrong.append(f"{package} cannot be imported: {type(error).__name__}: {error}".splitlines()[0])
    every = os.cpu_count() or 1
    mine = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else every
    try:
        memory = f", {os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') / 1e9:.0f} GB of memory"
    except (AttributeError, ValueError, OSError):  # no such question on this system
        memory = ""
    blas, disk = [], []
    for one in libraries().info():
        kind: dict[str, Any] = one
        threads = f"{kind['num_threads']} thread{'' if kind['num_threads'] == 1 else 's'}"
        blas.append(f"{kind['internal_api']} {kind['version'] or ''} ({Path(kind['filepath']).name}), {threads}")
    for what, folder in (("caches", cache_root()), ("working folder", Path.cwd())):
        there = next(each for each in (folder, *folder.parents) if each.exists())
        size = f", {_size([folder])}" if what == "caches" else ""
        disk.append(f"{what} {folder}{size}, {shutil.disk_usage(there).free / 1e9:.1f} GB free")
    # how many compiled functions of the present sources are kept, and those of other versions
    sources = [Path(lanes.__file__).resolve()]
    for room in ("calibration", "problems", "optimizers", "bench"):
        sources += (here / room).rglob("_*kernels.py")
    present = {kernel_folder(source) for source in sources}
    kept = sum(len([*folder.glob("*.nbc")]) for folder in present)
    others = [other for other in cache_folder().glob("*-*/") if other not in present]
    older = f"; {len(others)} folders of other versions, {_size(others)}, may be deleted" if others else ""
    kernels = f"{kept} compiled, {_size([*present])} in {cache_folder()}{older}"
    cores, forks = f"{mine} of {every} cores", "" if CAN_FORK else ", which cannot fork"
    found = {
        "calibench": [f"{version('calibench')} in {here}{commit}{changed}"],
        "Python": [f"{platform.python_version()} in {sys.prefix}"],
        "system": [f"{platform.platform()}, {cores}{memory}{forks}"],
        "libraries": [", ".join(versions)],
        "BLAS": blas,
        "kernels": [kernels, _shipped({folder.name for folder in present})],
        "extras": [*_extras()],
        "disk": disk,
        "wrong": wrong,
    }
    return {name: [line.replace(home, "~") for line in lines] for name, lines in found.items()}


def _shipped(present: set[str]) -> str:
    """Say whether machine code that came with the installation is used where none is compiled here."""
    if not (all_ := sorted(path.stem for path in shipped.FOLDER.glob("*.zip"))):
        return "none came with the installation"
    if (archive := shipped.archive()) is None:
        return f"none that came with the installation fits: it has {', '.join(all_)}"
    fitting = sum(name.partition("/")[0] in present for name in archive.namelist())
    return f"{fitting} came with the installation, for {shipped.level()}, and are loaded where none is compiled here"


def _extras() -> Iterator[str]:
    packages: dict[str, list[str]] = {}
    try:
        declared = requires("calibench") or []
    except PackageNotFoundError:
        declared = []
    for line in declared:
        if (name := re.match(r"[\w.-]+", line)) and (part := re.search(r"extra == ['\"]([\w-]+)", line)):
            packages.setdefault(part[1], []).append(name[0])
    missing = {
        extra: [name for name in names if not library_version(name)]
        for extra, names in packages.items()
        if extra not in _FOR_DEVELOPERS
    }
    yield f"here: {', '.join(extra for extra, lacks in missing.items() if not lacks) or 'none'}"
    for extra, lacks in missing.items():
        if lacks:
            yield f"{extra} lacks {', '.join(lacks)}: pip install 'calibench[{extra}]'"


def _size(folders: list[Path]) -> str:
    sizes = [file.stat().st_size for folder in folders for file in folder.rglob("*") if file.is_file()]
    return f"{sum(sizes) / 1e6:.1f} MB"
