"""The Orthoglide's kinematics, gauge model and system (11), against slow twins written from the paper."""

import numpy as np
import pytest

from calibench import problems
from calibench.problems import constants
from calibench.problems.orthoglide.kinematics import (
    calibration_matrix,
    direct_kinematics,
    geometry,
    inverse_kinematics,
    posture_jacobian,
)
from calibench.problems.orthoglide.plans import covariance, named_plan, paper_plan
from tests.few import few

L = geometry().length
ZERO = np.full(3, L)
ERRORS = np.array([0.4, -0.7, 1.1, -0.5, 0.9, 0.3])
WORKSPACE = np.stack(np.meshgrid(*[np.linspace(-100, 60, 5)] * 3), axis=-1).reshape(-1, 3)


def jacobian(p, rho, legs=ZERO):
    """Return dp / d(drho, dL), shape (3, 6), at a tool centre point and true joints, eq. (5)."""
    left = np.tile(p, (3, 1)) - np.diag(rho)
    return np.linalg.solve(left, np.hstack([np.diag(p - rho), np.diag(legs)]))


def closure(p, joints, errors):
    """Return the three left-hand sides of (2) minus the right-hand sides, mm^2."""
    rho, legs = joints + errors[:3], L + errors[3:]
    return np.array([np.sum((p - rho[i] * np.eye(3)[i]) ** 2) - legs[i] ** 2 for i in range(3)])


def tool(joints, errors):
    """Solve (2) by Newton from the nominal tool: the slow twin of the direct kinematics."""
    p = np.zeros(3)
    for _ in range(30):
        slope = 2 * (p - np.diag(joints + errors[:3]))
        p = p - np.linalg.solve(slope, closure(p, joints, errors))
    return p


def leg_place(leg, joints, errors, plane):
    """Return where the line from joint centre to tool meets the plane across the leg."""
    p, r = tool(joints, errors), (joints + errors[:3])[leg] * np.eye(3)[leg]
    mu = (plane - r[leg]) / (p - r)[leg]
    return mu * p + (1 - mu) * r  # s(mu), section 3.2


def deviation(reading, errors):
    """Return the deviation of one reading as section 3.1 takes it, with a gauge anywhere on the leg."""
    leg, direction, axis = ("xyz".index(w) for w in (reading.leg, reading.direction, reading.axis))
    p0, r0 = tool(ZERO, errors), ZERO[leg] + errors[leg]
    plane = reading.gauge_position * p0[leg] + (1 - reading.gauge_position) * r0  # eq. (10) at one half
    places = []
    for level in (reading.level_mm, reading.against_mm):
        joints = np.sqrt(L**2 - level**2) * np.ones(3)
        joints[axis] = L + level
        places.append(leg_place(leg, joints, errors, plane)[direction])
    return places[0] - places[1]


def test_the_zero_posture_of_the_nominal_machine_is_the_origin():
    np.testing.assert_allclose(direct_kinematics(ZERO[None]), 0, atol=1e-12)
    np.testing.assert_allclose(inverse_kinematics(np.zeros((1, 3)))[0], L)


@pytest.mark.parametrize("errors", [np.zeros(6), ERRORS, 5 * ERRORS])
def test_direct_kinematics_undo_the_inverse_over_the_workspace(errors):
    back = direct_kinematics(inverse_kinematics(WORKSPACE, errors), errors)
    assert np.abs(back - WORKSPACE).max() < 1e-9


def test_the_printed_root_is_the_other_assembly():
    # At Zero C = 0, so one root is t = 0 and the tool is at the origin; the printed one, -B/A, is 2L/3 away per axis.
    printed = np.full(3, L / 2 + 2 * L**2 / 3 / L - L / 2)
    np.testing.assert_allclose(closure(printed, ZERO, np.zeros(6)), 0, atol=1e-9)
    assert printed[0] > 200


def test_all_legs_keep_the_sign_plus():
    joints = inverse_kinematics(WORKSPACE, ERRORS)
    assert (joints + ERRORS[:3] > WORKSPACE).all()
    for p, rho in zip(WORKSPACE, joints):
        np.testing.assert_allclose(closure(p, rho, ERRORS), 0, atol=1e-9)


def test_out_of_reach_is_not_a_number():
    assert np.isnan(inverse_kinematics(np.array([[0.0, 300.0, 200.0]]))[0, 0])
    assert np.isnan(direct_kinematics(np.array([[L, 3 * L, 9 * L]]))).all()


def test_equation_5_agrees_with_differences():
    joints, h = inverse_kinematics(WORKSPACE[60:61], ERRORS)[0], 1e-4
    analytic = jacobian(WORKSPACE[60], joints + ERRORS[:3], L + ERRORS[3:])
    for i, step in enumerate(h * np.eye(6)):
        up, down = (direct_kinematics(joints[None], ERRORS + s)[0] for s in (step, -step))
        np.testing.assert_allclose(analytic[:, i], (up - down) / (2 * h), atol=1e-8)


def test_equations_6_and_8_are_equation_5_at_the_postures():
    np.testing.assert_allclose(posture_jacobian(), jacobian(np.zeros(3), ZERO), atol=1e-15)
    for axis in range(3):
        for level in (geometry().stroke_plus, geometry().stroke_minus):
            p = level * np.eye(3)[axis]
            expected = jacobian(p, inverse_kinematics(p[None])[0])
            np.testing.assert_allclose(posture_jacobian(axis, np.arcsin(level / L)), expected, atol=1e-14)


def test_the_angles_are_asin_of_stroke_over_length_not_the_printed_ones():
    assert np.degrees(geometry().alpha_plus) == pytest.approx(11.151, abs=5e-4)
    assert np.degrees(geometry().alpha_minus) == pytest.approx(-18.803, abs=5e-4)
    said = constants.column("pashkevich2008", "geometry").entries
    assert (said["alpha_plus"].printed, said["alpha_minus"].printed) == (11.0, -18.7)
    assert (said["alpha_plus"].value, said["alpha_minus"].value) == (11.151, -18.803)


@pytest.mark.parametrize("plan", few(2, ["paper", "cross", "levels", "positions"]))
@pytest.mark.parametrize("errors", [np.zeros(6), ERRORS])
def test_the_residuals_are_those_of_the_slow_twin(plan, errors):
    problem = problems.make("orthoglide6", data="synthetic", plan=plan)
    expected = np.array([deviation(r, errors) for r in problem.plan]) - problem.deviations
    np.testing.assert_allclose(problem.residuals(errors), expected, atol=1e-11)


def test_the_differences_of_table_1_are_max_minus_min():
    problem = problems.make("orthoglide6", data="exp1", free="rho")
    expected = [deviation(r, np.array([0.3, -0.2, 0.5, 0, 0, 0])) for r in problem.plan] - problem.deviations
    np.testing.assert_allclose(problem.residuals(np.array([0.3, -0.2, 0.5])), expected, atol=1e-11)


@pytest.mark.parametrize("row", range(12))
def test_every_row_of_equation_11_agrees_with_differences_of_the_exact_model(row):
    reading, h = paper_plan()[row], 1e-3
    slopes = [(deviation(reading, step) - deviation(reading, -step)) / (2 * h) for step in h * np.eye(6)]
    assert np.abs(calibration_matrix()[row] - slopes).max() < 1e-5


def test_the_linear_model_is_equation_11():
    linear = problems.make("orthoglide6", model="linear")
    np.testing.assert_allclose(linear.jacobian(ERRORS), calibration_matrix(), atol=1e-14)
    np.testing.assert_allclose(linear.residuals(ERRORS), calibration_matrix() @ ERRORS - linear.deviations, atol=1e-12)


@pytest.mark.parametrize("free", ["full", "rho", "L"])
@pytest.mark.parametrize("model", ["exact", "linear"])
@pytest.mark.parametrize("data", ["exp2", "exp3_t2", "synthetic"])
def test_jacobian_and_batch_hold_for_every_choice(free, model, data):
    problem = problems.make("orthoglide6", free=free, model=model, data=data)
    points = problem.lower + (problem.upper - problem.lower) * np.random.default_rng(0).random((9, len(problem.lower)))
    assert problem.batch(points).tolist() == [problem(x) for x in points]
    x, h = points[0], 1e-3
    slopes = [(problem.residuals(x + s) - problem.residuals(x - s)) / (2 * h) for s in h * np.eye(len(x))]
    np.testing.assert_allclose(problem.jacobian(x), np.transpose(slopes), atol=1e-8)
    assert np.isfinite(problem.batch(np.vstack([problem.lower, problem.upper]))).all()


def test_the_paper_s_readings_stand_in_the_order_of_equation_11():
    assert [r.label for r in paper_plan()] == [
        "x_y+", "y_x+", "x_y-", "y_x-", "y_z+", "z_y+", "y_z-", "z_y-", "x_z+", "z_x+", "x_z-", "z_x-",
    ]  # fmt: skip


def test_the_covariance_of_shared_zeros_is_equation_14():
    block = np.kron(np.array([[2.0, 1.0], [1.0, 2.0]]), np.eye(2))  # G: + and - share their Zero
    np.testing.assert_array_equal(covariance(paper_plan()), np.kron(np.eye(3), block))


def test_repeated_readings_with_a_zero_of_their_own_are_independent():
    spread = covariance(named_plan("both_ways"))
    np.testing.assert_array_equal(np.linalg.eigvalsh(spread).round(12), np.repeat([1.0, 3.0], 12))
    np.testing.assert_array_equal(covariance(problems.make("orthoglide6", data="exp1", free="L").plan), 2 * np.eye(6))
