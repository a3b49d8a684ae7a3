"""Four neighbours at once: the bits of four single ones, compiled and interpreted alike."""

import numpy as np
import pytest

from calibench.core.compilation import lanes
from calibench.core.compilation.compiled import njit
from calibench.core.compilation.lanes import LANES


@njit()
def cross_in_a_kernel(x, places, f, chances, highest, low, high, y):
    return lanes.cross(x, 2, places[0], places[1], places[2], f, chances, 1, highest, low, high, 3, y)


@njit()
def exchange_in_a_kernel(x, a, b, point, ends, lengths, y):
    lanes.exchange(x, a, b, point, ends, lengths, 1, y, 0, 5)


def ways(kernel):
    return [kernel, getattr(kernel, "py_func", kernel)]


@pytest.mark.parametrize("places", [(4, 8, 12), (1, 1, 7), (9, 3, 12)])
@pytest.mark.parametrize("broken", [None, np.nan, np.inf])
def test_four_components_are_crossed_as_one_by_one(places, broken):
    rng = np.random.default_rng(3)
    x, highest = rng.normal(size=16), np.uint32(3 * 2**30)
    if broken is not None:
        x[5] = broken
    chances = np.array([9, 3 * 2**30, 3 * 2**30 + 1, 0, 2**32 - 1], dtype=np.uint32)
    low, high = np.full(7, -1.0), np.full(7, 1.0)
    for kernel in ways(cross_in_a_kernel):
        y = np.full(16, 7.0)
        outside = kernel(x, np.array(places), 0.7, chances, highest, low, high, y)
        a, b, c = places
        for k in range(LANES):
            mutant = x[a + k] + 0.7 * (x[b + k] - x[c + k])
            expected = mutant if chances[1 + k] <= highest else x[2 + k]
            assert y[2 + k].tobytes() == expected.tobytes()
        assert (np.delete(y, range(2, 6)) == 7.0).all()
        assert (outside != 0) == (not all(-1.0 <= v <= 1.0 for v in y[2:6]))


@pytest.mark.parametrize("inside", range(LANES + 1))
def test_each_of_four_components_may_be_the_one_outside(inside):
    x = np.zeros(16)
    low, high = np.full(7, -1.0), np.full(7, 1.0)
    if inside < LANES:
        high[3 + inside] = -0.5
    for kernel in ways(cross_in_a_kernel):
        outside = kernel(x, np.zeros(3, int), 0.5, np.zeros(5, np.uint32), np.uint32(0), low, high, np.ones(16))
        assert (outside != 0) == (inside < LANES)


def test_strings_of_four_numbers_exchange_what_is_behind_each_point():
    rng, lengths = np.random.default_rng(4), np.array([5, 1, 20, 53, 7, 3])
    ends = lengths.cumsum()
    x = rng.integers(0, 1 << np.tile(lengths, 2))
    first, second = ("".join(f"{n:0{b}b}" for n, b in zip(r, lengths, strict=True)) for r in (x[:6], x[6:]))
    for point in range(ends[-1] + 1):
        crossed = [first[:point] + second[point:], second[:point] + first[point:]]
        for kernel in ways(exchange_in_a_kernel):
            y = np.full(10, -1)
            kernel(x, 1, 7, point, ends, lengths, y)
            expected = [[int(s[ends[j] - lengths[j] : ends[j]], 2) for j in range(1, 5)] for s in crossed]
            assert y.tolist() == [*expected[0], -1, *expected[1], -1]
