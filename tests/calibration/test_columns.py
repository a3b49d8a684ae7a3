"""Which column of a file is which joint of an arm, and which was measured."""

import numpy as np
import pytest

from calibench.calibration.columns import match_columns
from calibench.calibration.frames import ball_in_sockets, frames_of_positions

JOINTS = ("shoulder_pan_joint", "elbow_joint")


@pytest.mark.parametrize(
    "names",
    [
        JOINTS,
        ("q_shoulder_pan_joint", "q_elbow_joint"),
        ("Shoulder Pan Joint", "ElbowJoint"),
        ("actual_shoulder_pan_joint", "elbow_joint_position"),
        ("joint_1", "joint_2"),
        ("q0", "q1"),
        ("A1", "A2"),
        ("column_1", "column_2"),
    ],
)
def test_joints_are_found_however_they_are_spelt(names):
    assert tuple(match_columns([*names, "x", "y", "z"], JOINTS).joints.values()) == names


def test_what_was_asked_for_and_scatter_are_no_measurement():
    names = ["Goal x", "Goal y", "Goal z", *JOINTS, "measurement_x", "measurement_std_x", "measurement_y"]
    found = match_columns([*names, "measurement_z", "measurement_rx", "measurement_ry", "measurement_rz"], JOINTS)
    assert list(found.position.values()) == ["measurement_x", "measurement_y", "measurement_z"]
    assert list(found.rotation.values()) == ["measurement_rx", "measurement_ry", "measurement_rz"]


def test_of_several_markers_the_first_is_read():
    found = match_columns(
        [*JOINTS, *(f"{a}{k}" for k in (1, 2) for a in ("x", "y", "z", "phix", "phiy", "phiz"))], JOINTS
    )
    assert found.position == {"x": "x1", "y": "y1", "z": "z1"}


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["elbow_joint", "x", "y", "z"], "joint shoulder_pan_joint of the URDF has no column"),
        ([*JOINTS, "q_wrist", "x", "y", "z"], "column q_wrist: the URDF has no joint wrist"),
        (["q1", "q2", "a1", "a2"], "q1 to q2 and a1 to a2 could be the 2 joints"),
        ([*JOINTS, "a_x", "a_y", "a_z", "b_x", "b_y", "b_z"], "a_x and b_x could both be the measured x"),
        (["Elbow-Joint", "elbow joint", JOINTS[0]], "could both be joint elbow_joint"),
    ],
)
def test_what_could_be_two_things_is_refused(names, said):
    with pytest.raises(ValueError, match=said):
        match_columns(names, JOINTS)


def poses_of(n, seed=0):
    rng = np.random.default_rng(seed)
    made = np.tile(np.eye(4), (n, 1, 1))
    made[:, :3, :3] = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(n)]
    made[:, :3, :3] *= np.linalg.det(made[:, :3, :3])[:, None, None] ** 1
    made[:, :3, 3] = rng.uniform(-600, 600, (n, 3))
    return made


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_frames_are_exact_without_noise_whatever_the_unit_and_some_wild_readings(scale):
    poses, target = poses_of(40), np.array([30.0, -10.0, 80.0])
    turn = poses_of(1, 9)[0, :3, :3]
    true = (poses[:, :3, :3] @ target + poses[:, :3, 3]) @ turn.T + [100.0, -3000.0, 50.0]
    seen = true.copy()
    seen[[3, 11, 30]] += 500.0
    found = frames_of_positions(poses, scale * seen)
    assert found.scale == pytest.approx(1 / scale)
    np.testing.assert_allclose(found.base[:3, :3], turn, atol=1e-8)
    np.testing.assert_allclose(found.tool[:3, 3], target, atol=1e-5)
    assert np.flatnonzero(~found.near).tolist() == [3, 11, 30]
    assert frames_of_positions(poses, seen * [1, -1, 1]).mirrored
    assert not found.mirrored


def test_five_poses_find_the_frames_and_four_do_not():
    poses = poses_of(5)
    assert frames_of_positions(poses, poses[:, :3, 3]).apart < 1e-6
    with pytest.raises(ValueError, match="4 poses are too few"):
        frames_of_positions(poses[:4], poses[:4, :3, 3])


def test_a_ball_in_sockets_is_where_it_leaves_nothing():
    poses, ball = poses_of(12), np.array([5.0, 6.0, 70.0])
    points = np.array([[300.0, 0, 0], [350.0, 0, 0]])
    group = np.arange(12) % 2
    poses[:, :3, 3] = points[group] - poses[:, :3, :3] @ ball
    found, sockets, left = ball_in_sockets(poses, group)
    np.testing.assert_allclose(found, ball, atol=1e-8)
    np.testing.assert_allclose(sockets, points, atol=1e-8)
    assert left < 1e-8


def test_columns_without_names_are_the_joints_and_the_place_in_their_order():
    names = [f"column_{k}" for k in range(1, 6)]
    found = match_columns(names, ["lift", "boom"])
    assert found.joints == {"lift": "column_1", "boom": "column_2"}
    assert found.position == {"x": "column_3", "y": "column_4", "z": "column_5"}
    assert [note.text for note in found.notes] == [
        "no header: column_1 to column_5 are taken for lift, boom, x, y, z, in this order"
    ]
    assert match_columns(names[:2], ["lift", "boom"]).joints == found.joints


@pytest.mark.parametrize("rotation", [("rx", "ry", "rz"), ("qx", "qy", "qz", "qw")])
def test_columns_without_names_may_have_a_rotation_behind_the_place(rotation):
    names = [f"column_{k}" for k in range(1, 6 + len(rotation))]
    found = match_columns(names, ["lift", "boom"])
    assert found.position == {"x": "column_3", "y": "column_4", "z": "column_5"}
    assert found.rotation == dict(zip(rotation, names[5:]))
    assert f"taken for lift, boom, x, y, z, {', '.join(rotation)}, in this order" in found.notes[0].text


@pytest.mark.parametrize("count", [4, 6, 7, 10])
def test_columns_without_names_that_are_too_many_or_too_few_are_counted(count):
    names = [f"column_{k}" for k in range(1, count + 1)]
    said = (
        rf"{count} columns without a header, and 2 joints .lift, boom. with x, y and z are 5, with a rotation 8 or 9; "
        r"write a header with their names, such as lift,boom,x,y,z and a name for each of the others"
    )
    with pytest.raises(ValueError, match=said):
        match_columns(names, ["lift", "boom"])


def test_paths_of_ros_are_joints_and_a_pose():
    joints = [f"/joint_states/{joint}/{what}" for joint in ("pan", "elbow_joint") for what in ("position", "velocity")]
    place = [f"/tracker/pose/position/{axis}" for axis in "xyz"]
    turn = [f"/tracker/pose/orientation/{axis}" for axis in "xyzw"]
    matched = match_columns(["__time", *joints, *place, *turn], ["pan", "elbow_joint"])
    assert list(matched.joints.values()) == ["/joint_states/pan/position", "/joint_states/elbow_joint/position"]
    assert list(matched.position.values()) == place
    assert list(matched.rotation.values()) == turn
    assert matched.rotation["qw"] == "/tracker/pose/orientation/w"
