"""An arm and its camera in one fit: poses of an arm written by hand, with a camera on its hand or beside it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from calibench import calibrate, hand_eye
from calibench.calibration.kinematics import forward, nominal
from calibench.calibration.urdf import read_urdf
from tests.bench import arm_by_hand
from tests.bench.hand_eye_by_hand import about, pose, quaternion_of, vector_of

CAMERA = pose([40.0, -25.0, 110.0], (0.3, -0.5, 0.8))  # on link_6; a camera beside the robot sees a board there
HOME = np.array([0.3, 0.6, 1.1, -0.4, 0.9, 0.4])
NOISE = 0.1, 0.0004
STILL = (np.zeros(3), 0.0)
MODES = ("eye_in_hand", "eye_to_hand")


def link(q, truth=arm_by_hand.TRUTH):
    place, turn = arm_by_hand.placed(q, truth, STILL, np.zeros(3))
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = turn, place
    return made


def other_frame(mode):
    """Return the frame that stands still in the base: the board's, or that of a camera beside the robot."""
    away = pose([20.0, -30.0, 600.0], (3.0, 0.2, 0.1))
    return link(HOME) @ CAMERA @ (away if mode == "eye_in_hand" else np.linalg.inv(away))


def seen(mode, q):
    one, still = np.array([link(row) for row in q]) @ CAMERA, other_frame(mode)
    return np.linalg.inv(one) @ still if mode == "eye_in_hand" else np.linalg.inv(still) @ one


def measured(mode, n=40, seed=8):
    rng = np.random.default_rng(seed)
    q = HOME + rng.uniform(-0.8, 0.8, (n, 6))
    board = seen(mode, q)
    for one in board:
        one[:3, :3] = about(rng.normal(0, NOISE[1], 3)) @ one[:3, :3]
        one[:3, 3] += rng.normal(0, NOISE[0], 3)
    return q, board


def columns(q, board):
    made = {f"{name} [rad]": column for name, column in zip(arm_by_hand.NAMES, q.T, strict=True)}
    made |= {f"board_{axis} [mm]": board[:, k, 3] for k, axis in enumerate("xyz")}
    turns = np.array([quaternion_of(one[:3, :3]) for one in board])
    return made | {f"board_q{axis}": column for axis, column in zip("xyzw", turns.T, strict=True)}


@pytest.fixture(scope="module")
def urdf(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "by_hand.urdf"
    path.write_text(arm_by_hand.urdf())
    return path


@pytest.fixture(scope="module")
def answers(urdf):
    return {
        mode: calibrate(urdf, columns(*measured(mode)), hand_eye=mode, tip="link_6", resamples=100) for mode in MODES
    }


def away(frame, true):
    """Return how far a frame is from the true one (6,) [mm, rad], and whether each lies within the interval."""
    found = np.array(frame.matrix)
    shift, turn = found[:3, 3] - true[:3, 3], vector_of(found[:3, :3] @ true[:3, :3].T)
    half = np.array([*(np.diff(frame.position_ci95)[:, 0] / 2), *frame.turn_within95])
    off = np.array([*shift, *turn])
    return off, np.abs(off) <= half


@pytest.mark.parametrize("mode", MODES)
def test_arm_and_camera_come_out_within_their_intervals_and_nearer_than_each_in_turn(answers, mode):
    (q, board), answer = measured(mode), answers[mode]
    mount, still = (answer.camera, answer.board) if mode == "eye_in_hand" else (answer.board, answer.camera)
    assert (mount.parent, still.parent) == ("link_6", "base")

    # the camera alone, with the arm as it is described
    nominal = np.array([link(row, {}) for row in q])
    pairs = {name: column for name, column in columns(q, board).items() if name.startswith("board")}
    pairs |= {f"flange_{axis} [mm]": nominal[:, k, 3] for k, axis in enumerate("xyz")}
    turns = np.array([quaternion_of(one[:3, :3]) for one in nominal])
    pairs |= {f"flange_q{axis}": column for axis, column in zip("xyzw", turns.T, strict=True)}
    alone = hand_eye(pairs, mounting=mode)
    first = alone.camera if mode == "eye_in_hand" else alone.board

    off, within = away(mount, CAMERA)
    assert within.sum() >= 5
    assert np.linalg.norm(off[:3]) < 0.5 * np.linalg.norm(away(first, CAMERA)[0][:3])
    assert away(still, other_frame(mode))[1].sum() >= 4
    told = {change.parameter: change for change in answer.changes}
    for name in ("zero_joint_3", "zero_joint_4"):
        low, high = told[name].ci95
        assert low - told[name].sd < arm_by_hand.TRUTH[name] < high + told[name].sd
    assert answer.error_after < 1.3 * np.sqrt(3) * NOISE[0] < 0.5 * alone.unseen.position


def test_the_written_arm_with_its_camera_sees_fresh_poses_as_they_are(answers, tmp_path):
    answer = answers["eye_in_hand"]
    chain = read_urdf(answer.write_urdf(tmp_path / "written.urdf")).chain("", "link_6")
    fresh = HOME + np.random.default_rng(1).uniform(-0.8, 0.8, (50, 6))
    there = forward(chain, nominal(chain), fresh) @ np.array(answer.camera.matrix)
    off = np.linalg.inv(there) @ np.array(answer.board.matrix) - seen("eye_in_hand", fresh)
    assert np.sqrt((off[:, :3, 3] ** 2).sum(axis=1).mean()) < np.sqrt(3) * NOISE[0]


def test_the_camera_in_the_board_and_a_board_of_another_size_are_read_as_stated(urdf, answers):
    q, board = measured("eye_in_hand")
    small = board.copy()
    small[:, :3, 3] /= 0.9
    there = {name.replace("board", "camera"): column for name, column in columns(q, np.linalg.inv(small)).items()}
    one = answers["eye_in_hand"]
    other = calibrate(
        urdf, there, hand_eye="eye_in_hand", read="camera_in_board", board_scale=0.9, tip="link_6", resamples=20
    )
    np.testing.assert_allclose(other.camera.matrix, one.camera.matrix, atol=1e-4)
    np.testing.assert_allclose(other.board.matrix, one.board.matrix, atol=1e-4)


def test_the_link_of_the_camera_gets_its_place_where_the_urdf_has_one(urdf, answers):
    bare = answers["eye_in_hand"]
    answer = calibrate(
        urdf, columns(*measured("eye_in_hand")), hand_eye="eye_in_hand", tip="ball", level=bare.chosen, resamples=20
    )
    assert answer.camera.parent == "link_6"
    np.testing.assert_allclose(answer.camera.matrix, bare.camera.matrix, atol=1e-5)
    written = dict(zip(("x", "y", "z"), answer.camera.position, strict=True))
    told = {change.parameter: change.change for change in answer.changes}
    assert {axis: told[f"{axis}_ball_joint"] for axis in "xyz"} == pytest.approx(written)


def test_the_command_writes_the_arm_the_frames_and_a_page(urdf, run_bench, tmp_path):
    data = columns(*measured("eye_in_hand"))
    rows = [",".join(data), *(",".join(f"{v:.9g}" for v in row) for row in zip(*data.values(), strict=True))]
    (tmp_path / "seen.csv").write_text("\n".join(rows))
    code, told, _ = run_bench(f"calibrate hand_eye=eye_in_hand urdf={urdf} data=seen.csv resamples=20")
    assert code == 0
    assert "camera in ball" in told
    assert "camera_q" not in told
    folder = tmp_path / "results/calibrate/seen"
    found = json.loads((folder / "calibration.json").read_text())
    assert f"x: {found['camera']['position'][0] / 1000:.7f}" in (folder / "static_transforms.yaml").read_text()
    assert "camera in ball" in (folder / "report.html").read_text()
    assert (folder / "by_hand_calibrated.urdf").exists()


def test_degrees_and_a_file_without_a_board_are_told(urdf):
    data = columns(*measured("eye_in_hand"))
    degrees = {name.replace(" [rad]", ""): column for name, column in data.items()}
    for name in arm_by_hand.NAMES:
        degrees[name] = np.rad2deg(degrees[name])
    with pytest.raises(ValueError, match=r"joints in degrees: units=joint_1:deg,.*joint_6:deg$"):
        calibrate(urdf, degrees, hand_eye="eye_in_hand")
    joints = {name: column for name, column in data.items() if name.startswith("joint")}
    with pytest.raises(ValueError, match="no pose of the board is found"):
        calibrate(urdf, joints, hand_eye="eye_in_hand")
