"""The law that makes comparisons fair, over the whole registry: a budget is a wall, a box is a box, a seed is a run.

The laws stand in `calibench.testing`, for a user's own optimiser is held to the same.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest

from calibench import optimizers
from calibench.optimizers.base import Traits
from calibench.testing import optimizer as laws
from tests.few import one_of_each

BUDGETS = [1, 50, *(pytest.param(budget, marks=pytest.mark.slow) for budget in (7, 1000))]
AT_A_BUDGET = [
    laws.budget_is_a_wall, laws.only_the_self_terminating_leave_a_rest, laws.a_seed_is_a_run,
    laws.nothing_is_asked_outside_the_box,
]  # fmt: skip
ONCE = [law for law in laws.OPTIMIZER_LAWS if law not in AT_A_BUDGET]
NAMES = optimizers.names()


def traits_of(name: str, **options: Any) -> Traits:
    return optimizers.make(name, **options).traits


@pytest.mark.parametrize("budget", BUDGETS)
@pytest.mark.parametrize("name", one_of_each(NAMES))
def test_a_method_keeps_its_laws_at_every_budget(name: str, budget: int) -> None:
    for law in AT_A_BUDGET:
        law(partial(optimizers.make, name), (budget,))


@pytest.mark.parametrize("name", one_of_each(NAMES))
def test_what_a_method_says_of_itself_is_true(name: str) -> None:
    for law in ONCE:
        law(partial(optimizers.make, name))


@pytest.mark.parametrize("budget", BUDGETS)
@pytest.mark.parametrize("name", [n for n in NAMES if traits_of(n).uses_gradient and not traits_of(n).uses_residuals])
def test_a_jacobian_is_charged_its_dimension(name: str, budget: int) -> None:
    told = laws.account_of(partial(optimizers.make, name), budget, squares=True)
    evaluations, jacobians = told.tags.count(b"e"), told.tags.count(b"j")
    dimension = told.points.shape[1]
    assert told.run.status == "ok", told.run.row["error"]
    assert (told.run.evaluations, told.run.row["jacobian_evaluations"]) == (evaluations, jacobians)
    assert told.run.charged == evaluations + dimension * jacobians <= budget
    assert told.run.charged == budget or traits_of(name).self_terminating
    assert jacobians or budget < 1 + traits_of(name).minimum_budget + dimension


RESTARTED = [n for n in NAMES if "restarts" in optimizers.registry.options(n)]


def test_whatever_stops_by_itself_takes_restarts() -> None:
    """The wall below then says that it spends the budget. MMA and CCSAQ descend for ever unless they are restarted."""
    stops = {n for n in NAMES if traits_of(n).self_terminating}
    assert set(RESTARTED) == stops | {"nlopt_LD_MMA", "nlopt_LD_CCSAQ"}


@pytest.mark.parametrize("budget", [50, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", one_of_each(RESTARTED))
def test_restarts_spend_the_whole_budget(name: str, budget: int) -> None:
    make = partial(optimizers.make, name, restarts=True)
    assert not make().traits.self_terminating
    for law in AT_A_BUDGET:
        law(make, (budget,), dimension=2)
