"""`bench design machine=arm plan.n=N`: poses worth more than random ones, inside the limits, and when to stop."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calibench.bench.cli import main
from calibench.calibration import Arm, parse_urdf, read_arm, read_urdf
from calibench.calibration.determined import order_of
from calibench.calibration.fit import fit_arm
from calibench.calibration.kinematics import forward, jacobian, nominal, parameter_units
from calibench.calibration.model import model_of
from calibench.calibration.poses import choose, design_poses
from calibench.calibration.readings import Table
from calibench.calibration.start import HowRead
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
        (["plan.n=4", "plan.sigma_rotation=0"], "a number above 0 is needed: noise of their rotations (0.0005) [RAD]"),
        (["plan.n=0"], "from 1 to 200 is needed"),
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


def test_poses_stay_out_of_the_boxes_with_every_link_and_the_target(design, tmp_path):
    boxes = np.array([[[200, 900], [-900, 900], [-900, 250]], [[-900, -300], [-300, 300], [300, 900]]])
    chain = read_urdf(tmp_path / "my.urdf").chain()

    def inside(found):
        poses, places = np.array(found["poses"]), []
        for k in range(1, len(chain.joints) + 1):
            places.append(forward(replace(chain, joints=chain.joints[:k], tail=np.eye(4)), {}, poses[:, :k])[:, :3, 3])
        tip = forward(chain, {}, poses)
        places += [tip[:, :3, 3], (tip @ [0, 100, 100, 1])[:, :3]]
        along = np.concatenate([a + (b - a) * t for a, b in pairwise(places) for t in np.linspace(0, 1, 60)])
        return sum(((along > box[:, 0]) & (along < box[:, 1])).all(axis=1).sum() for box in boxes)

    words = f"plan.keep_out={boxes.ravel().tolist()}".replace(" ", "")
    assert inside(design("plan.n=30")) > 0
    assert inside(design("plan.n=30", words)) == 0
    assert "plan.keep_out=: hardly any pose" in design("plan.n=3", "plan.keep_out=[-3e3,3e3,-3e3,3e3,-3e3,3e3]", code=2)


def test_what_is_written_of_poses_are_targets_in_the_units_of_ros_and_what_they_bring(design, tmp_path):
    found = design("plan.n=4", "plan.to=next.csv")
    targets = json.loads((tmp_path / "next_targets.json").read_text())
    assert targets == found["targets"]
    assert [[one[name] for name in found["joints"]] for one in targets] == found["poses"]
    gain = pd.read_csv(tmp_path / "next_gain.csv")
    assert gain.to_dict("records") == [pytest.approx(one) for one in found["gain"]]
    assert (tmp_path / "next_gain.png").stat().st_size > 5000
    errors = [one["error_mm"] for one in found["gain"]]
    assert errors == sorted(errors, reverse=True)
    assert found["gain"][0]["poses"] == 0
    assert found["gain"][-1]["poses"] == 80
    assert found["gain"][-1]["left_mm"] >= np.sqrt(3) * found["scatter_mm"]
    wrong = design("plan.n=4", "plan.off=5")["gain"]
    assert wrong[0]["error_mm"] == pytest.approx(10 * found["gain"][0]["error_mm"]), "the error that is stated"


def test_a_target_of_a_joint_that_slides_is_in_metres():
    text = urdf().replace('name="joint_1" type="revolute"', 'name="joint_1" type="prismatic"')
    chain = parse_urdf(text.encode()).chain()
    found = design_poses(Arm(Path("my.urdf"), chain), 3)
    assert [one["joint_1"] for one in found.targets] == pytest.approx((found.joints[:, 0] / 1000).tolist())


def test_the_error_that_is_foretold_is_that_of_the_numbers_that_are_fitted(tmp_path):
    (tmp_path / "my.urdf").write_text(urdf())
    arm = read_arm(tmp_path / "my.urdf")
    foretold, true = [], []
    for seed in range(8):
        rng = np.random.default_rng([seed, 3])
        p, joints = nominal(arm.chain), rng.uniform(-2, 2, (40, 6))
        numbers = [k for k, name in enumerate(parameter_units(arm.chain)) if name.startswith("zero_joint_")][1:5]
        p[numbers] = rng.normal(0, 1e-3, 4)
        seen = forward(arm.chain, p, joints)[:, :3, 3] + rng.normal(0, 0.05, (40, 3))
        readings = Table.of({
            **{f"joint_{k + 1}": joints[:, k] for k in range(6)}, **dict(zip("xyz", seen.T, strict=True))
        }, "drawn", units={f"joint_{k + 1}": "rad" for k in range(6)} | dict.fromkeys("xyz", "mm"))  # fmt: skip
        start = HowRead().start(readings, arm.chain)
        found = design_poses(arm, 1, start=start, limits="data")
        foretold.append(found.chosen.error[0])
        model = model_of(arm.chain, start.readings, start.base, start.tool)
        fit = fit_arm(model, order_of(model.names, "geometry", model.sliding))
        away = fit.p - p
        arms = [k for k in fit.kept if not model.names[k].startswith(("base_", "tool_"))]
        slopes = jacobian(fit.model.chain, fit.p, rng.uniform(-2, 2, (300, 6)), np.array(arms))[:, :3]
        true.append(np.sqrt(((slopes @ away[arms]) ** 2).sum(axis=1).mean()))
    assert np.sqrt(np.mean(np.square(true))) == pytest.approx(np.sqrt(np.mean(np.square(foretold))), rel=0.3)
