"""Scan a batch of values, in one compiled pass, for what the gate must know of it."""

import math

from calibench.core.compilation.compiled import njit
from calibench.problems.base import Array

_NONE, _NOT_FINITE = -1, -2


@njit()
def scan(values: Array, best: float) -> int:
    """Return the index of the first value below `best`; -1 without one; -2 if any value is not finite."""
    below, finite = 0, 0
    for i in range(values.size):  # it counts and never leaves the loop early: so the compiler can vectorise it
        below += values[i] < best
        finite += abs(values[i]) < math.inf
    if finite < values.size:
        return _NOT_FINITE
    return _NONE if below == 0 else next_better(values, best, 0)


@njit()
def next_better(values: Array, best: float, first: int) -> int:
    """Return the index of the first value below `best` from `first` on; -1 without one."""
    for i in range(first, values.size):
        if values[i] < best:
            return i
    return _NONE


@njit()
def is_outside(x: Array, box: Array) -> bool:
    """Tell whether x is not a point of the box, shape (2, dim): of another size, not finite, or beyond a bound."""
    if x.size != box.shape[1]:
        return True
    inside = 0
    for i in range(x.size):
        inside += (box[0, i] <= x[i]) & (x[i] <= box[1, i]) & (abs(x[i]) < math.inf)
    return inside < x.size


@njit()
def outside_of(points: Array, box: Array) -> int:
    """Return how many of the points, shape (k, dim), are outside in the same sense."""
    count = 0
    for i in range(len(points)):
        count += is_outside(points[i], box)
    return count
