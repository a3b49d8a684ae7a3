"""Columns in a unit that is none of theirs, exchanged, of another sign or a row late are told with their cure."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench.bench import read_measured
from calibench.core.notes import Code
from calibench.discrepancy import DataError, MeasuredData, Predicted, explain, machines, procedure
from calibench.discrepancy.checks.validate import refuse_mistaken, rows_stopped, validate
from calibench.discrepancy.machines.gpm2002 import formulation
from calibench.problems.base import Parameter
from tests.independent import delta, mount

NIGHT = mount.case(0, only="", altaz=False, base=46000)
PRINTER = next(
    one for one in (delta.case(k, base=46001) for k in range(99)) if not one.truth and len(one.columns["kind"]) > 40
)
ANGLES = ("ha", "dec", "star_ha", "star_dec")


def table(path, factors, stated="deg"):
    """Write the night in units that are larger by `factors` than the stated one."""
    degrees = {name: np.degrees(NIGHT.columns[name]) / factors.get(name, 1.0) for name in ANGLES}
    heads = ",".join(f"{name} [{stated}]" for name in ANGLES)
    np.savetxt(path, np.column_stack([*degrees.values()]), "%.9f", ",", header=heads, comments="")
    return path


def refusal(machine, data, check=validate):
    with pytest.raises(DataError) as told:
        check(machine if hasattr(machine, "formulate") else machines.make(machine), data)
    return str(told.value)


LEGS = ("enc_1", "enc_2", "enc_3")
HOURS, RAD = 15.0, 180 / np.pi
IN_HOURS, IN_RAD = dict.fromkeys(ANGLES[::2], HOURS), dict.fromkeys(ANGLES, RAD)


@pytest.mark.parametrize(
    "factors",
    [IN_HOURS, IN_RAD | IN_HOURS],
    ids=["hours", "hours and radians"],
)
def test_a_stated_unit_of_a_mount_that_is_wrong_is_told_and_its_cure_cures(tmp_path, factors):
    path = table(tmp_path / "night.csv", factors)
    line = refusal("mount", read_measured(path, "mount", NIGHT.stated), refuse_mistaken)
    cures = [json.loads(found) for found in re.findall(r"units=(\{.*?\})", line)]
    units = {name: unit for one in cures for name, unit in one.items()}
    assert units == {name: {HOURS: "h", RAD: "rad"}[factor] for name, factor in factors.items()}
    refuse_mistaken(machines.make("mount"), read_measured(path, "mount", NIGHT.stated, units=units))


def test_a_search_that_finds_no_name_looks_for_a_mistake_of_the_table(tmp_path):
    path = table(tmp_path / "night.csv", IN_HOURS)
    assert 'units={"ha": "h", "star_ha": "h"}' in refusal("mount", read_measured(path, "mount", NIGHT.stated), explain)


def of_night(**columns):
    return MeasuredData({**NIGHT.columns, **columns}, "mount", NIGHT.stated, "night")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: {"star_ha": c["star_dec"], "star_dec": c["star_ha"]}, "star_ha and star_dec are exchanged"),
        (lambda c: {"star_ha": -c["star_ha"]}, "if star_ha is multiplied by -1"),
        (lambda c: {n: np.roll(c[n], 1) for n in ANGLES[2:]}, "star_ha, star_dec are taken from the row after"),
        (lambda c: {"star_dec": np.roll(c["star_dec"], 1)}, "star_dec is taken from the row after"),
    ],
    ids=["exchanged", "sign", "a row late", "a column a row late"],
)
def test_stars_that_the_mount_cannot_have_pointed_at_are_told_with_what_cures_them(change, said):
    assert said in refusal("mount", of_night(**change(NIGHT.columns)))


def of_printer(**columns):
    return MeasuredData({**PRINTER.columns, **columns}, "delta", PRINTER.metadata, "printer")


def test_ways_of_two_towers_that_are_exchanged_at_one_end_are_told():
    ways = {name: PRINTER.columns[name] for name in PRINTER.columns if name[:5] in ("steps", "trave")}
    one, other = [name for name in ways if name.endswith(("_a", "_b"))]
    line = refusal("delta", of_printer(**{one: ways[other], other: ways[one]}))
    assert f"if {one} and {other} are exchanged" in line
    assert f"or as near if {one}_2 and {other}_2 are exchanged" in line


def test_a_way_whose_zero_is_off_at_one_end_is_told_by_how_much_and_no_rod_is_named():
    way = next(name for name in PRINTER.columns if name.endswith("_a_2"))
    per_mm = 1.0 if way.startswith("travel") else PRINTER.metadata["steps_per_mm"][0]
    line = refusal("delta", of_printer(**{way: PRINTER.columns[way] + 25 * per_mm}), refuse_mistaken)
    by = {name: float(size) for size, name in re.findall(r"if (\S+) is added to (\w+): its zero", line)}
    assert by == pytest.approx({way[:-2]: 25 * per_mm, way: -25 * per_mm}, rel=0.01)


def test_a_printer_whose_every_column_is_in_metres_is_told():
    steps = {n: c / PRINTER.metadata["steps_per_mm"][0] for n, c in PRINTER.columns.items() if n.startswith("steps")}
    lengths = {n.replace("steps", "travel"): c for n, c in steps.items()}
    lengths |= {name: PRINTER.columns[name] for name in ("height", "distance")}
    table = {"kind": PRINTER.columns["kind"]} | {name: column / 1000 for name, column in lengths.items()}
    line = refusal("delta", MeasuredData(table, "delta", PRINTER.metadata, "printer"), refuse_mistaken)
    [cure] = re.findall(r"units=(\{.*?\})", line)
    assert json.loads(cure) == dict.fromkeys(lengths, "m")


def test_what_a_machine_lacks_is_no_mistake_of_its_table():
    refuse_mistaken(machines.make("mount"), of_night())
    bowed = PRINTER.columns["height"] + 0.3 * np.sin(np.arange(len(PRINTER.columns["height"])))
    refuse_mistaken(machines.make("delta"), of_printer(height=bowed))


@pytest.mark.parametrize(
    ("tracked", "change", "said"),
    [
        (True, lambda c: {"enc_1": c["enc_2"], "enc_2": c["enc_1"]}, "enc_1 and enc_2 are exchanged"),
        (True, lambda c: {n: -c[n] for n in ("enc_1", "enc_2", "enc_3")}, "enc_1, enc_2, enc_3 are multiplied by -1"),
        (True, lambda c: {n: c[n] / 1000 for n in "xy"}, 'units={"x": "m", "y": "m"}'),
        (True, lambda c: {"enc_1": np.roll(c["enc_1"], 1)}, "enc_1 is taken from the row after"),
        (False, lambda c: {"enc_1": c["enc_2"], "enc_2": c["enc_1"]}, "enc_1 and enc_2 are exchanged"),
        (
            True,
            lambda c: {"enc_1": c["enc_2"], "enc_2": c["enc_3"], "enc_3": c["enc_1"]},
            "if enc_2 is called enc_3, enc_1 is called enc_2, enc_3 is called enc_1",
        ),
        (True, lambda c: {n: c[n] / (2 * np.pi) for n in LEGS}, 'units={"enc_1": "rev", "enc_2": "rev"'),
        (
            True,
            lambda c: {n: c[n] / np.where(np.arange(len(c[n])) < 99, 1000, 1) for n in "xy"},
            "if x, y are multiplied by 1000 up to row 99: they look like m there",
        ),
        (
            True,
            lambda c: {n: np.delete(c[n], 255 if n in "xy" else -1) for n in c},
            "or as near if x, y are taken from the row before from row 256 on: there one is missing",
        ),
    ],
    ids=[
        "exchanged",
        "all signs",
        "metres",
        "a row late",
        "angles alone",
        "in turn",
        "turns",
        "a part in m",
        "a row lost",
    ],
)
def test_readings_of_a_machine_that_finds_its_own_start_are_told_with_what_cures_them(tracked, change, said):
    made = case(5, family="backlash", lam=3.0, noise="gauss", xy=tracked)
    line = refusal("gpm2002", MeasuredData({**made.columns, **change(made.columns)}, "gpm2002", made.metadata, "run"))
    assert said in line
    assert "is added to enc_3" not in line


def test_a_table_without_a_cure_is_refused_after_few_starts(monkeypatch):
    made, starts, refined = case(5, family="backlash", lam=3.0, noise="gauss", xy=True), [], formulation._refined
    monkeypatch.setattr(formulation, "_refined", lambda *of: starts.append(1) or refined(*of))
    order = np.random.default_rng(1)
    mixed = {name: order.permutation(made.columns[name]) for name in LEGS}
    line = refusal("gpm2002", MeasuredData({**made.columns, **mixed}, "gpm2002", made.metadata, "run"))
    assert line.endswith("is metadata nominal that of this machine?")
    assert len(starts) < 700


def test_a_search_that_finds_no_numbers_ends_in_a_line(monkeypatch):
    def broken(*_):  # as of a GPM2002 of which one encoder's rows stand in reverse order
        raise np.linalg.LinAlgError("177-th leading minor not positive definite")

    monkeypatch.setattr(procedure, "_explained", broken)
    line = refusal("mount", of_night(), explain)
    assert line.startswith("night: calibration leaves the machine so far from the readings")


def test_nothing_is_missing_only_beside_a_note_where_inputs_tell_nothing():
    x = np.random.default_rng(4).uniform(0, 10, 120)
    line = machines.make("table", model="line", inputs=["x"])
    notes = [
        {note.code for note in explain(line, MeasuredData({"x": x, "y": y}, "table")).notes}
        for y in (2 * x + 0.01 * np.sin(99 * x), 2 * x[::-1])
    ]
    assert [Code.FAR_FROM_MODEL in codes for codes in notes] == [False, True]


class CoreXY:
    name = "corexy"

    def formulate(self, data):
        def nozzle(q):
            return np.stack([q["sx"] * (q["a"] + q["b"]) / 2, q["sy"] * (q["a"] - q["b"]) / 2], axis=-1)

        free = tuple(Parameter(name, "1", 1.0, 0.9, 1.1) for name in ("sx", "sy"))
        return Predicted(data, nozzle, free, {"x": 0.02, "y": 0.02}, inputs=("a", "b"))


def test_all_cures_that_fit_alike_are_told():
    rng = np.random.default_rng(3)
    a, b = rng.uniform(10, 280, (2, 120))
    x, y = 1.001 * (a + b) / 2 + 0.02 * rng.normal(size=120), 0.9985 * (a - b) / 2 + 0.02 * rng.normal(size=120)
    line = refusal(CoreXY(), MeasuredData({"a": a, "b": b, "x": y, "y": x}, "corexy"))
    assert "if b is multiplied by -1" in line
    assert "or as near if x and y are exchanged" in line


def of_core(n=120):
    rng = np.random.default_rng(3)
    a, b = rng.uniform(10, 280, (2, n))
    x, y = 1.001 * (a + b) / 2 + 0.02 * rng.normal(size=n), 0.9985 * (a - b) / 2 + 0.02 * rng.normal(size=n)
    return {"a": a, "b": b, "x": x, "y": y}


@pytest.mark.parametrize(("rows", "named"), [(slice(100, None), "rows 102, 103"), (slice(12), "rows 1, 2, 3")])
def test_a_sensor_that_has_stopped_is_told_and_its_rows_are_left_out(rows, named):
    columns = of_core()
    for name in "xy":
        columns[name][rows] = columns[name][rows][0]
    data = validate(CoreXY(), MeasuredData(columns, "corexy")).data
    [note] = [note for note in data.notes if note.code is Code.ROWS_WILD]
    assert note.text.startswith(named)
    assert "while the machine moves, as of a sensor that has stopped" in note.text
    assert len(data) == 120 - len(note.rows)
    assert len(note.rows) == len(columns["x"][rows]) - (rows.start is not None)  # of the last ones one was read


def test_a_machine_that_stands_still_or_a_coarse_sensor_is_no_sensor_that_has_stopped():
    still, coarse = of_core(), of_core()
    for column in still.values():
        column[100:] = column[100]
    coarse = {name: column if name in "ab" else 50 * np.round(column / 50) for name, column in coarse.items()}
    for columns in (still, coarse):
        assert not rows_stopped(CoreXY().formulate(MeasuredData(columns, "corexy")))[0].any()


def test_two_wrong_units_of_a_machine_are_told_together():
    columns = of_core()
    columns |= {name: columns[name] / 1000 for name in "ab"} | {name: columns[name] / 10 for name in "xy"}
    data = MeasuredData(columns, "corexy", units=dict.fromkeys("abxy", "mm"))
    assert "if a, b are multiplied by 1000" in (line := refusal(CoreXY(), data))
    assert "x, y are multiplied by 10" in line


def test_a_part_of_the_rows_in_another_unit_and_a_lost_row_are_told():
    columns = of_core()
    columns["x"][70:] /= 1000
    assert "if x is multiplied by 1000 from row 71 on" in refusal(CoreXY(), MeasuredData(columns, "corexy"))
    columns = {name: np.delete(column, 50 if name in "ab" else -1) for name, column in of_core().items()}
    line = refusal(CoreXY(), MeasuredData(columns, "corexy"))  # the row without a partner is row 51
    assert "if a, b are taken from the row before from row 52 on: there one is missing" in line


def test_a_mesh_of_heights_is_refused_with_what_a_row_needs():
    mesh = {f"column_{k}": np.linspace(0, 0.2, 7) for k in range(1, 8)}
    line = refusal("delta", MeasuredData(mesh, "delta", PRINTER.metadata, "mesh"))
    assert "travel_a, travel_b and travel_c; a mesh of heights in rows and columns does not tell where" in line
