"""What each NLopt algorithm is given: the table is whole, the adapter obeys it, and the page shows it."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.tables import PAGE, filled
from calibench import bench, optimizers, problems
from calibench.optimizers.nlopt import ALGORITHMS, SETTING_OF, SETTINGS

nlopt = pytest.importorskip("nlopt")


def test_every_algorithm_is_set_once() -> None:
    assert sum(len(setting.algorithms) for setting in SETTINGS) == len(SETTING_OF)
    assert set(SETTING_OF) == set(ALGORITHMS)


def test_the_page_shows_the_table() -> None:
    page = PAGE.read_text()
    assert filled(page) == page


def test_inner_methods_get_the_tolerance_of_the_table() -> None:
    for algorithm, setting in SETTING_OF.items():
        assert optimizers.make(f"nlopt_{algorithm}").options.get("local_tolerance") == setting.inner_tolerance


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_the_gradient_test_is_off_wherever_there_is_one(algorithm: str) -> None:
    """NLopt takes a parameter that an algorithm never reads: only its effect tells. A slope of 1e6 would end it."""
    ends = calls_of(algorithm, tolg=1e6) < calls_of(algorithm)
    assert ends is ("tolg" in SETTING_OF[algorithm].parameters)


def calls_of(algorithm: str, **parameters: float) -> int:
    """Return how often NLopt alone evaluates a bowl, 60 times at most."""
    search = nlopt.opt(getattr(nlopt, algorithm), 2)
    count = [0]

    def bowl(x: np.ndarray, gradient: np.ndarray) -> float:
        count[0] += 1
        if gradient.size:
            gradient[:] = [2.0 * (x[0] - 0.3), 20.0 * (x[1] + 0.1)]
        return float((x[0] - 0.3) ** 2 + 10.0 * (x[1] + 0.1) ** 2)

    search.set_min_objective(bowl)
    search.set_lower_bounds([-1.0, -1.0])
    search.set_upper_bounds([1.0, 1.0])
    search.set_maxeval(60)
    if ALGORITHMS[algorithm].may_hang:
        search.set_xtol_rel(1e-3)
    if SETTING_OF[algorithm].inner_tolerance is not None:
        local = nlopt.opt(nlopt.LD_SLSQP if algorithm[1] != "N" else nlopt.LN_BOBYQA, 2)
        local.set_ftol_rel(1e-3)
        search.set_local_optimizer(local)
    for name, value in parameters.items():
        search.set_param(name, value)
    nlopt.srand(1)
    try:
        search.optimize([0.8, 0.7])
    except (RuntimeError, nlopt.RoundoffLimited):
        pass
    return count[0]


@pytest.mark.parametrize("name", ["nlopt_GD_MLSL", "nlopt_GD_MLSL_LDS", "nlopt_G_MLSL", "nlopt_G_MLSL_LDS"])
def test_the_descents_of_mlsl_reach_the_goal(name: str) -> None:
    """At 1e-8 they ended above it, 0 of 12 times at it in 5000 evaluations."""
    problem = problems.make("link_length")
    run = bench.execute(problem, optimizers.make(name), budget=2000, start="random")
    assert run.best_value < problem.targets[-1]


@pytest.mark.parametrize("name", ["nlopt_GN_MLSL", "nlopt_GN_MLSL_LDS"])
def test_the_descents_of_mlsl_without_a_gradient_reach_the_goal(name: str) -> None:
    problem = problems.make("sensor_zero")
    run = bench.execute(problem, optimizers.make(name), budget=2000, start="random")
    assert run.best_value < problem.targets[-1]


@pytest.mark.parametrize("name", ["nlopt_LD_LBFGS", "nlopt_LD_VAR1", "nlopt_LD_VAR2"])
def test_luksans_variable_metric_reaches_the_goal_of_a_calibration(name: str) -> None:
    problem = problems.make("full12")
    run = bench.execute(problem, optimizers.make(name), budget=5000, start="random")
    assert run.stop_reason == "converged"
    assert run.best_value < problem.targets[-1]
