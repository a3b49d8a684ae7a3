"""What the gate must know of a batch of values, found in one compiled pass."""

from __future__ import annotations

import math

from calibench.core.compiled import njit
from calibench.problems.base import Array

_NONE, _NOT_FINITE = -1, -2


@njit()
def survey(values: Array, best: float) -> int:
    """Return the index of the first value below `best`; -1 without one; -2 if any value is not finite."""
    below, finite = 0, 0
    for i in range(values.size):  # counts, not exits: so it runs in the lanes
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
