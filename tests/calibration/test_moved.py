"""A base, a target or a joint that moved between two rows is told, with the row and how far; a sound arm has none."""

import numpy as np
import pytest

from calibench import calibrate
from calibench.calibration.determined import order_of
from calibench.calibration.fit import fit_arm
from calibench.calibration.moved import motion_from, motion_of_wild
from calibench.core.notes import DataError
from tests.bench.arm_by_hand import NAMES, placed, urdf
from tests.calibration.test_normal import measured


def motions(model):
    fit = fit_arm(model, order_of(model.names, "geometry"))
    return [found(model, fit.p, fit.kept, fit.wild) for found in (motion_from, motion_of_wild)]


def told(tmp_path, q, seen, **more):
    (tmp_path / "my.urdf").write_text(urdf())
    columns = dict(zip((*NAMES, "x", "y", "z"), np.column_stack([q, seen]).T, strict=True))
    return calibrate(tmp_path / "my.urdf", columns | more, units=dict.fromkeys("xyz", "mm"))


def moving(n, rows, seed, **motion):
    """Return joints (n, 6) [rad] and places (n, 3) [mm], those of `rows` (n,) with another target or joint."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2.4, 2.4, (n, 6))
    jump = np.where(rows[:, None], motion.get("joint", np.zeros(6)), 0.0)
    shifts = np.where(rows[:, None], motion.get("target", np.zeros(3)), 0.0)
    at, turns = placed(q + jump)
    return q, at + np.einsum("nij,nj->ni", turns, shifts) + rng.normal(0, 0.03, (n, 3))


@pytest.mark.parametrize("n", [60, 9000])
def test_the_row_after_which_the_tracker_stood_elsewhere_is_found(n):
    model, at = measured(n, posed=False, seed=4), n // 3
    assert motions(model) == [None, None]
    model.position[at:] += [0.4, -0.3, 0.1]
    found, _ = motions(model)
    assert found.what == "base"
    assert abs(int(found.rows[0]) - at) <= n // 6000
    assert found.off == pytest.approx(0.51, abs=0.05)


@pytest.mark.parametrize("off", [0.3, 3.0, 80.0])
def test_a_target_that_moved_on_its_link_is_told_and_a_column_mends_it(tmp_path, off):
    q, seen = moving(60, np.arange(60) >= 40, seed=1, target=off * np.array([0.6, 0.0, 0.8]))
    with pytest.raises(DataError, match=r"row 41.*target.*on its link.* a column target") as stopped:
        told(tmp_path, q, seen)
    assert stopped.value.note.code == "two_stands" or stopped.value.note.values["off_mm"] == pytest.approx(off, 0.2)
    mended = told(tmp_path, q, seen, target=np.where(np.arange(60) < 40, 1, 2))
    assert mended.error_after < 0.1


def test_a_joint_whose_zero_jumped_is_named(tmp_path):
    q, seen = moving(80, np.arange(80) >= 50, seed=2, joint=1e-3 * np.eye(6)[2])
    with pytest.raises(DataError, match=rf"from row 51 on.*the zero of {NAMES[2]} had moved"):
        told(tmp_path, q, seen)


def test_wild_readings_of_one_motion_are_told_as_such_and_others_are_not(tmp_path):
    rows = np.arange(60) >= 54  # too few for a motion from a row on
    q, seen = moving(60, rows, seed=3, target=np.array([2.0, 0.0, 0.0]))
    [note] = [note for note in told(tmp_path, q, seen).notes if note.code == "step"]
    assert note.rows == ("row 55", "row 60")
    assert note.values["off_mm"] == pytest.approx(2.0, abs=0.1)
    q, seen = moving(60, rows, seed=3)
    seen[rows] += np.random.default_rng(3).normal(0, 2.0, (6, 3)) * np.array([10.0, 1, 1, 1, 1, 1])[:, None]
    assert "step" not in {note.code for note in told(tmp_path, q, seen).notes}


def test_a_sound_arm_moves_nothing_in_any_order_of_its_poses():
    for seed in range(12):
        model = measured(30 + 10 * seed, posed=bool(seed % 2), seed=seed)
        order = np.argsort(model.joints[:, seed % 6]) if seed % 3 else np.arange(len(model.joints))
        assert motions(model.at(order)) == [None, None]
