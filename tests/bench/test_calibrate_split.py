"""`bench calibrate` of a file with a column `split`: what is written is of the rows `train`, what is told of `hold`."""

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.optimize import least_squares

from calibench.bench.cli import main
from tests.bench.arm_by_hand import NAMES, about, measured, table, texts, urdf

X, Y, Z = np.eye(3)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.urdf").write_text(urdf())
    return tmp_path


@pytest.fixture
def calibrate(here, capsys):
    def call(*words, code=0):
        with pytest.raises(SystemExit) as ended:
            main(["calibrate", "urdf=my.urdf", "data=my.csv", "page=false", *words, "--json"])
        told = capsys.readouterr()
        assert ended.value.code == code, told.err
        return json.loads(told.out) if code == 0 else told.err

    return call


def by_rpy(roll, pitch, yaw):
    return about(Z, yaw) @ about(Y, pitch) @ about(X, roll)


def joints_of(file):
    """Return place [mm], turn (3, 3) and axis of each moving joint of a URDF, in the order of the file."""
    found = []
    for joint in ElementTree.parse(file).getroot().findall("joint"):
        if joint.get("type") == "revolute":
            origin = joint.find("origin")
            at, turned = (np.array((origin.get(key) or "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
            found.append((1000 * at, by_rpy(*turned), np.array(joint.find("axis").get("xyz").split(), dtype=float)))
    return found


def reached(joints, q, base, target):
    """Return where the target is in the tracker's frame, (n, 3) [mm], and how it is turned, (n, 3, 3)."""
    places, turns = [], []
    for row in q:
        at, turn = np.array(base[:3]), by_rpy(*base[3:])
        for (place, turned, axis), angle in zip(joints, row, strict=True):
            at, turn = at + turn @ place, turn @ turned @ about(axis, angle)
        places.append(at + turn @ np.array(target[:3]))
        turns.append(turn @ by_rpy(*target[3:]))
    return np.array(places), np.array(turns)


def rms(left):
    return float(np.sqrt((left**2).sum(axis=1).mean()))


def written(here, q, seen, heads=("x", "y", "z"), hold=15):
    lines = table(q, seen, heads=heads).splitlines()
    marks = ["hold" if i % 4 == 1 and i // 4 < hold else "train" for i in range(len(q))]
    (here / "my.csv").write_text("\n".join(f"{a},{b}" for a, b in zip(lines, ["split", *marks], strict=True)))
    return np.array(marks) == "hold"


def test_who_predicts_the_rows_held_back_by_the_written_urdf_finds_the_error_that_is_told(here, calibrate):
    q, seen, _ = measured(60)
    hold = written(here, q, seen)
    found = calibrate()
    assert (found["poses"], found["fitted"], found["chosen"]) == (60, 45, "geometry")
    arm = joints_of(found["files"]["urdf"])
    there, _ = reached(arm, q, found["frames"]["base"], [*found["frames"]["target"][:3], 0, 0, 0])
    assert rms((there - seen)[hold]) == pytest.approx(found["after"]["rms"], rel=1e-4)
    assert rms((there - seen)[~hold]) < 0.98 * rms((there - seen)[hold])  # those that were fitted are nearer
    assert "45 of 60 poses; error of poses not fitted" in Path(found["files"]["urdf"]).read_text()

    drawn = joints_of("my.urdf")  # before: the arm as it was drawn, base and target by the other rows

    def off(p, there=~hold):
        return (reached(drawn, q[there], p[:6], [*p[6:], 0, 0, 0])[0] - seen[there]).ravel()

    begin = [*found["frames"]["base"], *found["frames"]["target"][:3]]
    frames = least_squares(off, begin, x_scale=[100, 100, 100, 0.1, 0.1, 0.1, 10, 10, 10], xtol=1e-12, ftol=1e-12).x
    assert rms(off(frames, hold).reshape(-1, 3)) == pytest.approx(found["before"]["rms"], rel=1e-3)


@pytest.mark.slow
def test_the_same_holds_of_rotations(here, calibrate):
    q, seen, turns = measured(60)
    rng = np.random.default_rng(8)
    turns = np.array([turn @ by_rpy(*rng.normal(0, 3e-4, 3)) for turn in turns])
    told = [[np.arctan2(t[2, 1], t[2, 2]), -np.arcsin(t[2, 0]), np.arctan2(t[1, 0], t[0, 0])] for t in turns]
    hold = written(here, q, np.column_stack([seen, told]), ("x", "y", "z", "roll", "pitch", "yaw"))
    found = calibrate()
    there, turned = reached(joints_of(found["files"]["urdf"]), q, found["frames"]["base"], found["frames"]["target"])
    assert rms((there - seen)[hold]) == pytest.approx(found["after"]["rms"], rel=1e-4)
    cosine = (np.einsum("nij,nij->n", turned, turns) - 1) / 2
    apart = np.arccos(np.clip(cosine, -1, 1))[hold]
    assert np.sqrt((apart**2).mean()) == pytest.approx(found["after"]["rotation"], rel=1e-3)


def test_rows_that_are_held_back_have_no_say_in_what_is_written(here, calibrate):
    q, seen, _ = measured(60)
    hold = written(here, q, seen)
    found = calibrate()
    first = Path(found["files"]["urdf"]).read_text().splitlines()
    seen[hold] += np.random.default_rng(1).normal(0, 2.0, (15, 3))
    written(here, q, seen)
    again = calibrate()
    second = Path(again["files"]["urdf"]).read_text().splitlines()
    assert [a for a, b in zip(first, second, strict=True) if a != b] == [first[2]]  # the comment, with the error
    assert again["changes"] == found["changes"]
    assert again["after"]["rms"] > 2.0


@pytest.mark.slow
def test_a_wild_row_among_those_held_back_is_named_and_left_out_of_their_error(here, calibrate):
    q, seen, _ = measured(60)
    hold = written(here, q, seen)
    clean = calibrate()
    wild = int(np.flatnonzero(hold)[3])
    seen[wild] += 40.0
    written(here, q, seen)
    found = calibrate()
    assert [one["row"] for one in found["wild"]] == [f"row {wild + 1}"]
    assert found["after"]["rms"] == pytest.approx(clean["after"]["rms"], rel=0.2)
    assert found["changes"] == clean["changes"]


@pytest.mark.slow
def test_which_rows_were_fitted_is_said_with_a_split_and_without(here, capsys):
    q, seen, _ = measured(60)
    written(here, q, seen)
    for name, said in (
        ("my.csv", "is fitted to the other 45 alone; the errors are of the rows"),
        ("all.csv", "is fitted to all 60; errors of poses left out are scaled to it"),
    ):
        (here / "all.csv").write_text(table(q, seen))
        with pytest.raises(SystemExit):
            main(["calibrate", "urdf=my.urdf", f"data={name}", "page=false"])
        assert said in capsys.readouterr().out


def test_rows_held_back_that_repeat_a_fitted_pose_are_told(here, calibrate):
    q, seen, _ = measured(60)
    q[5], seen[5] = q[6], seen[6] + 0.02
    q[9], seen[9] = q[8], seen[8] - 0.02
    written(here, q, seen)
    assert "2 of 15 rows that are held back repeat a pose that was fitted" in texts(calibrate())


@pytest.mark.parametrize(
    ("fitted", "said"),
    [(6, "6 poses beside the 54 that column split holds back are too few"), (0, "column split holds back every row")],
)
def test_too_few_rows_to_fit_are_refused_in_a_line(here, calibrate, fitted, said):
    q, seen, _ = measured(60)
    lines = table(q, seen).splitlines()
    marks = ["split", *(["train"] * fitted), *(["hold"] * (60 - fitted))]
    (here / "my.csv").write_text("\n".join(f"{a},{b}" for a, b in zip(lines, marks, strict=True)))
    told = calibrate(code=2)
    assert said in told
    assert told.count("\n") == 1


def test_the_names_of_the_arm_are_those_of_its_urdf(here):
    assert len(joints_of("my.urdf")) == len(NAMES)
