"""`de` as Cong et al. 2008 state it, equations (46) to (48), step by step."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from calibench import bench, optimizers, problems
from calibench.optimizers.own import _differential_kernels as step
from calibench.optimizers.own._random_kernels import random_state


@pytest.fixture
def state():
    return random_state(np.random.default_rng(7))


def propose(population, f, cr, lower, upper, state):
    trial = np.full_like(population, np.nan)
    step.propose(population, f, cr, *(np.array(bound, float) for bound in (lower, upper)), state, trial)
    return trial


def test_defaults_are_the_paper_s():
    de = optimizers.make("de")
    assert (de.population, de.F, de.CR) == (150, 0.5, 0.8)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"population": 3}, "de.population=3: "),
        ({"F": -0.1}, "de.F=-0.1: "),
        ({"F": 2.1}, "de.F=2.1: "),
        ({"CR": 1.5}, "de.CR=1.5: "),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        optimizers.make("de", **options)


def test_mutants_are_of_three_others(state):
    # powers of 5: v = x_r1 + F (x_r2 - x_r3), F = 1/2, tells r1, r2 and r3
    population = 5.0 ** np.arange(6)[:, None]
    triples = {}
    for triple in permutations(range(6), 3):
        triples.setdefault(
            population[triple[0], 0] + 0.5 * (population[triple[1], 0] - population[triple[2], 0]), triple
        )
    assert len(triples) == 6 * 5 * 4
    met = [set() for _ in range(6)]
    for _ in range(1000):
        trial = propose(population, 0.5, 1.0, [-1e9], [1e9], state)
        for i, v in enumerate(trial[:, 0]):
            met[i].add(triples[v])  # a KeyError here: two of the three were the same
    for i in range(6):
        assert met[i] == {t for t in triples.values() if i not in t}


def test_one_component_at_least_is_the_mutant_s(state):
    population = step.initialize(10, np.zeros(4), np.ones(4), state)
    changed = np.array([propose(population, 0.5, 0.0, [-9] * 4, [9] * 4, state) != population for _ in range(500)])
    assert (changed.sum(axis=2) == 1).all()  # CR = 0: the forced one alone
    np.testing.assert_allclose(changed.mean(axis=(0, 1)), 0.25, atol=0.03)


def test_crossover_takes_each_other_component_with_probability_CR(state):
    population = step.initialize(10, np.zeros(5), np.ones(5), state)
    changed = np.array([propose(population, 0.5, 0.3, [-9] * 5, [9] * 5, state) != population for _ in range(800)])
    assert changed.any(axis=2).all()
    assert changed.mean() == pytest.approx(1 / 5 + 4 / 5 * 0.3, abs=0.01)


def test_what_leaves_the_box_is_drawn_anew_uniformly(state):
    population = step.initialize(20, np.zeros(2), np.ones(2), state)
    lower, upper = [100.0, -8.0], [101.0, -4.0]  # no mutant of these lies inside
    drawn = np.concatenate([propose(population, 0.5, 1.0, lower, upper, state) for _ in range(500)])
    shares = (drawn - lower) / np.subtract(upper, lower)
    for column in shares.T:
        counts, _ = np.histogram(column, bins=10, range=(0, 1))
        assert counts.sum() == 10_000
        assert ((counts - 1000) ** 2 / 1000).sum() < 27.9  # chi-square, 9 degrees of freedom, 1 in 1000


def test_inside_the_box_the_mutant_is_kept(state):
    population = np.array([[1.0], [2.0], [4.0], [8.0]])
    trial = propose(population, 0.5, 1.0, [-99], [99], state)
    others = [{a + 0.5 * (b - c) for a, b, c in permutations(np.delete(population, i), 3)} for i in range(4)]
    assert all(trial[i, 0] in others[i] for i in range(4))


def test_selection_is_strict():
    population, trial = np.zeros((3, 2)), np.ones((3, 2))
    values = np.array([1.0, 1.0, 1.0])
    step.select(population, values, trial, np.array([0.5, 1.0, 1.5]))
    assert population[:, 0].tolist() == [1, 0, 0]  # better, tie, worse
    assert values.tolist() == [0.5, 1.0, 1.0]


@pytest.mark.slow
@pytest.mark.parametrize("error", ["J2", "J3"])
@pytest.mark.parametrize("seed", range(5))
def test_de_reaches_1e18_within_2500000_evaluations(error, seed):
    run = bench.execute(
        problems.make("full12", error=error), optimizers.make("de"), budget=2_500_000, seed=seed, target=1e-18
    )
    assert run.stop_reason == "target", run.best_value
