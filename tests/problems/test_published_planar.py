"""The GPM2002 problems against the numbers of Cong et al. 2008: names and order, boxes, truths, starts, branch.

The printed columns are read from the data file; tolerances are half a printed digit or say why they are not.
"""

import itertools

import numpy as np
import pytest
import reference
from planar_cases import PLANAR, entries, label, made, nominal_machine, over, true_machine, vector

from calibench import problems
from calibench.problems.planar.gpm2002 import home, inverse_kinematics

Z = ("z1", "z2", "z3")
LA, LB = ("la1", "la2", "la3"), ("lb1", "lb2", "lb3")
NEAR_ONE, NEAR_ZERO, LENGTH = (0.8, 1.2), (-0.2, 0.2), (239, 249)

# Names and order, box by kind, the table with truth, the problem's default plan and size: "Problems" of PAPERS.md.
SENSOR_ZERO = problems.make("sensor_zero")
LINK_LENGTH = problems.make("link_length")
FULL11 = problems.make("full11")
FULL11_SECTION3 = problems.make("full11", paper_section=3)
FULL12_XA2 = problems.make("full12")
FULL12_YA2 = problems.make("full12", gauge="ya2")

NAMES = [
    (SENSOR_ZERO, Z),
    (LINK_LENGTH, Z + LA + LB),
    (FULL11, (*Z, *LA, *LB, "xa3", "ya3")),
    (FULL11_SECTION3, (*Z, *LA, *LB, "xa3", "ya3")),
    (FULL12_XA2, ("ya2", "xa3", "ya3", *LA, *LB, *Z)),
    (FULL12_YA2, (*Z, *LA, *LB, "xa2", "xa3", "ya3")),
]
SECTION3_BOX = dict.fromkeys(Z, NEAR_ONE) | dict.fromkeys(LA + LB, LENGTH)
SECTION3_BASES = {"xa2": (423, 443), "xa3": (423, 443), "ya3": (490, 510)}
TABLE5_BOX = dict.fromkeys(Z, NEAR_ZERO) | dict.fromkeys(LA + LB, LENGTH)
TABLE5_BASES = {"ya2": (-5, 5), "xa3": (428, 438), "ya3": (495, 505)}
BOXES = [
    (SENSOR_ZERO, SECTION3_BOX),
    (LINK_LENGTH, SECTION3_BOX),
    (FULL11, TABLE5_BOX | TABLE5_BASES),
    (FULL11_SECTION3, SECTION3_BOX | SECTION3_BASES),
    (FULL12_XA2, TABLE5_BOX | TABLE5_BASES),
    (FULL12_YA2, SECTION3_BOX | SECTION3_BASES),
]
TRUTHS = [
    (SENSOR_ZERO, "table2.actual"),
    (LINK_LENGTH, "table3.actual"),
    (FULL11, "table5.actual"),
    (FULL11_SECTION3, "table4.actual"),
    (FULL12_XA2, "table5.actual"),
    (FULL12_YA2, "table4.actual"),
]
STARTS = [
    (SENSOR_ZERO, "table2.initial"),
    (LINK_LENGTH, "table3.initial"),
    (FULL11, "table5.nominal"),
    (FULL11_SECTION3, "table4.initial"),
    (FULL12_XA2, "table5.nominal"),
    (FULL12_YA2, "table4.initial"),
]


@pytest.mark.parametrize(("problem", "names"), NAMES)
def test_the_parameters_have_the_names_and_the_order_of_the_paper(problem, names):
    assert tuple(p.name for p in problem.parameters) == tuple(names)


@over(PLANAR)
def test_offsets_are_in_rad_and_all_else_in_mm(case):
    problem = made(case)
    assert {p.name: p.unit for p in problem.parameters} == {
        p.name: "rad" if p.name in Z else "mm" for p in problem.parameters
    }
    # J3's coordinates are lengths all of them: that is its benefit
    assert problem.error != "J3" or {c.unit for c in problem.coordinates} == {"mm"}


@pytest.mark.parametrize(("problem", "box"), BOXES)
def test_the_box_is_that_of_the_problem(problem, box):
    for p in problem.parameters:
        assert (p.lower, p.upper) == pytest.approx(box[p.name], abs=1e-12), p.name


@pytest.mark.parametrize(("problem", "column"), TRUTHS)
def test_the_truth_is_the_actual_column_of_its_table(problem, column):
    printed = entries(column)
    assert {p.name: p.true for p in problem.parameters} == {p.name: printed[p.name] for p in problem.parameters}


@pytest.mark.parametrize(("problem", "column"), STARTS)
def test_the_start_is_the_initial_column_of_its_table(problem, column):
    # printed to 1e-5 rad; that z3 agrees too is what tells l_a3 = 243.5 and l_b3 = 244.2 from their misprints
    printed = entries(column)
    for p in problem.parameters:
        assert p.start == pytest.approx(printed[p.name], abs=1e-5), p.name


@pytest.mark.parametrize("wrong", [{"la3": 244.5}, {"lb3": 244.6}])
def test_the_printed_start_of_z3_refutes_the_misprinted_lengths(wrong):
    for table in ("table3", "table4"):
        machine = nominal_machine() | entries(f"{table}.actual")
        assert _start(machine, 3) == pytest.approx(entries(f"{table}.initial")["z3"], abs=1e-5)
        assert _start(machine | wrong, 3) != pytest.approx(entries(f"{table}.initial")["z3"], abs=1e-5)


def test_the_sizes_and_plans_are_the_papers():
    sizes = {label(case): len(made(case).readings) for case in PLANAR if dict(case[1])["error"] == "J2"}
    assert sizes == {
        "sensor_zero-J2": 9,
        "link_length-J2": 21,
        "full11-J2-3": 31,
        "full11-J2-4": 50,
        "full12-J2-xa2": 50,
        "full12-J2-ya2": 31,
    }
    plans = {name: problems.make(name).options["plan"] for name in ("sensor_zero", "link_length", "full11", "full12")}
    assert plans == {"sensor_zero": "grid", "link_length": "grid", "full11": "disc", "full12": "disc"}


def test_sensor_zero_knows_no_j3():
    assert {made(case).error for case in PLANAR if case[0] == "sensor_zero"} == {"J1", "J2"}


def test_the_home_angles_are_the_papers():
    # 1.111132, 3.110680, -1.458332 rad: zero of the offsets of Tables 5, 7 and 8, to half a digit
    angles = inverse_kinematics(vector(nominal_machine()), home()[None])[0]
    np.testing.assert_allclose(angles, [1.111132, 3.110680, -1.458332], rtol=0, atol=5e-7)


def test_home_is_the_papers():
    assert home().tolist() == [216.5, 250.0]


def test_only_one_of_eight_elbow_branches_gives_the_start_of_table_2():
    printed = entries("table2.initial")
    machine = nominal_machine() | entries("table2.actual")
    fitting = [
        branch
        for branch in itertools.product((-1, 1), repeat=3)
        if all(abs(_start(machine, i, branch[i - 1]) - printed[f"z{i}"]) < 1e-5 for i in reference.LEGS)
    ]
    assert fitting == [(1, 1, 1)]


@over(PLANAR)
def test_every_reading_is_taken_in_that_branch(case):
    # in the branch + the joint B lies to the left of the line from A to the end-effector
    problem, machine = made(case), vector(true_machine(case))
    angles = problem.readings + machine[12:15]
    for i in range(3):
        towards = problem.true_positions - machine[2 * i : 2 * i + 2]
        side = towards[:, 0] * np.sin(angles[:, i]) - towards[:, 1] * np.cos(angles[:, i])
        assert (side > 0).all()


def test_out_of_reach_is_not_a_number_and_no_warning():
    angles = inverse_kinematics(vector(nominal_machine()), np.array([[216.5, 250.0], [2000.0, 250.0]]))
    assert np.isfinite(angles[0]).all()
    assert np.isnan(angles[1]).all()


def test_the_budget_of_the_paper_is_fifty_million():
    assert SENSOR_ZERO.budgets == {"ci": 20_000, "paper": 50_000_000}


@over(PLANAR)
def test_the_last_target_is_the_level_of_success_and_targets_fall(case):
    problem = made(case)
    assert list(problem.targets) == sorted(problem.targets, reverse=True)
    assert problem.targets[-1] == pytest.approx(1e-23 if problem.error == "J1" else 1e-18)
    assert problem(problem.truth) < problem.targets[-1]


def test_random_starts_belong_to_section_4_and_printed_ones_to_section_3():
    starts = {problem: problem.default_start for problem, _ in STARTS}
    assert [p for p, start in starts.items() if start == "random"] == [FULL11, FULL12_XA2]
    assert [p for p, start in starts.items() if start == "nominal"] == [
        SENSOR_ZERO, LINK_LENGTH, FULL11_SECTION3, FULL12_YA2,
    ]  # fmt: skip


def test_three_samples_can_have_a_second_exact_zero():
    # Three equations for three offsets. Which plan of three points the paper used is not known; these, drawn in a
    # box, have a second zero within .2 rad, so a value of zero at n=3 proves nothing about the offsets.
    from scipy.optimize import least_squares

    problem = problems.make("sensor_zero", n=3, plan="box")
    other = least_squares(problem.residuals, [0.8354, 1.1325, 1.0135], problem.jacobian, method="lm", xtol=1e-15)
    assert problem(other.x) < 1e-15
    assert (problem.lower < other.x).all()
    assert (other.x < problem.upper).all()
    assert np.abs(other.x - problem.truth).max() > 0.1


def _start(machine, leg, elbow=1):
    """Return the paper's start of an offset: the hand stops at (210, 245) and takes it for home."""
    geometry = entries("geometry")
    assumed = reference.active_angle(nominal_machine(), leg, geometry["home_x"], geometry["home_y"], elbow)
    reading = reference.active_angle(machine, leg, geometry["estimate_x"], geometry["estimate_y"], elbow)
    return assumed - (reading - machine[f"z{leg}"])
