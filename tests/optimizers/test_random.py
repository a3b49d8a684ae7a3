"""Random numbers against the generator's definition in whole numbers, and which half of a population begins again."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.optimizers.own._random_kernels import (
    STREAMS,
    WHOLE,
    from_the_worst,
    half,
    halves,
    index,
    random_state,
    scaled,
    uniform,
    words,
)  # fmt: skip


def xoshiro(s):
    """Yield the words of xoshiro256++ from its four words of state (Blackman and Vigna 2021, algorithm as defined)."""
    mask = 2**64 - 1

    def rotated(x, k):
        return ((x << k) | (x >> (64 - k))) & mask

    while True:
        yield (rotated((s[0] + s[3]) & mask, 23) + s[0]) & mask
        t = (s[1] << 17) & mask
        s[2] ^= s[0]
        s[3] ^= s[1]
        s[1] ^= s[2]
        s[0] ^= s[3]
        s[2] ^= t
        s[3] = rotated(s[3], 45)


def fresh(seed=0):
    return random_state(np.random.default_rng(seed))


def test_each_stream_is_xoshiro_from_its_own_state():
    state = fresh()
    twins = [xoshiro(s) for s in state.reshape(4, STREAMS).T.tolist()]
    for _ in range(2):  # a second call goes on where the first stopped
        drawn = words(state, 100)
        assert drawn.shape == (128,)
        assert drawn.tolist() == [next(twins[i]) for _ in range(4) for i in range(STREAMS)]


def test_the_first_stream_serves_single_numbers():
    state = fresh(1)
    twin, others = xoshiro(state[::STREAMS].tolist()), state.reshape(4, STREAMS)[:, 1:].copy()
    assert [uniform(state) for _ in range(50)] == [(next(twin) >> 11) * 2.0**-53 for _ in range(50)]
    assert (state.reshape(4, STREAMS)[:, 1:] == others).all()
    assert index(state, 1000) == int((next(twin) >> 11) * 2.0**-53 * 1000)


def test_half_words_are_the_words_in_two():
    drawn, twin = halves(fresh(2), 201), words(fresh(2), 101)
    assert len(drawn) >= 201
    assert sorted(drawn.tolist()) == sorted([*(twin % WHOLE).tolist(), *(twin // np.uint64(WHOLE)).tolist()])


def test_scaled_half_words_take_all_integers_equally_often():
    drawn = halves(fresh(3), 70_000)[:70_000]
    counts = np.bincount([scaled(half, 7) for half in drawn], minlength=7)
    assert len(counts) == 7
    assert ((counts - 10_000) ** 2 / 10_000).sum() < 22.5  # chi-square, 6 degrees of freedom, 1 in 1000
    assert scaled(np.uint32(0), 7) == 0
    assert scaled(np.uint32(WHOLE - 1), 7) == 6


def test_streams_are_not_correlated():
    drawn = (words(fresh(4), 32 * 4000) >> np.uint64(11)).reshape(-1, STREAMS) * 2.0**-53
    together = np.corrcoef(drawn.T)[np.triu_indices(STREAMS, 1)]
    assert np.abs(together).max() < 5 / np.sqrt(len(drawn))  # five standard deviations, 496 pairs
    np.testing.assert_allclose(drawn.mean(axis=0), 0.5, atol=5 * np.sqrt(1 / 12 / len(drawn)))


@pytest.mark.parametrize("size", [0, 1, 2, 3, 7, 8, 31, 200])
def test_the_worst_come_first_equal_ones_in_their_order_and_no_number_last(size):
    rng = np.random.default_rng(size)
    for few in (2, 5, 1000):  # many ties, some, hardly any
        values = rng.integers(few, size=size).astype(float)
        values[rng.random(size) < 0.1] = np.inf
        values[rng.random(size) < 0.1] = np.nan
        assert from_the_worst(values).tolist() == np.argsort(-values, kind="stable").tolist()


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
