"""Pairs of poses in the files of other tools: each gives what the CSV of the same pairs gives, or one line."""

import json
import shlex
from contextlib import redirect_stdout
from io import StringIO

import numpy as np
import pytest

from calibench.bench.calibration.hand_eye import read_poses
from calibench.bench.cli import main
from tests.bench.hand_eye_by_hand import columns_of, measured, quaternion_of, vector_of, write

FLANGE, SEEN = measured(12, noise=(0.3, 0.002))
IN_METRES = "units=flange_x:m,flange_y:m,flange_z:m,board_x:m,board_y:m,board_z:m"


def metres(poses):
    made = poses.copy()
    made[:, :3, 3] /= 1000
    return made


A, B = metres(FLANGE), metres(SEEN)


def seven(one):
    return [*map(float, one[:3, 3]), *map(float, quaternion_of(one[:3, :3]))]


def transform(one):
    x, y, z, qx, qy, qz, qw = seven(one)
    return {"translation": {"x": x, "y": y, "z": z}, "rotation": {"x": qx, "y": qy, "z": qz, "w": qw}}


def moveit(path):
    lines = []
    for a, b in zip(A, B, strict=True):
        lines.append(f"- effector_wrt_world: {a.ravel().tolist()}\n  object_wrt_sensor: {b.ravel().tolist()}")
    path.write_text("\n".join(lines) + "\n")


def easy_handeye2(path):
    lines = ["samples:"]
    for a, b in zip(A, B, strict=True):
        for head, name, one in (("-", "robot", a), (" ", "tracking", b)):
            lines.append(f"{head} {name}:")
            for part, values in transform(one).items():
                lines += [f"    {part}:", *(f"      {axis}: {value!r}" for axis, value in values.items())]
    path.write_text("\n".join(lines) + "\n")


def easy_handeye(path):
    lists = {"hand_world_samples": A, "camera_marker_samples": B}
    path.write_text(json.dumps({name: {"transforms": [*map(transform, poses)]} for name, poses in lists.items()}))


def opencv(path):
    np.savez(
        path, R_gripper2base=A[:, :3, :3], t_gripper2base=A[:, :3, 3:], t_target2cam=B[:, :3, 3],
        R_target2cam=np.array([vector_of(one[:3, :3]) for one in B]),
    )  # fmt: skip


def robot_world(path):
    back = np.linalg.inv(A)
    np.savez_compressed(
        path, R_base2gripper=back[:, :3, :3], t_base2gripper=back[:, :3, 3], R_world2cam=B[:, :3, :3],
        t_world2cam=B[:, :3, 3],
    )  # fmt: skip


def file_storage(path):
    lines = ["%YAML:1.0", "---"]
    for name, poses in (("gripper2base", A), ("target2cam", B)):
        lines.append(f"R_{name}:")
        head = "   - !!opencv-matrix\n      rows: 3\n      cols: 3\n      dt: d\n      data: "
        lines += [f"{head}{one[:3, :3].ravel().tolist()}" for one in poses]
        places = poses[:, :3, 3].ravel().tolist()
        lines.append(f"t_{name}: !!opencv-matrix\n   rows: {len(poses)}\n   cols: 3\n   dt: d\n   data: {places}")
    path.write_text("\n".join(lines) + "\n")


def rows_in_turn(path):
    rows = [
        f"{name},{','.join(map(repr, seven(one)))}" for a, b in zip(A, B) for name, one in (("hand", a), ("eye", b))
    ]
    path.write_text("\n".join(rows) + "\n")


@pytest.fixture
def bench(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def call(*words, code=0):
        with pytest.raises(SystemExit) as ended:
            main(["calibrate", "hand_eye=eye_in_hand", *words])
        told = capsys.readouterr()
        assert ended.value.code == code, told.err
        assert code == 0 or told.err.count("\n") == 1
        return json.loads(told.out) if code == 0 else told.err

    return call


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """Return what the table of the pairs gives."""
    folder = tmp_path_factory.mktemp("table")
    write(folder / "table.csv", columns_of(FLANGE, "flange"), columns_of(SEEN, "board", "m"))
    words = ["calibrate", "hand_eye=eye_in_hand", f"data={folder}/table.csv", f"results={folder}", "--json"]
    with redirect_stdout(StringIO()) as told, pytest.raises(SystemExit):
        main(words)
    return json.loads(told.getvalue())


@pytest.mark.parametrize(
    ("name", "writer", "words"),
    [
        ("moveit.yaml", moveit, ()),
        ("easy.yaml", easy_handeye2, ()),
        ("easy.json", easy_handeye, ()),
        ("opencv.npz", opencv, (IN_METRES,)),
        ("world.npz", robot_world, (IN_METRES,)),
        ("storage.yml", file_storage, (IN_METRES,)),
        ("rows.csv", rows_in_turn, (IN_METRES,)),
    ],
)
def test_each_file_gives_what_the_table_of_the_same_pairs_gives(bench, table, tmp_path, name, writer, words):
    writer(tmp_path / name)
    found = bench(f"data={name}", *words, "--json")
    for frame in ("camera", "board"):
        for key in ("matrix", "position_se", "turn_se"):
            assert np.allclose(found[frame][key], table[frame][key], rtol=1e-5, atol=1e-6)
    assert any("the flange in the base" in note["text"] for note in found["notes"])


def opencv_seen(folder, times=False):
    """Write the flange as a table, and the board in another file, as solvePnP of OpenCV has it: rvec, tvec."""
    samples = [{"image": f"{k}.png", "rvec": list(vector_of(one[:3, :3])), "tvec": one[:3, 3:].tolist()}
               for k, one in enumerate(B)]  # fmt: skip
    parts = [columns_of(FLANGE, "flange")]
    if times:
        samples = [one | {"time": float(k)} for k, one in enumerate(samples)]
        parts.append((["time"], np.arange(12.0)))
    (folder / "seen.json").write_text(json.dumps(samples))
    write(folder / "robot.csv", *parts)


@pytest.mark.parametrize("by_name", [False, True])
def test_poses_one_level_down_are_read_under_any_name(tmp_path, by_name):
    opencv_seen(tmp_path)
    samples = json.loads((tmp_path / "seen.json").read_text())
    if by_name:
        samples = {name: [one[name] for one in samples] for name in ("rvec", "tvec")}
    (tmp_path / "in.json").write_text(json.dumps({"camera": {"fx": 900.0}, "size": [9, 6], "views": samples}))
    found, wanted = (read_poses(f"{tmp_path}/robot.csv,{tmp_path}/{name}.json", {}) for name in ("in", "seen"))
    assert list(found.columns) == list(wanted.columns)
    assert all((found.columns[name] == wanted.columns[name]).all() for name in wanted.columns)


@pytest.mark.parametrize("words", ["robot.csv,seen.json", "seen.json,robot.csv"])
def test_the_board_in_a_file_of_opencv_joins_the_robot_s_table_in_its_order(bench, table, tmp_path, words):
    opencv_seen(tmp_path)
    found = bench(f"data={words}", "units=board_x:m,board_y:m,board_z:m", "--json")
    for frame in ("camera", "board"):
        assert np.allclose(found[frame]["matrix"], table[frame]["matrix"], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("heads", "words"),
    [
        (["x", "y", "z", "qx", "qy", "qz", "qw"], "robot.csv,seen.json"),
        (["qw", "z", "y", "x", "qz", "qy", "qx"], "seen.json,robot.csv"),
        ([*"abcdefg"], "robot.csv,seen.json"),
    ],
)
def test_columns_to_copy_leave_the_board_what_its_names_say(bench, table, tmp_path, heads, words):
    opencv_seen(tmp_path)
    numbers = np.array([seven(one) for one in FLANGE])
    order = ["xyz".find(h) if len(h) == 1 else 3 + "xyzw".find(h[1]) for h in heads] if "x" in heads else range(7)
    write(tmp_path / "robot.csv", (heads, numbers[:, [*order]]))
    line = bench(f"data={words}", code=2)
    (columns,) = shlex.split("columns=" + line.partition("columns=")[2])
    assert "board" not in columns
    units = ",".join([*(f"board_{axis}:m" for axis in "xyz"), *(f"flange_{axis}:mm" for axis in "xyz")])
    found = bench(f"data={words}", columns, f"units={units}", "--json")
    assert np.allclose(found["camera"]["matrix"], table["camera"]["matrix"], rtol=1e-5, atol=1e-6)


def test_columns_of_two_files_stand_in_the_order_of_the_files(tmp_path):
    opencv_seen(tmp_path)
    for words, first in (("robot.csv,seen.json", "flange_x"), ("seen.json,robot.csv", "board_x")):
        both = read_poses(",".join(f"{tmp_path}/{word}" for word in words.split(",")), {})
        assert next(iter(both.columns)) == first


def test_the_board_in_a_file_of_opencv_with_times_joins_by_time(tmp_path):
    opencv_seen(tmp_path, times=True)
    both = read_poses(f"{tmp_path}/robot.csv,{tmp_path}/seen.json", {})
    assert len(both) == 24
    assert np.isnan(both.columns["board_x"]).sum() == np.isnan(both.columns["flange_x"]).sum() == 12


def test_two_files_of_unlike_length_say_how_many_each_has(bench, tmp_path):
    opencv_seen(tmp_path)
    some = json.loads((tmp_path / "seen.json").read_text())[:-1]
    (tmp_path / "seen.json").write_text(json.dumps(some))
    assert "robot.csv has 12 and seen.json has 11" in bench("data=robot.csv,seen.json", code=2)


def test_arrays_without_a_unit_are_refused_with_what_to_state(bench, tmp_path):
    opencv(tmp_path / "opencv.npz")
    assert "flange_z, board_x, board_y, board_z: no unit is stated" in bench("data=opencv.npz", code=2)


BOMB = "a: &a [1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{b}: &{b} [{','.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefghi", "bcdefghij", strict=True)
)
POSE = "hand,0,0,0,0,0,0,1\n"


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.yaml", BOMB, "aliases written out"),
        ("a.yaml", "[" * 500, "deep in each other"),
        ("a.yaml", "a: [1\n", "is no YAML"),
        ("a.yaml", "!!python/object/apply:os.getcwd []", "has no poses of the flange"),
        ("a.yaml", "- effector_wrt_world: [1, 2]\n  object_wrt_sensor: [1, 2]\n", "has 2 numbers"),
        ("a.yaml", "- {robot: {translation: {x: 1}}, tracking: 1}\n", "lacks a translation"),
        ("a.yaml", "- {robot: 1, tracking: 2}\n- {robot: 1}\n", "sample 2 has robot"),
        ("a.json", '{"hand": [[0,0,0,0,0,0,1]], "eye": []}', "hand has 1 and eye has 0"),
        ("a.json", '{"hand": [[0,0,0,0,0,0,0]], "eye": []}', "a quaternion without length"),
        ("a.json", '{"R_gripper2base": [[1]], "t_gripper2base": [[1, 2, 3]]}', "(n, 3, 3)"),
        ("a.csv", POSE + POSE, "line 2 is a second row of hand"),
        ("a.csv", POSE + "foot,1\n", "line 2 begins with 'foot'"),
        ("a.npz", "no archive", "is no npz file"),
    ],
)
def test_files_of_no_pairs_are_refused_in_one_line(bench, tmp_path, name, text, told):
    (tmp_path / name).write_text(text)
    assert told in bench(f"data={name}", code=2)


def test_arrays_of_objects_are_never_unpickled(bench, tmp_path):
    np.savez(tmp_path / "a.npz", R_gripper2base=np.array([{}, {}], dtype=object))
    assert "Object arrays cannot be loaded" in bench("data=a.npz", code=2)


def test_a_matrix_that_is_no_rotation_is_refused(bench, tmp_path):
    shapes = {"R": (4, 3, 3), "t": (4, 3)}
    arrays = {f"{k}_{name}": np.ones(shape) for k, shape in shapes.items() for name in ("gripper2base", "target2cam")}
    np.savez(tmp_path / "a.npz", **arrays)
    assert "no rotation (4 of 4)" in bench("data=a.npz", code=2)
