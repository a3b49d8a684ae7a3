"""`bench calibrate dh=`: an arm of a table instead of a URDF; what was hidden in its numbers comes out in a table."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from calibench import problems
from calibench.bench.cli import main
from calibench.bench.provenance.run_id import options_of
from calibench.calibration.kinematics import forward, nominal
from calibench.calibration.urdf import read_urdf
from calibench.problems.arm.families import shipped
from tests.bench.arm_by_hand import texts
from tests.dh_by_hand import PUMA_CRAIG, STANFORD, UR10, as_csv, modified, reached, standard
from tests.few import few

BASE = ((0.8, -1.9, 0.4), 0.7)  # of the arm in the tracker: m, and a turn about z
TARGET = (0.06, 0.02, 0.11)
HIDDEN = {  # m and rad; rows count from 0
    "ur10": {("a", 1): 8e-4, ("theta", 2): 2.6e-3, ("beta", 1): -9e-4, ("d", 3): 6e-4, ("alpha", 4): 1e-3},
    "craig": {("a", 2): -7e-4, ("theta", 2): 2e-3, ("alpha", 4): 1.1e-3, ("d", 3): 9e-4},
    "stanford": {("d", 2): 4e-3, ("theta", 1): 2e-3, ("alpha", 3): 1.5e-3, ("theta", 4): -3e-3},
}
ARMS = {"ur10": (UR10, standard), "craig": (PUMA_CRAIG, modified), "stanford": (STANFORD, standard)}
URDF_NAMES = [
    *(f"shoulder_{one}_joint" for one in ("pan", "lift")),
    "elbow_joint",
    *(f"wrist_{k}_joint" for k in "123"),
]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def bench(here, capsys):
    def call(*words, code=0):
        with pytest.raises(SystemExit) as ended:
            main([*words, "--json"])
        told = capsys.readouterr()
        assert ended.value.code == code, told.err
        return json.loads(told.out) if code == 0 else told.err

    return call


def turned(roll, pitch, yaw):
    cx, sx, cy, sy, cz, sz = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    return np.array([
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ])  # fmt: skip


def measured(name, n=60, noise=3e-5, seed=3, hold=0, turns=False):
    """Write `name`.csv and its table; return joints (n, 6) [rad, m] and places seen (n, 3) [m]."""
    rows, of = ARMS[name]
    rng = np.random.default_rng(seed)
    q = np.column_stack([rng.uniform(-2.4, 2.4, n) if r[4] == "r" else rng.uniform(0.3, 1.2, n) for r in rows])
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = turned(0, 0, BASE[1]), BASE[0]
    arm = base @ reached(rows, q, of, HIDDEN[name])
    seen = arm[:, :3, 3] + arm[:, :3, :3] @ np.array(TARGET) + rng.normal(0, noise, (n, 3))
    columns = [q, seen]
    heads = [*(f"axis_{k}" for k in range(1, 7)), "x [m]", "y [m]", "z [m]"]
    heads[2] += "" if rows[2][4] == "r" else " [m]"
    if turns:
        r = arm[:, :3, :3]
        columns.append(np.column_stack([
            np.arctan2(r[:, 2, 1], r[:, 2, 2]), -np.arcsin(r[:, 2, 0]), np.arctan2(r[:, 1, 0], r[:, 0, 0])
        ]) + rng.normal(0, 1e-4, (n, 3)))  # fmt: skip
        heads += ["roll", "pitch", "yaw"]
    marks = ["hold" if i % 4 == 1 and i // 4 < hold else "train" for i in range(n)]
    lines = [",".join([*heads, *(["split"] if hold else [])])]
    for row, mark in zip(np.column_stack(columns), marks, strict=True):
        lines.append(",".join([*(f"{v:.9f}" for v in row), *([mark] if hold else [])]))
    Path(f"{name}.csv").write_text("\n".join(lines))
    Path(f"{name}_dh.csv").write_text(as_csv(rows))
    return q, seen, np.array(marks) == "hold"


def words(name, *more):
    of = {standard: "standard", modified: "modified"}[ARMS[name][1]]
    return "calibrate", f"dh={name}_dh.csv", f"convention={of}", f"data={name}.csv", "page=false", *more


def written(path):
    """Return the rows of a table that was written, each a dictionary of texts by heading."""
    lines = [line for line in Path(path).read_text().splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def numbers(row):
    return tuple(
        float(row.get(f"{n} [{'m' if n in 'ad' else 'rad'}]", 0)) for n in ("a", "alpha", "d", "theta", "beta")
    )


@pytest.mark.parametrize("name", few(1, list(ARMS)))
def test_what_was_hidden_in_a_table_comes_back_within_its_errors(bench, name):
    measured(name, turns=name == "stanford")
    found = bench(*words(name))
    assert found["chosen"] == "geometry"
    assert found["dh"] == f"{name}_dh.csv"
    assert found["after"]["rms"] < 0.09 < 0.5 < found["before"]["rms"]
    truth = {f"{number}_axis_{k + 1}": v * (1000 if number in "ad" else 1) for (number, k), v in HIDDEN[name].items()}
    changes = {change["parameter"]: change for change in found["changes"]}
    assert set(truth) <= set(changes), set(truth) - set(changes)
    away = [abs(change["change"] - truth.get(one, 0.0)) / change["sd"] for one, change in changes.items()]
    assert max(away) < 4
    assert np.mean(np.array(away) < 2) > 0.75
    undetermined = {one["parameter"] for one in found["undetermined"]}
    assert not set(changes) & undetermined
    assert {one.partition("_")[0] for one in set(changes) | undetermined} <= {"theta", "d", "a", "alpha", "beta"}


@pytest.mark.slow
def test_only_numbers_that_the_data_determine_are_others_than_they_were(bench):
    measured("ur10")
    found = bench(*words("ur10"))
    changed = {change["parameter"] for change in found["changes"]}
    rows = written(found["files"]["dh"])
    for k, (row, before) in enumerate(zip(rows, UR10, strict=True), start=1):
        for one, number, was in zip(
            ("a", "alpha", "d", "theta", "beta"), numbers(row), (*before[:4], 0.0), strict=True
        ):
            sd = row.get(f"sd_{one} [{'m' if one in 'ad' else 'rad'}]", "")
            if f"{one}_axis_{k}" in changed:
                assert number != was
                assert float(sd) > 0
            else:
                assert number == pytest.approx(was, abs=1e-9)
                assert sd == ""
    kept = {f"{one}_axis_{k}" for k in (2, 3) for one in ("d",)}
    assert not kept & changed  # Hayati: the offset along axes that are parallel is told once, behind them
    assert {"beta_axis_2", "beta_axis_3", "d_axis_4"} <= changed


def test_the_urdf_that_is_written_is_the_arm_of_the_table_that_is_written(bench):
    q, _, _ = measured("ur10")
    found = bench(*words("ur10"))
    told = [numbers(row) for row in written(found["files"]["dh"])]
    wanted = reached([(*row[:4], "r") for row in told], q, standard, {("beta", k): r[4] for k, r in enumerate(told)})
    chain = read_urdf(found["files"]["urdf"]).chain()
    np.testing.assert_allclose(forward(chain, nominal(chain), q)[:, :3, 3] / 1000, wanted[:, :3, 3], atol=1e-8)


def test_a_table_is_written_where_two_targets_were_read(bench):
    q, seen, _ = measured("ur10", 40)
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = turned(0, 0, BASE[1]), BASE[0]
    arm = base @ reached(UR10, q, standard, HIDDEN["ur10"])
    other = arm[:, :3, 3] + arm[:, :3, :3] @ (-0.05, 0.08, 0.02) + np.random.default_rng(5).normal(0, 3e-5, (40, 3))
    heads = [*(f"axis_{k}" for k in range(1, 7)), *(f"{one}_{k} [m]" for k in (1, 2) for one in "xyz")]
    np.savetxt("ur10.csv", np.column_stack([q, seen, other]), "%.9f", ",", header=",".join(heads), comments="")
    found = bench(*words("ur10"))
    assert found["after"]["rms"] < 0.09
    assert {f"{one}_axis_{k + 1}" for one, k in HIDDEN["ur10"]} <= {one["parameter"] for one in found["changes"]}
    assert numbers(written(found["files"]["dh"])[1])[0] == pytest.approx(UR10[1][0] + 8e-4, abs=2e-4)


@pytest.mark.parametrize("code", ["-9999", "the last one"])
def test_places_that_an_instrument_gives_without_a_target_are_told_as_such(bench, code):
    measured("ur10", 60)
    head, *rows = [line.split(",") for line in Path("ur10.csv").read_text().splitlines()]
    for i in range(5, 59, 6):
        rows[i][6:] = ["-9999"] * 3 if code == "-9999" else rows[i - 1][6:]
    Path("ur10.csv").write_text("\n".join(map(",".join, [head, *rows])))
    notes = {note["code"]: note["text"] for note in bench(*words("ur10"))["notes"]}
    assert "9 repeat the place of another row to the last digit" in notes["wild_uncounted"]
    assert not {"step", "many_wild"} & set(notes)  # nothing was moved


def test_a_true_arm_keeps_its_table(bench, monkeypatch):
    monkeypatch.setitem(HIDDEN, "craig", {})
    measured("craig", 40)
    found = bench(*words("craig"))
    assert (found["chosen"], found["changes"]) == ("frames", [])
    assert not {"dh", "urdf"} & set(found["files"])


def test_an_arm_by_its_table_and_by_its_urdf_is_one_arm_to_every_verb(bench, here, capsys):
    measured("ur10", 40)
    text = Path("ur10.csv").read_text()
    for k, name in enumerate(URDF_NAMES, start=1):
        text = text.replace(f"axis_{k}", name)
    Path("ur10.csv").write_text(text)
    Path("t.csv").write_text(as_csv(UR10, names=URDF_NAMES))
    Path("ur10.urdf").write_bytes(shipped("ur10.urdf").read_bytes())
    table = ("machine.dh=t.csv", "machine.convention=standard")
    one = bench("design", "machine=arm", *table, "data=ur10.csv", "plan.n=4", "plan.limits=data")
    other = bench("design", "machine=arm", "machine.urdf=ur10.urdf", "data=ur10.csv", "plan.n=4", "plan.limits=data")
    assert (one["numbers"], one["measured"]) == (other["numbers"], other["measured"])
    np.testing.assert_allclose(one["error_mm"][0], other["error_mm"][0], rtol=0.05)

    of_table = problems.make("arm", dh=Path("t.csv"), convention="standard", data=Path("ur10.csv"))
    of_urdf = problems.make("arm", urdf=Path("ur10.urdf"), data=Path("ur10.csv"))
    assert [p.name for p in of_table.parameters] == [p.name for p in of_urdf.parameters]
    assert of_table(of_table.start) == pytest.approx(of_urdf(of_urdf.start), rel=1e-6)
    assert of_table(of_table.best) == pytest.approx(of_urdf(of_urdf.best), rel=1e-6)
    assert {"dh", "convention"} <= set(options_of(of_table))
    assert not {"dh", "convention"} & set(options_of(of_urdf))  # rows of a URDF keep their ids

    calibrated = bench("calibrate", "urdf=ur10.urdf", "data=ur10.csv", "page=false")
    by_table = bench("calibrate", "machine=arm", "dh=t.csv", "convention=standard", "data=ur10.csv", "page=false")
    assert by_table["after"]["rms"] == pytest.approx(calibrated["after"]["rms"], rel=0.02)
    assert "--json" not in capsys.readouterr().err


def test_the_convention_that_the_readings_fit_is_told_where_none_is_stated(bench):
    for name, of in (("ur10", "standard"), ("craig", "modified")):
        measured(name, 30)
        told = bench("calibrate", f"dh={name}_dh.csv", f"data={name}.csv", code=2)
        assert "the convention is not stated, and the same numbers are two arms" in told
        assert f"the readings fit the arm as {of} only" in told
        assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "stated", "of"), few(1, [("ur10", "modified", "standard"), ("craig", "standard", "modified")])
)
def test_a_convention_stated_wrong_is_told_with_the_one_that_fits(bench, name, stated, of):
    measured(name, 30)
    asked = [word.replace(f"convention={of}", f"convention={stated}") for word in words(name)]
    told = bench(*asked, code=2)
    assert f"{name}_dh.csv: the readings fit the arm as {of}: convention={of}. As it stands: " in told
    assert told.count("\n") == 1


def spoilt(name, rows, names=None):
    Path(f"{name}_dh.csv").write_text(as_csv(rows, names=names))


@pytest.mark.parametrize(
    ("row", "other", "said"), few(1, [(2, "r", "slides: type prismatic"), (3, "p", "turns: type revolute")])
)
def test_a_row_with_the_wrong_kind_of_joint_is_told(bench, row, other, said):
    measured("stanford", 40)
    spoilt("stanford", [(*r[:4], other if k == row else r[4]) for k, r in enumerate(STANFORD)])
    told = bench(*words("stanford"), code=2)
    assert f"stanford_dh.csv: the readings fit the arm if row {row + 1} (axis_{row + 1}) {said}. As it stands: " in told
    assert told.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "pair"),
    [
        ("ur10", (0, 3)),
        *(pytest.param("ur10", pair, marks=pytest.mark.slow) for pair in ((1, 3), (2, 3), (3, 5))),
        *(pytest.param("craig", pair, marks=pytest.mark.slow) for pair in ((2, 3), (0, 3), (1, 3), (3, 5))),
    ],
)
def test_two_rows_that_are_exchanged_are_told(bench, name, pair):
    measured(name, 40)
    rows, names = list(ARMS[name][0]), [f"axis_{k}" for k in range(1, 7)]
    i, j = pair
    rows[i], rows[j] = rows[j], rows[i]
    spoilt(name, rows)  # names stay: the numbers are exchanged
    told = bench(*words(name), code=2)
    assert (
        f"rows {i + 1} (axis_{i + 1}) and {j + 1} (axis_{j + 1}) exchange their numbers, and keep their names" in told
    )
    names[i], names[j] = names[j], names[i]
    spoilt(name, rows, names)
    told = bench(*words(name), code=2)
    assert f"rows {i + 1} (axis_{j + 1}) and {j + 1} (axis_{i + 1}) are exchanged" in told
    assert told.count("\n") == 1
    _, dh, convention, data, *_ = words(name)
    assert bench("discover", "machine=arm", f"machine.{dh}", f"machine.{convention}", data, code=2) == told


@pytest.mark.parametrize(
    ("name", "row", "number", "wrong", "said"),
    few(
        1,
        [
            ("ur10", 0, "alpha", -np.pi / 2, "alpha of row 1 (axis_1) is 1.571 rad, not -1.571 rad. "),
            ("craig", 1, "alpha", 0.0, "alpha of row 2 (axis_2) is -1.571 rad, not 0 rad. "),
            ("ur10", 1, "a", -0.162, "a of row 2 (axis_2) is about -0.612 m, not -0.162. "),
            *(
                pytest.param(*case, marks=pytest.mark.slow)
                for case in (
                    ("ur10", 3, "alpha", 0.0, "alpha of row 4 (axis_4) is 1.571 rad, not 0 rad. "),
                    ("ur10", 4, "alpha", np.pi / 2, "alpha of row 5 (axis_5) is -1.571 rad, not 1.571 rad. "),
                    ("craig", 2, "a", -0.4318, "a of row 3 (axis_3) is about 0.43 m, not -0.432. "),
                )
            ),
        ],
    ),
)
def test_one_number_of_a_table_that_is_wrong_is_told_with_the_one_that_fits(bench, name, row, number, wrong, said):
    measured(name, 40)
    rows = [list(r) for r in ARMS[name][0]]
    rows[row][("a", "alpha", "d").index(number)] = wrong
    spoilt(name, rows)
    told = bench(*words(name), code=2)
    assert f"{name}_dh.csv: the readings fit the arm if {said}" in told
    assert told.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("n", "seed"), [(12, 3), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((14, 1), (12, 6), (14, 2)))]
)
def test_a_dozen_poses_name_no_other_error_of_a_table_than_there_is(bench, n, seed):
    measured("ur10", n, seed=seed)
    spoilt("ur10", [(*r[:2], 0.0116 if k == 4 else r[2], *r[3:]) for k, r in enumerate(UR10)])
    told = bench(*words("ur10"), code=2)
    assert "the readings fit the arm if d of row 5 (axis_5) is about 0.11" in told
    assert "alpha" not in told.partition("As it stands")[0]


@pytest.mark.slow
def test_offsets_along_parallel_axes_of_which_one_is_wrong_are_told_together(bench):
    measured("ur10", 40)
    spoilt("ur10", [(*r[:2], 0.2639 if k == 3 else r[2], *r[3:]) for k, r in enumerate(UR10)])
    told = bench(*words("ur10"), code=2)
    assert "d of row 4 (axis_4) is about 0.164 m, not 0.264, or if d of row " in told


@pytest.mark.parametrize(
    ("one", "other", "head"),
    few(
        1,
        [
            ("a", "d", "joint,type,d [m],alpha [rad],a [m],theta [rad]"),
            ("alpha", "theta", "joint,type,a [m],theta [rad],d [m],alpha [rad]"),
        ],
    ),
)
def test_two_columns_of_a_table_that_are_exchanged_are_told(bench, one, other, head):
    measured("stanford", 40)
    Path("stanford_dh.csv").write_text(as_csv(STANFORD, head))
    assert f"the readings fit the arm if columns {one} and {other} are exchanged. " in bench(*words("stanford"), code=2)


def test_a_table_with_german_headings_gives_a_urdf_with_names_that_ros_takes(bench):
    measured("ur10", 60)
    german = as_csv(UR10, "Gelenk,Typ,a [m],alpha [rad],d [m],theta [rad]", [f"Gelenk {k}" for k in range(1, 7)])
    Path("ur10_dh.csv").write_text(german.replace("revolute", "Drehgelenk"))
    Path("ur10.csv").write_text(Path("ur10.csv").read_text().replace("axis_", "Gelenk "))
    found = bench(*words("ur10"))
    chain = read_urdf(found["files"]["urdf"]).chain()
    assert chain.driven == tuple(f"Gelenk_{k}" for k in range(1, 7))
    again = bench("calibrate", f"urdf={found['files']['urdf']}", "data=ur10.csv", "page=false")
    assert again["before"]["rms"] < 0.12


def test_poses_of_an_arm_without_limits_say_so(bench, capsys):
    measured("ur10", 30)
    asked = ("design", "machine=arm", "machine.dh=ur10_dh.csv", "machine.convention=standard", "plan.n=3")
    assert bench(*asked)["limits"] == "none"
    with pytest.raises(SystemExit):
        main(list(asked))
    assert "no limits are stated" in capsys.readouterr().out


def test_poses_on_a_long_rail_use_all_of_it(bench):
    rail = "joint,type,a [m],alpha [rad],d [m],theta [rad],lower,upper\nrail,p,0,pi/2,0,0,2,5\n"
    Path("rail.csv").write_text(rail + "".join(f"axis_{k},r,0.5,{k - 2}*pi/2,0.1,0,-3,3\n" for k in range(1, 5)))
    found = bench("design", "machine=arm", "machine.dh=rail.csv", "machine.convention=standard", "plan.n=12")
    rail = [pose[0] for pose in found["poses"]]
    assert 2000 <= min(rail) < 2500
    assert 4500 < max(rail) <= 5000


WORDS = ["Sockel", "Schulter", "Ellbogen", "Unterarm", "Beuge", "Kopf"]


def in_words(name):
    """Call the joints of the readings by words of which none looks like a joint's."""
    text = Path(f"{name}.csv").read_text()
    for k, word in enumerate(WORDS, start=1):
        text = text.replace(f"axis_{k}", word)
    Path(f"{name}.csv").write_text(text)


@pytest.mark.slow
@pytest.mark.parametrize("row", [0, *(pytest.param(row, marks=pytest.mark.slow) for row in (5, 2))])
def test_a_column_that_no_row_reads_is_named_where_the_readings_do_not_fit(bench, row):
    measured("ur10", 40)
    in_words("ur10")
    rest = [k for k in range(6) if k != row]
    spoilt("ur10", [UR10[k] for k in rest], [WORDS[k] for k in rest])
    told = bench(*words("ur10"), code=2)
    assert f"column {WORDS[row]} is read by no row: if it is a joint, its row is missing in the table" in told
    assert told.count("\n") == 1


@pytest.mark.parametrize(("noise", "far"), few(1, [(1e-2, True), (1e-3, False)]))
def test_a_calibration_that_leaves_more_than_an_arm_errs_says_so(bench, noise, far):
    measured("ur10", 40, noise=noise)
    notes = [note for note in texts(bench(*words("ur10"))) if "so much is no matter of calibration" in note]
    assert len(notes) == far
    assert all("is this the table of the arm, and does each column hold its joint?" in note for note in notes)


@pytest.mark.slow
def test_a_joint_of_a_table_that_slides_the_other_way_is_told_as_what_it_is(bench):
    measured("stanford", 40)
    lines = [line.split(",") for line in Path("stanford.csv").read_text().splitlines()]
    flipped = [lines[0], *([*row[:2], str(-float(row[2])), *row[3:]] for row in lines[1:])]
    Path("stanford.csv").write_text("\n".join(map(",".join, flipped)))
    assert "joint axis_3 slides the other way than in the table: change the sign of its column" in bench(
        *words("stanford"), code=2
    )


@pytest.mark.parametrize(
    ("limits", "kind", "said"),
    [
        (("-3", "3"), "r", "with limits in rad all its rows lie within: write lower [rad] and upper [rad]"),
        (("0.2", "1.3"), "p", "with limits in m all its rows lie within: write their unit in the cells, 1.3 m"),
    ],
)
def test_limits_in_another_unit_are_told_with_it(bench, limits, kind, said):
    measured("stanford", 40)
    scale = (1000, 180 / np.pi, 1000, 180 / np.pi)
    table = as_csv(STANFORD, "joint,type,a [mm],alpha [deg],d [mm],theta [deg]", scale=scale).splitlines()
    rows = [f"{line},{','.join(limits if STANFORD[k][4] == kind else ('', ''))}" for k, line in enumerate(table[1:])]
    Path("stanford_dh.csv").write_text("\n".join([f"{table[0]},lower,upper", *rows]))
    assert said in bench(*words("stanford"), code=2)


def test_mm_below_a_heading_of_m_are_told_as_such_where_the_limits_are_mm(bench):
    """Nobody has a rail of a kilometre, so it is the heading that is wrong and not the limits."""
    measured("stanford", 40)
    head, *rows = Path("stanford.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    Path("stanford.csv").write_text("\n".join([head, *(",".join(
        f"{1000 * float(cell):.6f}" if k == 2 else cell for k, cell in enumerate(row)) for row in cells)]))  # fmt: skip
    scale = (1000, 180 / np.pi, 1000, 180 / np.pi)
    table = as_csv(STANFORD, "joint,type,a [mm],alpha [deg],d [mm],theta [deg]", scale=scale).splitlines()
    limits = [",100,2000" if STANFORD[k][4] == "p" else ",," for k in range(6)]
    Path("stanford_dh.csv").write_text(
        "\n".join([f"{table[0]},lower,upper", *(f"{row}{more}" for row, more in zip(table[1:], limits, strict=True))])
    )
    assert "2 mm with axis_3 in mm: units=axis_3:mm" in bench(*words("stanford"), code=2)


def five_rows():
    Path("ur10_dh.csv").write_text(as_csv(UR10[:5]))


def seven_rows():
    Path("ur10_dh.csv").write_text(as_csv([*UR10, UR10[5]]))


def in_mm_for_m():
    Path("ur10_dh.csv").write_text(as_csv(UR10, scale=(1000, 1, 1000, 1)))


def in_degrees():
    Path("ur10_dh.csv").write_text(as_csv(UR10, scale=(1, 180 / np.pi, 1, 1)))


def without_d():
    Path("ur10_dh.csv").write_text(as_csv(UR10).replace("d [m]", "height"))


def of_another_arm():
    Path("ur10_dh.csv").write_text(as_csv(STANFORD).replace("prismatic", "revolute"))


@pytest.mark.parametrize(
    ("spoil", "more", "said"),
    [
        (five_rows, (), "5 rows that move (axis_1, axis_2, axis_3, axis_4, axis_5), and axis_6 is a joint beside them"),
        (seven_rows, (), "joint axis_7 of the table has no column; "),
        (in_mm_for_m, (), "these look like mm; write a [mm] and d [mm]"),
        (in_degrees, (), "alpha is stated in rad and reaches 90: degrees? then write alpha [deg]"),
        (without_d, (), "no column d among joint, type, a, alpha, height, theta"),
        (of_another_arm, (), "is this the table of the arm, convention= the one it was written in"),
        (None, ("urdf=my.urdf",), "urdf= and dh= both describe the arm; give one"),
        (None, ("machine.tip=tool0",), "machine.tip= is a link of a URDF; a table goes from its first row to its last"),
        (None, ("machine.dh=b.csv",), "unknown argument 'machine.dh'; "),
        (None, ("level=all",), "choices: auto, frames, zeros, geometry, gains"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_table_is_one_line_that_says_what_to_do(bench, spoil, more, said):
    measured("ur10", 30)
    if spoil:
        spoil()
    told = bench(*words("ur10", *more), code=2)
    assert said in told
    assert told.count("\n") == 1
    assert not Path("results").exists()


def test_a_convention_without_a_table_is_refused(bench):
    assert "convention= is that of a table; state dh= too" in bench(
        "calibrate", "urdf=a.urdf", "convention=standard", "data=a.csv", code=2
    )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "problem.urdf=my.urdf, or problem.dh=table.csv"),
        ({"urdf": "a", "dh": "b"}, "both describe the arm"),
        ({"urdf": "a", "convention": "standard"}, "is that of a table"),
        ({"dh": "b", "tip": "c"}, "are links of a URDF"),
        ({"dh": "ur10_dh.csv"}, "problem.convention=standard"),
    ],
)
def test_a_problem_needs_one_description(here, options, said):
    measured("ur10", 20)
    with pytest.raises(ValueError, match=said.replace(".", r"\.")):
        problems.make("arm", data="ur10.csv", **options)
