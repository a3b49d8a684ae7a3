"""`delta9`: the kernels against a machine written plainly, what its plans see, and what it refuses."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from calibench import problems, testing
from calibench.problems.delta.calibration import ANGLES, WEIGHT, places, travels


def carriages(problem, x, travel):
    """Return the three carriages at their endstops, less `travel`, (3, 3), and the rods."""
    angles = np.array(ANGLES) + np.array([x[4], x[5], 0.0])
    out = problem.machine.radius + x[3]
    height = problem.machine.switch + np.array(x[:3]) - travel
    return np.stack([out * np.cos(angles), out * np.sin(angles), height], axis=-1), problem.machine.rod + np.array(
        x[6:]
    )


def nozzle(problem, x, travel, near):
    """Return where the nozzle hangs, by Newton's steps on the spheres' equations from a place near it."""
    at, rods = carriages(problem, x, travel)
    p = np.array(near)
    for _ in range(8):
        p = p - np.linalg.solve(2 * (p - at), ((p - at) ** 2).sum(axis=1) - rods**2)
    return p


def test_kernels_are_the_machine_written_plainly():
    problem = problems.make("delta9", plan="rings", sigma=0.01, seed=3)
    machine, at = problem.machine, problem.places
    x = problem.truth + 0.3 * np.array([1, -1, 0.5, 1, 0.01, -0.01, 0.7, -0.2, 0.4])
    ends = [travels(p, machine) for p in (at.first, at.second)]
    expected = []
    for k, between in enumerate(at.between):
        first = nozzle(problem, x, ends[0][k], at.first[k])
        second = nozzle(problem, x, ends[1][k], at.second[k])
        model = np.linalg.norm(second - first) if between else first[2]
        expected.append((WEIGHT if between else 1.0) * (model - problem.measured[k]))
    assert problem.residuals(x) == pytest.approx(np.array(expected), abs=1e-9)


@pytest.mark.parametrize("options", [{}, {"sigma": 0.02}, {"plan": "rich"}, {"instance": 3}])
def test_all_laws_of_a_problem_are_kept(options):
    testing.check_problem(problems.make("delta9", **options))


@pytest.mark.parametrize("plan", ["object", "rings", "rich"])
def test_every_plan_sees_all_nine(plan):
    found = problems.identify(problems.make("delta9", plan=plan))
    assert found.rank == 9
    assert found.condition < 200


def test_a_richer_plan_tells_more():
    worst = [problems.identify(problems.make("delta9", plan=p)).standard_errors[0] for p in ("object", "rings", "rich")]
    assert worst[0] > 1.5 * worst[1] > 2 * worst[2] * 1.1


def test_heights_alone_leave_radius_and_rods_almost_inseparable():
    problem = problems.make("delta9", plan="rich")
    heights = problem.places.between == 0
    J = problem.jacobian(problem.truth) / np.array([1, 1, 1, 1, 244, 244, 1, 1, 1])
    with_distances, alone = np.linalg.cond(J), np.linalg.cond(J[heights])
    assert alone > 2 * with_distances


def test_descent_finds_the_truth_without_noise():
    problem = problems.make("delta9")
    found = least_squares(problem.residuals, problem.start, problem.jacobian, x_scale="jac", xtol=1e-15, ftol=1e-15)
    assert found.x == pytest.approx(problem.truth, abs=1e-7)
    assert problem.merit(found.x)["kmrmse"] < 1e-6


def test_a_machine_that_cannot_close_has_no_value():
    problem = problems.make("delta9")
    x = problem.start.copy()
    x[6] = -300.0
    assert np.isnan(problem(x))
    assert np.isnan(problem.batch(x[None])).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"plan": "ring"}, "rings"),
        ({"sigma": -1.0}, r"delta9\.sigma=-1\.0: must be 0 or more \(a standard deviation"),
        ({"seed": -1}, "delta9.seed=-1: must be 0 or more"),
        ({"instance": 0}, "delta9.instance=0: must be 1 or more"),
        ({"instance": 2, "sigma": 0.5}, "delta9.sigma=0.5: instance=2 means"),
    ],
)
def test_what_no_delta_is_is_refused_in_one_line(options, said):
    with pytest.raises(ValueError, match=said) as refused:
        problems.make("delta9", **options)
    assert "\n" not in str(refused.value)


def test_a_plan_has_the_rows_it_says():
    assert [len(places(name, 100.0).between) for name in ("object", "rings", "rich")] == [19, 31, 61]
