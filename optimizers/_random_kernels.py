"""A small generator for compiled loops: xoshiro256++ (Blackman and Vigna 2021), state of four words seeded by NumPy.

NumPy's generators cannot be advanced from compiled code with the same bits on every platform; this one can.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bedrock.compiled import njit

State = NDArray[np.uint64]


def random_state(rng: np.random.Generator) -> State:
    """Return a fresh state, shape (4,), drawn from `rng`."""
    return rng.integers(1, np.iinfo(np.uint64).max, size=4, dtype=np.uint64)


@njit()
def uniform(state: State) -> float:
    """Advance `state`; return a number in [0, 1) with 53 random bits."""
    total = state[0] + state[3]
    word = ((total << np.uint64(23)) | (total >> np.uint64(41))) + state[0]
    shifted = state[1] << np.uint64(17)
    state[2] ^= state[0]
    state[3] ^= state[1]
    state[1] ^= state[2]
    state[0] ^= state[3]
    state[2] ^= shifted
    state[3] = (state[3] << np.uint64(45)) | (state[3] >> np.uint64(19))
    return float(word >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit()
def index(state: State, count: int) -> int:
    """Return a random integer in [0, count); its bias, count / 2^53, is far below what any run could see."""
    return int(uniform(state) * count)


@njit()
def between(state: State, lower: float, upper: float) -> float:
    """Return a number in [lower, upper]."""
    return min(lower + uniform(state) * (upper - lower), upper)
