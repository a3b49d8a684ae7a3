"""Joints in one file and poses in another, as tools of ROS write them, joined by the stamps of their headers."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench.bench.cli import main
from calibench.bench.measured.by_time import by_time, ros_columns
from calibench.core.notes import DataError
from calibench.core.tables.columns import Columns
from tests.bench.arm_by_hand import NAMES, placed, urdf

BEGIN = 1_700_000_000.0
SHUFFLED = (2, 0, 1, 5, 4, 3)  # the order in which a driver names the joints


def a_bag(n=40, seed=3, hertz=20):
    """Return times and joints (m, 6) of an arm that stands at `n` poses, and times and poses of a tracker."""
    rng = np.random.default_rng(seed)
    stops = rng.uniform(-2.4, 2.4, (n, 6))
    t = np.arange(0, 2 * n - 1, 1 / hertz)
    at = np.clip(t / 2 - t // 2, 0, 1) * 2  # of each 2 s the first is a stand, the second a motion
    k = (t // 2).astype(int)
    part = np.clip(at - 1, 0, 1)[:, None]
    q = stops[k] * (1 - part) + stops[np.minimum(k + 1, n - 1)] * part + rng.normal(0, 1e-5, (len(t), 6))
    seen = np.arange(0.013, 2 * n - 1, 1 / 13)
    joints = np.array([np.interp(seen, t, column) for column in q.T]).T
    there, turned = placed(joints)
    places = there + rng.normal(0, 0.03, (len(seen), 3))
    turns = Rotation.from_matrix(turned).as_quat()
    return t, q, seen, np.column_stack([places / 1000, turns])


def stamp(t):
    return f"{int(BEGIN + t)},{round((t % 1) * 1e9) % 1_000_000_000}"


def echo(bag):
    """Return both files of `ros2 topic echo --csv`; a gripper speaks on the topic too."""
    t, q, seen, poses = bag
    names = [NAMES[k] for k in SHUFFLED]
    rows = []
    for i, (when, row) in enumerate(zip(t, q, strict=True)):
        values = ",".join(f"{row[k]:.8f}" for k in SHUFFLED)
        rows.append(f"{stamp(when)},,{','.join(names)},{values},{','.join(['0.0'] * 12)}")
        if i % 3 == 0:
            rows.append(f"{stamp(when)},,finger,0.02,0.0,0.0")
    of_tracker = [f"{stamp(w)},world,{','.join(f'{v:.9f}' for v in p)}" for w, p in zip(seen, poses, strict=True)]
    return "\n".join(rows) + "\n", "\n".join(of_tracker) + "\n"


def rostopic(bag):
    t, q, seen, poses = bag
    head = "%time,field.header.seq,field.header.stamp,field.header.frame_id,"
    ns = [int((BEGIN + one) * 1e6) * 1000 for one in t]
    rows = [head + ",".join([*(f"field.name{k}" for k in range(6)), *(f"field.position{k}" for k in range(6))])]
    for i, (when, row) in enumerate(zip(ns, q, strict=True)):
        values = [*(NAMES[k] for k in SHUFFLED), *(f"{row[k]:.8f}" for k in SHUFFLED)]
        rows.append(f"{when + 10**9},{i},{when},,{','.join(values)}")  # written a second late
    axes = [f"field.pose.position.{a}" for a in "xyz"] + [f"field.pose.orientation.{a}" for a in "xyzw"]
    of_tracker = [head + ",".join(axes)]
    for i, (when, pose) in enumerate(zip(seen, poses, strict=True)):
        ns_of = int((BEGIN + when) * 1e6) * 1000
        of_tracker.append(f"{ns_of + 10**9},{i},{ns_of},world,{','.join(f'{v:.9f}' for v in pose)}")
    return "\n".join(rows) + "\n", "\n".join(of_tracker) + "\n"


def bagpy(bag, lists=True):
    t, q, seen, poses = bag
    head = "Time,header.seq,header.stamp.secs,header.stamp.nsecs,header.frame_id,"
    rows = [head + ("name,position" if lists else "name," + ",".join(f"position_{k}" for k in range(6)))]
    names = str([NAMES[k] for k in SHUFFLED])
    for i, (when, row) in enumerate(zip(t, q, strict=True)):
        values = ", ".join(f"{row[k]:.8f}" for k in SHUFFLED)
        cells = f'"({values})"' if lists else values.replace(" ", "")
        rows.append(f'{when:.6f},{i},{stamp(when)},,"{names}",{cells}')
    axes = [f"pose.position.{a}" for a in "xyz"] + [f"pose.orientation.{a}" for a in "xyzw"]
    of_tracker = [head + ",".join(axes)]
    for i, (when, pose) in enumerate(zip(seen, poses, strict=True)):
        of_tracker.append(f"{when:.6f},{i},{stamp(when)},world,{','.join(f'{v:.9f}' for v in pose)}")
    return "\n".join(rows) + "\n", "\n".join(of_tracker) + "\n"


@pytest.fixture(scope="module")
def bag():
    return a_bag()


@pytest.mark.parametrize("written", [echo, rostopic, bagpy, lambda bag: bagpy(bag, lists=False)])
def test_every_tool_writes_the_same_joints_and_poses(bag, written):
    joints, poses = (ros_columns(text) for text in written(bag))
    t, q, _, seen = bag
    for k, name in enumerate(NAMES):
        column = joints.columns[name]
        assert np.allclose(column[np.isfinite(column)], q[:, k], atol=1e-7)
    assert np.allclose(np.column_stack([poses.columns[a] for a in "xyz"]), seen[:, :3], atol=1e-8)
    assert np.allclose(np.column_stack([poses.columns[f"q{a}"] for a in "xyzw"]), seen[:, 3:], atol=1e-8)
    assert abs(np.nanmin(joints.columns["t_s"]) - BEGIN - t[0]) < 1e-5
    assert poses.units["x"] == "m"


def test_stands_alone_are_joined_and_the_calibration_says_how_many(tmp_path, monkeypatch, capsys, bag):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.urdf").write_text(urdf())
    for name, text in zip(("joint_states.csv", "tracker.csv"), echo(bag), strict=True):
        (tmp_path / name).write_text(text)
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", "urdf=my.urdf", "data=joint_states.csv,tracker.csv", "page=false", "--json"])
    told = capsys.readouterr()
    assert ended.value.code == 0, told.err
    found = json.loads(told.out)
    [joined] = [note for note in found["notes"] if "joined by time" in note["text"]]
    assert joined["values"]["poses"] == found["poses"] == 40
    assert 0.3 < joined["values"]["joined"] / joined["values"]["rows"] < 0.5
    assert found["after"]["rms"] < 0.05 < 1.0 < found["before"]["rms"]


def test_a_row_without_joints_near_in_time_is_dropped_and_the_nearest_is_taken_within_the_gap():
    joints = Columns({"time": np.array([1.0, 5.0, 9.0, 13.0]), "a": np.array([0.1, 0.5, 0.9, 1.3])})
    poses = Columns({"time": np.array([1.3, 4.8, 7.0, 9.4]), "x": np.arange(4.0), "y": np.ones(4), "z": np.ones(4)})
    made = by_time({"joints": joints, "poses": poses}, gap=0.5)
    assert made.columns["a"].tolist() == [0.1, 0.5, 0.9]
    assert made.columns["x"].tolist() == [0.0, 1.0, 3.0]
    assert "3 of 4 rows of poses are joined" in made.notes[-1].text
    assert by_time({"joints": joints, "poses": poses}, gap=0.25).columns["x"].tolist() == [1.0]
    other = Columns({**poses.columns, "time": poses.columns["time"] + 1e6})
    with pytest.raises(DataError, match="of two clocks, which nothing joins here"):
        by_time({"joints": joints, "poses": other})


def test_a_gap_without_times_to_join_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(urdf())
    for name, heads in (("a.csv", ",".join(NAMES)), ("b.csv", "x,y,z")):
        (tmp_path / name).write_text(f"{heads}\n" + f"{','.join('1' for _ in heads.split(','))}\n" * 12)
    for data in ("a.csv", "a.csv,b.csv"):
        with pytest.raises(SystemExit) as ended:
            main(["calibrate", "urdf=arm.urdf", f"data={data}", "gap=0.2"])
        assert ended.value.code == 2
        assert "gap= joins files by their times" in capsys.readouterr().err
