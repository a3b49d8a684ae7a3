"""The compiler's own start: what numba loads before the first kernel, as long as loading ten kernels takes."""

from __future__ import annotations

import sys
from typing import Any


def load_compiler() -> None:
    """Load now what the first kernel of a process would load, so that forked children have it and need not, each.

    Nothing happens where no kernel was imported, or none is to be compiled.
    """
    if "numba" not in sys.modules:
        return
    import numba
    from numba.core.registry import cpu_target

    settings: Any = numba.config
    if not settings.DISABLE_JIT:
        cpu_target.target_context.refresh()
