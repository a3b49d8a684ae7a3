"""Cosine and sine without a call into the C library, so that they too run with candidates in the SIMD lanes.

The argument less its quarter turns, r in -pi/4 .. pi/4, goes into both Taylor series, cut where a term is below a
quarter of the last bit. The errors are below one and a half units in the last place.
"""

from __future__ import annotations

import math

import numpy as np

from calibench.core.compilation.compiled import njit
from calibench.core.compilation.fused import fma

FAR = 1e6  # rad; from here on the reduction loses bits
_QUARTERS = 2.0 / math.pi
_HALF_PI, _HALF_PI_REST = math.pi / 2, 6.123233995736766e-17  # their sum is pi/2 to 107 bits
_S3, _S5, _S7, _S9, _S11, _S13, _S15, _S17 = (
    (-1.0) ** (k // 2) / math.factorial(k) for k in (3, 5, 7, 9, 11, 13, 15, 17)
)
_C2, _C4, _C6, _C8, _C10, _C12, _C14, _C16 = (
    (-1.0) ** (k // 2) / math.factorial(k) for k in (2, 4, 6, 8, 10, 12, 14, 16)
)


@njit()
def cos_sin(z: float) -> tuple[float, float]:
    """Return cos z and sin z of any z, rad."""
    if not abs(z) > FAR:
        return near_cos_sin(z)
    return (math.cos(z), math.sin(z)) if abs(z) < math.inf else (math.nan, math.nan)


@njit()
def near_cos_sin(z: float) -> tuple[float, float]:
    """Return cos z and sin z for |z| <= FAR, without a branch."""
    quarters = np.floor(z * _QUARTERS + 0.5)
    r = fma(-quarters, _HALF_PI_REST, fma(-quarters, _HALF_PI, z))  # the inner one is exact
    q = r * r
    s = fma(q, fma(q, fma(q, fma(q, fma(q, fma(q, fma(q, _S17, _S15), _S13), _S11), _S9), _S7), _S5), _S3)
    c = fma(q, fma(q, fma(q, fma(q, fma(q, fma(q, fma(q, _C16, _C14), _C12), _C10), _C8), _C6), _C4), _C2)
    sine, cosine = fma(r * q, s, r), fma(q, c, 1.0)
    turned = quarters - 4.0 * np.floor(0.25 * quarters)  # 0, 1, 2, 3
    odd = turned == 1.0 or turned == 3.0
    x, y = (sine if odd else cosine), (cosine if odd else sine)
    return (-x if turned == 1.0 or turned == 2.0 else x), (-y if turned >= 2.0 else y)
