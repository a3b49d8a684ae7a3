"""What each NLopt algorithm is given: the page's table is whole, and the adapter obeys it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.gate.evaluator import Evaluator
from calibench.optimizers.nlopt import ALGORITHMS
from tests.optimizers.page import named, table_of

nlopt = pytest.importorskip("nlopt")


TOLERANCES = {name: cells[2] for cells in table_of("nlopt") for name in named(cells[0])}


def test_every_algorithm_stands_once_on_the_page() -> None:
    assert sorted(name for cells in table_of("nlopt") for name in named(cells[0])) == sorted(ALGORITHMS)


class Listening:
    """An algorithm of NLopt that keeps what it is told."""

    def __init__(self, *_: object) -> None:
        self.told: dict[str, tuple[object, ...]] = {}

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *values: self.told.update({name.removeprefix("set_"): values})


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_the_tests_that_may_end_a_search_are_those_of_the_page(algorithm: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nlopt, "opt", Listening)
    name, gate = f"nlopt_{algorithm}", Evaluator(problems.make("sensor_zero"), 100)
    once = optimizers.make(name)._search(nlopt, gate).told  # type: ignore[attr-defined]
    again = once
    if "restarts" in optimizers.registry.options(name):
        again = optimizers.make(name, restarts=True)._search(nlopt, gate).told  # type: ignore[attr-defined]
    tests = [f"`{once['param'][0]}` = {once['param'][1]:g}"] if "param" in once else []
    if "local_optimizer" in once:
        ((inner,), same) = once["local_optimizer"][0].told["ftol_rel"], once["local_optimizer"][0].told["xtol_rel"]
        assert same == (inner,)
        tests.append(f"`local_tolerance` = {inner:g} (ftol_rel and xtol_rel of the inner method)")
    if "xtol_rel" in again:
        tests.append(f"`xtol_rel` = {again['xtol_rel'][0]:g}{'' if 'xtol_rel' in once else ' with restarts'}")
    assert TOLERANCES[algorithm] == (", ".join(tests) or "none")


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_the_gradient_test_is_off_wherever_there_is_one(algorithm: str) -> None:
    """NLopt takes a parameter that an algorithm never reads: only its effect tells. A slope of 1e6 would end it."""
    ends = calls_of(algorithm, tolg=1e6) < calls_of(algorithm)
    assert ends is ("tolg" in TOLERANCES[algorithm])


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
    if "local_tolerance" in TOLERANCES[algorithm]:
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
