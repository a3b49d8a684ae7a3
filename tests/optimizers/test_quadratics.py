"""Laws on convex quadratics: who has the gradient gets down, and no candidate depends on the unit of the value.

f = |D Q (x - x*)|^2 with a random rotation Q: f* = 0 is exact, and a power of two as its unit is exact too. A budget of
200 (dim + 1) pays for 200 values with their gradients.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from calibench import bench, optimizers
from calibench.optimizers.nlopt import ALGORITHMS
from tests.few import one_of_each
from tests.optimizers.page import sized_by_value

nlopt = pytest.importorskip("nlopt")
pytest.importorskip("pygmo")

DIMENSIONS, CONDITIONS, UNITS = (2, 6, 12), (1.0, 1e4), (2.0**-30, 1.0, 2.0**30)
LOCAL = [n for n in optimizers.names() if "restarts" in optimizers.registry.options(n)]
WITH_GRADIENT = [n for n in LOCAL if optimizers.make(n).traits.uses_gradient]
MOVING_ASYMPTOTES = {  # first-order models, a curvature for all directions at once: below, NLopt alone does the same
    "nlopt_LD_MMA": "does not learn the curvature of a rotated valley",
    "nlopt_LD_CCSAQ": "does not learn the curvature of a rotated valley",
}
LINE_SEARCHES = {  # of SciPy, alike in a direct call (test_scipy): they end where they gain no more, 2e-11 by rounding
    # of tnc and 1.0e-5 to 1.3e-5 of cg, over five kernels of OpenBLAS
    "scipy_cg": 2e-5, "scipy_l_bfgs_b": 1e-11, "scipy_tnc": 3e-11, "scipy_basinhopping": 1e-11,
}  # fmt: skip
TO_ROUNDING = [f"nlopt_{algorithm}" for algorithm in ALGORITHMS if ALGORITHMS[algorithm].family == "limited_memory"]
OURS = [n for n in optimizers.names() if not n.startswith("pygmo_") and n != "fmincon"]


class Quadratic:
    """f = unit |D Q (x - x*)|^2 in a box, x* inside it and neither at its centre nor at the start."""

    def __init__(self, dimension: int, condition: float = 1e4, unit: float = 1.0) -> None:
        rng = np.random.default_rng([2008, dimension])
        rotation = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
        self._A = unit**0.5 * np.sqrt(np.geomspace(1.0, condition, dimension))[:, None] * rotation
        self._optimum = rng.uniform(-0.5, 0.5, dimension)
        self.lower, self.upper = -np.ones(dimension), np.ones(dimension)
        self.start = rng.uniform(-0.9, 0.9, dimension)
        self.asked: list[np.ndarray] = []

    def residuals(self, x: np.ndarray) -> np.ndarray:
        self.asked.append(np.array(x))
        return np.asarray(self._A @ (x - self._optimum))

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        return self._A

    def __call__(self, x: np.ndarray) -> float:
        r = self.residuals(x)
        return float(r @ r)


def left_of(name: str, dimension: int, condition: float, unit: float, share: float, **options: Any) -> float:
    """Return the best value over that at the start; a run that comes below `share` of it ends there."""
    problem = Quadratic(dimension, condition, unit)
    first = problem(problem.start)
    run = bench.execute(
        problem, optimizers.make(name, **options), budget=200 * (dimension + 1), target=0.99 * share * first
    )
    assert run.status == "ok", run.row["error"]
    return run.best_value / first


@pytest.mark.parametrize("name", one_of_each(n for n in WITH_GRADIENT if n not in MOVING_ASYMPTOTES))
def test_a_method_with_the_gradient_comes_down_twelve_decades_or_as_far_as_its_line_search(name: str) -> None:
    most, enough = optimizers.make(name).traits.maximum_dimension or np.inf, LINE_SEARCHES.get(name, 1e-12)
    units = (1.0,) if name in OURS else UNITS  # of which the unit changes no candidate
    for dimension in (d for d in DIMENSIONS if d <= most):
        for condition in CONDITIONS:
            for unit in units:
                assert left_of(name, dimension, condition, unit, 1e-12) < enough, (dimension, condition, unit)


@pytest.mark.parametrize("name", list(MOVING_ASYMPTOTES))
def test_moving_asymptotes_come_down_where_all_directions_are_alike_and_only_there(name: str) -> None:
    for dimension in DIMENSIONS:
        for unit in UNITS:
            assert left_of(name, dimension, 1.0, unit, 1e-12) < 1e-12, (dimension, unit)
            assert left_of(name, dimension, 1e4, unit, 1e-12) > 1e-8, (dimension, unit)


@pytest.mark.parametrize("name", list(MOVING_ASYMPTOTES))
@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_nlopt_alone_stays_up_with_moving_asymptotes_too(name: str, dimension: int) -> None:
    """No line of ours between the formula and NLopt: it is the method and not the adapter."""
    problem = Quadratic(dimension)
    values: list[float] = []

    def function(x: np.ndarray, gradient: np.ndarray) -> float:
        r = problem._A @ (x - problem._optimum)
        gradient[:] = 2.0 * problem._A.T @ r
        values.append(float(r @ r))
        return values[-1]

    search = nlopt.opt(getattr(nlopt, name.removeprefix("nlopt_")), dimension)
    search.set_lower_bounds(problem.lower)
    search.set_upper_bounds(problem.upper)
    search.set_min_objective(function)
    search.set_maxeval(200)
    search.optimize(problem.start)
    assert len(values) == 200
    assert min(values) > 1e-8 * values[0]


@pytest.mark.parametrize("name", TO_ROUNDING)
def test_luksans_codes_go_on_to_rounding(name: str) -> None:
    """Their own test, a slope of 1e-8, ends them far above."""
    for unit in UNITS:
        assert left_of(name, 2, 1e4, unit, 1e-24) < 1e-24, unit


@pytest.mark.parametrize("name", one_of_each(OURS))
def test_the_unit_of_the_value_changes_no_candidate(name: str) -> None:
    one = asked(name, 1.0)
    assert len(one) > 10
    for unit in (UNITS[0], UNITS[2]):
        assert np.array_equal(asked(name, unit), one), unit


@pytest.mark.parametrize("algorithm", [a for a, known in ALGORITHMS.items() if not known.may_hang])
def test_the_value_is_divided_because_its_size_matters_or_without_effect(algorithm: str) -> None:
    name = f"nlopt_{algorithm}"
    plain = [asked(name, unit, scale_value=False) for unit in UNITS]
    same = all(np.array_equal(plain[1], other) for other in plain)
    assert same is not (algorithm in sized_by_value())


def asked(name: str, unit: float, **options: Any) -> np.ndarray:
    """Return the points that `name` proposes, shape (calls, dim)."""
    problem = Valley(unit)
    optimizer = optimizers.make(name, **options)
    if optimizer.traits.may_hang:  # it would run in another process, and tells nothing there but its trace
        run = bench.execute(problem, optimizer, budget=60)
        return np.array([(n, charged) for n, charged, _, _ in run.points] + [(0, 0)] * 11)
    run = bench.execute(problem, optimizer, budget=400)
    assert run.status == "ok", run.row["error"]
    return np.array(problem.asked)


class Valley(Quadratic):
    """Rosenbrock's valley in two variables, times `unit`."""

    def __init__(self, unit: float) -> None:
        super().__init__(2)
        self._size = unit**0.5
        self.lower, self.upper, self.start = np.full(2, -2.0), np.full(2, 2.5), np.array([-1.2, 1.0])

    def residuals(self, x: np.ndarray) -> np.ndarray:
        self.asked.append(np.array(x))
        return self._size * np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        return self._size * np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])
