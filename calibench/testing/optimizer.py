"""The laws of an optimiser: the budget is a wall, the box is a box, a seed is a run, and its traits are true.

``make()`` returns the optimiser, a new one each time: ``lambda: Mine(population=30)``, or the class itself. It runs on
Rosenbrock's function, which keeps its own books.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from calibench.optimizers.base import Traits
from calibench.testing._law import TIME_LIMIT, Checks, checks_of, keep_all, require
from calibench.testing.book import Account, Deaf, account_of, taken

BUDGETS = (1, 7, 50)
LONG = 600  # evaluations, after which a method shows what it does late
Make = Callable[[], Any]


def check_optimizer(make: Make, *, time_limit: float = TIME_LIMIT) -> None:
    """Raise `AssertionError`, one line, for the first law that the optimisers of `make` break.

    It has `time_limit` seconds for all of them, and a gigabyte: what takes longer or more breaks the law that is tried.
    """
    keep_all(lambda: optimizer_checks(make), time_limit)


def optimizer_checks(make: Make) -> Checks:
    """Return (name, check) for every law of an optimiser."""
    return checks_of(OPTIMIZER_LAWS, make)


def it_has_minimize_and_traits(make: Make) -> None:
    """An optimiser has ``minimize(objective, rng)``; its traits, where it states some, are `Traits`."""
    require(
        callable(make), "each run has an optimiser of its own", f"an object of {type(make).__name__}",
        f"give what makes one: the class, or lambda: {type(make).__name__}(...)",
    )  # fmt: skip
    optimizer = make()
    can = callable(getattr(optimizer, "minimize", None))
    require(can, "an optimiser has minimize(objective, rng)", type(optimizer).__name__, "write it")
    traits = getattr(optimizer, "traits", Traits())
    require(isinstance(traits, Traits), "traits are Traits", repr(traits), "say traits = optimizers.Traits(...)")


def budget_is_a_wall(make: Make, budgets: tuple[int, ...] = BUDGETS, dimension: int = 12) -> None:
    """Nothing is evaluated above the budget, and what the gate counted is what the problem saw."""
    for budget in budgets:
        told = _account(make, budget, dimension=dimension)
        _ended_well(told, budget)
        evaluations, jacobians = told.tags.count(b"e"), told.tags.count(b"j")
        charged = evaluations + told.points.shape[1] * jacobians
        require(
            (told.run.evaluations, told.run.row["jacobian_evaluations"]) == (evaluations, jacobians),
            "every evaluation passes the objective",
            f"{evaluations} evaluations and {jacobians} Jacobians, counted {told.run.evaluations}",
            "call nothing but the objective that minimize was given",
        )
        require(
            1 <= charged <= budget, "the budget is a wall", f"{charged} charged of {budget}",
            "ask the objective, and nothing beside it",
        )  # fmt: skip


def only_the_self_terminating_leave_a_rest(make: Make, budgets: tuple[int, ...] = BUDGETS, dimension: int = 12) -> None:
    """Who is not `self_terminating` spends the whole budget, but for the rest that its next step would exceed."""
    traits = _traits(make)
    for budget in budgets:
        told = _account(make, budget, dimension=dimension)
        _ended_well(told, budget)
        dear = told.points.shape[1] if traits.uses_residuals else 1  # what is refused: a Jacobian, or an evaluation
        spent = told.run.charged > budget - dear
        reason = told.run.stop_reason
        require(
            spent or traits.self_terminating,
            "only the self_terminating leave a rest", f"{told.run.charged} of {budget} spent",
            "go on until the objective stops you, or state self_terminating=True",
        )  # fmt: skip
        right = reason == "converged" or spent if reason != "budget" else True
        require(
            right and (reason == "budget" or told.run.charged < budget), "the reason is that of the books",
            f"{reason} with {told.run.charged} of {budget} spent", "return 'converged', or let the Stop pass",
        )  # fmt: skip


def a_seed_is_a_run(make: Make, budgets: tuple[int, ...] = BUDGETS, dimension: int = 12) -> None:
    """The same seed gives the same points in the same order, to the last bit."""
    for budget in budgets:
        one, other = _account(make, budget, dimension=dimension), _account(make, budget, dimension=dimension)
        _ended_well(one, budget)
        same = _same(one, other) and one.run.points == other.run.points
        require(
            same, "a seed is a run", f"two runs that part at {_first_difference(one, other)}",
            "draw from rng alone, keep nothing between two runs, iterate over nothing unordered",
        )  # fmt: skip


def only_the_stochastic_depend_on_the_seed(make: Make, budget: int = LONG) -> None:
    """Another seed gives another run if the trait `stochastic` says so, and the same one if not."""
    one, other = (_account(make, budget, seed=seed, dimension=2) for seed in (0, 1))
    same = _same(one, other)
    stated = _traits(make).stochastic
    require(
        same is not stated, "only the stochastic depend on the seed",
        f"stochastic={stated} and {'the same run' if same else 'another run'} by another seed",
        f"state stochastic={not same}",
    )  # fmt: skip


def nothing_is_asked_outside_the_box(
    make: Make, budgets: tuple[int, ...] = (*BUDGETS, LONG), dimension: int = 12
) -> None:
    """Every point is a number in the box, but for one rounding; or the trait `bounded` is False."""
    if not _traits(make).bounded:
        return
    for budget in budgets:
        points = _account(make, budget, dimension=dimension).points
        outside = ~((points >= np.nextafter(-2.0, -np.inf)) & (points <= np.nextafter(2.5, np.inf)))  # nan is outside
        require(
            not outside.any(), "nothing is asked outside the box",
            f"{points[outside][0] if outside.any() else 0:.9g} in a box of -2 .. 2.5 at budget {budget}",
            "clip to objective.lower and objective.upper, or state bounded=False",
        )  # fmt: skip


def uses_start_is_true(make: Make, budget: int = 300) -> None:
    """The run depends on the start if the trait `uses_start` says so, and only then."""
    one, other = (_account(make, budget, dimension=2, start=start) for start in (-1.2, 0.7))
    differ = not _same(one, other)
    stated = _traits(make).uses_start
    require(
        differ is stated, "uses_start is true",
        f"uses_start={stated} and {'another run' if differ else 'the same run'} from another start",
        f"begin at objective.start or state uses_start={differ}",
    )  # fmt: skip


def minimum_budget_is_enough(make: Make) -> None:
    """With the least budget that its traits state a run ends well and spends no more."""
    traits = _traits(make)
    dimension = taken(traits, 2)
    budget = traits.minimum_budget + traits.minimum_budget_per_dimension * dimension
    told = _account(make, budget, dimension=dimension)
    run = told.run
    require(
        run.status == "ok" and run.charged <= budget, "the stated minimum_budget is enough",
        f"{run.status} {run.row['error']!r} at {budget}", "state the evaluations of the first step",
    )  # fmt: skip


def an_open_box_is_searched_or_refused(make: Make, budget: int = 50) -> None:
    """In a box without ends every point that is asked for is finite, or the trait `needs_finite_bounds` refuses it."""
    if _traits(make).needs_finite_bounds:
        return
    told = _account(make, budget, dimension=2, bound=np.inf)
    astray = ~np.isfinite(told.points).all(axis=1)
    require(
        told.run.status == "ok" and not astray.any(), "an open box is searched, or needs_finite_bounds refuses it",
        f"{told.run.status}, {astray.sum()} of {astray.size} points not finite where the bounds are infinite",
        "state needs_finite_bounds=True",
    )  # fmt: skip


OPTIMIZER_LAWS = (
    it_has_minimize_and_traits, budget_is_a_wall, only_the_self_terminating_leave_a_rest, a_seed_is_a_run,
    only_the_stochastic_depend_on_the_seed, nothing_is_asked_outside_the_box, uses_start_is_true,
    minimum_budget_is_enough, an_open_box_is_searched_or_refused,
)  # fmt: skip


def _traits(make: Make) -> Traits:
    traits = getattr(make(), "traits", Traits())
    return traits if isinstance(traits, Traits) else Traits()


def _account(make: Make, budget: int, **options: Any) -> Account:
    try:
        return account_of(make, budget, squares=_traits(make).uses_residuals, **options)
    except Deaf:
        raise AssertionError(
            f"an optimiser ends when the objective stops it; found calls without end after the budget of {budget}; "
            "let optimizers.Stop pass, or return when it comes"
        ) from None


def _ended_well(told: Account, budget: int) -> None:
    """Raise unless the run is ok: one that failed says nothing of a law."""
    require(
        told.run.status == "ok", "a run ends well at any budget",
        f"{told.run.status} at budget {budget}: {told.run.row['error_type']} {told.run.row['error']}",
        "mend what raised; a first step above the budget is stopped by the objective",
    )  # fmt: skip


def _same(one: Account, other: Account) -> bool:
    """Tell whether two runs asked for the same points, bit for bit where they are numbers."""
    return np.array_equal(one.points, other.points, equal_nan=True)


def _first_difference(one: Account, other: Account) -> str:
    n = min(len(one.points), len(other.points))
    parted = np.flatnonzero((one.points[:n] != other.points[:n]).any(axis=1))
    return f"evaluation {parted[0] + 1 if parted.size else n + 1}"
