"""Plans, a user's own table, simulated data, and what is refused: one line that names the cause and the way out."""

import csv
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from calibench import problems
from calibench.problems.orthoglide.plans import PlanName, Reading, named_plan, read_table

HEADER = "leg,direction,posture,gauge_position,level_mm,pass,payload_N,repeat,split,deviation [mm]"


def make(**options):
    return problems.make("orthoglide6", **options)


def rows_of(problem):
    """Return the measured table of a problem as the rows of a user's CSV file."""
    return [
        [r.leg, r.direction, r.axis, r.gauge_position, r.level_mm, r.approach, r.payload_N, r.repeat, "train", float(d)]
        for r, d in zip(problem.plan, problem.deviations)
    ]  # fmt: skip


def write(path, rows, header=HEADER):
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header.split(","))
        writer.writerows(rows)
    return path


@pytest.fixture
def rows():
    return rows_of(make())


@pytest.mark.parametrize("plan", get_args(PlanName))
def test_every_named_plan_is_solved_without_noise(plan):
    problem = make(data="synthetic", plan=plan)
    assert problem(problem.truth) == 0.0
    np.testing.assert_allclose(problem.best, problem.truth, atol=1e-10)
    assert problem.merit(problem.best)["kmrmse"] < 1e-10
    assert problem.merit(problem.start)["parameter_error_mm"] == np.abs(problem.truth).max()


def test_merit_of_measured_data_is_not_known():
    assert make().truth is None
    assert make().merit(np.zeros(6)) == {}


def before_measuring(plan):
    """Return what the nominal machine tells of a plan."""
    return problems.identify(make(data="synthetic", plan=plan), np.zeros(6), noise=0.01)


def test_better_plans_are_told_before_measuring():
    worst = {name: before_measuring(name).standard_errors.max() for name in get_args(PlanName)}
    assert worst["paper"] == pytest.approx(0.726, abs=1e-3)  # with the covariance as weight; .727 without
    assert worst["both_ways"] == pytest.approx(worst["paper"] / np.sqrt(2))
    assert worst["rich"] < worst["positions"] < worst["cross"] < worst["both_ways"] < worst["levels"] < worst["paper"]
    assert worst["rich"] < worst["paper"] / 6


def test_standard_errors_are_those_of_many_noisy_runs():
    expected = before_measuring("cross").standard_errors
    spread = make(data="synthetic", plan="cross").residual_covariance(np.zeros(6))
    cases = [make(data="synthetic", plan="cross", sigma=0.01, seed=s) for s in range(80)]
    found = np.array([problems.fit(case, covariance=spread) - case.truth for case in cases])
    # 80 runs know a standard deviation to 8 %; the truth is 6 mm from nominal, which changes the slopes by 5 %
    np.testing.assert_allclose(found.std(axis=0), expected, rtol=0.3)
    assert (np.abs(found.mean(axis=0)) < 4 * expected / np.sqrt(80)).all()


def test_the_noise_follows_the_seed_and_shares_its_zeros():
    quiet, one, again, two = (make(data="synthetic", sigma=s, seed=k) for s, k in ((0, 0), (1, 1), (1, 1), (1, 2)))
    assert one.data_id == again.data_id != two.data_id != quiet.data_id
    noise = np.array([make(data="synthetic", sigma=1.0, seed=s).deviations - quiet.deviations for s in range(300)])
    assert np.abs(noise.T @ noise / 300 - one.residual_covariance(one.start)).max() < 0.7
    assert np.corrcoef(noise[:, 0], noise[:, 2])[0, 1] == pytest.approx(0.5, abs=0.15)  # x_y+ and x_y-
    assert np.corrcoef(noise[:, 0], noise[:, 1])[0, 1] == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize("plan", ["paper", "cross", "payload", "both_ways"])
def test_a_table_written_and_read_is_the_same_problem(tmp_path, plan):
    problem = make(data="synthetic", plan=plan, sigma=0.01, seed=3)
    path = write(tmp_path / "mine.csv", rows_of(problem))
    mine = make(readings=str(path))
    assert mine.plan == problem.plan
    assert mine.data_id == problem.data_id
    assert mine(problem.truth) == problem(problem.truth)
    assert mine.truth is None
    assert problems.orthoglide6.from_readings(path).data_id == mine.data_id
    again = problems.make("orthoglide6", **{k: v for k, v in mine.options.items() if v is not None})
    assert again.data_id == mine.data_id


def test_a_plan_can_be_a_file_without_deviations(tmp_path):
    path = write(
        tmp_path / "plan.csv", [r[:3] for r in rows_of(make(data="synthetic", plan="paper"))], "leg,direction,posture"
    )
    text = path.read_text().replace(",x\n", ",max\n").replace(",y\n", ",max\n").replace(",z\n", ",max\n")
    lines = text.splitlines()
    half = [lines[0], *lines[1:3], *lines[5:7], *lines[9:11]]  # the six Max postures
    path.write_text("\n".join([*half, *(line.replace("max", "min") for line in half[1:])]) + "\n")
    assert before_measuring(str(path)).rank == 6
    assert sorted(r.label for r in make(data="synthetic", plan=str(path)).plan) == sorted(r.label for r in make().plan)


def test_the_paper_s_postures_have_names(tmp_path):
    rows = [["x", "y", "xmax", 0.1], ["X", "z", "min", -0.2], ["y", "x", "z-", 0.3]]
    path = write(tmp_path / "mine.csv", rows[:2], "leg,direction,posture,deviation")
    plan, values = read_table(path)
    assert [(r.axis, r.level_mm) for r in plan] == [("x", 60.0), ("x", -100.0)]
    assert values.tolist() == [0.1, -0.2]
    with pytest.raises(ValueError, match=r"posture='z-': .*x, y, z, max, min"):
        read_table(write(path, rows, "leg,direction,posture,deviation"))


def test_an_array_needs_its_plan():
    deviations = make().deviations
    mine = problems.orthoglide6.from_readings(deviations, plan="paper")
    assert mine.data_id == make().data_id
    with pytest.raises(ValueError, match="an array of deviations needs the plan"):
        problems.orthoglide6.from_readings(deviations)
    with pytest.raises(ValueError, match=r"readings have shape \(11,\)"):
        problems.orthoglide6.from_readings(deviations[:11], plan="paper")


def refused(match, call):
    with pytest.raises(ValueError, match=match) as caught:
        call()
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("data", ["exp1", "exp2_t1", "exp3_t1"])
def test_six_differences_cannot_give_six_parameters(data):
    refused(
        rf"free=full: the 6 differences of Max and Min of data={data} see 5 of 6 parameters; take free=rho",
        lambda: make(data=data),
    )
    assert len(make(data=data, free="rho").best) == 3


@pytest.mark.parametrize(
    ("column", "cell", "message"),
    [
        (9, "", "reading 3: the cell of deviation holds no value; fill it in or leave the row out"),
        (9, "nan", "reading 3: the cell of deviation holds no value"),
        (9, "0,3", "column deviation, reading 3: '0,3' is no number"),
        (0, "", "reading 3: the cell of leg holds no value"),
        (0, "w", "reading 3: leg='w': x, y or z is needed"),
        (2, "", "reading 3: the cell of posture holds no value"),
        (1, "y", r"reading 3 .*: a gauge along its own leg y reads nothing"),
        (1, "up", "direction='up': x, y or z is needed"),
        (3, "155", "reading 3: gauge_position=155: a share of the leg is needed"),
        (3, "0.1", r"reading 3 .*: gauge_position=0.1 is off the leg at level_mm=-100 .*take a smaller level"),
        (4, "", "reading 3: the cell of level_mm holds no value"),
        (4, "1e308", r"reading 3 .*: level_mm=1e\+308 is out of reach: -100 .. 60 mm"),
        (4, "80", r"reading 3 .*: level_mm=80 is out of reach: -100 .. 60 mm"),
        (4, "0", r"reading 3 .*: level_mm=0 is compared with itself"),
        (4, "60", r"reading 3 \(x_y\+\) is reading 1 again; number the two by repeat"),
        (5, "back", "reading 3: pass='back': fwd or rev is needed"),
        (6, "heavy", "column payload_N, reading 3: 'heavy' is no number"),
        (7, "1.5", "reading 3: repeat=1.5: a whole number is needed"),
    ],
)
def test_a_wrong_cell_is_named(tmp_path, rows, column, cell, message):
    rows[2][column] = cell
    path = write(tmp_path / "mine.csv", rows)
    for call in (lambda: make(readings=str(path)), lambda: problems.orthoglide6.from_readings(path)):
        refused(message, call)
        refused("readings=.*mine.csv", call)


def test_metres_are_noticed(tmp_path, rows):
    for row in rows:
        row[9] = float(row[9]) / 1000
    refused("look like metres, millimetres are needed", lambda: make(readings=str(write(tmp_path / "m.csv", rows))))
    for row in rows:
        row[9], row[4] = row[9] * 1000, row[4] / 1000
    refused("level_mm reaches 0.1: they look like metres", lambda: make(readings=str(write(tmp_path / "m.csv", rows))))


def test_micrometres_are_noticed():
    wrong = make().deviations * 1000
    refused("look like micrometres", lambda: problems.orthoglide6.from_readings(wrong, plan="paper"))


def test_too_few_rows_for_the_parameters(tmp_path, rows):
    path = write(tmp_path / "mine.csv", rows[:5])
    refused(r"has 5 rows; 6 parameters need 6 or more", lambda: make(readings=str(path)))
    twice = [[*r[:7], repeat, *r[8:]] for r in rows if r[0] == "x" for repeat in (0, 1)]
    leg = write(tmp_path / "mine.csv", twice)
    refused(
        r"the 8 rows of readings=.*mine.csv see 4 of 6 parameters; take more postures, or free=rho",
        lambda: make(readings=str(leg)),
    )


def test_files_that_are_none(tmp_path, rows):
    empty, bare = tmp_path / "empty.csv", write(tmp_path / "bare.csv", [])
    empty.write_text("")
    refused("cannot be read", lambda: make(readings=str(tmp_path / "no.csv")))
    refused("the file is empty", lambda: make(readings=str(empty)))
    refused("a header and no readings", lambda: make(readings=str(bare)))
    refused(
        "no column deviation; the header has leg, direction, posture",
        lambda: make(readings=str(write(bare, [r[:3] for r in rows], "leg,direction,posture"))),
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"free": "both"}, r"orthoglide6\.free=both: choices: full, rho, L"),
        ({"data": "exp3"}, r"orthoglide6\.data=exp3: .*choices: exp1, exp2, exp2_t1"),
        ({"model": "liner"}, "did you mean 'linear'"),
        ({"sigma": 0.1}, r"orthoglide6\.sigma=0\.1: data=exp2 is measured; take data=synthetic"),
        ({"data": "synthetic", "sigma": -1}, r"sigma=-1: must be 0 or more \(a standard deviation, mm\)"),
        ({"data": "synthetic", "seed": -1}, "seed=-1: must be 0 or more"),
        ({"data": "synthetic", "plan": "croos"}, r"orthoglide6\.plan=croos: did you mean 'cross'"),
        ({"readings": "a.csv", "data": "exp2"}, "data=exp2: the readings are measured; leave one of the two out"),
    ],
)
def test_wrong_options_are_one_line(options, message):
    refused(message, lambda: make(**options))
    refused(message, lambda: problems.orthoglide6(**options))


def test_a_posture_out_of_reach_is_refused_in_a_plan_too():
    far = replace(named_plan("paper")[0], level_mm=61.0)
    refused("level_mm=61 is out of reach", lambda: problems.orthoglide6.from_readings(np.zeros(1), (far,)))
    assert Reading("x", "y", "z", 30.0).label == "y_x@z+30"
