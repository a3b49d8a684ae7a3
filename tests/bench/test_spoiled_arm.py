"""One sound file spoiled as people spoil it: `calibrate` and `discover` name the same mistake and the same cure."""

import json

import numpy as np
import pytest

import calibench
from calibench.bench.cli import main
from calibench.bench.measured import read_measured
from calibench.core.notes import Code, DataError
from calibench.discrepancy.machines.arm import Arm
from tests.bench.arm_by_hand import NAMES, in_sockets, measured, placed, table, urdf

ALL = ",".join(f"{name}:deg" for name in NAMES)


def exchanged(q, seen):
    return q[:, [0, 2, 1, 3, 4, 5]], seen


def turned(q, seen):
    return q * [1, 1, -1, 1, 1, 1], seen


def shifted(degrees):
    def spoil(q, seen):
        q = q * [1, 1, 1, 0.4, 1, 1]  # inside its limits, shifted or not
        seen = placed(q)[0]
        return q - np.deg2rad(degrees) * np.eye(6)[3], seen

    return spoil


def in_part(of, rows, factor):
    def spoil(*both):
        both[of][rows] *= factor
        return both

    return spoil


def without_row(of, row):
    return lambda *both: tuple(np.delete(one, row if k == of else -1, axis=0) for k, one in enumerate(both))


IN_TURNS = ",".join(f"{name}:rev" for name in NAMES)
SPOILT = {
    "exchanged": (exchanged, Code.JOINTS_EXCHANGED, """columns='{"q_joint_2":"joint_3","q_joint_3":"joint_2"}'"""),
    "turned": (turned, Code.JOINT_REVERSED, "if joint joint_3 turns the other way than in the URDF"),
    "quarter": (shifted(90), Code.JOINT_SHIFTED, "if 90° are added to joint joint_4"),
    "shifted": (shifted(-37), Code.JOINT_SHIFTED, "if -37° are added to joint joint_4"),
    "degrees": (lambda q, seen: (np.rad2deg(q), seen), Code.JOINT_UNIT, f"units={ALL}"),
    "metres": (lambda q, seen: (q, seen / 1000), Code.POSITION_UNIT, "units=x:m,y:m,z:m"),
    "turns": (lambda q, seen: (q / (2 * np.pi), seen), Code.JOINT_UNIT, f"with joints in turns: units={IN_TURNS}"),
    "turns, metres": (
        lambda q, seen: (q / (2 * np.pi), seen / 1000),
        Code.JOINT_UNIT,
        f"with joints in turns and x, y, z in m: units={IN_TURNS},x:m,y:m,z:m",
    ),
    "half in m": (in_part(1, slice(30, 60), 1e-3), Code.POSITION_UNIT, "x, y, z in m from row 31 on"),
    "a quarter in m": (in_part(1, slice(15), 1e-3), Code.POSITION_UNIT, "x, y, z in m up to row 15"),
    "a row of joints lost": (without_row(0, 20), Code.ROWS_OUT_OF_STEP, "in the row below from row 22 on"),
    "a row of places lost": (without_row(1, 40), Code.ROWS_OUT_OF_STEP, "in the row above from row 41 on"),
    "below": (lambda q, seen: (q, np.roll(seen, 1, axis=0)), Code.ROWS_OUT_OF_STEP, "stand in the row below"),
    "above": (lambda q, seen: (q, np.roll(seen, -1, axis=0)), Code.ROWS_OUT_OF_STEP, "stand in the row above"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("spoilt")
    (made / "my.urdf").write_text(urdf())
    q, seen, _ = measured(60)
    for name, (spoil, _, _) in SPOILT.items():
        (made / f"{name}.csv").write_text(table(*spoil(q.copy(), seen.copy())))
    return made


@pytest.mark.parametrize("name", SPOILT)
def test_a_mistake_has_one_cure_whether_an_arm_is_calibrated_or_searched(folder, name, monkeypatch):
    _, code, cure = SPOILT[name]
    monkeypatch.chdir(folder)
    data = read_measured(f"{name}.csv", "arm")
    for refuse in (lambda: calibench.calibrate("my.urdf", data.columns), lambda: Arm("my.urdf").formulate(data)):
        with pytest.raises(DataError) as refused:
            refuse()
        assert refused.value.note.code is code
        assert cure in refused.value.note.text


def test_both_verbs_say_it_in_one_line(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    lines = []
    for words in (["calibrate", "urdf=my.urdf", "page=false"], ["discover", "machine=arm", "machine.urdf=my.urdf"]):
        with pytest.raises(SystemExit) as ended:
            main([*words, "data=turned.csv"])
        assert ended.value.code == 2
        lines.append(capsys.readouterr().err)
    assert lines[0] == lines[1]
    assert SPOILT["turned"][2] in lines[0]
    assert lines[0].count("\n") == 1


def test_one_joint_in_rad_among_those_in_degrees_is_told(folder):
    q, seen, _ = measured(60)
    mixed = np.rad2deg(q) * [1, 1, 1, np.pi / 180, 1, 1]
    with pytest.raises(DataError, match="with joint joint_4 alone in rad: units=joint_4:rad"):
        calibench.calibrate(
            folder / "my.urdf", np.column_stack([mixed, seen]), names=[*(f"{n} [deg]" for n in NAMES), *"xyz"]
        )


def test_rows_that_an_arm_moved_in_have_no_cure_in_a_unit_or_a_lost_row(folder):
    q, seen, _ = measured(60)
    seen[40:] += 20
    with pytest.raises(DataError) as refused:
        calibench.calibrate(folder / "my.urdf", np.column_stack([q, seen]), names=[*NAMES, *"xyz"])
    assert refused.value.note.code is Code.TWO_STANDS


def test_what_is_no_mistake_that_is_known_is_told_as_another_arm(folder):
    q, seen, _ = measured(60)
    mixed = np.random.default_rng(0).permutation(q)
    with pytest.raises(DataError, match=r"machine\.tip=") as refused:
        calibench.calibrate(folder / "my.urdf", np.column_stack([mixed, seen]), names=[*NAMES, *"xyz"])
    assert refused.value.note.code is Code.OTHER_ARM


def test_joints_that_were_taken_in_order_are_all_named_where_two_are_exchanged(folder):
    q, seen = exchanged(*measured(60)[:2])
    readings = np.column_stack([q, seen])
    names = [*(f"q{k}" for k in range(1, 7)), *"xyz"]
    with pytest.raises(DataError, match=r"joints joint_2 and joint_3 are exchanged") as refused:
        calibench.calibrate(folder / "my.urdf", readings, names=names)
    cure = json.loads(str(refused.value).partition("columns='")[2].partition("'")[0])
    assert calibench.calibrate(folder / "my.urdf", readings, names=names, columns=cure)


def test_a_ball_in_sockets_tells_the_same_mistakes(folder, tmp_path):
    in_sockets(tmp_path / "plate", places=3, postures=12)
    rows = [
        (place, socket, *row)
        for place in range(3)
        for socket in range(2)
        for row in np.loadtxt(tmp_path / "plate" / f"place_{place}" / f"hole_{socket}.csv", delimiter=",")
    ]
    place, socket, *q = np.array(rows).T
    columns = {"place": place, "socket": socket, **dict(zip(NAMES, q, strict=True))}
    for name, code in (("joint_3", Code.JOINT_REVERSED), ("joint_5", Code.JOINT_REVERSED)):
        with pytest.raises(DataError, match="mm away from its sockets") as refused:
            calibench.calibrate(folder / "my.urdf", {**columns, name: -columns[name]}, distance=50)
        assert refused.value.note.code is code
        assert refused.value.note.values == {"joint": name}
