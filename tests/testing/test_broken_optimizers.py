"""Each law of an optimiser is broken on purpose by a small fake, and caught in one line."""

from __future__ import annotations

import os
import sys
from typing import Any

import numpy as np
import pytest

from calibench import optimizers, testing
from calibench.optimizers import Stop, Traits
from calibench.testing.optimizer import SumOfSquares

KEPT: list[Any] = []


class Wanderer:
    """An optimiser that keeps every law: random points of the box, the start first."""

    traits = Traits(stochastic=True, needs_finite_bounds=True)

    def minimize(self, objective, rng):
        objective(objective.start)
        while True:
            objective(objective.lower + rng.random(objective.dimension) * (objective.upper - objective.lower))


class Plain(Wanderer):
    """The same, drawing from nothing: it steps along a fixed path from the start."""

    traits = Traits()

    def minimize(self, objective, rng):
        x = objective.start.copy()
        while True:
            objective(x)
            x = np.clip(0.9 * x + 0.01, objective.lower, objective.upper)


class NoMinimize:
    traits = Traits()


class DictOfTraits(Wanderer):
    traits = {"stochastic": True}  # noqa: RUF012


class Deaf(Wanderer):
    def minimize(self, objective, rng):
        while True:
            try:
                super().minimize(objective, rng)
            except Stop:
                pass


class OneMore(Wanderer):
    def minimize(self, objective, rng):
        objective(np.append(objective.start, 1.0))


class Cheat(Wanderer):
    def minimize(self, objective, rng):
        frame = sys._getframe()
        while "problem" not in frame.f_locals:
            frame = frame.f_back
        frame.f_locals["problem"](objective.start)  # beside the books
        super().minimize(objective, rng)


class Lazy(Wanderer):
    def minimize(self, objective, rng):
        objective(objective.start)
        return "converged"


class Forgetful(Plain):
    def minimize(self, objective, rng):
        objective(objective.start)
        KEPT.append(0)
        super().minimize(_moved(objective, 0.1 / len(KEPT)), rng)


def _moved(objective, by):
    return type("Moved", (), {
        "start": objective.start + by, "lower": objective.lower, "upper": objective.upper,
        "__call__": lambda self, x: objective(x),
    })()  # fmt: skip


class SaysItIsStochastic(Plain):
    traits = Traits(stochastic=True)


class SaysItIsNot(Wanderer):
    traits = Traits()


class Outside(Wanderer):
    def minimize(self, objective, rng):
        objective(objective.start)
        while True:
            objective(objective.lower + 2 * rng.random(objective.dimension) * (objective.upper - objective.lower))


class OutsideLate(Wanderer):
    later = 1e-6

    def minimize(self, objective, rng):
        for _ in range(100):
            objective(objective.lower + rng.random(objective.dimension) * (objective.upper - objective.lower))
        while True:
            objective(objective.upper + self.later)


class NoNumberLate(OutsideLate):
    later = np.nan


class IgnoresItsStart(Wanderer):
    def minimize(self, objective, rng):
        while True:
            objective(objective.lower + rng.random(objective.dimension) * (objective.upper - objective.lower))


class NeedsMore(Wanderer):
    traits = Traits(stochastic=True, minimum_budget=3)

    def minimize(self, objective, rng):
        if objective.remaining < 10:
            raise ValueError("a population of 10 is needed")
        super().minimize(objective, rng)


BROKEN: list[tuple[str, Any, str]] = [
    ("it_has_minimize_and_traits", NoMinimize, r"an optimiser has minimize\(objective, rng\)"),
    ("it_has_minimize_and_traits", DictOfTraits, "traits are Traits"),
    ("budget_is_a_wall", Deaf, "found calls without end after the budget of 1; let optimizers.Stop pass"),
    ("budget_is_a_wall", Cheat, "found 2 evaluations and 0 Jacobians, counted 1"),
    ("budget_is_a_wall", NeedsMore, "failed at budget 1: ValueError a population of 10"),
    ("only_the_self_terminating_leave_a_rest", Lazy, "found 1 of 7 spent"),
    ("a_seed_is_a_run", Forgetful, "two runs that part at evaluation 2"),
    ("only_the_stochastic_depend_on_the_seed", SaysItIsStochastic, "state stochastic=False"),
    ("only_the_stochastic_depend_on_the_seed", SaysItIsNot, "state stochastic=True"),
    ("nothing_is_asked_outside_the_box", Outside, "in a box of -2 .. 2.5 at budget 7; clip"),
    ("nothing_is_asked_outside_the_box", OutsideLate, "found 2.500001 in a box of -2 .. 2.5 at budget 600; clip"),
    ("nothing_is_asked_outside_the_box", NoNumberLate, "found nan in a box of -2 .. 2.5 at budget 600; clip"),
    ("uses_start_is_true", IgnoresItsStart, "state uses_start=False"),
    ("minimum_budget_is_enough", NeedsMore, "failed 'a population of 10 is needed' at 3"),
    (
        "an_open_box_is_searched_or_refused",
        SaysItIsNot,
        "where the bounds are infinite; state needs_finite_bounds=True",
    ),
]


@pytest.mark.parametrize("make", [Wanderer, Plain, lambda: optimizers.make("de", population=5)])
def test_a_good_optimiser_keeps_every_law(make: Any) -> None:
    testing.check_optimizer(make)


@pytest.mark.parametrize(("law", "broken", "said"), BROKEN, ids=[f"{law}-{made.__name__}" for law, made, _ in BROKEN])
def test_a_broken_law_is_told_in_one_line(law: str, broken: Any, said: str) -> None:
    KEPT.clear()
    with pytest.raises(AssertionError, match=said) as caught:
        dict(testing.optimizer_checks(broken))[law]()
    assert "\n" not in str(caught.value)
    assert str(caught.value).count("; ") >= 2  # law; what was found; what to do


def test_a_check_of_all_laws_ends_at_a_broken_one() -> None:
    with pytest.raises(AssertionError, match="traits are Traits"):
        testing.check_optimizer(DictOfTraits)


def test_every_law_is_broken_once() -> None:
    assert {law for law, _, _ in BROKEN} == {law.__name__ for law in testing.OPTIMIZER_LAWS}


class OfMany(Plain):
    """One that needs many dimensions, and some evaluations for each of them."""

    traits = Traits(minimum_dimension=14, minimum_budget_per_dimension=2)

    def minimize(self, objective, rng):
        assert objective.dimension >= 14
        super().minimize(objective, rng)


class OfOne(Plain):
    traits = Traits(maximum_dimension=1)

    def minimize(self, objective, rng):
        assert objective.dimension == 1
        super().minimize(objective, rng)


@pytest.mark.parametrize("make", [OfMany, OfOne])
def test_an_optimiser_is_run_in_as_many_dimensions_as_it_takes(make: Any) -> None:
    testing.check_optimizer(make)


def test_what_traits_are_not_stated_are_the_default() -> None:
    class Bare:
        def minimize(self, objective, rng):
            Plain().minimize(objective, rng)

    testing.check_optimizer(Bare)


class Counts:
    """A sound one that goes by what the objective knows of the run."""

    traits = Traits(stochastic=True, uses_start=False, needs_finite_bounds=True)

    def minimize(self, objective, rng):
        for k in range(objective.budget):
            assert objective.evaluations == k
            objective(objective.lower + rng.random(objective.dimension) * (objective.upper - objective.lower))
        objective(objective.best_x)


def test_what_a_run_knows_of_itself_is_there_to_be_read():
    testing.check_optimizer(Counts)


def test_a_point_of_a_wrong_shape_is_told_as_such():
    with pytest.raises(AssertionError, match=r"\(12,\).*\(13,\)"):
        testing.check_optimizer(OneMore)


def test_the_laws_own_function_is_silent_at_points_that_are_not_finite(tmp_path):
    problem = SumOfSquares(tmp_path / "book", 2)
    far = np.full(2, np.inf)
    try:
        assert not np.isfinite(problem(far))
        assert not np.isfinite(problem.residuals(far)).any()
        assert not np.isfinite(problem.jacobian(far)[0, 0])
    finally:
        os.close(problem.book)
