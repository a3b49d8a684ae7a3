"""`ga` as Cong et al. 2008 state it: the string, the tournament, the crossing point, the two bits, the renewal."""

from __future__ import annotations

import numpy as np
import pytest

from calibench import bench, optimizers, problems
from calibench.optimizers.own import _genetic_kernels as step
from calibench.optimizers.own._random_kernels import halves, random_state, scaled

LENGTHS = np.array([4, 1, 7, 3])
TOTAL = int(LENGTHS.sum())


@pytest.fixture
def state():
    return random_state(np.random.default_rng(5))


def strings(words):
    """Return individuals as the paper writes them: one string of 0 and 1 each."""
    return ["".join(f"{k:0{length}b}" for k, length in zip(row, LENGTHS, strict=True)) for row in words.tolist()]


def zeros_and_ones(pairs):
    """Return pairs of a string of zeros and one of ones."""
    words = np.zeros((2 * pairs, len(LENGTHS)), dtype=np.int64)
    words[1::2] = 2**LENGTHS - 1
    return words


def crossed(words, probability, by_parameter, state):
    """Return the children of neighbours, each of whom won a tournament once."""
    children = np.empty_like(words)
    step.cross(words, np.arange(len(words)), probability, by_parameter, LENGTHS, state, children)
    return children


def test_defaults_are_the_paper_s():
    ga = optimizers.make("ga")
    assert (ga.population, ga.precision, ga.tournament, ga.PCrossover, ga.PMutation, ga.NR) == (
        100, 1e-4, 4, 0.85, 0.15, 50,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"population": 1}, "ga.population=1: "),
        ({"precision": 0}, "ga.precision=0: "),
        ({"tournament": 0}, "ga.tournament=0: "),
        ({"tournament": 101, "rivals": "distinct"}, "ga.tournament=101: "),
        ({"PCrossover": 1.1}, "ga.PCrossover=1.1: "),
        ({"PMutation": -0.1}, "ga.PMutation=-0.1: "),
        ({"NR": 0}, "ga.NR=0: "),
        ({"coding": "grey"}, "ga.coding=grey: "),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        optimizers.make("ga", **options)
    with pytest.raises(ValueError, match=f"^{message}"):
        type(optimizers.make("ga"))(**options)  # not through the registry


def test_strings_of_table_5_s_box_have_189_bits():
    problem = problems.make("full12", error="J2")
    lengths = optimizers.make("ga").lengths(problem.upper - problem.lower)
    assert lengths.tolist() == [17] * 9 + [12] * 3  # 10 mm and .4 rad in steps of 1e-4


def test_a_precision_beyond_a_double_s_is_refused():
    with pytest.raises(ValueError, match=r"^ga\.precision=1e-16: .* 57 bits"):
        optimizers.make("ga", precision=1e-16).lengths(np.array([10.0, 1.0]))


@pytest.mark.parametrize("gray", [False, True])
def test_decoding_is_the_string_s_number_on_the_box(gray, state):
    lower, upper = np.array([-1.0, 0.0, 428.0, 0.1]), np.array([1.0, 5.0, 438.0, 0.3])
    words, points = np.empty((50, 4), dtype=np.int64), np.empty((50, 4))
    step.randomize(np.arange(50), words, LENGTHS, state)
    step.decode(words, gray, LENGTHS, step.scales(lower, upper, LENGTHS, 50), points)
    for row, point in zip(words.tolist(), points, strict=True):
        for j, length in enumerate(LENGTHS):
            bits = [int(bit) for bit in f"{row[j]:0{length}b}"]
            if gray:  # bit b of the number is the parity of the code's bits up to b
                bits = [sum(bits[: b + 1]) % 2 for b in range(length)]
            number = int("".join(map(str, bits)), 2)
            expected = lower[j] + number * (upper[j] - lower[j]) / (2**length - 1)
            assert point[j] == pytest.approx(expected, rel=1e-15)


def test_the_ends_of_the_box_are_reached():
    lower, upper = np.array([-5.0, 428.0, 239.0, -0.2]), np.array([5.0, 438.0, 249.0, 0.2])
    points = np.empty((2, 4))
    step.decode(zeros_and_ones(1), False, LENGTHS, step.scales(lower, upper, LENGTHS, 2), points)
    assert points.tolist() == [lower.tolist(), upper.tolist()]


def test_neighbours_of_a_gray_code_differ_in_one_bit():
    lengths, words = np.array([5]), np.arange(32)[:, None]
    points = np.empty((32, 1))
    step.decode(words, True, lengths, step.scales(np.zeros(1), np.full(1, 31.0), lengths, 32), points)
    order = np.argsort(points[:, 0])
    assert points[order, 0].tolist() == list(range(32))
    assert all((a ^ b).bit_count() == 1 for a, b in zip(order[:-1].tolist(), order[1:].tolist(), strict=True))


def test_random_strings_have_all_bits_equally_often(state):
    words = np.empty((4000, 4), dtype=np.int64)
    step.randomize(np.arange(4000), words, LENGTHS, state)
    ones = np.array([[int(bit) for bit in string] for string in strings(words)])
    assert ones.shape == (4000, TOTAL)
    np.testing.assert_allclose(ones.mean(axis=0), 0.5, atol=0.03)


@pytest.mark.parametrize("tournament", [1, 4])
def test_the_winner_is_the_best_of_its_tournament(tournament, state):
    values = np.random.default_rng(0).permutation(30).astype(float)
    twin_state = state.copy()
    winners = step.reproduce(values, tournament, False, state)
    drawn = halves(twin_state, 30 * tournament)[: 30 * tournament].reshape(30, tournament)
    for winner, row in zip(winners, drawn, strict=True):
        assert winner == min((scaled(half, 30) for half in row), key=lambda i: values[i])


def test_the_best_of_ten_wins_a_tournament_of_four_in_a_third_of_all(state):
    values = np.arange(10.0)
    wins = sum(np.count_nonzero(step.reproduce(values, 4, False, state) == 0) for _ in range(2000))
    assert wins / 20_000 == pytest.approx(1 - 0.9**4, abs=0.01)


def test_distinct_rivals_never_meet_themselves(state):
    wins = np.zeros(10)
    for _ in range(2000):
        wins += np.bincount(step.reproduce(np.arange(10.0), 4, True, state), minlength=10)
    assert wins[0] / 20_000 == pytest.approx(4 / 10, abs=0.01)
    assert wins[6] / 20_000 == pytest.approx(1 / 210, abs=0.002)  # only against the three worse ones
    assert not wins[7:].any()
    assert not step.reproduce(np.arange(10.0), 10, True, state).any()


def test_behind_one_point_a_pair_exchanges_its_bits(state):
    words = zeros_and_ones(1000)
    words = crossed(words, 1.0, False, state)
    told = strings(words)
    points = [string.count("0") for string in told[::2]]
    for point, first, second in zip(points, told[::2], told[1::2], strict=True):
        assert first == "0" * point + "1" * (TOTAL - point)
        assert second == "1" * point + "0" * (TOTAL - point)
    assert set(points) == set(range(1, TOTAL))  # never the whole string, never nothing


def test_crossover_by_parameter_has_a_point_in_each(state):
    words = zeros_and_ones(2000)
    words = crossed(words, 1.0, True, state)
    assert (words[::2] + words[1::2] == 2**LENGTHS - 1).all()
    for j, length in enumerate(LENGTHS):
        assert set(words[::2, j]) == {2**k - 1 for k in range(length + 1)}


def test_crossover_happens_with_its_probability(state):
    words = zeros_and_ones(4000)
    words = crossed(words, 0.85, False, state)
    assert np.mean(words[::2].any(axis=1)) == pytest.approx(0.85, abs=0.02)
    words = zeros_and_ones(10)
    words = crossed(words, 0.0, False, state)
    assert (words == zeros_and_ones(10)).all()


def test_without_a_partner_there_is_no_crossing(state):
    words = zeros_and_ones(2)[:3]
    words[2] = 1
    words = crossed(words, 1.0, False, state)
    assert words[2].tolist() == [1, 1, 1, 1]


def test_two_bits_of_a_mutant_flip_and_they_differ(state):
    words = np.zeros((20_000, 4), dtype=np.int64)
    step.mutate(words, 0.15, step.PER_INDIVIDUAL, LENGTHS, state)
    flipped = np.array([[int(bit) for bit in string] for string in strings(words)])
    counts = flipped.sum(axis=1)
    assert set(counts.tolist()) == {0, 2}
    assert np.mean(counts == 2) == pytest.approx(0.15, abs=0.01)
    np.testing.assert_allclose(flipped[counts == 2].mean(axis=0), 2 / TOTAL, atol=0.02)
    pairs = {tuple(np.flatnonzero(row)) for row in flipped[counts == 2]}
    assert len(pairs) == TOTAL * (TOTAL - 1) // 2  # all there are


def test_bits_are_counted_from_the_front():
    for place in range(TOTAL):
        words = np.zeros((1, 4), dtype=np.int64)
        step.flip(words[0], place, LENGTHS)
        assert strings(words) == ["0" * place + "1" + "0" * (TOTAL - 1 - place)]


def test_a_string_of_one_bit_flips_it(state):
    words = np.zeros((3, 1), dtype=np.int64)
    step.mutate(words, 1.0, step.PER_INDIVIDUAL, np.array([1]), state)
    assert (words == 1).all()


def test_mutation_per_parameter_flips_two_bits_of_each_with_its_probability(state):
    words = np.zeros((8000, 4), dtype=np.int64)
    step.mutate(words, 0.15, step.PER_PARAMETER, LENGTHS, state)
    counts = np.array([[k.bit_count() for k in row] for row in words.tolist()])
    for j, length in enumerate(LENGTHS):
        assert set(counts[:, j].tolist()) == {0, min(length, 2)}
        assert np.mean(counts[:, j] > 0) == pytest.approx(0.15, abs=0.02)
        assert set(words[:, j].tolist()) >= {2**b + 2**c for b in range(length) for c in range(b)}


def test_mutation_per_bit_flips_each_with_its_probability(state):
    words = np.zeros((5000, 4), dtype=np.int64)
    step.mutate(words, 0.15, step.PER_BIT, LENGTHS, state)
    flipped = np.array([[int(bit) for bit in string] for string in strings(words)])
    np.testing.assert_allclose(flipped.mean(axis=0), 0.15, atol=0.02)
    assert len(set(flipped.sum(axis=1).tolist())) > 3


def test_the_best_is_maintained_untouched(state):
    words = np.random.default_rng(0).integers(0, 2, (8, 4))
    children = np.empty_like(words)
    for best in range(8):
        step.breed(words, np.arange(8.0), best, 4, False, 1.0, False, 1.0, step.PER_BIT, LENGTHS, state, children)
        assert children[0].tolist() == words[best].tolist()


class Told:
    """The unit square, valued by a function of points and the number of the batch; keeps all batches."""

    def __init__(self, value):
        self.lower, self.upper, self.start = np.zeros(2), np.ones(2), np.zeros(2)
        self.batches, self._value = [], value

    def __call__(self, x):
        raise AssertionError("it asks in batches")

    def batch(self, points):
        self.batches.append(points.copy())
        return self._value(points, len(self.batches))


@pytest.mark.parametrize("renewal", ["random", "worst"])
def test_half_begin_again_after_NR_still_generations(renewal):
    told = Told(lambda points, batch: np.ones(len(points)))
    ga = optimizers.make("ga", population=8, NR=3, PCrossover=0, PMutation=0, renewal=renewal)
    bench.execute(told, ga, budget=8 + 3 * 7 + 4 + 2 * 7 + 4, seed=0)
    assert [len(b) for b in told.batches] == [8, 7, 7, 7, 4, 7, 7, 4]  # a renewal is a still generation itself
    first = {tuple(x) for x in told.batches[0]}
    assert all(tuple(x) in first for batch in told.batches[1:4] for x in batch)  # copies of the first sample
    assert not any(tuple(x) in first for x in told.batches[4])


def test_an_improvement_begins_the_count_anew():
    told = Told(lambda points, batch: np.full(len(points), 1.0 if batch < 3 else 0.5))
    bench.execute(told, optimizers.make("ga", population=8, NR=3), budget=8 + 5 * 7 + 4, seed=0)
    assert [len(b) for b in told.batches] == [8, 7, 7, 7, 7, 7, 4]


def test_the_mean_since_the_renewal_may_count_as_the_improvement():
    # the best is the first sample's; the mean falls until batch 4, and after the renewal (8 in batch 8) again
    told = Told(lambda points, batch: np.where(np.arange(len(points)) == 0, 1.0, 9.0 - min(batch, 4)))
    ga = optimizers.make("ga", population=8, NR=3, PCrossover=0, PMutation=0, improvement="mean")
    bench.execute(told, ga, budget=8 + 6 * 7 + 4 + 3 * 7, seed=0)
    assert [len(b) for b in told.batches] == [8, 7, 7, 7, 7, 7, 7, 4, 7, 7, 7]


def test_the_best_keeps_its_value():
    # nothing after the first sample is any good: so all are bred from its best, two bits away
    told = Told(lambda points, batch: ((points - 0.3) ** 2).sum(axis=1) if batch == 1 else np.full(len(points), 9.0))
    ga = optimizers.make("ga", population=10, tournament=200, PCrossover=0, PMutation=1, NR=99)
    bench.execute(told, ga, budget=100, seed=0)
    codes = [np.rint(batch * (2**14 - 1)).astype(int) for batch in told.batches]  # [0, 1] in steps of 1e-4
    best = codes[0][((told.batches[0] - 0.3) ** 2).sum(axis=1).argmin()]
    assert len(codes) == 11
    for code in codes[1:]:
        assert {sum(int(k).bit_count() for k in row) for row in code ^ best} == {2}


@pytest.mark.parametrize("renewal", ["random", "worst"])
def test_the_best_survives_a_renewal(renewal):
    told = Told(lambda points, batch: ((points - 0.3) ** 2).sum(axis=1))
    # without crossing and mutation, and all in each tournament, a generation is copies of the best
    ga = optimizers.make("ga", population=6, NR=2, tournament=200, PCrossover=0, PMutation=0, renewal=renewal)
    bench.execute(told, ga, budget=400, seed=0)
    seen, best, renewals = np.inf, None, 0
    for batch in told.batches[:-1]:
        if len(batch) == 5:
            assert (batch == best).all()
        else:
            renewals += 1
        values = ((batch - 0.3) ** 2).sum(axis=1)
        if values.min() < seen:
            seen, best = values.min(), batch[values.argmin()]
    assert renewals > 20
