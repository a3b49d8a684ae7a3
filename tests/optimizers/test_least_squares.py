"""Least squares on the papers' problems: from a hundred random starts to the rounding floor, and who leaves the box."""

import numpy as np
import pytest

from calibench import bench, optimizers, problems

CIRCLE = {"plan": "circle", "radius": 80}
PROBLEMS = ["sensor_zero", "link_length", "full11", "full12"]


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, CIRCLE], ids=["default plan", "circle R80"])
@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("method", ["trf", "lm"])
@pytest.mark.parametrize("starts", [range(10), pytest.param(range(10, 100), marks=pytest.mark.slow)], ids=["10", "90"])
def test_every_random_start_reaches_the_rounding_floor(method, name, options, starts):
    p, optimizer = problems.make(name, **options), optimizers.make(method)
    runs = [bench.execute(p, optimizer, budget=20_000, seed=seed, start="random") for seed in starts]
    assert max(run.best_value for run in runs) < 1e-18
    inside = [bool(((p.lower <= run.best_x) & (run.best_x <= p.upper)).all()) for run in runs]
    assert [run.row["inside_box"] for run in runs] == inside
    assert method == "lm" or all(inside)


def test_unbounded_lm_slides_along_the_gauge_out_of_the_box():
    p = problems.make("full12")
    runs = [bench.execute(p, optimizers.make("lm"), budget=20_000, seed=seed, start="random") for seed in range(10)]
    assert not any(run.row["inside_box"] for run in runs)
    assert all(run.row["kmrmse_aligned"] < 1e-9 for run in runs)
    assert np.ptp([run.row["gauge_phi"] for run in runs]) > 0.01


@pytest.mark.parametrize("method", ["lm", "trf", "dogbox"])
def test_without_a_jacobian_differences_pay_for_themselves(method):
    class NoJacobian:
        lower, upper, start = np.full(2, -2.0), np.full(2, 2.0), np.array([-1.2, 1.0])
        calls = 0

        def __call__(self, x):
            raise AssertionError("least squares asks for residuals")

        def residuals(self, x):
            self.calls += 1
            return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])

    p = NoJacobian()
    run = bench.execute(p, optimizers.make(method), budget=500)
    assert run.best_value < 1e-15
    assert run.evaluations == run.charged == p.calls <= 500


def test_an_open_box_is_searched():
    class Open:
        lower, upper, start = np.full(2, -np.inf), np.full(2, np.inf), np.array([-1.2, 1.0])

        def __call__(self, x):
            r = self.residuals(x)
            return float(r @ r)

        def residuals(self, x):
            return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])

    for method in ("lm", "trf", "dogbox"):
        assert bench.execute(Open(), optimizers.make(method), budget=2000).best_value < 1e-15


@pytest.mark.parametrize("jacobian", [True, False])
@pytest.mark.parametrize("method", ["trf", "dogbox"])
def test_a_coordinate_whose_bounds_are_equal_is_held(method, jacobian):
    class Held:
        lower, upper, start = np.array([-2.0, 0.5, -2.0]), np.array([2.0, 0.5, 2.0]), np.array([-1.2, 0.5, 1.0])

        def __call__(self, x):
            raise AssertionError("least squares asks for residuals")

        def residuals(self, x):
            assert x[1] == 0.5
            return np.array([10 * (x[2] - x[0] ** 2), 1 - x[0], x[1]])

    class Sloped(Held):
        def jacobian(self, x):
            return np.array([[-20 * x[0], 0, 10], [-1, 0, 0], [0, 1, 0]])

    run = bench.execute((Sloped if jacobian else Held)(), optimizers.make(method), budget=500)
    assert run.status == "ok"
    assert run.best_x == pytest.approx([1, 0.5, 1], abs=1e-6)
    assert run.best_value == pytest.approx(0.25)


@pytest.mark.parametrize("method", ["trf", "dogbox"])
def test_a_box_that_is_one_point_is_evaluated_once(method):
    class Point:
        lower = upper = start = np.array([3.0, 4.0])

        def __call__(self, x):
            return float(x @ x)

        def residuals(self, x):
            return x

    run = bench.execute(Point(), optimizers.make(method), budget=500)
    assert (run.status, run.stop_reason, run.evaluations, run.best_value) == ("ok", "converged", 1, 25.0)
