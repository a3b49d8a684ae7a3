"""What a calibration does not say for itself: errors that leave something out, scales without a place, ranges."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench.bench.cli import main
from calibench.bench.tracking.catalogue import catalogue
from calibench.calibration.kinematics import forward, nominal
from calibench.calibration.urdf import read_urdf
from tests.bench.arm_by_hand import NAMES, about, measured, placed, table, texts, urdf
from tests.few import few


@pytest.fixture
def calibrate(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.urdf").write_text(urdf())

    def call(text, *words):
        (tmp_path / "my.csv").write_text(text)
        with pytest.raises(SystemExit):
            main(["calibrate", "urdf=my.urdf", "data=my.csv", "page=false", *words, "--json"])
        return json.loads(capsys.readouterr().out)

    return call


def note_of(found, words):
    [note] = [note for note in texts(found) if words in note] or [""]
    return note


def number(text, before, after=" mm"):
    return float(text.split(before)[1].split(after)[0])


def of_its_urdf(found, q):
    """Return where the target is by the written URDF with the frames that were found, (n, 3) [mm]."""
    base, target = found["frames"]["base"], np.array(found["frames"]["target"][:3])
    chain = read_urdf(found["files"]["urdf"]).chain(tip="link_6")
    flange = forward(chain, nominal(chain), q)
    at = flange[:, :3, 3] + flange[:, :3, :3] @ target
    return at @ Rotation.from_euler("xyz", base[3:]).as_matrix().T + base[:3]


def rms(off):
    return np.sqrt((off**2).sum(axis=1).mean())


@pytest.mark.parametrize("held", few(1, [False, True]))
def test_the_error_with_a_wild_reading_in_it_is_told_beside_the_one_without(calibrate, held):
    q, seen, _ = measured(60)
    seen[30] += [0.0, 3.0, 0.0]
    lines = table(q, seen).splitlines()
    if held:
        split = ["split", *("hold" if k % 5 == 0 else "train" for k in range(60))]
        lines = [f"{line},{word}" for line, word in zip(lines, split, strict=True)]
    found = calibrate("\n".join(lines) + "\n")
    assert found["after"]["rms"] < 0.1
    told = number(note_of(found, "in no error above"), "with it the error after is ")
    assert told == pytest.approx(np.hypot(3.0, 0.06) / np.sqrt(12 if held else 60), rel=0.05)


def test_a_scale_is_used_as_the_note_says_and_without_it_the_urdf_is_off_by_what_it_says(calibrate):
    q, seen, _ = measured(80)
    read = q.copy()
    read[:, 2] /= 1.001  # joint_3 goes a thousandth further than its reading says
    found = calibrate(table(read, seen), "level=gains")
    scale = next(c["change"] for c in found["changes"] if c["parameter"] == "gain_joint_3")
    assert scale == pytest.approx(1e-3, rel=0.05)
    scales = {c["joint"]: 1 + c["change"] for c in found["changes"] if c["parameter"].startswith("gain_")}
    scaled = read * [scales.get(name, 1.0) for name in NAMES]
    assert rms(of_its_urdf(found, scaled) - seen) < 0.08
    note = note_of(found, "joint scales have no place in a URDF")
    assert rms(of_its_urdf(found, read) - seen) == pytest.approx(number(note, "is written leaves "), rel=0.02)
    assert number(note, "is written leaves ") > 0.3


def test_poses_of_a_small_range_say_how_far_they_carry(calibrate):
    rng = np.random.default_rng(3)
    q = rng.uniform(-1, 1, (30, 6)) * [0.2, 0.6, 0.6, 0.2, 0.6, 0.25]
    seen = placed(q)[0] + rng.normal(0, 0.03, (30, 3))
    found = calibrate(table(q, seen), "level=geometry")
    note = note_of(found, "valid where the poses are")
    inside, outside = number(note, "foretold to "), number(note, "joints to ")
    far = rng.uniform(-2.6, 2.6, (500, 6))
    off = of_its_urdf(found, far) - placed(far)[0]
    near = of_its_urdf(found, q) - placed(q)[0]
    assert 0.4 < rms(near) / inside < 2.5
    assert 0.3 < rms(off) / outside < 3.0
    assert "joint_1" in note.split("; ")[1]
    assert not note_of(calibrate(table(*measured(60)[:2])), "valid where")


def test_a_tracker_that_went_elsewhere_is_refused_by_a_search_as_well(calibrate, tmp_path, capsys):
    q, seen, _ = measured(80)
    seen[50:] = seen[50:] @ about((0, 0, 1), 0.6).T + [900.0, -2000.0, 30.0]
    (tmp_path / "my.csv").write_text(table(q, seen))
    with pytest.raises(SystemExit) as ended:
        main(["discover", "machine=arm", "machine.urdf=my.urdf", "data=my.csv", "units=x:mm,y:mm,z:mm"])
    said = capsys.readouterr()
    assert ended.value.code == 2
    assert "30 of 80 poses, row 51 to row 80, fit the arm by themselves only" in said.out + said.err


@pytest.mark.usefixtures("undrawn")
def test_numbers_that_other_poses_would_tell_stand_apart_from_those_that_look_like_others(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(3)
    q = rng.uniform(-1, 1, (25, 6)) * 0.15
    seen = placed(q)[0] + rng.normal(0, 0.03, (25, 3))
    (tmp_path / "my.urdf").write_text(urdf())
    (tmp_path / "my.csv").write_text(table(q, seen))
    with pytest.raises(SystemExit):
        main(["calibrate", "urdf=my.urdf", "data=my.csv", "level=geometry"])
    found = json.loads((tmp_path / "results/calibrate/my/calibration.json").read_text())
    assert found["provenance"]["command"] == "bench calibrate urdf=my.urdf data=my.csv level=geometry"
    [entry] = catalogue("results")
    assert (entry.command, entry.when) == (found["provenance"]["command"], found["provenance"]["started_at"])
    badly = [one["parameter"] for one in found["undetermined"] if one["reason"].startswith("these poses tell it")]
    assert badly
    said = capsys.readouterr().out
    assert f"{len(found['undetermined']) - len(badly)} are not, and these poses tell " in said
    page = (tmp_path / "results/calibrate/my/report.html").read_text()
    told, _, folded = page.partition("What these data do not determine")[2].partition("<details>")
    assert all(f">{name}<" in told and f">{name}<" not in folded.partition("</details>")[0] for name in badly)
