"""Load numba's compiler in advance; that takes as long as loading ten kernels from the cache.

Kernels in the cache need none of it (`core.compilation.loading`).
"""

from __future__ import annotations

import sys
from typing import Any


def load_compiler() -> None:
    """Load now what the first compilation would load, so that forked children need not load it each.

    Nothing happens where numba was not imported, or nothing is to be compiled.
    """
    if "numba" not in sys.modules:
        return
    import numba
    from numba.core.registry import cpu_target

    settings: Any = numba.config
    if not settings.DISABLE_JIT:
        cpu_target.target_context.refresh()
