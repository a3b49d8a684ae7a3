"""The laws have a limit of their own: what hangs, or is huge, is told in a line with the law that was tried."""

import re
import tracemalloc

import numpy as np
import pytest

from calibench import testing
from calibench.testing.problem import batch_has_the_bits_of_single_calls, jacobian_agrees_with_differences


class Bowl:
    def __init__(self, n=2):
        self.lower, self.upper, self.start = -np.ones(n), np.ones(n), np.zeros(n)

    def residuals(self, x):
        return x[:3] - 0.25

    def jacobian(self, x):
        return np.eye(3, x.size)

    def __call__(self, x):
        r = self.residuals(x)
        return float(r @ r)

    def batch(self, X):
        return np.array([self(x) for x in X])


class Hanging(Bowl):
    def residuals(self, x):
        while x[0] != 0.0:
            pass
        return x[:3] - 0.25


class Greedy(Bowl):
    def residuals(self, x):
        return np.ones(10**10)[:3]


def test_what_hangs_is_told_with_the_law_that_was_tried():
    said = r"the laws are tried within 0.5 s; found same_point_has_the_same_value not at its end; .*time_limit=SECONDS"
    with pytest.raises(AssertionError, match=said):
        testing.check_problem(Hanging(), time_limit=0.5)


class Endless:
    def minimize(self, objective, rng):
        while True:
            pass


def test_an_optimiser_that_hangs_is_told_too():
    with pytest.raises(AssertionError, match=r"within 0\.5 s; found budget_is_a_wall"):
        testing.check_optimizer(Endless, time_limit=0.5)


def test_a_machine_and_an_effect_that_hang_are_told_too():
    class Machine:
        name = "hangs"

        def formulate(self, data):
            while True:
                pass

    for check in (
        lambda: testing.check_machine(Machine(), _readings(), time_limit=0.2),
        lambda: testing.check_effect(object(), Machine(), _readings(), time_limit=0.2),
    ):
        with pytest.raises(AssertionError, match=re.escape("the laws are tried within 0.2 s")):
            check()


def _readings():
    from calibench.discrepancy import MeasuredData

    return MeasuredData({"x": np.zeros(3)}, {})


def test_what_takes_all_memory_breaks_a_law():
    with pytest.raises(AssertionError, match="MemoryError"):
        testing.check_problem(Greedy())


def test_the_laws_of_many_dimensions_take_little_memory():
    problem = Bowl(2_500)  # a square matrix of it is twice as large as what is allowed
    tracemalloc.start()
    try:
        jacobian_agrees_with_differences(problem)
        batch_has_the_bits_of_single_calls(problem)
        assert tracemalloc.get_traced_memory()[1] < 25e6
    finally:
        tracemalloc.stop()
