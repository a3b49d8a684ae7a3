"""`fma(a, b, c)`: a b + c rounded once. Compiled it is one instruction, interpreted the C library's function.

A compiler left to contract products and sums by itself does so where it likes, and a batch gets other bits than a
single call. Written out, the fusion is part of the formula: the same bits in the lanes, alone, and without compiler.
"""

from __future__ import annotations

import ctypes
import sys
from typing import Any

import numpy as np
from numba.core import types
from numba.extending import intrinsic, overload

_in_c = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None).fma
_in_c.argtypes, _in_c.restype = [ctypes.c_double] * 3, ctypes.c_double


def fma(a: float, b: float, c: float) -> float:
    """Return a b + c, correctly rounded."""
    return np.float64(_in_c(a, b, c))


@intrinsic
def _instruction(_typing: Any, a: Any, b: Any, c: Any) -> Any:
    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), emit


@overload(fma)
def _compiled(a, b, c):  # type: ignore[no-untyped-def]  # numba compares this signature with the one it returns
    return lambda a, b, c: _instruction(a, b, c)  # type: ignore[call-arg]
