"""J1, J2, J3 of the package against the paper's equations written out, over every planar problem.

Both sides round: the twin's coordinates are not centred, so a component of E2 carries some 1e-10 mm^2 of rounding.
Relative to residuals of the size met in the box (a candidate's J2 is 1e6 to 1e11 mm^4) that is far below 1e-10; next to
a zero it is not, and there `test_calibration_laws` says what holds.
"""

import numpy as np
import pytest
import reference
from hypothesis import assume, given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from planar_cases import PLANAR, inside, made, named, over, points, true_machine

CLOSE = 1e-10
FAR_FROM_ZERO = {"J1": 5.0, "J2": 1e6, "J3": 1e6}  # mm^2, mm^4: J1 is about J2 / 238144


def twin(case, x):
    """Return the value that the paper's equations give to the candidate x of a case."""
    problem = made(case)
    machine = true_machine(case)
    if problem.error == "J3":
        machine = reference.decoupled(machine)
    function = {"J1": reference.j1, "J2": reference.j2, "J3": reference.j3}[problem.error]
    return function(machine | named(problem, x), problem.readings)


@over(PLANAR)
def test_the_kernels_compute_the_papers_equations_at_random_points_of_the_box(case):
    problem = made(case)
    for x in points(problem, 40, seed=1):
        assert problem(x) == pytest.approx(twin(case, x), rel=CLOSE, abs=0)


@over(PLANAR)
@settings(deadline=None, max_examples=30, derandomize=True, database=None)
@given(unit=arrays(np.float64, 12, elements=st.floats(0, 1)))
def test_the_kernels_compute_the_papers_equations_wherever_hypothesis_looks(case, unit):
    problem = made(case)
    x = inside(problem, unit[: len(problem.lower)])
    expected = twin(case, x)
    assume(expected > FAR_FROM_ZERO[problem.error])
    assert problem(x) == pytest.approx(expected, rel=CLOSE, abs=0)


@over(PLANAR)
def test_the_end_effector_is_that_of_equation_33(case):
    problem = made(case)
    machine = reference.decoupled(true_machine(case)) if problem.error == "J3" else true_machine(case)
    joints = reference.passive_joints_decoupled if problem.error == "J3" else reference.passive_joints
    for x in points(problem, 5, seed=2):
        candidate = machine | named(problem, x)
        expected = reference.end_effector(candidate, *joints(candidate, problem.readings))
        np.testing.assert_allclose(problem.positions(x), np.column_stack(expected), rtol=0, atol=1e-9)


@over(PLANAR)
def test_the_readings_are_the_true_machines_angles_less_its_offsets(case):
    problem, machine = made(case), true_machine(case)
    x, y = problem.true_positions.T
    for leg in reference.LEGS:
        angle = reference.active_angle(machine, leg, x, y, elbow=+1)
        np.testing.assert_allclose(problem.readings[:, leg - 1], angle - machine[f"z{leg}"], rtol=0, atol=1e-14)


def test_the_twin_has_components_of_e2_that_are_equal():
    # The claim that carries the compiled form: with (x, y) eliminated, the three rows of (38) are one number.
    case = next(case for case in PLANAR if case[0] == "full12" and made(case).error == "J2")
    problem = made(case)
    for x in points(problem, 5, seed=3):
        machine = true_machine(case) | named(problem, x)
        rows = reference.circle_errors(machine, *reference.passive_joints(machine, problem.readings))
        np.testing.assert_allclose(rows - rows[0], 0.0, atol=1e-9 * np.abs(rows).max())
