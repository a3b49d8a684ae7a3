"""Rigs: several targets read at one pose are one fit, and targets of the base take the tracker's drift out."""

import numpy as np
import pytest

import calibench
from calibench.calibration.frames import frames_of_positions
from calibench.calibration.kinematics import forward, nominal
from calibench.calibration.urdf import read_urdf
from tests.bench.arm_by_hand import NAMES, TARGET, TRUTH, placed, urdf

REFLECTORS = (TARGET, np.array([-50.0, 30.0, 90.0]), np.array([10.0, -80.0, 60.0]))
FEET = ((1200.0, -1600.0, 400.0), (450.0, -1500.0, 410.0), (800.0, -2400.0, 405.0))  # mm, as the tracker sees them


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "my.urdf").write_text(urdf())
    return tmp_path / "my.urdf"


def rig(n, drift=0.0, reflectors=REFLECTORS, feet=FEET, seed=1, noise=0.03, truth=TRUTH):
    """Return columns: `n` poses of the reflectors, the feet every sixth, of a tracker that shifts and turns evenly."""
    rng, s = np.random.default_rng(seed), np.linspace(0, drift, n)
    q = rng.uniform(-2.4, 2.4, (n, 6))

    def read(places):
        moved = s[:, None] * [0.3, -0.2, 0.4] + np.cross(s[:, None] * [1e-4, 2e-4, -1e-4], places)
        return places + moved + rng.normal(0, noise, (n, 3))

    columns = dict(zip(NAMES, q.T, strict=True))
    for k, seat in enumerate(reflectors, start=1):
        seen = read(placed(q, truth, target=seat)[0])
        columns |= dict(zip((f"x_{k}", f"y_{k}", f"z_{k}"), seen.T, strict=True))
    for k, foot in enumerate(feet, start=1):
        seen = read(np.tile(foot, (n, 1)))
        seen[np.arange(n) % 6 != 0] = np.nan
        columns |= dict(zip((f"base{k}_x", f"base{k}_y", f"base{k}_z"), seen.T, strict=True))
    return columns


def without(columns, *begins):
    return {name: column for name, column in columns.items() if not name.startswith(begins)}


def single(columns, k):
    """Return the columns of one reflector alone."""
    others = [f"{axis}_{j}" for axis in "xyz" for j in (1, 2, 3) if j != k]
    left = without(columns, "base", *others)
    return {name[0] if name.endswith(f"_{k}") and len(name) == 3 else name: column for name, column in left.items()}


def error(calibration, folder, truth=TRUTH):
    """Return how far the flange of the written arm is from the true one, rms [mm] of fresh poses."""
    chain = read_urdf(calibration.write_urdf(folder / "out.urdf")).chain(tip="link_6")
    q = np.random.default_rng(99).uniform(-2.4, 2.4, (300, 6))
    seen, there = placed(q, truth)[0], forward(chain, nominal(chain), q)
    frames = frames_of_positions(there, seen, 1.0)
    return float(np.sqrt(((seen - (frames.base @ there @ frames.tool)[:, :3, 3]) ** 2).sum(axis=1).mean()))


def quick(arm, columns):
    return calibench.calibrate(arm, columns, level="geometry", resamples=20)


def codes(calibration):
    return {str(note.code): note for note in calibration.notes}


def test_three_reflectors_are_one_fit_which_is_nearer_to_the_truth_than_each_alone(arm):
    columns = rig(30)
    together = quick(arm, without(columns, "base"))
    alone = [error(quick(arm, single(columns, k)), arm.parent) for k in (1, 2, 3)]
    assert error(together, arm.parent) < 0.8 * np.median(alone)
    assert codes(together)["targets"].values["targets"] == ["1", "2", "3"]
    [seats] = {tuple(np.round(together.fit.model.parts(together.fit.p)[1][1], 0))}
    assert np.linalg.norm(np.array(seats) - (REFLECTORS[1] - TARGET)) < 2


def test_a_column_that_names_the_target_of_a_row_says_the_same_as_columns_of_each(arm):
    wide = without(rig(30), "base")
    long = {name: np.tile(wide[name], 3) for name in NAMES}
    long |= {axis: np.concatenate([wide[f"{axis}_{k}"] for k in (1, 2, 3)]) for axis in "xyz"}
    long["target"] = np.repeat(["a", "b", "c"], 30)
    one, other = quick(arm, wide), quick(arm, long)
    changes = [[change.change for change in answer.changes] for answer in (one, other)]
    np.testing.assert_allclose(*changes, atol=1e-5)


def test_a_reflector_that_some_poses_hide_costs_these_readings_and_no_pose(arm):
    columns = without(rig(30), "base")
    for axis in "xyz":
        columns[f"{axis}_2"][::3] = np.nan
    assert quick(arm, columns).poses == 30


def test_the_drift_that_targets_of_the_base_tell_is_taken_out(arm):
    columns = rig(40, drift=1.0)
    drifting, without_feet = quick(arm, columns), quick(arm, without(columns, "base"))
    assert error(drifting, arm.parent) < 0.4 * error(without_feet, arm.parent)
    assert codes(drifting)["base_drift"].values["course"] == "even"
    assert "step" in codes(without_feet)
    assert "step" not in codes(drifting)


def test_a_tracker_that_stood_still_is_left_alone(arm):
    columns = rig(30)
    still = quick(arm, columns)
    assert codes(still)["base_drift"].values["course"] == "still"
    assert still.error_after == quick(arm, without(columns, "base")).error_after


def test_a_target_that_stands_with_the_base_needs_no_name(arm):
    columns = rig(30, drift=1.0, reflectors=REFLECTORS[:1], feet=FEET[:2])
    rows = {name: [] for name in (*NAMES, "x", "y", "z", "target")}
    for i in range(30):
        for of, where in (("ball", "{}_1"), ("floor", "base1_{}"), ("wall", "base2_{}")):
            read = [columns[where.format(axis)][i] for axis in "xyz"]
            if np.isfinite(read).all():
                joints = [columns[name][i] if of == "ball" else np.nan for name in NAMES]
                for name, value in zip(rows, (*joints, *read, of), strict=True):
                    rows[name].append(value)
    answer = quick(arm, rows)
    assert answer.poses == 30
    assert codes(answer)["base_drift"].text.startswith("floor, wall stand with the base: by 5 visits")


def test_a_column_target_that_numbers_the_poses_is_refused(arm):
    columns = single(rig(30), 1) | {"target": [f"P{k}" for k in range(30)]}
    with pytest.raises(ValueError, match="column target names 30 targets in 30 rows"):
        quick(arm, columns)
