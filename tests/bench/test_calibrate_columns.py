"""What names of columns say to `bench calibrate`: units, numbered places; and what it says of the rest."""

import json
import shlex

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from calibench.bench.cli import main
from tests.bench.arm_by_hand import NAMES, measured, table, texts, urdf
from tests.few import few


@pytest.fixture
def calibrate(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.urdf").write_text(urdf())

    def call(text, *words, file="my.csv", code=0):
        if text:
            (tmp_path / file).write_text(text)
        with pytest.raises(SystemExit) as ended:
            main(["calibrate", "urdf=my.urdf", f"data={file}", "page=false", *words, "--json"])
        told = capsys.readouterr()
        assert ended.value.code == code, told.err
        return json.loads(told.out) if code == 0 else told.err

    return call


Q, SEEN, TURNS = measured(40)
POSED = ("x", "y", "z", "qx", "qy", "qz", "qw")


@pytest.mark.parametrize(
    ("joints", "places"),
    few(
        1,
        [
            ([f"{name}_deg" for name in NAMES], ("x_m", "y_m", "z_m")),
            ([f"q{k} deg" for k in range(1, 7)], ("pos_x_m", "pos_y_m", "pos_z_m")),
            ([f"{name}_meas_deg" for name in NAMES], ("x_m", "y_m", "z_m")),
        ],
    ),
)
def test_a_name_may_end_in_its_unit(calibrate, joints, places):
    found = calibrate(table(np.rad2deg(Q), SEEN / 1000, places, joints))
    assert found["after"]["rms"] < 0.1
    assert sum("turned into" in note for note in texts(found)) == 2


def test_joints_as_they_were_commanded_stand_beside_those_that_were_read(calibrate):
    names = [*(f"{name}_cmd" for name in NAMES), *(f"{name}_meas" for name in NAMES)]
    assert calibrate(table(np.column_stack([Q + 0.1, Q]), SEEN, names=names))["after"]["rms"] < 0.1


def test_matrices_of_matlab_are_joints_and_places(calibrate, tmp_path):
    savemat(tmp_path / "my.mat", {"q": Q, "xyz": SEEN, "T": np.eye(4)})
    found = calibrate("", file="my.mat")
    assert found["after"]["rms"] < 0.1
    assert any("T (4 x 4) have another shape and are not read" in note for note in texts(found))


@pytest.mark.parametrize(
    ("heads", "cure"),
    [("A,B,C", "if A, B, C are turns about z, y, x: columns='{\"rx\":\"C\",\"ry\":\"B\",\"rz\":\"A\"}'"),
     ("o1,o2,o3,o4", "if o1, o2, o3, o4 are a quaternion: "
      "columns='{\"qx\":\"o1\",\"qy\":\"o2\",\"qz\":\"o3\",\"qw\":\"o4\"}'"),
     ("fa,fb,fc", "")],
)  # fmt: skip
def test_columns_that_nothing_reads_are_told_and_how_those_of_a_rotation_are_read(calibrate, heads, cure):
    names, turns = heads.split(","), Rotation.from_matrix(TURNS)
    beside = turns.as_quat() if len(names) == 4 else turns.as_euler("ZYX", degrees=True)
    text = table(Q, np.column_stack([SEEN, beside]), ("x", "y", "z", *names))
    said = "; ".join(filter(None, [f"not read: {', '.join(names)}", cure]))
    assert said in texts(calibrate(text))
    if cure:
        assert calibrate(text, *shlex.split(cure[cure.index("columns=") :]))["observed"] == "pose"


def test_one_joint_in_degrees_is_told_alone(calibrate):
    mixed = Q * np.where(np.arange(6) == 3, 180 / np.pi, 1.0)
    assert calibrate(table(mixed, SEEN), code=2).rstrip().endswith("units=joint_4:deg")
    assert calibrate(table(mixed, SEEN), "units=joint_4:deg")["after"]["rms"] < 0.1
    assert "units=joint_1:deg,joint_2:deg," in calibrate(table(np.rad2deg(Q), SEEN), code=2)


@pytest.mark.parametrize(
    ("q", "seen", "heads", "said"),
    [
        (Q, np.column_stack([SEEN, 2 * Rotation.from_matrix(TURNS).as_quat()]), POSED, "their squares sum to 4"),
        (Q * [1, 0, 1, 1, 1, 1] + 0.1, SEEN, ("x", "y", "z"), "column joint_2 is the same in every row"),
        (Q + np.pi / 2 * np.eye(6)[1], SEEN, ("x", "y", "z"), "mm if -90° are added to joint joint_2"),
        (Q * np.eye(6)[1], SEEN, ("x", "y", "z"), "only joint_2 moves in these poses"),
        (Q, SEEN[:, :1], ("far",), "no measured x, y and z were found among joint_1, joint_2"),
    ],
)
def test_what_is_the_matter_is_said_in_one_line(calibrate, q, seen, heads, said):
    told = calibrate(table(q, seen, heads), "limits=false", code=2)
    assert said in told
    assert told.count("\n") == 1


def test_a_urdf_in_mm_is_told(calibrate, tmp_path):
    text = urdf()
    for place in ("0.3", "0.1", "0.6", "0.5", "0.05", "0.12"):
        text = text.replace(f" {place}", f" {float(place) * 1000:g}").replace(f'"{place}', f'"{float(place) * 1000:g}')
    (tmp_path / "my.urdf").write_text(text)
    assert "a URDF is in metres, and these look like mm" in calibrate(table(Q, SEEN), code=2)


@pytest.mark.parametrize("huge", few(2, [1e6, 1e11, 1e300, np.inf]))
def test_a_cell_of_any_size_costs_its_row_alone(calibrate, huge):
    seen = SEEN.copy()
    seen[3, 0] = huge
    assert calibrate(table(Q, seen))["after"]["rms"] < 0.1
