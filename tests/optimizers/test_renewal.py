"""Which half of a population begins again."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.optimizers.own._random_kernels import half, random_state


@pytest.mark.parametrize("size", [2, 5, 8])
def test_the_worst_half_and_never_the_best(size):
    rng = np.random.default_rng(size)
    values = rng.permutation(size).astype(float)
    values[values == size - 1] = np.inf
    chosen = half(values, int(values.argmin()), True, random_state(rng))
    assert sorted(chosen) == sorted(np.argsort(values)[size - size // 2 :])


def test_the_best_stays_where_all_are_equal():
    state = random_state(np.random.default_rng(0))
    for worst in (True, False):
        assert 1 not in half(np.zeros(4), 1, worst, state)


def test_a_random_half_takes_all_others_equally_often():
    state, values = random_state(np.random.default_rng(1)), np.array([3.0, 0.0, 9.0, 4.0, 5.0, 6.0])
    times = np.zeros(6)
    for _ in range(5000):
        chosen = half(values, 1, False, state)
        assert len(set(chosen.tolist())) == 3
        times[chosen] += 1
    assert times[1] == 0
    np.testing.assert_allclose(np.delete(times, 1) / 5000, 3 / 5, atol=0.03)
