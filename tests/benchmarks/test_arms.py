"""The tables of two measured arms: series of one stand are one table, a third is predicted, intervals are paired."""

import os
from pathlib import Path

import numpy as np
import pytest

from benchmarks.arms import mukca
from benchmarks.arms.across import choices, evenly, formulated, grouped, predicted, rows as of_series, shared_geometry
from benchmarks.arms.frames import framed
from benchmarks.arms.levels import FREE, calibrated
from benchmarks.arms.nested import Nested, auc, rule, searched_again, table as signs
from benchmarks.arms.parts import seen
from benchmarks.arms.series import URDF, in_runs, series, shuffled
from benchmarks.arms.sockets import difference
from benchmarks.arms.within import gain
from calibench.calibration.kinematics import forward, nominal
from calibench.calibration.rigid import rpy, shift
from calibench.calibration.urdf import read_urdf
from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.machines.arm import Arm
from calibench.problems.arm.families import shipped

pytestmark = pytest.mark.usefixtures("at_one_noise")

DATA = Path(os.environ.get("CALIBENCH_DATA", Path(__file__).parents[3] / "shared" / "data"))
GIVEN, PANDA = DATA / "arm_ur10_tmac", DATA / "arm_panda_sockets"
given = pytest.mark.skipif(not GIVEN.is_dir(), reason=f"no measured series at {GIVEN}")
WRONG = {"x_elbow_joint": 0.8, "zero_wrist_1_joint": 0.004, "rx_shoulder_lift_joint": 5e-4}
HERE, THERE = shift(1500, -700, 200) @ rpy(0.02, -0.01, 2.2), shift(-900, 2100, 180) @ rpy(-0.01, 0.03, 0.4)


def measured(stand, name, seed, n=60, noise=0.02):
    """Return a series of an arm that is wrong in a known way, from one stand of the tracker."""
    chain, rng = read_urdf(URDF).chain(), np.random.default_rng(seed)
    q = rng.uniform(-1.5, 1.5, (n, 6))
    at = forward(chain.placed(stand, shift(40, 20, 90)), WRONG, q)[:, :3, 3] + rng.normal(0, noise, (n, 3))
    columns = dict(zip(chain.driven, q.T, strict=True)) | dict(zip("xyz", at.T, strict=True))
    split = np.where(np.arange(n) % 5 == 0, "hold", "train")
    return MeasuredData({**columns, "row": np.arange(float(n)), "split": split}, "arm", {}, name)


def test_the_other_method_has_the_ball_where_ours_has_it():
    q = np.random.default_rng(8).uniform(-1, 1, (2, 9, 7))
    chain = read_urdf(shipped("panda.urdf")).chain("", "ball_link")
    ball = forward(chain, nominal(chain), q.reshape(-1, 7))[:, :3, 3].reshape(2, 9, 3)
    mean = ball.mean(axis=1)
    spread, apart = mukca.left(shipped("panda.urdf"), mukca.origins(shipped("panda.urdf")), (q[0], q[1]))
    assert spread == pytest.approx(np.sqrt(((ball - mean[:, None]) ** 2).sum(axis=2).mean()), rel=1e-9)
    assert apart + mukca.DISTANCE == pytest.approx(np.linalg.norm(mean[0] - mean[1]), rel=1e-9)


@pytest.mark.skipif(not PANDA.is_dir(), reason=f"no measured postures at {PANDA}")
def test_the_other_method_fits_better_than_the_urdf_that_its_authors_published():
    seen, published = list(mukca.places(PANDA / "panda_2").values()), PANDA / "panda_calibrated.urdf"
    found = mukca.fitted(shipped("panda.urdf"), seen)
    ours = np.array([mukca.left(shipped("panda.urdf"), found, pair) for pair in seen])
    theirs = np.array([mukca.left(published, mukca.origins(published), pair) for pair in seen])
    assert (np.sqrt((ours**2).mean(axis=0)) < np.sqrt((theirs**2).mean(axis=0))).all()


@pytest.mark.slow
def test_series_of_one_stand_are_one_table():
    whole = {name: formulated([measured(stand, name, k)]) for k, (name, stand) in enumerate(
        {"B": HERE, "C": HERE, "D": THERE}.items())}  # fmt: skip
    assert grouped(whole) == [("B", "C"), ("D",)]


def test_what_two_stands_calibrate_predicts_a_third_to_the_noise():
    stands = [formulated([measured(HERE, "B", 1)]), formulated([measured(THERE, "D", 2)])]
    geometry = shared_geometry(stands)
    assert geometry["x_elbow_joint"] == pytest.approx(0.8, abs=0.05)
    third = formulated([measured(shift(0, 0, 900), "E", 3)])
    assert np.sqrt((predicted(third, geometry, evenly(len(third.data), 20)) ** 2).mean()) < 0.06
    assert np.sqrt((predicted(third, {}, evenly(len(third.data), 20)) ** 2).mean()) > 0.5


def test_choices_of_poses_differ_and_are_evenly_spread():
    assert evenly(100, 5).tolist() == [0, 25, 50, 74, 99]
    found = choices(100, 5, 4)
    assert len({tuple(told) for told in found}) == 4
    assert all(np.ptp(np.diff(told)) <= 1 and told[0] >= 0 and told[-1] < 100 for told in found)


def test_frames_of_the_true_geometry_leave_the_noise():
    whole = formulated([measured(HERE, "B", 4)])
    left = framed(whole, np.arange(len(whole.data)), WRONG).left(whole.data)
    assert np.sqrt((left**2).mean()) < 0.05


def test_shuffled_rows_keep_what_belongs_together():
    data = measured(HERE, "B", 5)
    other = shuffled(data)
    assert sorted(zip(other["x"], other["elbow_joint"], strict=True)) == sorted(
        zip(data["x"], data["elbow_joint"], strict=True)
    )
    assert not np.array_equal(other["x"], data["x"])
    assert np.array_equal(other["row"], np.arange(60))


def test_each_row_is_kept_back_once_beside_its_neighbours():
    runs = in_runs(shuffled(measured(HERE, "B", 5)))
    held = [np.asarray(run["row"])[np.asarray(run["split"]) == "hold"] for run in runs]
    assert [sorted(rows) for rows in held] == [list(range(12 * k, 12 * k + 12)) for k in range(5)]


def test_intervals_of_a_gain_are_of_the_same_poses():
    rng = np.random.default_rng(6)
    before = rng.uniform(0.2, 1.0, 200)
    low, high = gain(before, before - 0.01)
    assert 0.009 < low < high < 0.012  # poses drawn apart would tell nothing of so little
    assert difference(before, before) == (0.0, 0.0)


@given
@pytest.mark.slow
def test_two_series_of_a_ur10_predict_the_third_better_than_its_makers_table():
    for row in of_series(GIVEN):
        nominal, _, calibrated = (float(cell.split()[0]) for cell in row.split("|")[4:7])
        assert calibrated < 0.7 * nominal, row


@given
def test_a_series_is_read_as_its_authors_keep_it():
    data = series(GIVEN, "D")
    assert len(data) == 632
    assert (np.asarray(data["split"]) == "hold").sum() == 127


def part(truth, before, after, verdict="named", again=1.0):
    """Return a part of four poses, of which the squared errors are told."""
    return Nested("B", 30, 0, verdict, truth, np.array(before), np.array(after), again)


def test_a_sign_of_left_out_poses_counts_what_names_change():
    one = part(0.9, [4.0, 1.0, 1.0, 1.0], [1.0, 2.0, 1.0, 3.0])
    assert one.ratio == pytest.approx(1.0)
    assert one.worse == pytest.approx(2 / 3)  # the third pose is predicted as before
    assert one.surely == 0.0
    assert part(0.9, [4.0, 3.0, 2.0, 5.0], [1.0, 1.0, 1.0, 1.0]).surely == pytest.approx(2.5 / (np.sqrt(5 / 3) / 2))
    assert part(0.9, [1.0] * 4, [1.0] * 4).worse == 0.5


def test_a_rule_is_judged_by_the_names_that_carry_and_by_those_that_do_not():
    good, bad = [1.0] * 4, [4.0] * 4
    found = [
        part(0.8, bad, good),
        part(0.9, good, bad, "partly"),
        part(1.2, good, bad),
        part(1.1, bad, good, again=0.0),
    ]
    every, sure = rule(found).splitlines()
    assert every.endswith("1 of 2 that do not carry, 1 of 2 that carry")
    assert sure.endswith("1 of 2 that do not carry, 0 of 1 that carry")
    assert "| 30 | rms with names over without | 2 | 1.25 | 2 | 1.25 | 0.50 |" in signs(found)
    assert "| 30 | not told again | 2 | 0.00 | 2 | 0.50 | 0.75 |" in signs(found)
    assert auc(np.array([1.0, 2.0]), np.array([2.0, 3.0])) == 0.875


def with_play(count):
    """Return readings of an arm whose second joint has play, far above the noise; a fifth is held back."""
    sound = measured(HERE, "D", 5, count)
    chain = read_urdf(URDF).chain()
    q = np.stack([sound[name] for name in chain.driven], axis=-1)
    came = np.sign(np.diff(q, axis=0, prepend=q[:1])) * [0, 1, 0, 0, 0, 0]
    placed = chain.placed(HERE, shift(40, 20, 90))
    moved = [forward(placed, WRONG, at)[:, :3, 3] for at in (q - 2e-3 * came, q)]
    return sound.with_columns({axis: sound[axis] + (moved[0] - moved[1])[:, k] for k, axis in enumerate("xyz")})


@pytest.mark.slow
def test_a_true_name_is_told_again_without_a_part_of_the_poses_and_predicts_them():
    found = searched_again(with_play(60), 3)
    assert found is not None
    _, truth, before, after, again = found
    assert truth < 0.5
    assert again == 1.0
    assert after.sum() < 0.5 * before.sum()
    assert searched_again(measured(HERE, "D", 5), 3) is None  # nothing is named


@pytest.mark.slow
def test_what_is_seen_of_a_name_is_what_calibration_leaves_of_it():
    report = explain(Arm(URDF), with_play(60))
    plain, final = report.before.fit, report.model.fit
    [(_, c)] = final.model.coefficients(final.x)
    whole = final.J[:, len(plain.x) :] @ c
    left = whole - plain.J @ np.linalg.lstsq(plain.J, whole, rcond=None)[0]
    assert seen(report) == pytest.approx(np.linalg.norm(left) / np.linalg.norm(whole), rel=1e-6)
    assert seen(explain(Arm(URDF), measured(HERE, "D", 5))) == 1.0


def test_the_poses_that_a_series_keeps_back_are_those_that_a_calibration_is_judged_by():
    found = calibrated(measured(HERE, "B", 5))
    assert (found.poses, found.fitted) == (60, 48)
    assert [error.level for error in found.levels] == list(FREE)
    assert found.levels[0].rms > 10 * found.levels[2].rms
