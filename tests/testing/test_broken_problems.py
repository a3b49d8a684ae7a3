"""Each law of a problem is broken on purpose by a small fake, and caught in one line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from calibench import testing


class Valley:
    """A problem that keeps every law: two residuals in two variables, with all that a problem may have."""

    lower, upper, start, truth = np.full(2, -2.0), np.full(2, 2.0), np.array([-1.2, 1.0]), np.ones(2)
    minimum, targets, parameters = 0.0, (1e-8,), ("a", "b")

    def residuals(self, x):
        return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])

    def jacobian(self, x):
        return np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])

    def __call__(self, x):
        r = self.residuals(x)
        return float(r @ r)

    def batch(self, points):
        return np.array([self(x) for x in points])

    def batch_below(self, points, limits):
        return self.batch(points)


class Noisy:
    """A noisy problem that keeps every law."""

    stochastic = True
    lower, upper, start, truth = np.full(2, -1.0), np.full(2, 1.0), np.zeros(2), np.full(2, 0.3)

    def __call__(self, x):
        return self.noise_free(x) + 0.05 * self.rng.standard_normal()

    def noise_free(self, x):
        return float((x - 0.3) @ (x - 0.3))


class NoisyBelow(Noisy):
    """Right: it draws noise for each residual, and gives a sum up when that has passed its limit."""

    def batch(self, points):
        return np.array([self._until(x, np.inf) for x in points])

    def batch_below(self, points, limits):
        return np.array([self._until(x, limit) for x, limit in zip(points, limits, strict=True)])

    def _until(self, x, limit):
        total = 0.0
        for one in x:
            total += (one - 0.3 + 0.05 * self.rng.standard_normal()) ** 2
            if total >= limit:
                break
        return total


class NoisyInAnotherOrder(NoisyBelow):
    """Right: `batch` draws all noise of a point at once, from another distribution."""

    def batch(self, points):
        return np.array([self.noise_free(x) + self.rng.random() for x in points])


class Counting(Valley):
    calls = 0

    def __call__(self, x):
        self.calls += 1
        return super().__call__(x) + self.calls


class Writing(Valley):
    def __call__(self, x):
        value = super().__call__(x)
        x *= 0.5
        return value


class WritingTheBatch(Valley):
    def batch(self, points):
        values = super().batch(points)
        points[:] = 0.0
        return values


class ClipsInPlace(Valley):
    def __call__(self, x):
        np.clip(x, -1.99, 1.99, out=x)
        return super().__call__(x)


class FlatAtItsTruth(Valley):
    """Right, and hard on differences: of r = y^3 at 0 every central difference is above the derivative."""

    truth, minimum = np.array([1.0, 0.0]), 0.0
    slope = 0.0

    def residuals(self, x):
        return np.array([x[0] - 1.0, x[1] ** 3])

    def jacobian(self, x):
        return np.array([[1.0, 0.0], [0.0, 3 * x[1] ** 2 + self.slope * (x[1] == 0.0)]])


class WrongAtItsTruth(FlatAtItsTruth):
    slope = 1e-8


class FillsOneArray(Valley):
    """Right: it returns the same array at every call, filled anew."""

    def __init__(self):
        self.r = np.zeros(2)

    def residuals(self, x):
        self.r[:] = super().residuals(x)
        return self.r


class OpenAtItsBound(Valley):
    """Right: it is not defined at its lower bound."""

    batch = batch_below = None

    def residuals(self, x):
        if x[0] == -2.0:
            raise ValueError("no answer at the bound")
        return super().residuals(x)


def fake(**changed: Any) -> Any:
    """Return a Valley with attributes or methods in the place of its own."""
    return type("Fake", (Valley,), changed)()


def cut(self: Any, points: Any, limits: Any) -> Any:
    return np.minimum(NoisyBelow.batch_below(self, points, limits), 1.0)


def rounded(self: Any, points: Any) -> Any:
    values = Valley.batch(self, points)
    return np.nextafter(values, np.inf) if len(points) == 33 else values


def slopes_of(problem: Any, x: Any) -> Any:
    return 2.0 * problem.jacobian(x).T @ problem.residuals(x)


class Sloped(Valley):
    def gradient(self, x: Any) -> Any:
        return slopes_of(self, x)

    def value_and_gradient(self, x: Any) -> Any:
        return self(x), slopes_of(self, x)


BROKEN: list[tuple[str, Callable[[], Any], str]] = [
    ("box_is_sane", lambda: fake(upper=np.array([2.0, np.nan])), r"lower <= upper; found \[\(1, "),
    ("box_is_sane", lambda: fake(start=np.zeros(3)), r"one shape \(dim,\); found \(\(2,\), \(2,\), \(3,\)\)"),
    ("box_is_sane", lambda: fake(upper=Valley.lower), "some coordinate is free"),
    ("box_is_sane", object, "a problem has lower; found no lower"),
    ("start_and_truth_lie_in_the_box", lambda: fake(start=np.array([-3.0, 0.0])), "start lies in the box"),
    ("start_and_truth_lie_in_the_box", lambda: fake(truth=np.array([1.0, 2.5])), "truth lies in the box"),
    ("what_it_says_of_itself_is_right", lambda: fake(targets=(-1.0,)), "target -1 lies below minimum=0"),
    ("what_it_says_of_itself_is_right", lambda: fake(parameters=("a", "a")), "'a' is named twice"),
    ("value_is_one_finite_number_at_the_start", lambda: fake(__call__=lambda self, x: x), "a call returns one number"),
    ("value_is_one_finite_number_at_the_start", lambda: fake(__call__=lambda self, x: np.inf), "the start is finite"),
    ("same_point_has_the_same_value", Counting, "the same x has the same value"),
    ("calls_leave_x_alone", Writing, "x changed by __call__"),
    ("calls_leave_x_alone", WritingTheBatch, "x changed by batch"),
    ("calls_leave_x_alone", ClipsInPlace, "x changed by __call__"),
    (
        "value_is_the_sum_of_squared_residuals",
        lambda: fake(__call__=lambda self, x: 0.5 * Valley.__call__(self, x)), "the value is r @ r",
    ),
    ("batch_has_the_bits_of_single_calls", lambda: fake(batch=rounded), "a batch has the bits of single calls"),
    (
        "batch_has_the_bits_of_single_calls",
        lambda: fake(batch=lambda self, X: Valley.batch(self, X) + (not X.flags.c_contiguous)), "the layout of X",
    ),
    (
        "batch_has_the_bits_of_single_calls",
        lambda: fake(batch=lambda self, X: Valley.batch(self, X) + (len(X) == 66) * np.arange(len(X))),
        "no bit|neighbours",
    ),
    (
        "batch_below_is_exact_below_its_limits",
        lambda: fake(batch_below=lambda self, X, limits: np.minimum(Valley.batch(self, X), 3.0)),
        "batch_below is exact",
    ),
    (
        "batch_below_is_exact_below_its_limits",
        lambda: type("Cut", (NoisyBelow,), {"batch_below": cut})(), "batch_below is exact",
    ),
    (
        "jacobian_agrees_with_differences",
        lambda: fake(jacobian=lambda self, x: Valley.jacobian(self, x) * [1.0, 1.0001]), r"in column 1 \(b\)",
    ),
    (
        "jacobian_agrees_with_differences",
        lambda: fake(jacobian=lambda self, x: Valley.jacobian(self, x)[:1]), r"the Jacobian has shape \(m, dim\)",
    ),
    (
        "gradient_agrees_with_differences",
        lambda: fake(gradient=lambda self, x: slopes_of(self, x) * [1.0, 1.0001]), r"in entry 1 \(b\)",
    ),
    (
        "gradient_agrees_with_differences",
        lambda: fake(gradient=lambda self, x: slopes_of(self, x)[:1]), r"gradient has shape \(dim,\)",
    ),
    (
        "gradient_agrees_with_differences",
        lambda: fake(value_and_gradient=lambda self, x: (self(x) / 2, slopes_of(self, x))), "is the value; found",
    ),
    ("truth_has_the_least_value", lambda: fake(truth=np.array([-1.9, -1.9])), "the truth has the least value"),
    ("jacobian_agrees_with_differences", WrongAtItsTruth, r"in column 1 \(b\)"),
    ("no_value_lies_below_the_minimum", lambda: fake(minimum=50.0, targets=()), "no value is below minimum=50"),
    ("no_value_lies_below_the_minimum", lambda: fake(minimum=1e-6, targets=()), "no value is below minimum=1e-06"),
]  # fmt: skip


@pytest.mark.parametrize(
    "problem",
    [
        Valley(),
        Sloped(),
        Noisy(),
        NoisyBelow(),
        NoisyInAnotherOrder(),
        FlatAtItsTruth(),
        FillsOneArray(),
        OpenAtItsBound(),
    ],
    ids=lambda p: type(p).__name__,
)
def test_a_good_problem_keeps_every_law(problem: Any) -> None:
    testing.check_problem(problem)


@pytest.mark.parametrize(("law", "broken", "said"), BROKEN, ids=[f"{law}-{said[:20]}" for law, _, said in BROKEN])
def test_a_broken_law_is_told_in_one_line(law: str, broken: Callable[[], Any], said: str) -> None:
    checks = dict(testing.problem_checks(broken()))
    with pytest.raises(AssertionError, match=said) as caught:
        checks[law]()
    assert "\n" not in str(caught.value)
    assert str(caught.value).count("; ") >= 2  # law; what was found; what to do


def test_a_check_of_all_laws_ends_at_a_broken_one() -> None:
    with pytest.raises(AssertionError, match=BROKEN[0][2]):
        testing.check_problem(BROKEN[0][1]())


def test_every_law_is_broken_once() -> None:
    assert {law for law, _, _ in BROKEN} == {law.__name__ for law in testing.PROBLEM_LAWS}


@pytest.mark.parametrize(("name", "check"), testing.problem_checks(Valley()))
def test_the_pairs_are_for_parametrize(name: str, check: Callable[[], None]) -> None:
    assert name.isidentifier()
    check()
