"""Kernels from numba's cache without the compiler: what is compiled already needs nothing of what compiles.

numba's own cache loads, before it looks for a function, all that it can compile: NumPy in LLVM, and for its linear
algebra `scipy.linalg`. That takes as long as loading ten kernels, and is of use only where a kernel is not there yet:
numba's compiler loads it then by itself.
"""

from __future__ import annotations

from typing import Any, final

from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys


@final
class KernelCache(FunctionCache):
    """numba's cache of a function, which loads no compiler."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what is kept for arguments of these types; None where nothing is."""
        rtsys.initialize(target_context)  # the counting of references, which kept machine code is linked with
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]


def keep(function: Any) -> Any:
    """Let a function that numba compiles be kept between processes, and be loaded without the compiler."""
    if hasattr(function, "py_func"):  # else it is interpreted
        kept: Any = KernelCache
        function._cache = kept(function.py_func)  # what its `enable_caching` does; it offers no choice of cache
    return function
