"""`bench design machine=arm plan.n=N`: poses worth more than random ones, inside the limits, and when to stop."""

import json

import numpy as np
import pytest

from calibench.bench.cli import main
from calibench.calibration.poses import choose
from tests.bench.arm_by_hand import measured, table, urdf


@pytest.fixture
def design(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.urdf").write_text(urdf())

    def call(*words, code=0):
        with pytest.raises(SystemExit) as ended:
            main(["design", "machine=arm", "machine.urdf=my.urdf", *words, "--json"])
        told = capsys.readouterr()
        assert ended.value.code == code, told.err
        return json.loads(told.out) if code == 0 else told.err

    return call


def rows(count=80, seed=0):
    return np.random.default_rng(seed).normal(size=(count, 3, 5)) * np.geomspace(1, 0.1, 5)


def test_exchanged_poses_tell_more_than_any_of_many_random_sets():
    pool, nothing, workspace = rows(), np.zeros((5, 5)), rows(20, 1)
    rng = np.random.default_rng(3)
    sets = [rng.choice(len(pool), 6, replace=False) for _ in range(300)]
    information = [sum(pool[k].T @ pool[k] for k in one) + 1e-4 * np.eye(5) for one in sets]
    by_d = choose(pool, nothing, workspace, 6, "D")
    assert by_d.logdet > max(np.linalg.slogdet(one)[1] for one in information)
    by_e = choose(pool, nothing, workspace, 6, "E")
    assert by_e.least > max(np.linalg.eigvalsh(one)[0] for one in information)
    assert by_e.least >= by_d.least
    assert len(set(by_d.places)) == len(set(by_e.places)) == 6


def test_each_further_pose_leaves_less_uncertain():
    found = choose(rows(), np.zeros((5, 5)), rows(20, 1), 10)
    assert (np.diff(found.error) < 0).all()
    assert found.enough(1e9) == 0
    assert found.enough(0.0) is None


def test_poses_stand_inside_the_limits_and_the_box(design):
    found = design("plan.n=8", "plan.box=[200,900,-600,600,0,1200]")
    poses = np.array(found["poses"])
    assert poses.shape == (8, 6)
    assert np.abs(poses).max() <= 2.6
    assert found["numbers"] == 18
    again = design("plan.n=8", "plan.box=[200,900,-600,600,0,1200]")
    assert again == found


def test_poses_beside_those_that_are_measured_keep_to_their_ranges(design, tmp_path):
    q, seen, _ = measured(30, reach=1.5)
    (tmp_path / "my.csv").write_text(table(q, seen))
    found = design("plan.n=4", "data=my.csv", "plan.to=poses.csv")
    poses = np.array(found["poses"])
    assert ((poses >= q.min(axis=0)) & (poses <= q.max(axis=0))).all()
    assert found["measured"] == 30
    assert found["error_mm"][0] < 1
    written = np.loadtxt(tmp_path / "poses.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(written, poses, atol=1e-6)
    assert (tmp_path / "poses.csv").read_text().startswith("joint_1 [rad],joint_2 [rad],")


def test_the_noise_of_readings_to_come_changes_nothing_of_those_that_are_measured(design, tmp_path):
    q, seen, _ = measured(30, reach=1.5)
    (tmp_path / "my.csv").write_text(table(q, seen))
    found = {sigma: design("plan.n=4", "data=my.csv", f"plan.sigma={sigma}")["error_mm"] for sigma in (1e-3, 1, 1e3)}
    before = [error[0] for error in found.values()]
    np.testing.assert_allclose(before, design("plan.n=4", "data=my.csv")["error_mm"][0], rtol=1e-9)
    assert found[1e-3][4] < 0.9 * before[0], "a better tracker helps"
    assert found[1e3][4] == pytest.approx(before[0], rel=1e-3), "one that sees nothing does not"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["plan.n=4", "plan.sigma_rotation=0"], "plan.sigma_rotation=0: the noise of a reading [rad], above 0"),
        (["plan.n=0"], "from 1 to 200 poses are needed"),
        ([], "plan.n= is missing: how many poses to propose"),
        (["plan.n=4", "plan.to=nowhere/poses.csv"], "there is no folder nowhere"),
        (["plan.n=4", "plan.m=3"], "unknown argument 'plan.m'"),
        (["plan.n=4", "machine.observe=sockets"], "as many postures as the arm can reach"),
        (["plan.n=4", "plan.limits=data"], "goes with data=FILE"),
        (["plan.n=4", "plan.box=[1,0,1,0,1,0]"], "is needed"),
        (["plan.n=4", "plan.box=[5000,5001,0,1,0,1]"], "hardly any pose"),
    ],
)
def test_a_plan_that_makes_no_sense_is_one_line(design, words, said):
    told = design(*words, code=2)
    assert said in told
    assert told.count("\n") == 1
