"""The Python door: arrays and tables of pandas in, values out, the same numbers as the command line."""

import json
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

import calibench
from calibench.bench.cli import main
from calibench.core.notes import Code, DataError
from tests.bench import hand_eye_by_hand as pairs
from tests.bench.arm_by_hand import NAMES, measured, placed, table, urdf


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "my.urdf"
    path.write_text(urdf())
    return path


@pytest.fixture(scope="module")
def read():
    q, seen, _ = measured(60)
    text = table(q, seen)
    return np.array([line.split(",") for line in text.splitlines()[1:]], dtype=float)


@pytest.fixture(scope="module")
def answer(arm, read):
    return calibench.calibrate(arm, dict(zip((*NAMES, "x", "y", "z"), read.T, strict=True)))


def test_a_table_of_pandas_and_an_array_give_what_columns_give(arm, read, answer):
    frame = pd.DataFrame(read, columns=[*NAMES, "x", "y", "z"])
    for given, names in ((frame, ()), (read, (*NAMES, "x", "y", "z"))):
        again = calibench.calibrate(arm, given, names=names)
        assert again.to_dict()["changes"] == answer.to_dict()["changes"]


def test_words_and_objects_of_a_table_of_pandas_are_read_as_the_cells_of_a_file(arm, read, answer):
    frame = pd.DataFrame(read, columns=[*NAMES, "x", "y", "z"])
    again = calibench.calibrate(arm, frame.astype(str))
    assert again.to_dict()["changes"] == answer.to_dict()["changes"]
    lost = frame.assign(x=frame["x"].astype(object).where(frame.index != 3, None))
    assert calibench.calibrate(arm, lost).poses == len(frame) - 1
    with pytest.raises(DataError, match=r"column x, reading 1: '.* mm' is no number; .* unit in the heading"):
        calibench.calibrate(arm, frame.assign(x=[f"{x} mm" for x in frame["x"]]))


def test_the_command_line_gives_the_same_numbers(arm, read, answer, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    heads = ",".join((*NAMES, "x", "y", "z"))
    (tmp_path / "my.csv").write_text("\n".join([heads, *(",".join(f"{v:.7f}" for v in row) for row in read)]))
    with pytest.raises(SystemExit):
        main(["calibrate", f"urdf={arm}", "data=my.csv", "page=false", "--json"])
    written, ours = json.loads(capsys.readouterr().out), json.loads(json.dumps(answer.to_dict()))
    for key in ("changes", "undetermined", "levels", "frames", "notes"):
        assert written[key] == ours[key]
    assert all(set(note) == {"code", "text", "columns", "rows", "values"} for note in written["notes"])


def test_the_answer_says_what_changed_what_is_held_and_writes_the_arm(answer, tmp_path):
    assert answer.error_after < 0.08 < 1.5 < answer.error_before
    assert {change.parameter for change in answer.parameters} >= {"z_joint_3", "zero_joint_3"}
    assert all(one.reason for one in answer.held)
    path = answer.write_urdf(tmp_path / "true.urdf")
    q = measured(20, seed=8)[0]
    again = calibench.calibrate(path, np.column_stack([q, placed(q)[0]]), names=[*NAMES, *"xyz"])
    assert again.error_before < 0.06


def test_units_stand_in_names_or_beside_them(arm, read, answer):
    degrees = {f"{name} [deg]": np.rad2deg(q) for name, q in zip(NAMES, read.T)}
    places = dict(zip(("u", "v", "w"), read[:, 6:].T / 1000, strict=True))
    again = calibench.calibrate(
        arm, {**degrees, **places}, columns={"x": "u", "y": "v", "z": "w"}, units=dict.fromkeys("uvw", "m")
    )
    assert again.error_after == pytest.approx(answer.error_after, rel=1e-6)


def test_a_mistake_is_told_by_its_code(arm, read):
    turned = read.copy()
    turned[:, 2] *= -1
    with pytest.raises(DataError, match="joint_3 turns the other way") as refused:
        calibench.calibrate(arm, turned, names=[*NAMES, *"xyz"])
    assert refused.value.note.code is Code.JOINT_REVERSED
    assert refused.value.note.values == {"joint": "joint_3"}


def test_more_poses_are_proposed_and_worth_something(arm, read):
    planned = calibench.design(arm, 5, read[:30], names=[*NAMES, *"xyz"], box=((-900, 900), (-900, 900), (0, 1500)))
    assert planned.joints.shape == (5, 6)
    assert planned.chosen.error[-1] < planned.chosen.error[0]
    assert planned.measured == 30
    assert repr(planned).startswith("<design of 5 poses beside 30, ")
    assert Code.NOT_CHECKED in {note.code for note in planned.notes}


def test_a_camera_on_the_hand_is_found():
    flange, seen = pairs.measured(12)
    heads, numbers = zip(pairs.columns_of(flange, "flange"), pairs.columns_of(seen, "board"), strict=True)
    found = calibench.hand_eye(np.column_stack(numbers), names=[name for part in heads for name in part])
    assert found.camera.position == pytest.approx(pairs.CAMERA[0], abs=1e-4)


def test_one_order_of_angles_is_that_of_each_pose_that_has_angles():
    flange, seen = pairs.measured(12)
    (heads, robot), (names, board) = (
        pairs.columns_of(flange, "flange"),
        pairs.columns_of(seen, "board", turns=pairs.VECTOR),
    )
    numbers = np.column_stack([robot, board])
    found = calibench.hand_eye(numbers, names=[*heads, *names], rotation="vector")
    assert found.camera.position == pytest.approx(pairs.CAMERA[0], abs=1e-4)


@pytest.mark.parametrize(
    ("call", "options", "message"),
    [
        ("calibrate", {"level": "all"}, r"level='?all'?: .*choices: auto, "),
        ("calibrate", {"observe": "xyz"}, r"observe='?xyz'?: .*choices: .*position"),
        ("calibrate", {"resamples": 0}, r"resamples=0: must be 20 or more"),
        ("calibrate", {"units": "x:m"}, r"units='?x:m'?: names with values are needed"),
        ("design", {"limits": {"joint_3": (-1, 1)}}, r"limits=.*: .*choices: urdf, table, data"),
        ("design", {"by": "Q"}, r"by='?Q'?: .*choices: D, E"),
        ("design", {"sigma": -1}, r"sigma=-1: must be above 0"),
        ("design", {"count": 0}, r"count=0: must be 1 or more"),
        ("hand_eye", {"mounting": "on_hand"}, r"mounting='?on_hand'?: .*eye_in_hand"),
        ("hand_eye", {"read": "board"}, r"read='?board'?: .*board_in_camera"),
        ("hand_eye", {"board_scale": 0}, r"board_scale=0: must be above 0"),
    ],
)
def test_an_option_that_means_nothing_is_refused_by_its_name(arm, read, call, options, message):
    first = {"calibrate": (arm, read), "design": (arm, options.pop("count", 4)), "hand_eye": ({},)}[call]
    with pytest.raises(ValueError, match=f"^{message}"):
        getattr(calibench, call)(*first, **options)


def test_a_box_may_be_written_as_on_the_command_line(arm):
    boxes = ((-900, 900, -900, 900, 0, 1500), [[-900, 900], [-900, 900], [0, 1500]])
    flat, nested = (calibench.design(arm, np.int64(2), box=box, target=np.array([0, 50, 90])) for box in boxes)
    assert flat.joints.tolist() == nested.joints.tolist()


def test_what_is_no_table_is_refused_in_one_line(arm):
    for given, said in (
        ("my.csv", "columns by name"),
        (np.zeros(3), "columns by name"),
        ({"a": [1], "b": [1, 2]}, "of"),
    ):
        with pytest.raises(DataError, match=said):
            calibench.calibrate(arm, given)


def test_an_arm_is_calibrated_without_other_machines_and_without_pages():
    words = (
        "import sys, calibench, numpy; from calibench.calibration import api, hand_eye;"
        "print([m for m in sys.modules if m.partition('.')[0] in ('pandas', 'matplotlib', 'pyarrow', 'hydra', 'jinja2')"
        " or m.startswith(('calibench.problems', 'calibench.discrepancy', 'calibench.bench', 'calibench.optimizers'))])"
    )
    assert subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_the_covariance_of_the_numbers_goes_with_the_file(answer):
    told = json.loads(json.dumps(answer.to_dict()))["covariance"]
    matrix, names = np.array(told["matrix"]), told["names"]
    assert matrix.shape == (len(names),) * 2
    assert matrix == pytest.approx(matrix.T)
    assert {name: unit for name, unit in zip(names, told["units"], strict=True) if name.startswith("zero_")} == {
        change.parameter: "rad" for change in answer.changes if change.parameter.startswith("zero_")
    }
    for change in answer.changes:
        k = names.index(change.parameter)
        assert np.sqrt(matrix[k, k]) == pytest.approx(change.sd, rel=0.4)  # which is drawn
    assert np.abs(matrix / np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))).max() == pytest.approx(1.0)
