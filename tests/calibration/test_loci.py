"""Less than a place: some axes, distances from fixed points, and planes that are touched, by an arm written by hand."""

import json
import re

import numpy as np
import pytest

import calibench
from calibench.bench.cli import main
from calibench.calibration.loci import DISTANCE, PLANE, Fixture, Loci
from tests.bench.arm_by_hand import NAMES, TRUTH, about, placed, urdf
from tests.calibration.test_rig import codes, error, quick

WIRES = {"A": (1500.0, 900.0, 100.0), "B": (-900.0, 1400.0, 300.0), "C": (-700.0, -1500.0, 50.0)}  # mm, in the base
PLANES = {
    "table": ((0.05, -0.02, 0.9985), 300.0),
    "wall": ((0.98, 0.19, 0.06), 500.0),
    "side": ((0.0, 1.0, 0.0), 450.0),
}
FROM_BASE = (np.zeros(3), 0.0)


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "my.urdf").write_text(urdf())
    return tmp_path / "my.urdf"


def joints(n, seed=3):
    return np.random.default_rng(seed).uniform(-2.4, 2.4, (n, 6))


def columns_of(q, **others):
    return dict(zip(NAMES, q.T, strict=True)) | others


def noise(n, seed=8, size=0.03):
    return np.random.default_rng(seed).normal(0, size, n)


def seen(q, base=None):
    return (placed(q) if base is None else placed(q, base=base))[0]


def distances(q, places=WIRES):
    """Return how far the target is from each of `places` in the base, by name, with noise [mm]."""
    there = seen(q, FROM_BASE)
    return {
        name: np.linalg.norm(there - at, axis=1) + noise(len(q), seed=k) for k, (name, at) in enumerate(places.items())
    }


def touching(n, plane, seed=4, truth=TRUTH):
    """Return joints (n, 6), read to .01 mrad, at which the true target lies in a plane of the base."""
    rng, (normal, height) = np.random.default_rng(seed), plane
    q = rng.uniform(-2.4, 2.4, (10 * n, 6))

    def off(elbow):
        q[:, 2] = elbow
        return placed(q, truth, base=FROM_BASE)[0] @ normal - height

    there, aside, behind = off(0), off(np.pi / 2), off(np.pi)  # over the elbow's angle: a mean and a wave
    mean, along, across = (there + behind) / 2, (there - behind) / 2, aside - (there + behind) / 2
    way = rng.choice([-1, 1], 10 * n) * np.arccos(np.clip(-mean / np.hypot(along, across), -1, 1))
    q[:, 2] = np.angle(np.exp(1j * (np.arctan2(across, along) + way)))
    q = q[(np.abs(q[:, 2]) < 2.4) & (np.abs(off(q[:, 2])) < 1e-6)][:n]
    return q + rng.normal(0, 1e-5, (n, 6))


@pytest.mark.parametrize(("axes", "nearer"), [("xz", 0.1), ("z", 0.2)])
def test_some_axes_of_the_target_calibrate_the_arm(arm, axes, nearer):
    q = joints(150)
    read = {axis: seen(q)[:, "xyz".index(axis)] + noise(150, k) for k, axis in enumerate(axes)}
    found = quick(arm, columns_of(q, **read))
    assert error(found, arm.parent) < nearer < 0.3 * found.error_before
    assert codes(found)["parts_of_places"].text.startswith(f"{', '.join(axes)} read")
    assert 0.02 < found.scatter[0] < 0.04


def test_cells_that_are_empty_say_which_axes_a_row_reads(arm):
    q = joints(150)
    read = dict(zip("xyz", (seen(q) + noise(450).reshape(-1, 3)).T, strict=True))
    for k, axis in enumerate("xyz"):
        read[axis][np.arange(150) % 3 != k] = np.nan
    assert error(quick(arm, columns_of(q, **read)), arm.parent) < 0.2


def test_distances_from_points_that_nobody_states_calibrate_the_arm_and_find_them(arm):
    q = joints(80)
    columns = columns_of(q, **{f"distance_{name} [cm]": far / 10 for name, far in distances(q).items()})
    found = quick(arm, columns)
    assert error(found, arm.parent) < 0.1
    assert max(np.linalg.norm(np.subtract(found.frames[f"point {name}"], at)) for name, at in WIRES.items()) < 1.5
    assert "base" not in found.frames


@pytest.mark.parametrize(("names", "least"), [("A", 30), ("AB", 15), ("ABC", 10)])
def test_too_few_distances_are_told_with_the_least_number_for_them_and_a_design_that_runs(arm, capsys, names, least):
    q = np.repeat(joints(least - 1), 2, axis=0)  # a distance that is read twice is no second one
    columns = columns_of(q, **{f"distance_{name} [mm]": distances(q)[name] for name in names})
    with pytest.raises(ValueError, match=f"{least - 1} poses are too few: {least} at the least") as told:
        quick(arm, columns)
    cure = re.search(r"bench (design .*) says which", str(told.value))[1]
    with pytest.raises(SystemExit) as ended:
        main(cure.replace("FILE", str(arm)).replace("n=40", "n=8").split())
    assert ended.value.code == 0, capsys.readouterr().err


@pytest.mark.parametrize("times", [1, 2])
def test_repeats_are_told_where_a_distance_is_read_again_and_not_where_another_is(arm, times):
    q = np.repeat(joints(30 // times), times, axis=0)
    found = quick(arm, columns_of(q, **{f"distance_{name} [mm]": far for name, far in distances(q).items()}))
    assert ("with its repeats" in found.folds) == (times == 2)


def test_a_ball_bar_of_one_length_is_a_row_for_each_place_and_the_word_of_its_socket(arm):
    q, places = joints(4000), np.array([*WIRES.values()])
    far = np.linalg.norm(seen(q, FROM_BASE)[:, None] - places, axis=2)
    which = np.argmin(far, axis=1)
    far = far[np.arange(len(q)), which]
    some = np.argsort(np.abs(far - 1500))[:120]  # a bar that is read to .03 mm, within some mm
    words, stated = np.array([*WIRES])[which[some]], places[which[some]]
    free = columns_of(q[some], distance=far[some] + noise(120), distance_to=words)
    assert error(quick(arm, free), arm.parent) < 0.2
    tracker = stated @ about((0, 0, 1), 0.4).T + [100.0, 200.0, 300.0]
    named = dict(zip(("distance_to_x", "distance_to_y", "distance_to_z"), tracker.T, strict=True))
    found = quick(arm, free | named)
    assert error(found, arm.parent) < 0.2
    assert np.allclose(found.frames["base"][:3], [100, 200, 300], atol=3)


def test_touched_planes_calibrate_the_arm_and_the_page_says_what_they_do_not_tell(arm):
    q = np.vstack([touching(50, plane) for plane in PLANES.values()])
    found = quick(arm, columns_of(q, plane=np.repeat([*PLANES], 50)))
    assert error(found, arm.parent) < 0.05 < 0.3 * found.error_before
    assert "how large the arm is" in codes(found)["parts_of_places"].text
    normal, there = np.array(found.frames["plane table"][3:]), np.array(PLANES["table"][0])
    assert abs(normal @ there) > (1 - 1e-6) * np.linalg.norm(there)


def test_a_tracker_and_a_plane_in_one_file_have_each_a_noise_of_its_own(arm):
    q, flat = joints(30), touching(80, PLANES["table"])
    read = np.vstack([seen(q) + noise(90, size=0.2).reshape(-1, 3), np.full((80, 3), np.nan)])
    plane = np.array([""] * 30 + ["table"] * 80)
    columns = columns_of(np.vstack([q, flat]), **dict(zip("xyz", read.T, strict=True)))
    alone = error(quick(arm, {name: column[:30] for name, column in columns.items()}), arm.parent)
    both = quick(arm, columns | {"plane": plane})
    assert error(both, arm.parent) < 0.6 * alone
    of_rows = both.fit.model.of_rows
    assert of_rows[:30].min() > 5 * of_rows[30:].max()


def test_slopes_of_what_is_left_agree_with_differences():
    rng = np.random.default_rng(2)
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = about((0.6, 0.0, 0.8), 0.9), [50.0, -20.0, 400.0]
    fixtures = (Fixture("A", DISTANCE, frame), Fixture("T", PLANE, frame), Fixture("B", DISTANCE, frame, stated=True))
    fixture = np.repeat([-1, 0, 1, 2], 3)
    read = np.where(np.arange(36).reshape(12, 3) % 4 == 1, np.nan, rng.normal(0, 300, (12, 3)))
    read[3:] = np.nan
    loci = Loci(fixture, np.full(12, 250.0), fixtures)
    places, numbers = rng.normal(0, 300, (12, 3)), rng.normal(0, 1e-2, 6)

    def square(places, numbers):
        return 0.5 * (loci.residuals(places, read, numbers)[0] ** 2).sum()

    off, across, slopes = loci.residuals(places, read, numbers)
    assert np.allclose(across @ across, across)
    step = 1e-4
    for k, way in enumerate(step * np.eye(6)):
        by_hand = (square(places, numbers + way) - square(places, numbers - way)) / (2 * step)
        assert np.isclose((off * slopes[:, :, k]).sum(), by_hand, rtol=1e-5)
    for i, way in enumerate(np.eye(3)):
        by_hand = (square(places + step * way, numbers) - square(places - step * way, numbers)) / (2 * step)
        assert np.isclose((off * across[:, :, i]).sum(), by_hand, rtol=1e-5)


def test_the_command_reads_them_and_others_refuse_them_in_one_line(arm, monkeypatch, capsys):
    monkeypatch.chdir(arm.parent)
    q = joints(60)
    columns = columns_of(q, **{f"distance_{name}_mm": far for name, far in distances(q).items()})
    rows = [",".join(columns), *(",".join(f"{v:.6f}" for v in row) for row in zip(*columns.values(), strict=True))]
    (arm.parent / "wires.csv").write_text("\n".join(rows) + "\n")

    def call(*words):
        with pytest.raises(SystemExit) as ended:
            main([*words])
        return ended.value.code, capsys.readouterr()

    code, told = call("calibrate", "urdf=my.urdf", "data=wires.csv", "page=false", "--json")
    assert code == 0, told.err
    assert json.loads(told.out)["after"]["rms"] < 0.06
    code, told = call(
        "calibrate", "urdf=my.urdf", "data=results/calibrate/wires/readings.parquet", "page=false", "--json"
    )
    assert code == 0, told.err
    code, told = call("design", "machine=arm", "machine.urdf=my.urdf", "data=wires.csv", "plan.n=3")
    assert (code, told.out.startswith("3 poses beside")) == (0, True), told.err
    run = ["run", "problem=arm", "problem.urdf=my.urdf", "problem.data=wires.csv", "optimizer=lm", "budget=9"]
    for words in (["discover", "machine=arm", "machine.urdf=my.urdf", "data=wires.csv"], run):
        code, told = call(*words)
        assert (code, told.err.count("\n")) == (2, 1)
        assert "bench calibrate" in told.err


def test_what_a_user_knows_of_a_number_is_used_and_moves_what_the_readings_do_not_tell(arm, monkeypatch, capsys):
    q = joints(12)
    columns = columns_of(q, **dict(zip("xyz", (seen(q) + noise(36, size=0.3).reshape(-1, 3)).T, strict=True)))
    alone = quick(arm, columns)
    known = {"z_joint_3": (0.8, 0.01), "zero_joint_3": (0.0026, 2e-5), "z_joint_1": (1.5, 0.1)}
    told = calibench.calibrate(arm, columns, level="geometry", resamples=20, priors=known)
    changes = {change.parameter: change for change in told.changes}
    assert abs(changes["z_joint_3"].change - 0.8) < 0.03
    assert changes["z_joint_3"].sd < 0.015
    assert abs(changes["z_joint_1"].change - 1.5) < 0.1  # no reading tells it beside the base
    assert changes["z_joint_3"].sd < 0.1 * next(c.sd for c in alone.changes if c.parameter == "z_joint_3")

    monkeypatch.chdir(arm.parent)
    rows = [",".join(columns), *(",".join(f"{v:.6f}" for v in row) for row in zip(*columns.values(), strict=True))]
    (arm.parent / "my.csv").write_text("\n".join(rows) + "\n")
    (arm.parent / "known.csv").write_text("name,value,sd\nz_joint_3,0.8,0.01\n")
    for word, code, said in (
        ("known.csv", 0, ""), ('{"z_joint_3":[0.8,0.01]}', 0, ""), ("none.csv", 2, "No such file"),
        ('{"z_elbow":[0.8,0.01]}', 2, "z_elbow is no number of the arm"), ('{"z_joint_3":[1,0]}', 2, "above 0"),
        ('{"z_joint_3":1}', 2, "name, value and sd"),
    ):  # fmt: skip
        with pytest.raises(SystemExit) as ended:
            main(["calibrate", "urdf=my.urdf", "data=my.csv", "page=false", "resamples=20", f"priors={word}"])
        err = capsys.readouterr().err
        assert (ended.value.code, said in err, err.count("\n")) == (code, True, 1 if code else 0), err


def test_an_axis_in_another_unit_than_the_others_is_named(arm):
    q = joints(40)
    read = columns_of(q, **dict(zip("xyz", (seen(q) * [1, 1, 1e-3]).T, strict=True)))
    with pytest.raises(ValueError, match="if z is in m where the others are in mm: units=z:m"):
        quick(arm, read)
    mended = calibench.calibrate(arm, read, units={"x": "mm", "y": "mm", "z": "m"}, resamples=20, limits=False)
    assert error(mended, arm.parent) < 0.1
