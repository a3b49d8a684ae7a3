"""Costs that need not be known whole: a candidate is given up once a few samples say that it is not below its limit.

A term is never negative and rounding is monotone, so the cost over the first samples is a lower bound of the cost over
all, to the last bit. In a search that has settled the first two samples give up nine candidates in ten (full12, de);
looking again later, sample by sample or in stages, saved less than it took.
"""

from __future__ import annotations

import numpy as np

from bedrock.compiled import njit
from problems._planar_kernels import batch
from problems.base import Array

_FIRST = 2  # samples


@njit()
def batch_below(
    points: Array, limits: Array, samples: Array, template: Array, free: Array, polar: bool, legs: bool
) -> Array:
    """Return the costs, shape (k,), of `points`, shape (k, dim), that are below `limits`, shape (k,).

    Those have the bits of `batch`. Any other value is that of all samples or of the first, and not below its limit.
    """
    values = batch(points, samples[:_FIRST], template, free, polar, legs)
    staying = np.empty(points.shape[0], dtype=np.int64)
    left = 0
    for candidate in range(points.shape[0]):
        staying[left] = candidate
        left += not values[candidate] >= limits[candidate]  # what is not a number may still become one: it stays
    whole = batch(points[staying[:left]], samples, template, free, polar, legs)
    for i in range(left):
        values[staying[i]] = whole[i]
    return values
