"""Compile kernels with numba, strictly, into a cache that cannot be stale.

numba's own cache notices an edit of the file a kernel stands in, but not of the files that kernel calls. So the cache
folder is named by a digest of all our sources: another source, another folder. `fastmath` is never used: results are
the same bits on the same inputs.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])


def njit() -> Callable[[F], F]:
    """Compile the function at its first call, without fast mathematics, and keep the machine code between processes.

    Write `@njit()`. With ``NUMBA_DISABLE_JIT=1`` in the environment the plain Python function runs instead.
    """
    import numba

    settings: Any = numba.config
    settings.CACHE_DIR = str(_cache_folder())
    decorate: Any = numba.njit(cache=True, error_model="numpy")
    return cast(Callable[[F], F], decorate)


@cache
def _cache_folder() -> Path:
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "calibench"
    folder = root / _source_digest()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:  # a read-only home: compile anew in each process rather than fail
        return Path(tempfile.mkdtemp(prefix="calibench-"))


def _source_digest() -> str:
    root, digest = Path(__file__).resolve().parent.parent, blake2b(digest_size=8)
    for package in ("bedrock", "problems", "optimizers"):
        for source in sorted((root / package).glob("*.py")):
            digest.update(source.name.encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()
