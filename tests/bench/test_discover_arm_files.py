"""`bench discover machine=arm` reads as `bench calibrate` does: rotations of any name, FIGAROH's columns, sockets."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench.bench.measured import read_measured, sources
from calibench.bench.measured.sources import OF_A_CALIBRATION
from calibench.discrepancy import DataError
from calibench.discrepancy.machines.arm import Arm
from calibench.discrepancy.machines.arm.formulation import TURNED
from tests.bench.arm_by_hand import NAMES, in_sockets, measured, table, urdf

pytestmark = pytest.mark.usefixtures("at_one_noise")


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "my.urdf").write_text(urdf())
    return Arm(str(tmp_path / "my.urdf"))


def formulated(arm, tmp_path, text, stated=None):
    (tmp_path / "my.csv").write_text(text)
    return arm.formulate(read_measured(tmp_path / "my.csv", "arm", stated))


def posed(heads, angles, places=1.0):
    q, seen, turns = measured(40)
    return table(q, np.column_stack([places * seen, angles(Rotation.from_matrix(turns))]), heads)


ROLL = ("x", "y", "z", "roll", "pitch", "yaw")


def test_roll_pitch_and_yaw_are_read_as_rotations(arm, tmp_path):
    found = formulated(arm, tmp_path, posed(ROLL, lambda turns: turns.as_euler("xyz")))
    assert set(TURNED) <= set(found.readings)
    assert np.abs(np.stack([found.data[name] for name in TURNED])).max() < 20  # mrad


def test_the_names_of_figaroh_are_metres(arm, tmp_path):
    heads = ("x1", "y1", "z1", "phix1", "phiy1", "phiz1")
    found = formulated(arm, tmp_path, posed(heads, lambda turns: turns.as_euler("xyz"), places=1e-3))
    assert "x1, y1, z1: no unit is stated; they fit the arm in m" in map(str, found.data.notes)
    assert np.ptp(found.data["x"]) > 500
    assert set(TURNED) <= set(found.readings)


@pytest.mark.slow
def test_a_folder_of_sockets_is_one_set(arm, tmp_path):
    in_sockets(tmp_path / "plate", places=3, postures=12)
    [source] = sources(str(tmp_path / "plate"), "arm")
    data = source.read({"socket_distance_mm": 50})
    assert source.case == "plate"
    assert "3 places, 6 files of sockets" in map(str, data.notes)
    assert len(data) == 72
    assert sorted(set(data["place"].tolist())) == ["place_0", "place_1", "place_2"]
    assert any(p.name == "pair0_x" for p in arm.formulate(data).parameters)
    before = source.data_id
    file = tmp_path / "plate" / "place_0" / "hole_1.csv"
    file.write_text(file.read_text().replace("1", "2", 1))
    assert source.data_id not in ("", before)


def test_the_readings_of_a_calibration_bear_its_name(tmp_path):
    """Each calibration writes its readings under one name, in a folder of its own: two arms must not share a folder."""
    for name in ("left", "right"):
        (tmp_path / name).mkdir()
        (tmp_path / name / OF_A_CALIBRATION).touch()
        (tmp_path / name / "run.parquet").touch()
    assert [one.case for one in sources(str(tmp_path / "left" / OF_A_CALIBRATION), "arm")] == ["left"]
    assert [one.case for one in sources(str(tmp_path / "*" / OF_A_CALIBRATION), "arm")] == ["left", "right"]
    assert [one.case for one in sources(str(tmp_path / "left" / "run.parquet"), "arm")] == ["run"]


def test_a_folder_of_files_is_a_set_each(tmp_path):
    q, seen, _ = measured(12)
    for name in ("a", "b"):
        (tmp_path / f"{name}.csv").write_text(table(q, seen, names=NAMES))
    in_sockets(tmp_path / "plate", places=1, postures=4)
    assert [source.case for source in sources(str(tmp_path), "arm")] == ["a", "b"]


def test_joints_in_a_file_of_their_own_and_beyond_their_limits_are_told(arm, tmp_path):
    q, seen, _ = measured(40)
    (tmp_path / "tracker.csv").write_text("x,y,z\n" + "\n".join(",".join(map(str, row)) for row in seen))
    with pytest.raises(DataError, match="joint_1"):
        arm.formulate(read_measured(tmp_path / "tracker.csv", "arm"))
    q[7, 2] = 3.0
    notes = formulated(arm, tmp_path, table(q, seen)).data.notes
    words = "joint joint_3 stands at 3 rad, outside its limits -2.6 to 2.6 in the URDF (1 such row)"
    assert any(words in note.text for note in notes)
