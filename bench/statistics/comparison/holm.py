"""Holm's step-down correction of several tests: none of all true hypotheses is refused with more than the level.

Source: Holm, Scand. J. Statistics 6 (1979). SciPy 1.17 has false-discovery control, which promises less, and no Holm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def holm(p: ArrayLike) -> NDArray[np.float64]:
    """Return adjusted p-values, shape (n,), of `p`, shape (n,); NaN (no test was made) stays NaN and counts for none.

    >>> holm([0.01, 0.04, 0.03]).round(3).tolist()
    [0.03, 0.06, 0.06]
    """
    given = np.asarray(p, dtype=float)
    tested = np.flatnonzero(~np.isnan(given))
    order = tested[np.argsort(given[tested], kind="stable")]
    stepped = np.maximum.accumulate(given[order] * np.arange(len(order), 0, -1))
    adjusted = np.full(given.shape, np.nan)
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted
