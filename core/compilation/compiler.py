"""The compiler's own start: what numba loads before it compiles, as long as loading ten kernels takes.

Kernels that are kept need none of it (`core.compilation.loading`).
"""

from __future__ import annotations

import sys
from typing import Any


def load_compiler() -> None:
    """Load now what the first function that is compiled would load, so that forked children need not, each.

    Nothing happens where numba was not imported, or nothing is to be compiled.
    """
    if "numba" not in sys.modules:
        return
    import numba
    from numba.core.registry import cpu_target

    settings: Any = numba.config
    if not settings.DISABLE_JIT:
        cpu_target.target_context.refresh()
