"""Random numbers for compiled loops: 32 streams of xoshiro256++ (Blackman and Vigna 2021), seeded by NumPy.

NumPy's generators cannot be advanced from compiled code with the same bits on every platform; this one can. The streams
advance side by side in the SIMD lanes, about half a nanosecond a word, when a step asks for all it needs at once; the
first stream alone serves whoever needs a number now and then.

The partial restart of GA and PSO in Cong et al. 2008: half the population begins again, the best member stays.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit, part

State = NDArray[np.uint64]
Words = NDArray[np.uint64]
Array = NDArray[np.float64]
F = TypeVar("F", bound=Callable[..., Any])

STREAMS = 32
WHOLE = 1 << 32  # values of a half word
_UNIT = 1.0 / 9007199254740992.0  # 2^-53


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
        out = drawn[first : first + STREAMS]
        for i in range(STREAMS):
            s0, s1, s2, s3 = state[i], state[STREAMS + i], state[2 * STREAMS + i], state[3 * STREAMS + i]
            a, s0, s1, s2, s3 = _step(s0, s1, s2, s3)
            out[i] = a
            state[i], state[STREAMS + i], state[2 * STREAMS + i], state[3 * STREAMS + i] = s0, s1, s2, s3
    return drawn


@part()
def _step(s0: Any, s1: Any, s2: Any, s3: Any) -> tuple[Any, Any, Any, Any, Any]:
    """Return the word of a state and the next state."""
    total = s0 + s3
    word = ((total << np.uint64(23)) | (total >> np.uint64(41))) + s0
    shifted = s1 << np.uint64(17)
    s2 ^= s0
    s3 ^= s1
    s1 ^= s2
    s0 ^= s3
    return word, s0, s1, s2 ^ shifted, (s3 << np.uint64(45)) | (s3 >> np.uint64(19))


@njit()
def halves(state: State, count: int) -> NDArray[np.uint32]:
    """Advance all streams; return at least `count` random half words of 32 bits."""
    return np.frombuffer(words(state, (count + 1) // 2), np.uint32)  # a view: `view` compiles for .4 s


@njit()
def scaled(half: int, count: int) -> int:
    """Return the integer in [0, count) that a half word stands for; its bias, count / 2^32, no run could see."""
    return (int(np.int64(half)) * count) >> 32


@_wrapping
def uniform(state: State) -> float:
    """Advance the first stream; return a number in [0, 1) with 53 random bits."""
    word, s0, s1, s2, s3 = _step(state[0], state[STREAMS], state[2 * STREAMS], state[3 * STREAMS])
    state[0], state[STREAMS], state[2 * STREAMS], state[3 * STREAMS] = s0, s1, s2, s3
    return float(word >> np.uint64(11)) * _UNIT


@_wrapping
def singles(state: State, count: int) -> Array:
    """Return `count` numbers as `uniform` would give them one by one, shape (count,)."""
    s0, s1, s2, s3 = state[0], state[STREAMS], state[2 * STREAMS], state[3 * STREAMS]
    drawn = np.empty(count)
    for i in range(count):
        word, s0, s1, s2, s3 = _step(s0, s1, s2, s3)
        drawn[i] = float(word >> np.uint64(11)) * _UNIT
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
