"""`bench calibrate` of arms whose numbers look nearly alike: an elbow with an offset, axes that are parallel."""

import json

import numpy as np
import pytest

from calibench.bench.cli import main
from tests.bench.arm_by_hand import about

QUARTER = np.pi / 2
ELBOW = (  # place behind the joint before [mm], its turn about x, lower and upper [rad] of joints that turn about z
    ((0, 0, 333), 0, -2.8, 2.8), ((0, 0, 0), -QUARTER, -1.7, 1.7), ((0, -316, 0), QUARTER, -2.8, 2.8),
    ((82.5, 0, 0), QUARTER, -3.0, -0.1), ((-82.5, 384, 0), -QUARTER, -2.8, 2.8), ((0, 0, 0), QUARTER, 0, 3.7),
    ((88, 0, 0), QUARTER, -2.8, 2.8),
)  # fmt: skip
SCARA = (((0, 0, 320), 0, -2.3, 2.3), ((325, 0, 50), 0, -2.5, 2.5), ((275, 0, 0), 2 * QUARTER, -3, 3))
BASE, TARGET = np.array([800.0, -1900.0, 400.0]), np.array([60.0, 20.0, 70.0])


def urdf(arm):
    lines = ['<robot name="by_hand"><link name="link_0"/>']
    for k, (place, turn, lower, upper) in enumerate(arm, start=1):
        xyz = " ".join(str(v / 1000) for v in place)
        lines += [
            f'<link name="link_{k}"/><joint name="joint_{k}" type="revolute"><parent link="link_{k - 1}"/>',
            f'<child link="link_{k}"/><origin xyz="{xyz}" rpy="{turn} 0 0"/><axis xyz="0 0 1"/>',
            f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/></joint>',
        ]
    return "\n".join([*lines, "</robot>", ""])


def placed(arm, q, truth):
    """Return where the target is, (3,) [mm], and how it is turned, (3, 3); `truth` as the calibration names it."""
    at, turn = BASE, about((0, 0, 1), 0.7)
    for k, (place, tilt, *_) in enumerate(arm, start=1):
        at = at + turn @ np.array(place, dtype=float)
        turn = turn @ about((1, 0, 0), tilt)
        at = at + turn @ [truth.get(f"{axis}_joint_{k}", 0.0) for axis in "xyz"]
        turn = turn @ about((1, 0, 0), truth.get(f"rx_joint_{k}", 0)) @ about((0, 1, 0), truth.get(f"ry_joint_{k}", 0))
        turn = turn @ about((0, 0, 1), q[k - 1] + truth.get(f"zero_joint_{k}", 0.0))
    return at + turn @ TARGET, turn


@pytest.fixture
def calibrate(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def call(arm, truth, noise, posed, poses=80):
        rng = np.random.default_rng(8)
        low, high = np.array([limit[-2:] for limit in arm]).T
        names = [f"joint_{k}" for k in range(1, len(arm) + 1)]
        rows = [",".join([*names, "x", "y", "z", *(("rx", "ry", "rz") if posed else ())])]
        for q in rng.uniform(low, high, (poses, len(arm))):
            at, turn = placed(arm, q, truth)
            about_all = about((1, 0, 0), rng.normal(0, noise * 2e-3)) @ about((0, 1, 0), rng.normal(0, noise * 2e-3))
            r = about((0, 0, 1), rng.normal(0, noise * 2e-3)) @ about_all @ turn
            angles = np.arctan2(r[2, 1], r[2, 2]), -np.arcsin(r[2, 0]), np.arctan2(r[1, 0], r[0, 0])
            rows.append(",".join(f"{v:.9f}" for v in (*q, *(at + rng.normal(0, noise, 3)), *(angles if posed else ()))))
        (tmp_path / "my.csv").write_text("\n".join([*rows, ""]))
        (tmp_path / "my.urdf").write_text(urdf(arm))
        with pytest.raises(SystemExit) as ended:
            main(["calibrate", "urdf=my.urdf", "data=my.csv", "page=false", "--json"])
        assert ended.value.code == 0
        return json.loads(capsys.readouterr().out)

    return call


def test_a_slide_along_an_elbow_is_a_length_and_no_large_angle(calibrate):
    truth = {"zero_joint_3": 2e-3, "z_joint_4": 0.8, "x_joint_6": 0.3}
    found = calibrate(ELBOW, truth, 0.03, posed=True)
    changes = {change["parameter"]: change for change in found["changes"]}
    angles = [abs(change["change"]) for change in changes.values() if change["unit"] == "rad"]
    assert max(angles) < 2.2e-3  # it was 12 mrad of the elbow, as .8 mm are of 82.5
    assert abs(changes["zero_joint_3"]["change"] - 2e-3) < 5 * changes["zero_joint_3"]["sd"]


@pytest.mark.parametrize("posed", [pytest.param(True, marks=pytest.mark.slow), False])
def test_the_scatter_that_is_told_is_that_of_the_fit_that_is_written(calibrate, posed):
    rng, sizes = np.random.default_rng(4), {"x": 1.0, "y": 1.0, "z": 1.0, "rx": 3e-3, "ry": 3e-3, "zero": 1e-2}
    truth = {f"{what}_joint_{k}": rng.normal(0, size) for k in range(1, 8) for what, size in sizes.items()}
    found = calibrate(ELBOW, truth, 0.03, posed, poses=25)
    assert 0.01 < found["scatter"][0] < 0.05  # told were .4 and 3 mm: of fits that held numbers which these determine


@pytest.mark.parametrize("seed", [8, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (9, 16, 23))])
def test_what_an_arm_is_off_by_at_first_is_not_taken_for_noise(calibrate, seed):
    rng, sizes = np.random.default_rng(seed), {"x": 1.0, "y": 1.0, "z": 1.0, "rx": 3e-3, "ry": 3e-3, "zero": 1e-2}
    truth = {f"{what}_joint_{k}": rng.normal(0, size) for k in range(1, 8) for what, size in sizes.items()}
    found = calibrate(ELBOW, truth, 0.03, False, poses=25)
    assert found["after"]["rms"] < 0.15  # it was 1 to 4 mm: numbers were held that these poses determine
    assert len(found["changes"]) == 22


def test_where_axes_are_parallel_the_target_is_not_put_far_from_the_tip(calibrate):
    truth = {"x_joint_2": -0.3, "ry_joint_2": 1.1e-3, "rx_joint_2": 0.7e-3}
    found = calibrate(SCARA, truth, 0.02, posed=False)
    assert found["frames"]["target"][2] == pytest.approx(0.0, abs=1.0)  # nothing tells how high it is
    changes = {change["parameter"]: change["change"] for change in found["changes"]}
    assert changes["x_joint_2"] == pytest.approx(-0.3, abs=2 * 1.1e-3 * TARGET[2])
