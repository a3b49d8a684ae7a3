"""`bench calibrate hand_eye=...`: both frames as a closed form has them, honest intervals, and what is refused."""

import json
import shlex

import numpy as np
import pytest

from calibench.bench.cli import main
from calibench.calibration.closed_forms import FORMS
from calibench.calibration.hand_eye import frames_of, scale_of, slopes_of
from calibench.calibration.hand_eye_fit import Sight, _moved, _slopes, adjust
from calibench.calibration.hand_eye_start import arm_poses
from tests.bench.arm_by_hand import texts
from tests.bench.hand_eye_by_hand import (
    BOARD,
    CAMERA,
    QUATERNION,
    VECTOR,
    about,
    columns_of,
    measured,
    pose,
    vector_of,
    write,
)  # fmt: skip
from tests.few import few

NEAR = pose((3, -2, 1), (0.01, 0.02, -0.01))  # from the truth to where a fit begins
NOISE = (0.3, 0.002)  # mm, rad


@pytest.fixture
def bench(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def call(*words, code=0):
        with pytest.raises(SystemExit) as ended:
            main(["calibrate", *words])
        told = capsys.readouterr()
        assert ended.value.code == code, told.err
        assert code == 0 or told.err.count("\n") == 1
        return told.out if code == 0 else told.err

    return call


@pytest.fixture
def calibrate(bench, tmp_path):
    """Write pairs into a file, calibrate, and return what JSON says, or the line of a refusal.

    What the rotations mean is stated, and not found, where that is not what is asked: each meaning takes as long.
    """

    def call(
        flange, seen, *words, code=0, mode="eye_in_hand", turns=(VECTOR, VECTOR), names=("flange", "board"),
        stated=("rotation=vector",),
    ):  # fmt: skip
        parts = (columns_of(flange, names[0], turns=turns[0]), columns_of(seen, names[1], "m", turns[1]))
        write(tmp_path / "pairs.csv", *parts)
        said = bench(f"hand_eye={mode}", "data=pairs.csv", "--json", *stated, *words, code=code)
        return json.loads(said) if code == 0 else said

    return call


def model(n, mode, noise=(0.0, 0.0), seed=3):
    flange, seen = measured(n, mode, noise, seed)
    return Sight(arm_poses(flange, mode), seen), np.linalg.inv(pose(*CAMERA)) @ NEAR, pose(*BOARD) @ NEAR


@pytest.mark.parametrize("mode", ["eye_in_hand", "eye_to_hand"])
def test_both_frames_of_exact_pairs_are_the_true_ones(calibrate, mode):
    found = calibrate(*measured(8, mode), mode=mode, turns=(QUATERNION, VECTOR), stated=())
    for frame, true in ((found["camera"], CAMERA), (found["board"], BOARD)):
        assert np.allclose(frame["matrix"], pose(*true), atol=1e-6)
        assert np.allclose(frame["position"], true[0], atol=1e-6)


@pytest.mark.parametrize("mode", ["eye_in_hand", "eye_to_hand"])
def test_the_slopes_of_the_residuals_agree_with_differences(mode):
    made = adjust(*model(6, mode, (0.03, 2e-4)), free=("scale",))
    slopes = _slopes(made)[0]
    for k in range(13):
        step = np.zeros(13)
        step[k] = 1e-5
        wanted = (_slopes(_moved(made, step))[1] - _slopes(_moved(made, -step))[1]) / 2e-5
        assert np.allclose(slopes[:, :, k], wanted, rtol=1e-3, atol=1e-3 * max(1.0, np.abs(slopes[:, :, k]).max()))


def test_the_slopes_of_the_frames_agree_with_differences():
    found = adjust(*model(6, "eye_in_hand", NOISE))
    slopes = slopes_of(found)
    for k in range(12):
        step = np.zeros(12)
        step[k] = 1e-6
        mount, tool = (frame @ pose(s[:3], s[3:]) for frame, s in ((found.mount, step[:6]), (found.tool, step[6:])))
        pairs = ((np.linalg.inv(mount), np.linalg.inv(found.mount)), (tool, found.tool))
        for slope, (there, here) in zip(slopes, pairs, strict=True):
            turn = vector_of(there[:3, :3] @ here[:3, :3].T)
            moved = np.concatenate([there[:3, 3] - here[:3, 3], turn]) / 1e-6
            assert np.allclose(slope[:, k], moved, atol=2e-2 * max(1.0, np.abs(slope[:, k]).max()))


def hits(n, mode, noise, seed):
    """Return which of 12 intervals hold the truth: places, and turns about the parent's axes."""
    found, held = adjust(*model(n, mode, noise, seed)), []
    for frame, true in zip(frames_of(found, mode), (CAMERA, BOARD), strict=True):
        held += [low <= v <= high for v, (low, high) in zip(true[0], frame.position_ci95, strict=True)]
        turn = vector_of(np.array(frame.matrix)[:3, :3] @ about(true[1]).T)
        held += list(np.abs(turn) <= np.array(frame.turn_within95))
    return held


@pytest.mark.slow
@pytest.mark.parametrize(
    ("n", "mode", "noise"), [(12, "eye_in_hand", NOISE), (6, "eye_to_hand", (1.0, 0.001))]
)  # 200 cases each of seeds 0 to 199, both stated before they were run; a minute
def test_intervals_hold_the_truth_in_95_of_100_cases(n, mode, noise):
    held = np.array([hits(n, mode, noise, seed) for seed in range(200)])
    assert 0.93 <= held.mean() <= 0.97
    assert (held.mean(axis=0) > 0.90).all()


def test_intervals_hold_the_truth_in_most_of_a_few_cases():
    held = np.array([hits(12, "eye_in_hand", NOISE, seed) for seed in range(10)])
    assert held.mean() > 0.85


def test_the_noise_is_learned_and_may_be_stated(calibrate):
    pairs = measured(60, noise=NOISE)
    found = calibrate(*pairs)
    assert found["sigma"] == pytest.approx(NOISE[0], rel=0.15)
    assert found["sigma_rotation"] == pytest.approx(NOISE[1], rel=0.15)
    stated, wide = (calibrate(*pairs, f"sigma={0.3 * k}", f"sigma_rotation={0.002 * k}") for k in (1, 3))
    assert wide["learned"] == [False, False]
    errors, of_stated, of_wide = (np.array(one["camera"]["position_se"]) for one in (found, stated, wide))
    assert np.allclose(of_wide / of_stated, 3.0, rtol=0.01)
    assert (wide["sigma"], wide["sigma_rotation"]) == pytest.approx((0.9, 0.006))
    assert np.allclose(errors / of_stated, 1.0, atol=0.35)


def test_what_is_left_is_that_of_rows_held_back_or_left_out_in_turn(calibrate, bench, tmp_path):
    flange, seen = measured(20, noise=NOISE)
    crossed = calibrate(flange, seen)
    assert crossed["unseen"]["poses"] == 20
    assert crossed["unseen"]["position"] == pytest.approx(np.sqrt(3) * NOISE[0], rel=0.4)
    lines = (tmp_path / "pairs.csv").read_text().splitlines()
    split = ["split", *["train"] * 14, *["hold"] * 6]
    (tmp_path / "held.csv").write_text("\n".join(f"{a},{b}" for a, b in zip(lines, split, strict=True)))
    held = json.loads(bench("hand_eye=eye_in_hand", "data=held.csv", "--json"))
    assert (held["fitted"]["poses"], held["unseen"]["poses"]) == (14, 6)
    alone = calibrate(flange[:14], seen[:14])
    assert np.allclose(held["camera"]["matrix"], alone["camera"]["matrix"], atol=1e-6)


def test_an_outlying_pair_is_named_and_has_no_say(calibrate):
    flange, seen = measured(15, noise=NOISE)
    seen[4, :3, 3] += 30
    seen[9, :3, :3] = about((0, 0.2, 0)) @ seen[9, :3, :3]
    found = calibrate(flange, seen)
    assert {one["row"] for one in found["outliers"]} == {"row 5", "row 10"}
    keep = np.delete(np.arange(15), [4, 9])
    assert np.allclose(
        found["camera"]["position"], calibrate(flange[keep], seen[keep])["camera"]["position"], atol=1e-3
    )


def test_the_camera_in_the_board_is_read_where_that_is_stated(calibrate):
    flange, seen = measured(8)
    turned = np.linalg.inv(seen)
    assert "read=camera_in_board" in calibrate(flange, turned, names=("flange", "camera"), code=2)
    found = calibrate(flange, turned, "read=camera_in_board", names=("flange", "camera"))
    assert np.allclose(found["camera"]["matrix"], pose(*CAMERA), atol=1e-6)


def test_the_file_for_ros_is_in_metres_with_the_real_part_last(calibrate, tmp_path):
    calibrate(*measured(8))
    text = (tmp_path / "results/hand_eye/pairs/static_transforms.yaml").read_text()
    assert "translation: {x: 0.0400000, y: -0.0250000, z: 0.1100000}" in text
    size = np.linalg.norm(CAMERA[1])
    x, y, z = np.array(CAMERA[1]) / size * np.sin(size / 2)
    w = np.cos(size / 2)
    assert f"rotation: {{x: {x:.8f}, y: {y:.8f}, z: {z:.8f}, w: {w:.8f}}}" in text
    assert "--frame-id flange --child-frame-id camera" in text


def flanges(turns, places):
    return np.array([pose(p + np.array([500.0, 0, 400]), t) for p, t in zip(places, turns, strict=True)])


PLACES = np.random.default_rng(1).uniform(-100, 100, (12, 3))


@pytest.mark.parametrize(
    ("turns", "told"),
    [
        (np.zeros((12, 3)), "shifts alone do not tell"),
        (np.outer(np.linspace(-1, 1, 12), [0, 0, 1.0]), "about one axis of the flange, (0.00, 0.00, 1.00)"),
    ],
)
def test_poses_that_do_not_tell_the_frames_are_refused_with_what_to_measure(calibrate, turns, told):
    for noise in ((0.0, 0.0), NOISE):
        line = calibrate(*measured(12, flange=flanges(turns, PLACES), noise=noise), code=2)
        assert told in line
        assert "at least two axes" in line


def test_rotations_too_small_for_their_noise_are_refused_with_the_direction(calibrate):
    turns = np.random.default_rng(2).normal(0, 0.015, (12, 3))
    line = calibrate(*measured(12, flange=flanges(turns, PLACES), noise=(6.0, 0.05)), code=2)
    assert "do not determine it" in line
    assert "at least two axes" in line


def test_few_poses_are_refused_and_three_need_a_stated_noise(calibrate):
    flange, seen = measured(3, noise=NOISE)
    assert "too few: 3 at the least" in calibrate(flange[:2], seen[:2], code=2)
    assert "state sigma=" in calibrate(flange, seen, code=2)
    found = calibrate(flange, seen, "sigma=0.3", "sigma_rotation=0.002")
    for (low, high), true in zip(found["camera"]["position_ci95"], CAMERA[0], strict=True):
        assert low - 1 < true < high + 1
    assert found["unseen"]["position"] is None


def test_a_column_that_never_varies_is_named(calibrate):
    flange, seen = measured(12, noise=NOISE)
    level = np.array(flange)
    level[:, 2, 3] = 450
    seen = [np.linalg.inv(flat) @ real @ one for flat, real, one in zip(level, flange, seen, strict=True)]
    [note] = [note for note in texts(calibrate(level, np.array(seen))) if "never" in note]
    assert note.startswith("flange_z never varies")
    still = flanges(np.zeros((12, 3)), PLACES)
    line = calibrate(still, measured(12, flange=still)[1], code=2)
    assert "(flange_rx, flange_ry, flange_rz, board_rx" in line


@pytest.mark.parametrize("noise", [pytest.param((0.0, 0.0), marks=pytest.mark.slow), NOISE])
@pytest.mark.parametrize("mode", ["eye_in_hand", "eye_to_hand"])
def test_inverse_poses_are_told(calibrate, mode, noise):
    flange, seen = measured(12, mode, noise)
    for turns in ((QUATERNION, QUATERNION), (QUATERNION, VECTOR)):
        line = calibrate(flange, np.linalg.inv(seen), code=2, mode=mode, turns=turns, stated=())
        assert "times better with one side inverted" in line
        assert "read=camera_in_board" in line


@pytest.mark.parametrize("side", few(1, [0, 1]))
def test_a_quaternion_with_its_real_part_first_is_told_with_the_columns_to_copy(bench, tmp_path, side):
    parts = [columns_of(p, n) for p, n in zip(measured(12, noise=NOISE), ("flange", "board"), strict=True)]
    parts[side][1][:, 3:] = np.roll(parts[side][1][:, 3:], 1, axis=1)
    write(tmp_path / "q.csv", *parts)
    line = bench("hand_eye=eye_in_hand", "data=q.csv", code=2)
    assert "the first of them is the real part" in line
    (columns,) = shlex.split("columns=" + line.partition("columns=")[2])  # as a shell reads what is copied
    found = json.loads(bench("hand_eye=eye_in_hand", "data=q.csv", columns, "--json"))
    assert np.allclose(found["camera"]["position"], CAMERA[0], atol=1.0)


@pytest.mark.parametrize(("sides", "a", "b"), few(1, [([0], 3, 4), ([1], 0, 2), ([0, 1], 3, 4)]))
def test_columns_that_are_exchanged_are_told_with_the_columns_to_copy(bench, tmp_path, sides, a, b):
    parts = [columns_of(p, n) for p, n in zip(measured(12, noise=NOISE), ("flange", "board"), strict=True)]
    for side in sides:
        parts[side][1][:, [a, b]] = parts[side][1][:, [b, a]]
    write(tmp_path / "q.csv", *parts)
    line = bench("hand_eye=eye_in_hand", "data=q.csv", code=2)
    (columns,) = shlex.split("columns=" + line.partition("columns=")[2])
    found = json.loads(bench("hand_eye=eye_in_hand", "data=q.csv", columns, "--json"))
    assert np.allclose(found["camera"]["position"], CAMERA[0], atol=1.0)


def test_a_robot_of_a_millimetre_is_one_in_metres(bench, tmp_path):
    parts = [columns_of(p, n, "m") for p, n in zip(measured(12), ("flange", "board"), strict=True)]
    write(tmp_path / "q.csv", *(([head.replace("[m]", "[mm]") for head in heads], rows) for heads, rows in parts))
    assert "units=flange_x:m,flange_y:m,flange_z:m,board_x:m" in bench("hand_eye=eye_in_hand", "data=q.csv", code=2)


def test_a_sign_and_the_unit_of_one_column_are_told(bench, tmp_path):
    parts = [columns_of(p, n) for p, n in zip(measured(12, noise=NOISE), ("flange", "board"), strict=True)]
    parts[0][1][:, 4] *= -1
    write(tmp_path / "q.csv", *parts)
    assert "times better if flange_qy has the other sign" in bench("hand_eye=eye_in_hand", "data=q.csv", code=2)
    parts[0][1][:, 4] *= -1
    parts[0][1][:, 0] /= 1000
    write(tmp_path / "q.csv", *parts)
    assert "units=flange_x:m" in bench("hand_eye=eye_in_hand", "data=q.csv", code=2)


@pytest.mark.parametrize("mode", ["eye_in_hand", "eye_to_hand"])
def test_poses_in_a_left_handed_frame_are_told_and_not_taken_for_few_turns(calibrate, mode):
    flange, seen = measured(12, mode, NOISE)
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    assert "times better if the frames of flange or board are left-handed" in calibrate(
        flange, mirror @ seen @ mirror, code=2, mode=mode
    )


def test_rows_out_of_step_are_told(calibrate):
    flange, seen = measured(15, noise=NOISE)
    assert "stands in the row below" in calibrate(flange[1:], seen[:-1], code=2)
    assert "stands in the row above" in calibrate(flange[:-1], seen[1:], code=2)


@pytest.mark.slow
def test_mm_for_m_is_told_and_so_is_a_board_of_another_size(bench, calibrate, tmp_path):
    flange, seen = measured(12, noise=NOISE)
    heads, numbers = columns_of(seen, "board", "m")
    write(tmp_path / "m.csv", columns_of(flange, "flange"), ([h.replace("[m]", "[mm]") for h in heads], numbers))
    line = bench("hand_eye=eye_in_hand", "data=m.csv", code=2)
    assert "units=board_x:m,board_y:m,board_z:m" in line
    seen[:, :3, 3] *= 0.9
    line = calibrate(flange, seen, code=2)
    assert "is the size of its squares or markers the true one?" in line
    found = calibrate(flange, seen, "board_scale=" + line.partition("board_scale=")[2].strip())
    assert np.allclose(found["camera"]["position"], CAMERA[0], atol=1.0)


def test_units_lengths_of_quaternions_and_missing_columns_are_refused(bench, tmp_path):
    flange, seen = (columns_of(p, n) for p, n in zip(measured(12), ("flange", "board"), strict=True))
    bare = [h.partition(" [")[0] for h in seen[0]]
    words = ("hand_eye=eye_in_hand", "data=p.csv")
    write(tmp_path / "p.csv", flange, (bare, seen[1]))
    assert "board_x, board_y, board_z: no unit is stated" in bench(*words, code=2)
    bench(*words, "units=board_x:mm,board_y:mm,board_z:mm")
    long = seen[1].copy()
    long[2, 3:] *= 1.2
    write(tmp_path / "p.csv", flange, (seen[0], long))
    assert "row 3: board_qx, board_qy, board_qz, board_qw have the length 1.2" in bench(*words, code=2)
    write(tmp_path / "p.csv", flange)
    assert "no pose of the board is found" in bench(*words, code=2)
    assert "read=" in bench("hand_eye=eye_in_hand", "data=p.csv", "read=upside_down", code=2)
    assert "hand_eye" in bench("hand_eye=in_the_sky", "data=p.csv", code=2)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["eye_in_hand", "eye_to_hand"])
def test_a_board_of_slightly_another_size_is_told_with_a_cure_to_copy(calibrate, mode):
    flange, seen = measured(15, mode, noise=(1.0, 0.0035))
    before = calibrate(flange, seen, mode=mode)
    assert before["scale"] == pytest.approx(1.0, abs=3 * before["scale_se"])
    assert not any("board_scale=" in note for note in texts(before))
    seen[:, :3, 3] *= 1.03
    wrong = calibrate(flange, seen, mode=mode)
    assert wrong["scale"] == pytest.approx(1.03, abs=3 * wrong["scale_se"])
    assert "smaller than the camera was told" in texts(wrong)[0]
    (cure,) = (word for word in texts(wrong)[0].split() if word.startswith("board_scale="))
    right = calibrate(flange, seen, cure.rstrip(";"), mode=mode)
    assert not any("board_scale=" in note for note in texts(right))
    truth = CAMERA[0]
    off = [np.linalg.norm(np.array(one["camera"]["position"]) - truth) for one in (wrong, right)]
    assert off[1] < off[0]


@pytest.mark.slow
def test_the_error_of_a_scale_is_that_of_many_cases():
    values, errors, told = [], [], []
    for seed in range(60):
        made = model(12, "eye_in_hand", (1.0, 0.002), seed)
        value, error, unlikely = scale_of(adjust(*made))
        values.append(value)
        errors.append(error)
        told.append(unlikely)
    assert np.std(values) == pytest.approx(np.mean(errors), rel=0.3)
    assert np.mean(values) == pytest.approx(1.0, abs=3 * np.mean(errors) / np.sqrt(60))
    assert sum(told) <= 1


def test_a_scale_of_no_board_is_refused(calibrate):
    for wrong in ("0", "-1", "large"):
        assert "board_scale" in calibrate(*measured(8), f"board_scale={wrong}", code=2)


def test_the_base_in_the_flange_is_read_where_that_is_stated(calibrate):
    flange, seen = measured(12)
    line = calibrate(np.linalg.inv(flange), seen, code=2)
    cure = line.split()[-1]
    assert cure == "flange=base_in_flange"
    found = calibrate(np.linalg.inv(flange), seen, cure)
    assert np.allclose(found["camera"]["matrix"], pose(*CAMERA), atol=1e-6)
    assert calibrate(flange, seen, cure, code=2).split()[-1] == "flange=flange_in_base"


def test_a_quaternion_is_proposed_by_its_letters_units_by_our_names_and_a_list_beside_a_table_is_no_statement(
    bench, tmp_path
):
    flange, seen = measured(12, noise=NOISE)
    robot, board = columns_of(flange, "flange", "m")[1], columns_of(seen, "board", "m", VECTOR)
    first = [*range(3), 6, 3, 4, 5]  # the real part first
    names = [*"xyz", "qw", "qx", "qy", "qz"]
    write(tmp_path / "p.csv", (names, robot[:, first]), ([*(f"t{a}" for a in "xyz"), "rx", "ry", "rz"], board[1]))
    (tmp_path / "p.json").write_text("[1, 2]")
    line = bench("hand_eye=eye_in_hand", "data=p.csv", code=2)
    (columns,) = shlex.split("columns=" + line.partition("columns=")[2])
    units = "units=" + ",".join([f"{one}_{a}:m" for one in ("flange", "board") for a in "xyz"])
    words = ("rotation=vector", f"{units},rx:rad,ry:rad,rz:rad")
    found = json.loads(bench("hand_eye=eye_in_hand", "data=p.csv", columns, *words, "--json"))
    assert np.allclose(found["camera"]["position"], CAMERA[0], atol=1.0)


def test_a_b_c_of_a_kuka_are_proposed_as_turns_about_z_y_and_x(bench, tmp_path):
    flange, seen = measured(12, noise=NOISE)
    heads, numbers = columns_of(flange, "flange", turns=VECTOR)
    one = flange[:, :3, :3]  # A, B and C turn about z, y and x in this order, each about an axis that moves along
    abc = [np.arctan2(one[:, 1, 0], one[:, 0, 0]), -np.arcsin(one[:, 2, 0]), np.arctan2(one[:, 2, 1], one[:, 2, 2])]
    heads = [*heads[:3], "flange_A [deg]", "flange_B [deg]", "flange_C [deg]"]
    write(tmp_path / "k.csv", (heads, np.column_stack([numbers[:, :3], np.degrees(abc).T])), columns_of(seen, "board"))
    line = bench("hand_eye=eye_in_hand", "data=k.csv", code=2)
    (columns,) = shlex.split("columns=" + line.partition("columns=")[2])
    found = json.loads(bench("hand_eye=eye_in_hand", "data=k.csv", columns, "--json"))
    assert np.allclose(found["camera"]["position"], CAMERA[0], atol=1.0)


def test_degrees_that_are_stated_as_rad_are_told(bench, tmp_path):
    flange, seen = (columns_of(p, n, turns=VECTOR) for p, n in zip(measured(12), ("flange", "board"), strict=True))
    flange[1][:, 3:] = np.degrees(flange[1][:, 3:])
    write(tmp_path / "d.csv", flange, seen)
    line = bench("hand_eye=eye_in_hand", "data=d.csv", code=2)
    units = line.split()[-1]
    assert units == "units=flange_rx:deg,flange_ry:deg,flange_rz:deg"
    found = json.loads(bench("hand_eye=eye_in_hand", "data=d.csv", units, "--json"))
    assert np.allclose(found["camera"]["position"], CAMERA[0], atol=1e-3)


@pytest.mark.parametrize(
    ("turns", "told"),
    [
        (np.random.default_rng(2).normal(0, 0.015, (12, 3)), "° at the most, so that the intervals are wide"),
        (np.random.default_rng(2).normal(0, 1, (12, 3)) * [0.01, 0.03, 0.5], "about its axis (1.00, "),
        (np.random.default_rng(2).normal(0, 0.5, (12, 3)), ""),
    ],
)
def test_turns_that_are_missing_are_told(calibrate, turns, told):
    found = calibrate(*measured(12, flange=flanges(turns, PLACES), noise=NOISE))
    said = [note for note in texts(found) if note.startswith("the flange turns by")]
    assert len(said) == bool(told)
    assert all(told in note and "30° or more" in note for note in said)


def off(found):
    return np.linalg.norm(np.array(found["camera"]["position"]) - CAMERA[0])


def moving(time):
    """Return where the flange is at `time` (n,) [s], (n, 4, 4): six sines."""
    ways = np.sin(np.outer(time, [0.7, 1.1, 0.9, 1.3, 0.8, 1.0]) + np.arange(6)) * [120, 120, 120, 0.5, 0.5, 0.5]
    return np.array([pose([500, 100, 450], (2.9, 0.3, 0.1)) @ pose(way[:3], way[3:]) for way in ways])


@pytest.fixture
def streams(tmp_path):
    """Write the files of a robot and of a camera whose clock is 50 ms ahead, with a fifth of the pictures lost."""
    rng, time = np.random.default_rng(4), np.arange(0, 9, 0.02)
    seen_at = np.sort(rng.choice(np.arange(1, 8, 1 / 30), 170, replace=False))
    seen = measured(170, flange=moving(seen_at), noise=NOISE)[1]
    write(tmp_path / "robot.csv", (["time"], time[:, None]), columns_of(moving(time), "flange", turns=VECTOR))
    write(tmp_path / "camera.csv", (["time"], seen_at[:, None] + 0.05), columns_of(seen, "board", turns=VECTOR))
    late = moving(seen_at + 0.05)
    return late, seen


def test_two_streams_with_clocks_apart_give_the_frames_and_the_offset(bench, streams, tmp_path):
    told = bench("hand_eye=eye_in_hand", "data=robot.csv,camera.csv", "rotation=vector")
    [file] = (tmp_path / "results").rglob("hand_eye.json")
    found = json.loads(file.read_text())
    low, high = found["offset_ci95"]
    assert low < 0.05 < high < low + 0.01
    assert off(found) < 0.5
    assert "ahead of the robot's" in told


def test_a_lag_that_no_stamps_show_is_told_and_widens_the_intervals(calibrate, streams):
    found = calibrate(*streams)
    assert any("follows what is left of the pair before" in text for text in texts(found))
    assert "give data=robot.csv,camera.csv" in " ".join(texts(found))
    assert all(low < true < high for true, (low, high) in zip(CAMERA[0], found["camera"]["position_ci95"], strict=True))
    assert "a lag or a drift" in differ(calibrate(*streams, "sigma=0.3", "sigma_rotation=0.002"))[0]
    steady = calibrate(*measured(40, noise=NOISE))
    assert not any("follows" in text for text in texts(steady))


def test_half_of_the_pairs_may_be_wrong_and_each_of_them_is_named(calibrate):
    flange, seen = measured(40, noise=NOISE)
    wrong = np.random.default_rng(1).permutation(40)[:20]
    for k in wrong[:10]:  # the other solution of a flat board: its normal on the other side of the line of sight
        way = seen[k, :3, 3] / np.linalg.norm(seen[k, :3, 3])
        axis = np.cross(seen[k, :3, 2], way)
        angle = 2 * np.arcsin(min(1.0, np.linalg.norm(axis)))
        seen[k, :3, :3] = about(axis / np.linalg.norm(axis) * angle) @ seen[k, :3, :3]
    seen[wrong[10:]] = [pose(p[:3, 3] * 1.3, v) for p, v in zip(seen[wrong[10:]], np.eye(3)[np.arange(10) % 3] * 2)]
    found = calibrate(flange, seen)
    assert {one["row"] for one in found["outliers"]} == {f"row {k + 1}" for k in wrong}
    assert off(found) < 0.5


def test_noise_along_the_line_of_sight_has_less_say_than_across():
    better = 0
    for seed in range(10):
        sight, mount, tool = model(20, "eye_in_hand", NOISE, seed)
        way = sight.seen[:, :3, 3] / np.linalg.norm(sight.seen[:, :3, 3], axis=1)[:, None]
        sight.seen[:, :3, 3] += way * np.random.default_rng(seed).normal(0, 5, (20, 1))
        found = adjust(sight, mount, tool)
        assert len(found.noise) == 3
        assert found.noise[found.groups[0]] > 5 * found.noise[found.groups[1]]
        better += frames_of(found, "eye_in_hand")[0].position_se[0] < 1.0
    assert better == 10


def test_noise_along_the_line_of_sight_moves_no_frame():
    """Lines to where the board is seen are turned by noise across them, which looks like a board further away."""
    sight, mount, tool = model(2000, "eye_in_hand", (12.0, 0.002))
    way = sight.seen[:, :3, 3] / np.linalg.norm(sight.seen[:, :3, 3], axis=1)[:, None]
    sight.seen[:, :3, 3] += way * np.random.default_rng(0).normal(0, 60, (2000, 1))
    camera, _ = frames_of(adjust(sight, mount, tool), "eye_in_hand")
    assert (np.abs(np.subtract(camera.position, CAMERA[0])) < 2 * np.array(camera.position_se)).all()


def test_a_scale_that_is_free_is_fitted_beside_the_frames(calibrate):
    flange, seen = measured(20, noise=NOISE)
    seen[:, :3, 3] *= 1.4
    assert "board_scale=0.71" in calibrate(flange, seen, code=2)
    found = calibrate(flange, seen, "board_scale=free")
    assert found["scale"] == pytest.approx(1.4, abs=4 * found["scale_se"])
    assert off(found) < 0.7


# what OpenCV 4.11 has for these pairs, calibrateHandEye and calibrateRobotWorldHandEye: place [mm], vector [rad]
OPENCV = {
    "Park-Martin": ([39.9530312, -25.30129933, 110.38539913], [0.2955925, -0.5026606, 0.80230278]),
    "Tsai-Lenz": ([39.92931226, -25.35400308, 110.3882755], [0.29580956, -0.50291504, 0.80159473]),
    "Shah": ([37.52762211, -27.10995511, 111.75184563], [0.29547975, -0.50254654, 0.80207439]),
}


@pytest.mark.parametrize(("name", "within"), [("Park-Martin", 1e-6), ("Tsai-Lenz", 3e-3), ("Shah", 1e-6)])
def test_closed_forms_are_those_of_opencv(name, within):
    flange, seen = measured(12, noise=(1.0, 0.01), seed=5)
    made = FORMS[name](np.linalg.inv(flange), seen)
    assert np.allclose(made[:3, 3], OPENCV[name][0], atol=within)
    assert np.allclose(vector_of(made[:3, :3]), OPENCV[name][1], atol=within)


def differ(found):
    return [note["text"] for note in found["notes"] if note["code"] == "forms_differ"]


def test_a_note_says_why_closed_forms_lie_elsewhere(calibrate):
    flange, seen = measured(20, noise=NOISE)
    assert not differ(calibrate(flange, seen))
    seen[4, :3, 3] += 30
    assert "outlying pairs are in them" in differ(calibrate(flange, seen))[0]
