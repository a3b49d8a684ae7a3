"""Who stops summing early finds what he would have found: the law of `batch_below`, of de and of pso."""

from __future__ import annotations

import numpy as np
import pytest

from calibench import optimizers, problems
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.face import NUMBERS
from calibench.optimizers.base import Stop

METHODS = (("de", {"population": 30}), ("pso", {"population": 30, "NR": 5}))


class Watched:
    """A problem, whose candidates and values are kept as they pass."""

    side_effect_free = True

    def __init__(self, problem, abandons=True):
        self._problem = problem
        self.lower, self.upper, self.start = problem.lower, problem.upper, problem.start
        self.points, self.values = [], []
        if abandons:
            self.batch_below = self._batch_below

    def __call__(self, x):
        raise AssertionError("our own methods ask in batches")

    def batch(self, points):
        return self._note(points, self._problem.batch(points))

    def _batch_below(self, points, limits):
        return self._note(points, self._problem.batch_below(points, limits))

    def _note(self, points, values):
        self.points.append(points.copy())
        self.values.append(values.copy())
        return values


def search(problem, name, options, budget=6000):
    gate = Evaluator(problem, budget, targets=[1e5, 1e4])
    with pytest.raises(Stop):
        optimizers.make(name, **options).minimize(gate, np.random.default_rng(3))
    gate.close()
    return gate


@pytest.mark.parametrize("error", ["J1", "J2", "J3"])
@pytest.mark.parametrize(("name", "options"), METHODS)
def test_the_search_is_the_same_to_the_last_bit(name, options, error):
    problem = problems.make("full12", error=error)
    whole, early = Watched(problem), Watched(problem)
    a = search(whole, name, options)
    b = search(early, name, options | {"early_abandon": True})
    assert np.array_equal(np.concatenate(whole.points), np.concatenate(early.points))
    assert np.array_equal(a.best_x, b.best_x)
    for key in (*NUMBERS, "attempts", "hits", "hits_charged", "trace", "unknown_slopes"):
        assert getattr(a, key) == getattr(b, key), key
    given_up = np.concatenate(whole.values) != np.concatenate(early.values)
    assert 0.05 < given_up.mean() < 1  # else nothing was shown


@pytest.mark.parametrize(("name", "options"), METHODS)
def test_a_problem_that_cannot_abandon_is_asked_for_all(name, options):
    problem = problems.make("full12", error="J3")
    whole, early = Watched(problem), Watched(problem, abandons=False)
    a, b = search(whole, name, options), search(early, name, options | {"early_abandon": True})
    assert np.array_equal(np.concatenate(whole.values), np.concatenate(early.values))
    assert a.trace == b.trace


def test_it_is_off_by_default_and_stands_in_the_options():
    for name, _ in METHODS:
        assert optimizers.make(name).early_abandon is False
        assert optimizers.make(name, early_abandon=True) != optimizers.make(name)


@pytest.mark.parametrize("error", ["J1", "J2", "J3"])
@pytest.mark.parametrize("count", [1, 31, 100])
def test_values_below_their_limits_are_exact_and_others_are_not_below(error, count):
    problem, rng = problems.make("full12", error=error), np.random.default_rng(count)
    points = problem.lower + rng.random((count, 12)) * (problem.upper - problem.lower)
    whole = problem.batch(points)
    for limits in (np.full(count, np.inf), np.zeros(count), whole, np.nextafter(whole, np.inf), rng.permutation(whole)):
        values = problem.batch_below(points, limits)
        below = whole < limits
        assert np.array_equal(values[below], whole[below])
        assert (values[~below] >= limits[~below]).all()
        assert (values <= whole).all()


def test_what_is_not_a_number_is_none_with_limits_either():
    problem = problems.make("full12", error="J3")
    points = np.array([problem.truth, problem.truth])
    points[1, 0] = np.nan
    values = problem.batch_below(points, np.ones(2))
    assert values[0] < 1e-15
    assert np.isnan(values[1])


def test_an_abandoned_value_is_never_a_best():
    class Partial:
        """Says 3 where asked for all, and the limit itself where it may give up."""

        lower, upper, start = np.zeros(1), np.ones(1), np.zeros(1)

        def __call__(self, x):
            return 3.0

        def batch(self, points):
            return np.full(len(points), 3.0)

        def batch_below(self, points, limits):
            return np.minimum(limits, 3.0)

    gate = Evaluator(Partial(), 8)
    gate.batch(np.zeros((2, 1)))
    gate.batch_below(np.zeros((3, 1)), np.array([1.0, 2.0, 9.0]))  # below the best, as no member's value could be
    assert (gate.evaluations, gate.best_value, gate.best_evaluation) == (5, 3.0, 1)
    with pytest.raises(Stop):
        gate.batch_below(np.zeros((4, 1)), np.full(4, 1.0))
    assert (gate.evaluations, gate.best_value) == (8, 3.0)


def test_limits_of_another_shape_are_refused():
    problem = problems.make("full12", error="J3")
    with pytest.raises(ValueError, match=r"limits have shape \(3,\)"):
        problem.batch_below(np.array([problem.start] * 2), np.zeros(3))
