"""What holds for every registered calibration problem: sums, bits, derivatives, and zero at the truth.

The laws run over the registry, with every error function, gauge and section that a problem declares. Those that any
problem must keep stand in `calibench.testing`; here is what these problems keep beside them.
"""

import json

import numpy as np
import pytest
import reference
from planar_cases import ALL, PLANAR, coordinates_of, made, named, over, points, true_machine

from calibench import testing

FLOOR = {"J1": 1e-23, "J2": 1e-18, "J3": 1e-18}  # mm^2, mm^4: rounding at the default plans, with some margin
WITH_J3 = [case for case in PLANAR if made(case).error == "J3"]


@over(ALL)
def test_a_problem_that_ships_keeps_the_laws_of_a_users_own(case):
    for law in testing.PROBLEM_LAWS:
        law(made(case))


@over(PLANAR)
def test_there_is_a_residual_a_sample_and_for_j1_a_residual_a_leg(case):
    problem = made(case)
    samples = len(problem.readings) * (3 if problem.error == "J1" else 1)
    assert problem.residuals(problem.start).shape == (samples,)
    assert problem.jacobian(problem.start).shape == (samples, len(problem.lower))


@over(PLANAR)
def test_the_residuals_are_the_paper_s_leg_errors_and_powers(case):
    problem = made(case)
    machine = true_machine(case)
    x = points(problem, 1, seed=5)[0]
    candidate = (
        machine | named(problem, x) if problem.error != "J3" else reference.decoupled(machine) | named(problem, x)
    )
    joints = reference.passive_joints_decoupled if problem.error == "J3" else reference.passive_joints
    rows = reference.circle_errors(candidate, *joints(candidate, problem.readings))
    if problem.error == "J1":  # the length of E1's leg i is | |P - B_i| - l_b |, here with its sign
        lb = np.array([[candidate[f"lb{i}"]] for i in reference.LEGS])
        expected = (np.sqrt(rows + lb**2) - lb).T.ravel()
    else:
        expected = np.sqrt(3) * rows[0]
    np.testing.assert_allclose(problem.residuals(x), expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@over(ALL)
def test_without_noise_the_truth_is_a_zero(case):
    problem = made(case)
    if problem.truth is None:
        pytest.skip("measured data: the truth is not known")
    assert 0 <= problem(problem.truth) < problem.targets[-1] * (1 + 1e-9)


@over(PLANAR)
def test_the_rounding_floor_is_where_the_paper_s_best_results_lie(case):
    problem = made(case)
    assert 0 <= problem(problem.truth) < FLOOR[problem.error]


@over(ALL)
def test_the_start_and_a_random_point_are_no_zero(case):
    problem = made(case)
    least = getattr(problem, "minimum", None) or 0.0
    easy = least + 1e6 * (problem.targets[-1] - least)
    if problem.truth is None:
        easy = problem.targets[0]  # measured data leave a rest
    assert problem(problem.start) > easy
    assert problem(points(problem, 1)[0]) > easy


@over(ALL)
def test_no_coordinate_of_a_box_is_held(case):
    problem = made(case)
    assert (problem.lower < problem.upper).all()


@over(ALL)
def test_the_arrays_are_the_coordinates_in_order_and_cannot_be_changed(case):
    problem = made(case)
    for key, attribute in (("lower", "lower"), ("upper", "upper"), ("start", "start"), ("truth", "true")):
        array = getattr(problem, key)
        if array is None:
            continue
        assert array.tolist() == [getattr(c, attribute) for c in problem.coordinates]
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


@over(ALL)
def test_the_options_of_a_problem_make_it_again(case):
    from calibench import problems

    problem = made(case)
    options = json.loads(json.dumps(dict(problem.options)))
    again = problems.make(problem.name, **{key: value for key, value in options.items() if value is not None})
    x = points(problem, 1, seed=10)[0]
    assert again(x) == problem(x)
    assert again.data_id == problem.data_id


@over(WITH_J3)
def test_j3_at_the_corresponding_point_is_j2(case):
    name, options = case
    j3 = made(case)
    j2 = made((name, tuple((key, "J2" if key == "error" else value) for key, value in options)))
    for x in points(j2, 10, seed=11):
        machine = true_machine(case) | named(j2, x)
        assert j3(coordinates_of(j3, machine)) == pytest.approx(j2(x), rel=1e-11, abs=0)


@over(WITH_J3)
def test_the_physical_parameters_of_j3_follow_from_equation_44(case):
    problem = made(case)
    for x in points(problem, 10, seed=12):
        physical = reference.coupled(reference.decoupled(true_machine(case)) | named(problem, x))
        expected = [physical[p.name] for p in problem.parameters]
        np.testing.assert_allclose(problem.physical(x), expected, rtol=1e-14)
    np.testing.assert_allclose(problem.physical(problem.truth), [p.true for p in problem.parameters], rtol=1e-14)


@over([case for case in PLANAR if case not in WITH_J3])
def test_where_the_search_is_in_physical_parameters_physical_changes_nothing(case):
    problem = made(case)
    assert problem.coordinates == problem.parameters
    x = points(problem, 1, seed=13)[0]
    assert problem.physical(x).tolist() == x.tolist()


@over(WITH_J3)
def test_the_box_of_j3_is_the_bounding_box_of_the_physical_one(case):
    problem = made(case)
    box = {p.name: (p.lower, p.upper) for p in problem.parameters}
    for coordinate in problem.coordinates:
        if not coordinate.name.startswith(("lac", "las")):
            assert (coordinate.lower, coordinate.upper) == box[coordinate.name]
            continue
        leg, side = coordinate.name[-1], np.cos if coordinate.name.startswith("lac") else np.sin
        la, z = np.meshgrid(np.linspace(*box[f"la{leg}"], 3), np.linspace(*box[f"z{leg}"], 20001))
        reached = la * side(z)  # the grid holds 0, where the cosine turns, so it is the range itself
        assert coordinate.lower == pytest.approx(reached.min(), abs=1e-6)
        assert coordinate.upper == pytest.approx(reached.max(), abs=1e-6)


@over(ALL)
def test_a_candidate_of_the_wrong_shape_is_refused(case):
    # a kernel reads where it is told to, so a short vector would be overread in silence
    problem = made(case)
    dim = len(problem.lower)
    for wrong in (np.zeros(dim - 1), np.zeros(dim + 1), np.zeros((1, dim)), np.float64(1.0)):
        for call in (problem, problem.residuals, problem.jacobian):
            with pytest.raises(ValueError, match=f"{case[0]}: x has shape .* is needed"):
                call(wrong)
    for wrong in (np.zeros(dim), np.zeros((2, dim + 1)), np.zeros((1, 1, dim))):
        with pytest.raises(ValueError, match=f"{case[0]}: points have shape .* is needed"):
            problem.batch(wrong)


@over(ALL)
def test_an_empty_batch_has_no_values(case):
    problem = made(case)
    assert problem.batch(np.empty((0, len(problem.lower)))).shape == (0,)
