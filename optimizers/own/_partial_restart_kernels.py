"""The partial restart of GA and PSO in Cong et al. 2008: half the population begins again, the best member stays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit
from calibench.optimizers.base import Array
from calibench.optimizers.own._random_kernels import State, index


@njit()
def half(values: Array, best: int, worst: bool, state: State) -> NDArray[np.int64]:
    """Return which half of the population begins again, never `best`: the `worst`, or any, all equally likely."""
    others = np.empty(values.shape[0] - 1, dtype=np.int64)
    count = 0
    for i in np.argsort(-values, kind="mergesort"):  # stable, so that ties fall alike with compilation switched off
        if i != best:
            others[count] = i
            count += 1
    chosen = values.shape[0] // 2
    if not worst:
        for i in range(chosen):  # the first steps of a shuffle
            j = i + index(state, count - i)
            others[i], others[j] = others[j], others[i]
    return others[:chosen]
