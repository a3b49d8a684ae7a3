"""`bench calibrate`: a URDF and readings of a simulated arm in; what was hidden out, and a line for each bad file."""

import json
import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from calibench.bench.calibration.request import read_table
from calibench.bench.cli import main
from calibench.bench.measured import read_measured
from calibench.calibration.determined import order_of
from calibench.calibration.fit import fit_arm
from calibench.calibration.kinematics import forward, nominal
from calibench.calibration.model import model_of
from calibench.calibration.readings import read_readings
from calibench.calibration.start import start_of
from calibench.calibration.urdf import read_urdf
from tests.bench.arm_by_hand import BASE, NAMES, TRUTH, about, in_sockets, measured, placed, table, texts, urdf
from tests.few import few

GIVEN = Path(os.environ.get("CALIBENCH_DATA", Path(__file__).parents[3] / "shared" / "data"))
given = pytest.mark.skipif(
    not GIVEN.is_dir(), reason=f"no measured data at {GIVEN}; CALIBENCH_DATA names a folder that has them"
)
DEGREES = [f"{name}:deg" for name in NAMES]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.urdf").write_text(urdf())
    return tmp_path


@pytest.fixture
def calibrate(here, capsys):
    def call(*words, code=0, page="false"):
        with pytest.raises(SystemExit) as ended:
            main(["calibrate", "urdf=my.urdf", f"page={page}", *words, "--json"])
        told = capsys.readouterr()
        assert ended.value.code == code, told.err
        return json.loads(told.out) if code == 0 else told.err

    return call


def test_what_was_hidden_comes_back_within_its_errors(here, calibrate):
    q, seen, _ = measured(60)
    (here / "my.csv").write_text(table(q, seen))
    found = calibrate("data=my.csv")
    assert found["chosen"] == "geometry"
    assert found["before"]["rms"] > 1.5
    assert found["after"]["rms"] < 0.08
    changes = {change["parameter"]: change for change in found["changes"]}
    assert set(TRUTH) <= set(changes)
    away = [abs(change["change"] - TRUTH.get(name, 0.0)) / change["sd"] for name, change in changes.items()]
    assert max(away) < 4
    assert np.mean(np.array(away) < 2) > 0.75
    undetermined = {one["parameter"]: one["reason"] for one in found["undetermined"]}
    assert undetermined["x_joint_1"].startswith("looks like")
    assert set(changes) & set(undetermined) == set()


def test_the_calibrated_urdf_is_the_old_file_with_other_origins(here, calibrate):
    q, seen, _ = measured(60)
    (here / "my.csv").write_text(table(q, seen))
    found = calibrate("data=my.csv")
    before, after = urdf().splitlines(), Path(found["files"]["urdf"]).read_text().splitlines()
    assert "calibrated by bench calibrate" in after.pop(2)
    differ = [(a, b) for a, b in zip(before, after, strict=True) if a != b]
    assert differ
    assert all("<origin" in a and "<origin" in b for a, b in differ)
    changed = {change["joint"] for change in found["changes"]}
    assert len(differ) == len(changed)
    chain = read_urdf(found["files"]["urdf"]).chain()
    flange = forward(chain, nominal(chain), q[:20])
    truth = placed(q[:20], target=np.zeros(3))[0]
    between = [np.linalg.norm(a - b) for a, b in pairwise(truth)]
    ours = np.linalg.norm(np.diff(flange[:, :3, 3], axis=0), axis=1)
    np.testing.assert_allclose(ours, between, atol=0.25)  # the tool's length along its axis is the target's to tell
    drawn = read_urdf("my.urdf").chain()
    nominally = np.linalg.norm(np.diff(forward(drawn, nominal(drawn), q[:20])[:, :3, 3], axis=0), axis=1)
    assert np.abs(nominally - between).max() > 0.8


def test_a_true_arm_keeps_its_urdf(here, calibrate):
    q, seen, _ = measured(40, truth={})
    (here / "my.csv").write_text(table(q, seen))
    found = calibrate("data=my.csv")
    assert found["chosen"] == "frames"
    assert "urdf" not in found["files"]
    assert found["changes"] == []


def test_wild_readings_are_named_and_have_no_say(here, calibrate):
    q, seen, _ = measured(60)
    (here / "my.csv").write_text(table(q, seen))
    clean = calibrate("data=my.csv")
    seen[[6, 30]] += [[0, 35.0, 0], [400.0, 0, 0]]
    (here / "my.csv").write_text(table(q, seen))
    found = calibrate("data=my.csv")
    assert [one["row"] for one in found["wild"]] == ["row 31", "row 7"]
    assert clean["wild"] == []
    assert abs(found["after"]["rms"] - clean["after"]["rms"]) < 0.01


@pytest.mark.slow
def test_rotations_that_never_vary_are_told_as_such(here, calibrate):
    """A controller that writes zeros where no turn was measured: no order of rotations is the reason."""
    q, seen, turns = measured(30)
    heads = ("x", "y", "z", "rx", "ry", "rz")
    (here / "still.csv").write_text(table(q, np.column_stack([seen, np.zeros((30, 3))]), heads))
    notes = texts(calibrate("data=still.csv"))
    assert "rx, ry, rz never vary, though the arm turned its tool: they are left out" in notes
    assert "rotation=rpy; rx, ry, rz never vary" in calibrate("data=still.csv", "rotation=rpy", code=2)
    mixed = np.column_stack([seen, Rotation.from_matrix(turns).as_euler("xyz")[::-1, :2], np.zeros(30)])
    (here / "mixed.csv").write_text(table(q, mixed, heads))
    notes = texts(calibrate("data=mixed.csv"))
    assert any("fit in no order of rotations" in note and "; rz never varies) and" in note for note in notes)


@pytest.mark.parametrize("order", few(1, ["xyz", "rpy"]))
def test_the_order_and_unit_of_rotations_is_found(here, calibrate, order):
    q, seen, turns = measured(40)
    mount = about((0.6, 0, 0.8), 1.1)
    turns = turns @ mount
    if order == "xyz":  # R = Rx(a) Ry(b) Rz(c)
        angles = [(np.arctan2(-r[1, 2], r[2, 2]), np.arcsin(r[0, 2]), np.arctan2(-r[0, 1], r[0, 0])) for r in turns]
    else:
        angles = [(np.arctan2(r[2, 1], r[2, 2]), -np.arcsin(r[2, 0]), np.arctan2(r[1, 0], r[0, 0])) for r in turns]
    heads = ("m_x", "m_y", "m_z", "m_rx", "m_ry", "m_rz")
    (here / "my.csv").write_text(table(q, np.column_stack([seen, np.rad2deg(angles)]), heads))
    found = calibrate("data=my.csv")
    assert found["observed"] == "pose"
    assert any(f"(rotation={order}), degrees" in note for note in texts(found))
    assert any("no unit is stated; they fit the arm in mm" in note for note in texts(found))
    assert found["after"]["rotation"] < 2e-4


@pytest.mark.slow
def test_a_quaternion_may_begin_with_its_real_part_and_is_none_where_it_is_zero(here, calibrate):
    q, seen, turns = measured(40)
    numbers = Rotation.from_matrix(turns).as_quat(scalar_first=True)
    numbers[7] = 0
    (here / "my.csv").write_text(table(q, np.column_stack([seen, numbers]), ("x", "y", "z", "qx", "qy", "qz", "qw")))
    found = calibrate("data=my.csv")
    assert found["observed"] == "pose"
    assert found["after"]["rotation"] < 2e-4
    assert any("are read as quaternion whose first number is the real part" in note for note in texts(found))
    assert any(note.endswith("left out: row 8") for note in texts(found))


def test_joints_and_tracker_in_two_files_are_joined_row_by_row(here, calibrate):
    q, seen, _ = measured(40)
    np.savetxt(here / "tracker.csv", seen, delimiter=";", header="X [mm];Y [mm];Z [mm]", comments="", fmt="%.6f")
    (here / "tracker.csv").write_text((here / "tracker.csv").read_text().replace(".", ","))
    savemat(here / "joints.mat", {f"q{k}": q[:, k - 1] for k in range(1, 7)})
    found = calibrate("data=joints.mat,tracker.csv")
    assert found["after"]["rms"] < 0.08
    assert "joints, tracker are joined row by row" in texts(found)
    told = calibrate("data=joints.mat,tracker.csv", "units=q1:rad,Y:mm", 'columns={"x":"X"}')
    assert told["after"]["rms"] < 0.08
    assert "units: q7 is no column of joints, tracker" in calibrate(
        "data=joints.mat,tracker.csv", "units=q7:rad", code=2
    )
    told = calibrate("data=joints.mat,tracker.csv", 'columns={"x":"W"}', code=2)
    assert "columns: W is no column of joints, tracker" in told
    (here / "tracker.csv").write_text("\n".join((here / "tracker.csv").read_text().splitlines()[:-1]))
    assert "have not as many rows (joints 40, tracker 39)" in calibrate("data=joints.mat,tracker.csv", code=2)


def test_files_of_one_stem_are_told_apart_by_their_folders(here, calibrate):
    q, seen, _ = measured(40)
    for folder in ("arm", "tracker"):
        (here / folder).mkdir()
    joints, places = (
        np.array([line.split(",") for line in table(q, seen).split()])[:, k] for k in (slice(6), slice(6, 9))
    )
    (here / "arm" / "run.csv").write_text("\n".join(map(",".join, joints)))
    (here / "tracker" / "run.csv").write_text("\n".join(map(",".join, places)))
    found = calibrate("data=arm/run.csv,tracker/run.csv")
    assert "arm_run, tracker_run are joined row by row" in texts(found)
    assert calibrate("data=*/run.csv")["after"]["rms"] == found["after"]["rms"]
    (here / "tracker" / "run.csv").write_text("\n".join(map(",".join, places[:-1])))
    said = calibrate("data=arm/run.csv,tracker/run.csv", code=2)
    assert "have not as many rows (arm_run 40, tracker_run 39)" in said
    assert "a file, a glob, a folder or a name is needed" in calibrate("data=,", code=2)


def test_folders_of_one_name_are_places_of_their_own(tmp_path):
    for half in ("left", "right"):
        (tmp_path / half / "p1").mkdir(parents=True)
        (tmp_path / half / "p1" / "hole_0.csv").write_text("q1,q2\n1,2\n2,3\n3,5\n")
    found = read_table(str(tmp_path), {})
    assert set(found.columns["place"]) == {"left/p1", "right/p1"}
    assert found.notes[0].text == "2 places, 2 files of sockets"


def test_a_ball_in_sockets_calibrates_without_a_tracker(here, calibrate):
    in_sockets(here / "plate")
    found = calibrate("data=plate", "machine.tip=ball", "distance=50")
    assert found["observed"] == "sockets"
    assert found["poses"] == 128
    assert found["before"]["rms"] > 0.4
    assert found["after"]["rms"] < 0.1
    assert found["after"]["spans"] < 0.3 * found["before"]["spans"]
    assert "ball_joint" in Path(found["files"]["urdf"]).read_text()
    ball = read_urdf(found["files"]["urdf"]).chain(tip="ball").tail[:3, 3]
    np.testing.assert_allclose(ball, [10, -15, 90], atol=1.0)
    tip = [change for change in found["changes"] if change["joint"] == "ball_joint"]
    np.testing.assert_allclose([change["change"] for change in tip], ball, atol=1e-6)
    assert all(c["ci95"][0] < c["change"] < c["ci95"][1] and 0 < c["sd"] < 0.3 for c in tip)


@pytest.mark.slow
def test_where_a_pose_was_read_the_table_of_changes_tells_all_of_a_stated_tip(here, calibrate):
    q, seen, turns = measured(40)
    told = np.column_stack([seen, Rotation.from_matrix(turns @ about((0, 0, 1), np.pi)).as_euler("xyz")])
    (here / "my.csv").write_text(table(q, told, heads=("x", "y", "z", "roll", "pitch", "yaw")))
    found = calibrate("data=my.csv", "machine.tip=ball")
    tip = {change["what"]: change for change in found["changes"] if change["joint"] == "ball_joint"}
    assert len(tip) == 6
    half = tip["turn about z"]
    assert half["unit"] == "rad"
    assert abs(abs(half["change"]) - np.pi) < 0.01
    assert 0 < half["ci95"][1] - half["ci95"][0] < 0.02
    assert not [change for change in calibrate("data=my.csv")["changes"] if change["joint"] == "ball_joint"]


def test_a_joint_that_the_urdf_lacks_is_told_by_its_column(here, calibrate):
    text, last = urdf(), urdf().index('  <link name="link_6"/>')
    q, seen, _ = measured(40)
    (here / "my.csv").write_text(table(q, seen))
    (here / "my.urdf").write_text(text[:last] + "</robot>\n")
    told = calibrate("data=my.csv", code=2)
    assert "joint_6 belongs to no joint of the URDF that moves by itself: take the whole arm's URDF" in told
    assert told.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("apart", [49.92, 50.08])
def test_lengths_are_told_to_what_the_distance_of_sockets_is_known_to(here, calibrate, apart):
    in_sockets(here / "plate", places=6, apart=apart)
    found = calibrate("data=plate", "machine.tip=ball", "distance=50", "level=geometry")
    length = next(change for change in found["changes"] if change["parameter"] == "z_joint_3")
    assert length["ci95"][0] < TRUTH["z_joint_3"] < length["ci95"][1]  # an arm of 600 mm is .96 mm too long or short
    known = calibrate("data=plate", "machine.tip=ball", "distance=50", "level=geometry", "sigma_distance=0.005")
    told = next(change for change in known["changes"] if change["parameter"] == "z_joint_3")
    assert told["sd"] < 0.2 * length["sd"]


def test_a_socket_counts_by_how_far_its_postures_lie_apart(here):
    in_sockets(here / "plate", places=4, noise=0.02)
    for socket in (0, 1):
        file = here / "plate" / "place_3" / f"hole_{socket}.csv"
        q = np.loadtxt(file, delimiter=",")
        np.savetxt(file, q + np.random.default_rng(socket).normal(0, 5e-4, q.shape), delimiter=",")
    chain = read_urdf(here / "my.urdf").chain(tip="ball")
    start = start_of(read_readings(read_table("plate", {}), chain), chain)
    model = model_of(chain, start.readings, start.base, start.tool, distance=50.0)
    scatter = fit_arm(model, order_of(model.names, "geometry")).model.scatter
    assert scatter[model.place == 3].min() > 2 * scatter[model.place != 3].max()


@pytest.mark.slow
@pytest.mark.parametrize("size", [5, pytest.param(400, marks=pytest.mark.slow)])
def test_a_third_of_the_poses_may_be_wild(here, calibrate, size):
    q, seen, _ = measured(60)
    rng = np.random.default_rng(2)
    wild = rng.permutation(60)[:20]
    seen[wild] += rng.normal(0, size, (20, 3))
    (here / "my.csv").write_text(table(q, seen))
    found = calibrate("data=my.csv")
    assert found["after"]["rms"] < 0.08  # it was 46 mm, of a fit to all
    assert len(found["wild"]) >= 18  # some of 5 mm are small
    assert any("of 60 readings are wild" in note for note in texts(found))


def test_rows_that_the_file_holds_back_are_only_predicted(here, calibrate):
    q, seen, _ = measured(60)
    lines = table(q, seen).splitlines()
    split = ["split", *(["train"] * 45), *(["hold"] * 15)]
    (here / "my.csv").write_text("\n".join(f"{a},{b}" for a, b in zip(lines, split, strict=True)))
    found = calibrate("data=my.csv")
    assert found["folds"] == "the 15 rows that the file holds back"
    assert sum(part["poses"] for part in found["by_joint"] if part["where"].startswith("joint_1 ")) <= 15


def test_a_pose_is_held_out_with_its_repeats(here, calibrate):
    rng = np.random.default_rng(3)
    q, seen, _ = measured(60)
    again = np.tile(np.arange(20), 3)
    (here / "my.csv").write_text(table(q[again], seen[again] + rng.normal(0, 0.03, (60, 3))))
    found = calibrate("data=my.csv")
    assert found["folds"] == "each of 20 different ones left out once with its repeats, in 20 groups"
    (here / "once.csv").write_text(table(q[:20], seen[:20]))
    once = calibrate("data=once.csv")
    assert found["after"]["rms"] > 0.7 * once["after"]["rms"]  # .05 mm where repeats of a pose are fitted to tell it
    low, high = found["after"]["ci95"]
    assert high - low > 0.15 * found["after"]["rms"]


def test_copies_of_a_row_are_left_out_and_told(here, calibrate):
    q, seen, _ = measured(40)
    (here / "my.csv").write_text(table(q, seen))
    alone = calibrate("data=my.csv")
    again = np.r_[np.arange(40), 3, 3, 7]
    (here / "my.csv").write_text(table(q[again], seen[again]))
    found = calibrate("data=my.csv")
    assert any(note.startswith("3 rows are copies of others in every joint and reading") for note in texts(found))
    assert (found["poses"], found["after"]) == (40, alone["after"])


@pytest.mark.slow
def test_what_is_left_on_disk_is_read_again(here, calibrate):
    q, seen, _ = measured(30)
    (here / "my.csv").write_text(table(np.rad2deg(q), seen, names=[f"{name} [deg]" for name in NAMES]))
    found = calibrate("data=my.csv", page="true")
    data = read_measured(found["files"]["readings"], "arm")
    np.testing.assert_allclose(data["q_joint_3"], q[:, 2], atol=1e-8)
    page = Path(found["files"]["page"]).read_text()
    assert page.count("<svg") == 3
    assert "http" not in page.replace("http://www.w3.org", "")
    assert json.loads(Path(found["files"]["json"]).read_text())["after"] == found["after"]


def exchanged(q, seen):
    return table(q, seen[:, [1, 0, 2]])


def reversed_joint(q, seen):
    return table(q * [1, 1, -1, 1, 1, 1], seen)


def swapped_joints(q, seen):
    return table(q[:, [0, 2, 1, 3, 4, 5]], seen)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda q, s: table(np.rad2deg(q), s), f"are they degrees? units={','.join(DEGREES)}"),
        (lambda q, s: table(np.rad2deg(0.05 * q), s), "the same for joints that turn little"),
        (lambda q, s: table(q, s / 1000), "are taken for mm, and fit the arm when they are m: units=x:m,y:m,z:m"),
        (
            exchanged,
            'as a left-handed frame only: an axis points the other way, or two are exchanged; columns=\'{"x":"y"',
        ),
        (
            lambda q, s: table(q, s, ("x [m]", "y [m]", "z [m]")),
            "are taken for what the file states, and fit the arm when they are mm: units=x:mm,y:mm,z:mm",
        ),
        (
            lambda q, s: table(q, s, ("x [inch]", "y [inch]", "z [inch]")),
            "stated in inch, and fit the arm when they are mm",
        ),
        (
            lambda q, s: table(q, s, names=[f"{name} [deg]" for name in NAMES]),
            "with joints in rad, and not in degrees as the file states: units=joint_1:rad,",
        ),
        (lambda q, s: table(q[:-1], s[1:]), "if the readings of each row's joints stand in the row above"),
        (lambda q, s: table(q[1:], s[:-1]), "if the readings of each row's joints stand in the row below"),
        (reversed_joint, "joint joint_3 turns the other way than in the URDF"),
        (swapped_joints, 'joints joint_2 and joint_3 are exchanged: columns=\'{"q_joint_2":"joint_3"'),
        (lambda q, s: table(q + 0.4, s), "in the URDF (1 such row): is the column that of this joint, and its unit"),
        (
            lambda q, s: table(np.rad2deg(q), s, names=[f"{name} [rad]" for name in NAMES]),
            f"1.5 mm with joints in degrees: units={','.join(DEGREES)}",
        ),
        (lambda q, s: table(q[:5], s[:5]), "5 poses are too few: 10 at the least"),
        (lambda q, s: table(q[[0] * 30], s[[0] * 30] + np.arange(30)[:, None]), "1 pose is too few: 10 at the least"),
        (lambda q, s: table(q, s, names=[*NAMES[:5], "hand_joint"]), "column hand_joint: the URDF has no such joint"),
        (lambda q, s: table(q, s, names=[*NAMES[:5], "last"]), "joint joint_6 of the URDF has no column"),
        (lambda q, s: table(q, s, names=[*NAMES[:5], "Joint 6"]), ""),
        (lambda q, s: table(q, s, ("goal_x", "goal_y", "goal_z")), "no measured x, y and z were found"),
        (lambda q, s: table(q, s, ("x", "y", "height")), ""),
        (lambda q, s: table(q, s, ("pose_x", "other_y", "z2")), "pose_x and other_y and z2 are of places that are not"),
        (lambda q, s: table(q, np.random.default_rng(0).normal(0, 500, s.shape)), "is this the URDF of the arm"),
    ],
)
def test_what_no_arm_can_have_read_is_one_line_that_says_what_to_do(here, calibrate, make, said):
    q, seen, _ = measured(40)
    if said == "the same for joints that turn little":
        rng = np.random.default_rng(2)
        q = rng.uniform(-0.2, 0.2, (40, 6))
        seen = placed(q)[0]
        (here / "my.csv").write_text(table(np.rad2deg(q), seen))
        assert "units=" in calibrate("data=my.csv", "limits=false", code=2)
        return
    (here / "my.csv").write_text(make(q, seen))
    if not said:
        assert calibrate("data=my.csv")["chosen"] == "geometry"
        return
    told = calibrate("data=my.csv", code=2)
    assert said in told
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["data=my.csv", "urd=b"], "did you mean 'urdf'?"),
        (["data=my.csv", "machine.tip=hand"], "machine.tip='hand' is no link of it"),
        (["data=my.csv", "machine.observe=photo"], "choices: position, pose, sockets"),
        (["data=my.csv", "machine=delta"], "bench calibrate is for machine=arm"),
        (["data=nowhere.csv"], "there is no such file"),
        (["data=my.csv", "level=all"], "choices: auto, frames, zeros, geometry, gains"),
        (["data=my.csv", "distance=50"], "distance= is that of two sockets, and my has none"),
        (["data=my.csv", "rotation=rpy"], "rotation= is the order of rotations, and none of my is read"),
        ([], "data= is missing"),
    ],
)
def test_a_request_that_makes_no_sense_is_one_line(here, calibrate, words, said):
    q, seen, _ = measured(12)
    (here / "my.csv").write_text(table(q, seen))
    told = calibrate(*words, code=2)
    assert said in told
    assert told.count("\n") == 1
    assert not (here / "results").exists()


def test_places_without_a_unit_are_in_that_of_the_arm_under_any_name(here, calibrate):
    q, seen, _ = measured(40)
    (here / "my.csv").write_text(table(q, seen, ("x1", "y1", "z1")))
    found = calibrate("data=my.csv")
    assert found["after"]["rms"] < 0.08
    assert "x1, y1, z1: no unit is stated; they fit the arm in mm" in [note["text"] for note in found["notes"]]


@pytest.mark.slow
def test_a_page_leaves_the_names_of_columns_and_files_as_they_are(here, calibrate):
    q, seen, _ = measured(40)
    (here / "my.csv").write_text(table(q, seen / 1000, heads=("x1", "y1", "z1")))
    page = Path(calibrate("data=my.csv", page="true")["files"]["page"]).read_text()
    assert ">x1, y1, z1: no unit is stated; they fit the arm in m" in page
    assert "my: " in page
    assert "My: " not in page


def test_a_tracker_that_was_moved_is_told_with_the_rows(here, calibrate):
    q, seen, _ = measured(80)
    seen[50:] = seen[50:] @ about((0, 0, 1), 0.6).T + [900.0, -2000.0, 30.0]
    (here / "my.csv").write_text(table(q, seen))
    told = calibrate("data=my.csv", code=2)
    assert "30 of 80 poses, row 51 to row 80, fit the arm by themselves only: the tracker, or the base, stands" in told
    assert told.count("\n") == 1


STEP = 0.25  # of half a millimetre


def test_a_base_that_moved_a_little_is_told_with_its_row(here, calibrate):
    q, seen, _ = measured(60)
    (here / "my.csv").write_text(table(q, seen))
    assert not [note for note in texts(calibrate("data=my.csv")) if "moved" in note]
    step = np.cross([2e-4, 1e-4, 3e-4], seen[36:] - BASE[0]) + np.array([0.3, -0.2, 0.2])
    seen[36:] += STEP * step
    (here / "my.csv").write_text(table(q, seen))
    [note] = [note for note in texts(calibrate("data=my.csv")) if "moved" in note]
    assert note.startswith("from row 37 on, readings lie 0.1")
    seen[36:] += (1 - STEP) * step
    (here / "my.csv").write_text(table(q, seen))
    told = calibrate("data=my.csv", code=2)  # a URDF would hold a part of the step
    assert "from row 37 on, readings lie 0.6" in told
    assert "that is most of what is left" in told


def test_readings_of_other_poses_are_no_second_stand(here, calibrate):
    q, seen, _ = measured(80)
    seen[50:] = seen[50:][::-1]
    (here / "my.csv").write_text(table(q, seen))
    told = calibrate("data=my.csv", code=2)
    assert "by themselves" not in told
    assert "do the joints and the reading of a row belong together" in told


@given
def test_a_file_of_figaroh_runs_by_one_command(here, calibrate, capsys):
    folder = GIVEN / "arm_ur10e_figaroh"
    (here / "my.urdf").write_bytes((folder / "ur10_robot.urdf").read_bytes())
    found = calibrate(f"data={folder / 'calibration.csv'}")
    assert found["poses"] == 23
    assert found["observed"] == "pose"
    assert found["after"]["rotation"] < found["before"]["rotation"]


def test_a_joint_is_named_by_columns_and_its_unit_by_units(here, calibrate):
    q, seen, _ = measured(40)
    heads = [f"Achse {'ABCDEF'[k]}" for k in range(6)]
    (here / "my.csv").write_text(table(np.rad2deg(q), seen, names=heads))
    columns = json.dumps({f"q_{name}": head for name, head in zip(NAMES, heads, strict=True)})
    units = ",".join(f"q_{name}:deg" for name in NAMES)
    assert calibrate("data=my.csv", f"columns={columns}", f"units={units}")["after"]["rms"] < 0.08
    assert "joint joint_1 of the URDF has no column" in calibrate("data=my.csv", code=2)


def test_how_well_a_distance_is_known_needs_a_distance_and_a_size(here, calibrate):
    assert "state distance= too" in calibrate("data=plate", "sigma_distance=0.01", code=2)
    assert "above 0 is needed: sockets: how well" in calibrate("data=plate", "distance=50", "sigma_distance=0", code=2)


@pytest.mark.slow
def test_a_distance_that_is_known_better_is_kept_better(here, calibrate):
    in_sockets(here / "plate", places=4, postures=8)
    words = ("data=plate", "machine.tip=ball", "distance=50.2", "level=geometry", "resamples=20")
    well, badly = (calibrate(*words, f"sigma_distance={known}")["after"]["spans"] for known in (0.001, 5))
    assert well < 0.7 * badly


@pytest.mark.slow  # two calibrations in sockets
def test_the_readings_that_are_left_are_what_the_search_for_causes_reads(here, calibrate):
    from calibench.discrepancy.registries import machines

    in_sockets(here / "plate", places=2, postures=8)
    found = calibrate("data=plate", "machine.tip=ball", "distance=50")
    data = read_measured(found["files"]["readings"], "arm")
    made = machines.make("arm", urdf="my.urdf", tip="ball").formulate(data)
    assert len(made.data) == 31  # but of the first, of which nobody knows from where its joints came
    assert data.metadata["socket_distance_mm"] == 50
    again = calibrate(f"data={found['files']['readings']}", "machine.tip=ball", "distance=50")
    assert again["observed"] == "sockets"
    assert again["after"]["rms"] == pytest.approx(found["after"]["rms"], rel=0.02)
