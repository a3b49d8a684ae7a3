"""Machine code that came with the installation: read where this machine has compiled nothing yet, and never written.

`make dist` compiles the kernels of usual first steps for two levels of x86-64, and puts an archive for each level into
the wheel. Its name tells all that the code depends on beside the sources: another Python, numba, llvmlite or processor
finds none. An entry is named by the digest of its sources (`kernel_folder`) and by the function, and holds what numba
keeps, by the types of the arguments, the system and the level. A clone has no archives.
"""

import pickle
import sys
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile, ZipInfo

import llvmlite
import numba
from llvmlite.binding import get_host_cpu_features, get_process_triple

from calibench.core.compilation.compiled import full_width

FOLDER = Path(__file__).with_name("kernels")
_MODULES = "modules"  # the entry with the digests of problems and methods all of whose usual kernels are here
_V3 = frozenset(("avx2", "bmi", "bmi2", "cx16", "f16c", "fma", "lzcnt", "movbe", "popcnt", "sahf", "sse4.2", "xsave"))
_V4 = _V3 | {"avx512bw", "avx512cd", "avx512dq", "avx512f", "avx512vl"}
# LLVM's name -> what a processor must have, and what is changed of that level: its whole width is used (`full_width`)
LEVELS = {"x86-64-v4": (_V4, "-prefer-256-bit"), "x86-64-v3": (_V3, "")}


def kept_of(folder: str, function: str, types: Any, code: Any) -> Any:
    """Return what numba would have kept here of a function for these types; None where nothing fits."""
    if (entry := _read(f"{folder}/{function}")) is None:
        return None
    kept = pickle.loads(entry).get((types, (get_process_triple(), level(), LEVELS[level() or ""][1]), code))
    return None if kept is None else pickle.loads(kept)


@cache
def modules() -> frozenset[str]:
    """Return the digests of modules of problems and methods of which nothing usual is left to compile."""
    return frozenset((_read(_MODULES) or b"").decode().split())


@cache
def level() -> str | None:
    """Return the highest level of this processor; None where it has none, or numba is told to compile otherwise."""
    settings: Any = numba.config
    told = settings.CPU_NAME is not None or settings.CPU_FEATURES not in (None, full_width())
    if told or not settings.ENABLE_AVX or settings.DISABLE_JIT:
        return None
    try:
        has = {name for name, there in get_host_cpu_features().items() if there}
    except RuntimeError:  # LLVM does not know this processor
        return None
    return next((name for name, (needed, _) in LEVELS.items() if needed <= has), None)


@cache
def archive() -> ZipFile | None:
    """Return what came for this machine. It is in memory, as forks would share the place in an open file."""
    try:
        return ZipFile(BytesIO((FOLDER / _name(level())).read_bytes()))
    except (OSError, BadZipFile):
        return None


def pack(compiled: Path, level: str, modules: list[str], to: Path) -> None:
    """Write an archive of the cache folder `compiled` into the folder `to`: the same bytes for the same kernels."""
    with ZipFile(to / _name(level), "w", ZIP_DEFLATED) as packed:
        packed.writestr(ZipInfo(_MODULES), "\n".join(sorted(modules)))
        for index in sorted(compiled.glob("*-*/*.nbi")):
            with index.open("rb") as file:
                _version, (_stamp, names) = pickle.load(file), pickle.load(file)
            kept = {key: (index.parent / name).read_bytes() for key, name in names.items()}
            packed.writestr(ZipInfo(f"{index.parent.name}/{index.stem}"), pickle.dumps(kept), ZIP_DEFLATED)


def _name(level: str | None) -> str:
    python = f"py{sys.version_info.major}{sys.version_info.minor}{getattr(sys, 'abiflags', '')}"
    return f"{python}-numba-{numba.__version__}-llvmlite-{llvmlite.__version__}-{level}.zip"


def _read(name: str) -> bytes | None:
    found = archive()
    return found.read(name) if found is not None and name in found.NameToInfo else None
