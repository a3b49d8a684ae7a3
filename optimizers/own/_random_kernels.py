"""Random numbers for compiled loops: 32 streams of xoshiro256++ (Blackman and Vigna 2021), seeded by NumPy.

NumPy's generators cannot be advanced from compiled code with the same bits on every platform; this one can. The streams
advance side by side in the SIMD lanes, about half a nanosecond a word, when a step asks for all it needs at once; the
first stream alone serves whoever needs a number now and then.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit

State = NDArray[np.uint64]
Words = NDArray[np.uint64]
Array = NDArray[np.float64]
F = TypeVar("F", bound=Callable[..., Any])

STREAMS = 32
WHOLE = 1 << 32  # values of a half word


def random_state(rng: np.random.Generator) -> State:
    """Return a fresh state, shape (4 * 32,), drawn from `rng`: the first words of all streams, then the second, ..."""
    return rng.integers(1, np.iinfo(np.uint64).max, size=4 * STREAMS, dtype=np.uint64)


def _wrapping(function: F) -> F:
    """Compile; where compilation is switched off, let words wrap in silence, as NumPy warns of it."""
    compiled = njit()(function)
    return compiled if compiled is not function else np.errstate(over="ignore")(function)


@_wrapping
def words(state: State, count: int) -> Words:
    """Advance all streams; return at least `count` random words, shape (multiple of 32,)."""
    drawn = np.empty(-(-count // STREAMS) * STREAMS, dtype=np.uint64)
    for first in range(0, drawn.shape[0], STREAMS):
        for i in range(STREAMS):
            s0, s1, s2, s3 = state[i], state[STREAMS + i], state[2 * STREAMS + i], state[3 * STREAMS + i]
            total = s0 + s3
            drawn[first + i] = ((total << np.uint64(23)) | (total >> np.uint64(41))) + s0
            shifted = s1 << np.uint64(17)
            s2 ^= s0
            s3 ^= s1
            s1 ^= s2
            s0 ^= s3
            state[i], state[STREAMS + i], state[2 * STREAMS + i] = s0, s1, s2 ^ shifted
            state[3 * STREAMS + i] = (s3 << np.uint64(45)) | (s3 >> np.uint64(19))
    return drawn


@njit()
def halves(state: State, count: int) -> NDArray[np.uint32]:
    """Advance all streams; return at least `count` random half words of 32 bits."""
    return words(state, (count + 1) // 2).view(np.uint32)


@njit()
def scaled(half: int, count: int) -> int:
    """Return the integer in [0, count) that a half word stands for; its bias, count / 2^32, no run could see."""
    return (int(np.int64(half)) * count) >> 32


@_wrapping
def uniform(state: State) -> float:
    """Advance the first stream; return a number in [0, 1) with 53 random bits."""
    s0, s1, s2, s3 = state[0], state[STREAMS], state[2 * STREAMS], state[3 * STREAMS]
    total = s0 + s3
    word = ((total << np.uint64(23)) | (total >> np.uint64(41))) + s0
    shifted = s1 << np.uint64(17)
    s2 ^= s0
    s3 ^= s1
    s1 ^= s2
    s0 ^= s3
    state[0], state[STREAMS], state[2 * STREAMS] = s0, s1, s2 ^ shifted
    state[3 * STREAMS] = (s3 << np.uint64(45)) | (s3 >> np.uint64(19))
    return float(word >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@_wrapping
def singles(state: State, count: int) -> Array:
    """Return `count` numbers as `uniform` would give them one by one, shape (count,)."""
    s0, s1, s2, s3 = state[0], state[STREAMS], state[2 * STREAMS], state[3 * STREAMS]
    drawn = np.empty(count)
    for i in range(count):
        total = s0 + s3
        word = ((total << np.uint64(23)) | (total >> np.uint64(41))) + s0
        shifted = s1 << np.uint64(17)
        s2 ^= s0
        s3 ^= s1
        s1 ^= s2
        s0 ^= s3
        s2 ^= shifted
        s3 = (s3 << np.uint64(45)) | (s3 >> np.uint64(19))
        drawn[i] = float(word >> np.uint64(11)) * (1.0 / 9007199254740992.0)
    state[0], state[STREAMS], state[2 * STREAMS], state[3 * STREAMS] = s0, s1, s2, s3
    return drawn


@njit()
def index(state: State, count: int) -> int:
    """Return a random integer in [0, count); its bias, count / 2^53, is far below what any run could see."""
    return int(uniform(state) * count)


@njit()
def between(state: State, lower: float, upper: float) -> float:
    """Return a number in [lower, upper]."""
    return min(lower + uniform(state) * (upper - lower), upper)
