"""Files of rigs at both verbs: three reflectors, files without heads, packed times, a lifting column, other sensors."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from calibench.bench.cli import main
from calibench.bench.measured import read_measured
from calibench.core.tables.columns import as_seconds
from calibench.discrepancy.registries import machines
from tests.bench.arm_by_hand import NAMES, about, urdf
from tests.calibration.test_rig import rig, single, without

pytestmark = pytest.mark.usefixtures("at_one_noise")


@pytest.fixture
def bench(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.urdf").write_text(urdf())

    def call(verb, *words, code=0):
        arm = (
            ["urdf=my.urdf", "page=false"]
            if verb == "calibrate"
            else ["machine=arm", "machine.urdf=my.urdf", "pages=none"]
        )
        with pytest.raises(SystemExit) as ended:
            main([verb, *arm, *words, "--json"])
        told = capsys.readouterr()
        assert ended.value.code == code, told.err
        return json.loads(told.out.splitlines()[0] if verb == "discover" else told.out)

    return call


def write(name, columns, heads=True):
    rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    cells = [["" if value != value else str(value) for value in row] for row in rows]
    with open(name, "w") as file:
        file.writelines(",".join(row) + "\n" for row in [*([list(columns)] if heads else []), *cells])


def named(answer):
    return {finding["family"]: finding["target"] for finding in answer["findings"]}


def test_files_without_heads_are_one_table_for_both_verbs(bench):
    columns = single(rig(60, drift=1.0), 1)
    write("joints.txt", {name: np.rad2deg(columns[name]) for name in NAMES}, heads=False)
    write("tracker.txt", {axis: columns[axis] / 10 for axis in "xyz"}, heads=False)
    units = [f"column_{k}:{'deg' if k <= len(NAMES) else 'cm'}" for k in range(1, len(NAMES) + 4)]
    words = ["data=joints.txt,tracker.txt", f"units={','.join(units)}"]  # counted on from file to file
    calibrated = bench("calibrate", *words, "resamples=20")
    assert calibrated["poses"] == 60
    found = bench("discover", *words, "sigma_mm=0.03")
    assert named(found) == {"base_drift": "base"}


def test_a_search_reads_three_reflectors_as_a_calibration_does(bench):
    columns = without(rig(50), "base")
    columns["joint_2"] = columns["joint_2"] - 0.002 * np.sin(columns["joint_2"] + 0.4)  # it errs once a turn
    write("three.csv", columns)
    found = bench("discover", "data=three.csv", "sigma_mm=0.03")
    assert named(found) == {"eccentricity": "joint_2"}
    answer = bench("calibrate", "data=three.csv", "resamples=20", "level=geometry")
    assert answer["poses"] == answer["fitted"] == 50  # each of three readings
    assert [name for name in answer["frames"] if name.startswith("target ")] == ["target 2", "target 3"]
    again = read_measured("results/calibrate/three/readings.parquet", "arm")
    assert (
        len(machines.make("arm", urdf="my.urdf").formulate(again).data) == 3 * 50 - 1
    )  # but the first, of which nobody knows whence its joints came


def test_packed_times_are_times_and_other_sensors_are_carried_along(bench):
    columns = single(rig(40), 1)
    columns |= {"Timestamp": [f"202007141639{k:02d}" for k in range(40)], "incl_x": np.arange(40) % 7 * 0.1}
    write("sensors.csv", columns)
    answer = bench("calibrate", "data=sensors.csv", "resamples=20", "level=geometry")
    kept = pq.read_table(answer["files"]["readings"])
    assert kept["t_s"].to_pylist() == list(range(40))
    assert kept["incl_x"].to_pylist() == columns["incl_x"].tolist()


def test_an_error_that_follows_another_sensor_is_a_formula_of_it(bench):
    columns, tilt = single(rig(60), 1), np.random.default_rng(8).normal(0, 1, 60)
    columns["joint_3"] = columns["joint_3"] - 0.0004 * tilt
    write("tilt.csv", columns | {"incl_x": tilt})
    formula = bench("discover", "data=tilt.csv", "sigma_mm=0.03")["formula"]
    assert formula["text"] == "q_joint_3 += a incl_x"
    assert formula["sizes"][0]["value"] == pytest.approx(0.0004, rel=0.1)


def test_a_time_that_can_be_no_seconds_is_not_used_as_one(bench):
    write("rounded.csv", single(rig(40), 1) | {"Timestamp": [2.0201e13] * 20 + [2.0202e13] * 20})
    answer = bench("calibrate", "data=rounded.csv", "resamples=20", "level=geometry")
    assert "column_not_used" in {note["code"] for note in answer["notes"]}
    assert "t_s" not in pq.read_table(answer["files"]["readings"]).column_names


@pytest.mark.parametrize(("first", "step"), [(1594744744123, 1e3), (1594744744123456, 1e6), (1594744744123456512, 1e9)])
def test_counts_since_1970_are_seconds(first, step):
    seconds, text = as_seconds(np.array([first, first + 3 * step]))
    np.testing.assert_allclose(seconds, [0, 3], atol=1e-6)
    assert "since 1970" in text


PLACES = ((0, 0, 0.0), (0, 0, 0.3), (0, 0.1, 0.1), (0, 0, 0.6), (0, 0, 0.5), (0.05, 0, 0.1))  # m
AXES = ((0, 0, 1), (0, 0, 1), (0, 1, 0), (0, 1, 0), (0, 0, 1), (0, 1, 0))
MASSES = (
    (5, (0, 0, 0.15)),
    (8, (0, 0.05, 0.05)),
    (12, (0, 0, 0.3)),
    (6, (0, 0, 0.25)),
    (4, (0, 0, 0.05)),
    (2, (0, 0, 0.05)),
)


def on_a_column(bends):
    """Write an arm on a lifting column, and 100 readings of it: the column turns and gives way by moment times way."""
    lines = ['<robot name="lifted"><link name="base"/>']
    for k, (place, axis, (mass, centre)) in enumerate(zip(PLACES, AXES, MASSES, strict=True)):
        kind, above = ("revolute" if k else "prismatic"), (f"link_{k - 1}" if k else "base")
        at, about_, com = (" ".join(map(str, one)) for one in (place, axis, centre))
        lines.append(
            f'<link name="link_{k}"><inertial><origin xyz="{com}"/><mass value="{mass}"/></inertial></link>'
            f'<joint name="joint_{k}" type="{kind}"><parent link="{above}"/><child link="link_{k}"/>'
            f'<origin xyz="{at}"/><axis xyz="{about_}"/>'
            f'<limit lower="{-2.6 if k else 0}" upper="2.6" effort="1" velocity="1"/></joint>'
        )
    with open("my.urdf", "w") as file:
        file.write("\n".join([*lines, "</robot>"]))
    rng, rows = np.random.default_rng(12), []
    for _ in range(100):
        q, at, turn, moment = np.r_[rng.uniform(0, 850), rng.uniform(-2.4, 2.4, 5)], np.zeros(3), np.eye(3), np.zeros(3)
        for k, (place, axis, (mass, centre)) in enumerate(zip(PLACES, AXES, MASSES, strict=True)):
            at, turn = at + turn @ (1000 * np.array(place)), turn @ (about(axis, q[k]) if k else np.eye(3))
            moment = moment + np.cross(at + turn @ (1000 * np.array(centre)), [0, 0, -9.81 * mass])
        lean, out = bends * q[0] * moment * [1, 1, 0], np.array([0, 0, q[0]])
        end = at + turn @ [60.0, 20.0, 110.0]
        seen = about((0, 0, 1), 0.7) @ (out + np.cross(lean, out) / 2 + end + np.cross(lean, end)) + [800, -1900, 400]
        rows.append([*q, *(seen + rng.normal(0, 0.03, 3))])
    heads = ["joint_0 [mm]", *(f"joint_{k}" for k in range(1, 6)), "x", "y", "z"]
    write("column.csv", dict(zip(heads, np.array(rows).T, strict=True)))


def test_a_column_that_bends_by_its_load_times_how_far_it_is_out_is_named(bench):
    on_a_column(1.2e-11)
    found = bench("discover", "data=column.csv", "sigma_mm=0.03")
    assert named(found) == {"bending": "joint_0"}
    [finding] = found["findings"]
    assert finding["amplitude"]["value"] == pytest.approx(1.2e-11, rel=0.05)
