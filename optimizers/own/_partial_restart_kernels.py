"""The partial restart of GA and PSO in Cong et al. 2008: half the population begins again, the best member stays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit, part
from calibench.optimizers.base import Array
from calibench.optimizers.own._random_kernels import State, index


@njit()
def half(values: Array, best: int, worst: bool, state: State) -> NDArray[np.int64]:
    """Return which half of the population begins again, never `best`: the `worst`, or any, all equally likely."""
    others = np.empty(values.shape[0] - 1, dtype=np.int64)
    count = 0
    for i in from_the_worst(values):
        if i != best:
            others[count] = i
            count += 1
    chosen = values.shape[0] // 2
    if not worst:
        for i in range(chosen):  # the first steps of a shuffle
            j = i + index(state, count - i)
            others[i], others[j] = others[j], others[i]
    return others[:chosen]


@njit()
def from_the_worst(values: Array) -> NDArray[np.int64]:
    """Return the indices of the largest value first; equal ones in their order, and what is no number last.

    NumPy's stable sort says the same, and takes the compiler three seconds.
    """
    size = values.shape[0]
    order, merged = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)
    for i in range(size):
        order[i] = i
    width = 1
    while width < size:
        for first in range(0, size, 2 * width):
            middle, end = min(first + width, size), min(first + 2 * width, size)
            a, b = first, middle
            for k in range(first, end):
                if (b < end) and ((a == middle) or _is_before(values[order[b]], values[order[a]])):
                    merged[k] = order[b]
                    b += 1
                else:
                    merged[k] = order[a]
                    a += 1
        order, merged = merged, order
        width *= 2
    return order


@part()
def _is_before(value: float, other: float) -> bool:
    return (value > other) | ((other != other) & (value == value))
