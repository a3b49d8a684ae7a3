"""Compile kernels with numba, strictly, into a cache that cannot be stale.

numba's own cache notices an edit of the file a kernel stands in, but not of the files that kernel calls. So the kernels
of a file are kept in a folder that is named by a digest of its code and of all it imports: another code, another
folder, and an edit elsewhere compiles nothing. `fastmath` is never used: results are the same bits on the same inputs.
Kernels in the cache need nothing of the compiler (`core.compilation.loading`), whose loading takes as long as that of
ten kernels.
"""

import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, TypeVar, cast, final

import numpy as np

from calibench.core.kept import cache_root
from calibench.core.sources import file_digest

_SEEN = "compiled"  # folder of empty files
F = TypeVar("F", bound=Callable[..., Any])


def njit() -> Callable[[F], F]:
    """Compile the function at its first call, without fast mathematics, and keep the machine code between processes.

    Write `@njit()`. With ``NUMBA_DISABLE_JIT=1`` in the environment the plain Python function runs instead.
    """
    return _compiling()


def part() -> Callable[[F], F]:
    """Compile likewise what only kernels call, without an entrance from Python (`TypeError`): that compiles sooner."""
    return _compiling(no_cpython_wrapper=True)


@cache
def exact(kernel: Any, *dimensions: int) -> Any:
    """Let `kernel` take nothing but float64 arrays of these numbers of dimensions; its first call compiles it.

    They must lie in C order, writable or not; `kernel` does not write to them. Anything else is a `TypeError`, and no
    new compilation: so a caller can hand over what it got, and look at it only if it is refused.
    """
    if not hasattr(kernel, "py_func"):
        return _Interpreted(kernel, dimensions)

    def compile_once(*_arrays: Any) -> Any:
        import numba

        # one compilation: numba hands a writable array to what takes one that is not
        kernel.compile(tuple(numba.types.Array(numba.float64, d, "C", readonly=True) for d in dimensions))
        kernel.disable_compile()
        return kernel  # numba calls it with the same arguments

    kernel._compile_for_args = compile_once  # numba calls it where nothing is compiled for some arguments
    return kernel


@final
@dataclass(frozen=True)
class _Interpreted:
    """What `exact` returns with ``NUMBA_DISABLE_JIT=1``."""

    kernel: Any
    dimensions: tuple[int, ...]

    def __call__(self, *arrays: Any) -> Any:
        for array, d in zip(arrays, self.dimensions, strict=True):
            if type(array) is not np.ndarray or array.dtype != np.float64 or array.ndim != d:
                raise TypeError(f"an array of float64 in {d} dimensions is needed")
        result = self.kernel(*arrays)
        return float(result) if isinstance(result, np.floating) else result


@contextmanager
def heard(compiling: Callable[[], None]) -> Iterator[None]:
    """Call `compiling` whenever this thread's process is about to compile a kernel that was not kept yet."""
    _LISTENERS.append(compiling)
    try:
        yield
    finally:
        _LISTENERS.remove(compiling)


def tell_compiling() -> None:
    """Tell who listens (`heard`) that something is compiled now."""
    for listener in _LISTENERS:
        listener()


_LISTENERS: list[Callable[[], None]] = []


def unseen(words: Iterable[str]) -> list[str]:
    """Return those of `words` that no process has noted, by `seen`, as compiled; a word tells the code too."""
    digests = ((word, blake2b(word.encode(), digest_size=12).hexdigest()) for word in words)
    return [word for word, digest in digests if not (cache_folder() / _SEEN / digest).exists()]


def seen(words: Iterable[str]) -> None:
    """Note that the code behind these words is compiled and kept for later processes."""
    folder = cache_folder() / _SEEN
    with suppress(OSError):  # a read-only home: the next process asks again
        folder.mkdir(exist_ok=True)
        for word in words:
            (folder / blake2b(word.encode(), digest_size=12).hexdigest()).touch()


def _compiling(**more: bool) -> Callable[[F], F]:
    import numba

    settings: Any = numba.config
    if settings.CPU_FEATURES is None and settings.CPU_NAME is None and settings.ENABLE_AVX:
        settings.CPU_FEATURES = full_width()
    from calibench.core.compilation.loading import close, keep, without_literals

    compile_: Any = numba.njit
    decorate = compile_(error_model="numpy", no_cfunc_wrapper=True, **more)  # nobody calls it from C

    def compiled(function: F) -> F:
        kept = keep(without_literals(decorate(function)))
        return cast(F, close(kept) if more else kept)

    return compiled


@cache
def full_width() -> str | None:
    """Return this processor's features without the one that leaves half of a 512-bit unit idle; None: no change.

    Compilers keep to 256 bits because the first processors with 512 slowed down for them. With candidates in the lanes
    the whole width takes a fifth off the time of a planar batch. No bit of a result depends on it.
    """
    from llvmlite.binding import get_host_cpu_features

    try:
        features = get_host_cpu_features()
    except RuntimeError:  # LLVM does not know this processor
        return None
    return f"{features.flatten()},-prefer-256-bit" if features.get("avx512f", False) else None


@cache
def cache_folder() -> Path:
    """Return the folder of all that is compiled, of these and of other versions of the sources."""
    folder = cache_root() / "kernels"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:  # a read-only home: compile anew in each process rather than fail
        return Path(tempfile.mkdtemp(prefix="calibench-"))


@cache
def kernel_folder(file: Path) -> Path:
    """Return the folder of what is compiled of a source file, by its code and that of all it imports."""
    return cache_folder() / f"{file.stem}-{file_digest(file)}"


def load_compiler() -> None:
    """Load now what the first compilation would load, so that forked children need not; nothing without numba."""
    if "numba" not in sys.modules:
        return
    import numba
    from numba.core.registry import cpu_target

    settings: Any = numba.config
    if not settings.DISABLE_JIT:
        cpu_target.target_context.refresh()
