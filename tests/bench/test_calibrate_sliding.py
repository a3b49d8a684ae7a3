"""`bench calibrate` of an arm with a joint that slides, and what the search for causes reads of it afterwards."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from calibench import plot
from calibench.bench.cli import main
from calibench.bench.discovery.page.words import headline
from calibench.bench.measured import read_measured
from calibench.calibration.calibrate import Drawn, over_joints
from calibench.discrepancy import DataError
from calibench.discrepancy.labels import quantity_label
from calibench.discrepancy.procedure import explain
from calibench.discrepancy.registries import machines
from tests.bench.arm_by_hand import about
from tests.few import few

JOINTS = (  # name, place behind the joint before [mm], axis, whether it slides
    ("turntable", (0, 0, 250), (0, 0, 1), False),
    ("lift", (0, 0, 100), (0, 0, 1), True),
    ("boom", (300, 0, 50), (0, 0, 1), False),
    ("wrist", (350, 0, 0), (0, 1, 0), False),
    ("roll", (120, 0, 0), (1, 0, 0), False),
)
TARGET, HEAD = (50, 30, -40), "turntable [deg],lift [mm],boom [deg],wrist [deg],roll [deg],X [mm],Y [mm],Z [mm]"
PLAY = 0.4  # mm, of the lift


def urdf():
    lines, above = ['<robot name="lifter">', '  <link name="base"/>'], "base"
    for name, place, axis, slides in JOINTS:
        kind, limit = ("prismatic", 'lower="0" upper="0.4"') if slides else ("revolute", 'lower="-2.5" upper="2.5"')
        lines += [
            f'  <link name="{name}_link"/><joint name="{name}" type="{kind}">',
            f'    <parent link="{above}"/><child link="{name}_link"/>',
            f'    <origin xyz="{" ".join(str(v / 1000) for v in place)}"/><axis xyz="{" ".join(map(str, axis))}"/>',
            f'    <limit {limit} effort="1" velocity="1"/></joint>',
        ]
        above = f"{name}_link"
    return "\n".join([*lines, "</robot>", ""])


def placed(q):
    """Return where the target is, (3,) [mm], at joints q (5,) [rad | mm]; boom is 1 mm further out than drawn."""
    at, turn = np.zeros(3), np.eye(3)
    for (name, place, axis, slides), angle in zip(JOINTS, q, strict=True):
        at = at + turn @ (np.array(place) + np.array([1.0 if name == "boom" else 0.0, 0, 0]))
        at = at + (angle * turn @ axis if slides else 0)
        turn = turn if slides else turn @ about(axis, angle)
    return at + turn @ TARGET


@pytest.fixture
def lifter(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lifter.urdf").write_text(urdf())
    rng = np.random.default_rng(4)
    q = rng.uniform(-2.2, 2.2, (60, 5))
    q[:, 1] = rng.uniform(5, 395, 60)
    came = rng.choice([-1, 1], 60)
    seen = np.array([placed(row - PLAY / 2 * side * np.eye(5)[1]) for row, side in zip(q, came, strict=True)])
    table = np.column_stack([np.where([True, False, True, True, True], np.rad2deg(q), q), seen])
    table[:, 5:] += rng.normal(0, 0.03, (60, 3))
    rows = [",".join(f"{v:.5f}" for v in row) + f",{side}" for row, side in zip(table, came, strict=True)]
    (tmp_path / "lifter.csv").write_text("\n".join([f"{HEAD},direction lift", *rows, ""]))
    return tmp_path


def test_a_unit_of_another_kind_is_told_as_the_file_has_it(lifter, capsys):
    table = (lifter / "lifter.csv").read_text()
    (lifter / "lifter.csv").write_text(table.replace("lift [mm]", "lift [°]", 1))
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", "urdf=lifter.urdf", "data=lifter.csv", "page=false"])
    assert ended.value.code == 2
    assert "column lift is in °, and mm or a like unit is needed" in capsys.readouterr().err


def test_the_readings_left_of_a_joint_that_slides_are_in_mm_with_its_direction(lifter, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", "urdf=lifter.urdf", "data=lifter.csv", "page=false", "--json"])
    assert ended.value.code == 0
    left = read_measured(json.loads(capsys.readouterr().out)["files"]["readings"], "arm")
    assert dict(left.units)["q_lift"] == "mm"
    assert set(np.unique(left["direction_lift"])) == {-1.0, 1.0}
    report = explain(machines.make("arm", urdf="lifter.urdf"), left)
    assert "backlash lift" in [finding.effect for finding in report.findings], headline(report)
    notes = [note.text for note in report.notes if note.text.startswith("no column tells from where")]
    assert notes == [
        "no column tells from where turntable, boom, wrist, roll came: the order of rows tells it, but of the first "
        "row, which is left out"
    ]
    assert quantity_label("arm", "q_lift", report.words) == "position of lift"
    assert quantity_label("arm", "q_boom", report.words) == "angle of boom"


@pytest.mark.parametrize(
    ("column", "change", "said"),
    few(
        2,
        [
            ("Z", lambda z: z / 1000, "if Z is in m where the others are in mm: units=Z:m"),
            ("X", lambda x: 1000 * x, "if X is in mm where the others are in m: units=X:mm"),
            ("lift", lambda q: q / 1000, "mm with lift in m: units=lift:m"),
            ("boom", lambda q: -q, "if joint boom turns the other way than in the URDF"),
            ("boom", lambda q: np.random.default_rng(0).permutation(q), "apart, wherever the frames are: is this"),
        ],
    ),
)
def test_readings_that_no_such_arm_gives_are_refused_with_what_mends_them(lifter, column, change, said):
    data = read_measured("lifter.csv", "arm", {"sigma_mm": 0.03})
    spoilt = data.with_columns({column: change(np.asarray(data[column], dtype=float))})
    with pytest.raises(DataError, match=said):
        machines.make("arm", urdf="lifter.urdf").formulate(spoilt)


@pytest.mark.parametrize(
    ("column", "factor", "said"),
    [("Y", -1.0, "mm if x, y and z are those of a left-handed frame: an axis points the other way"),
     ("boom", -1.0, "if joint boom turns the other way"), ("boom", 1.0, "")],
)  # fmt: skip
def test_a_mistake_is_found_beside_a_rail_in_metres_whose_unit_nothing_states(lifter, column, factor, said):
    data = read_measured("lifter.csv", "arm", {"sigma_mm": 0.03})
    metres = {"lift": np.asarray(data["lift"], dtype=float) / 1000, column: factor * np.asarray(data[column])}
    spoilt = replace(data.with_columns(metres), units={n: u for n, u in data.units.items() if n != "lift"})
    if not said:
        machines.make("arm", urdf="lifter.urdf").formulate(spoilt)
        return
    with pytest.raises(DataError, match=said):
        machines.make("arm", urdf="lifter.urdf").formulate(spoilt)


def test_distances_from_points_in_turn_are_scanned_in_no_step_with_them(lifter, capsys):
    rng, at = np.random.default_rng(5), [(9, 9, 0), (0, 2000, 5), (3000, 0, 0)]
    q = rng.uniform([-2, 5, -2, -2, -2], [2, 395, 2, 2, 2], (100, 5))
    seen = np.array([placed(row) for row in q])
    far = np.linalg.norm(seen[:, None] - at, axis=2) + rng.normal(0, 0.03, (100, 3))
    head = ",".join([joint[0] for joint in JOINTS] + [f"distance_{k} [mm]" for k in "ABC"])
    np.savetxt("far.csv", np.column_stack([q / [1, 1000, 1, 1, 1], far]), "%.6f", ",", header=head, comments="")
    with pytest.raises(SystemExit):
        main(["calibrate", "urdf=lifter.urdf", "data=far.csv", "page=false"])
    assert "mm with lift in m: units=lift:m" in capsys.readouterr().err


def test_an_arm_whose_zeros_are_far_off_is_searched(lifter):
    data = read_measured("lifter.csv", "arm", {"sigma_mm": 0.03})
    off = data.with_columns({"wrist": data["wrist"] + 0.2, "boom": data["boom"] - 0.2})
    assert (
        len(machines.make("arm", urdf="lifter.urdf").formulate(off).data) == len(data) - 1
    )  # nothing tells whence the first came


def test_copies_under_other_headings_than_ours_are_refused(lifter):
    lines = (lifter / "lifter.csv").read_text().splitlines()
    (lifter / "lifter.csv").write_text("\n".join([*lines, *lines[3:6], ""]))
    data = read_measured("lifter.csv", "arm", {"sigma_mm": 0.03})
    with pytest.raises(DataError, match="rows 3 and 61, 4 and 62, 5 and 63"):
        explain(machines.make("arm", urdf="lifter.urdf"), data)


def test_distances_that_are_none_are_refused(lifter, capsys):
    lines = [",".join(line.split(",")[:6]) for line in (lifter / "lifter.csv").read_text().splitlines()]
    (lifter / "wire.csv").write_text("\n".join([lines[0].replace("X [mm]", "distance [mm]"), *lines[1:], ""]))
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", "urdf=lifter.urdf", "data=wire.csv"])
    assert ended.value.code == 2
    assert "readings of a distance and nominal arm lie" in capsys.readouterr().err


def test_no_error_over_a_joint_is_cut_off_by_the_joints_before_it():
    rng = np.random.default_rng(0)
    joints = rng.uniform(-1, 1, (60, 2))
    before = np.where(joints[:, 1] > 0.5, 9.0, 1.0)  # what the first joint's bins average, the second's show
    drawn = Drawn(joints, ("first", "second"), ("°", "mm"), np.zeros((60, 3)), before, 0.1 * before)
    shown = {"over_joints": [asdict(one) for one in over_joints(drawn)]}
    axes, table = plot.calibration(shown), plot.calibration.data(shown)
    assert [label.get_text() for label in axes.get_xticklabels()] == ["first\n-1 to 1 °", "second\n-1 to 1 mm"]
    assert axes.get_ylim()[0] < table[["before", "after"]].to_numpy().min()
    assert axes.get_ylim()[1] > table["before"].max()
