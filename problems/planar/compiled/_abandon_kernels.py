"""Early abandonment: a candidate is given up as soon as its partial sum is above its limit.

A term is never negative and rounding is monotone, so the cost over the first samples is a lower bound of the cost over
all, to the last bit. In a search of de that has settled the first four samples, one for each running sum of `batch`,
give up nine candidates in ten; looking again later, sample by sample or in stages, saved less than it took.
"""

from __future__ import annotations

import numpy as np

from calibench.core.compilation.compiled import njit
from calibench.problems.base import Array
from calibench.problems.planar.compiled._closed_loop_kernels import batch

_FIRST = 4  # samples


def screen(packed: Array) -> Array:
    """Return what `batch` needs besides the candidates to take the first samples only."""
    few = packed.copy()
    few[0, 0] = min(few[0, 0], _FIRST)
    few.flags.writeable = False
    return few


@njit()
def batch_below(points: Array, limits: Array, packed: Array, few: Array) -> Array:
    """Return the costs, shape (k,), of `points`, shape (k, dim), that are below `limits`, shape (k,).

    Those have the bits of `batch`. Any other value is that of all samples or of the first `few`, and not below its
    limit.
    """
    values = batch(points, few)
    staying = np.empty(points.shape, dtype=np.float64)
    at = np.empty(points.shape[0], dtype=np.int64)
    left = 0
    for candidate in range(points.shape[0]):
        if not values[candidate] >= limits[candidate]:  # what is not a number may still become one: it stays
            for c in range(points.shape[1]):
                staying[left, c] = points[candidate, c]
            at[left] = candidate
            left += 1
    whole = batch(staying[:left], packed)
    for i in range(left):
        values[at[i]] = whole[i]
    return values
