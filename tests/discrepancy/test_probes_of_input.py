"""Bad input, probe by probe: a file with one thing wrong is refused in a line that says what to do, or told in a note.

Each probe is a file on disk, of the GPM2002, of the Orthoglide, and of a machine of somebody's own.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.measured import read_measured
from calibench.discrepancy import DataError, Sensor
from calibench.discrepancy.checks.validate import copied_rows, validate
from calibench.discrepancy.machines.gpm2002.description import planned
from calibench.discrepancy.machines.orthoglide.kinematics import printed
from calibench.discrepancy.noise.repeats import pairs_of
from calibench.discrepancy.registries import machines
from calibench.discrepancy.remarks import outside_bounds
from calibench.problems.base import Parameter
from tests.discrepancy import arm
from tests.discrepancy.arm import Arm, readings

SENSORS = (
    Sensor("enc_1", "encoder", "rad", "joint 1"), Sensor("enc_2", "encoder", "rad", "joint 2"),
    Sensor("x", "tracker", "mm"), Sensor("y", "tracker", "mm"),
)  # fmt: skip


@dataclass(frozen=True)
class Sheet:
    """A file to be: heads and cells as text, and what is stated beside it."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    stated: dict[str, Any] = field(default_factory=dict)
    parted: str = ","
    encoding: str = "utf-8"
    before: str = ""

    def text(self) -> bytes:
        lines = [self.parted.join(row) for row in (self.head, *self.rows)]
        return (self.before + "\n".join(lines) + "\n").encode(self.encoding)

    def column(self, name: str, change: Callable[[int, str], str]) -> Sheet:
        """Return the sheet with the cells of a column changed: (row, cell) -> cell."""
        k = self.head.index(name)
        rows = (tuple(change(i, c) if j == k else c for j, c in enumerate(row)) for i, row in enumerate(self.rows))
        return replace(self, rows=tuple(rows))

    def times(self, name: str, factor: float, add: float = 0.0) -> Sheet:
        return self.column(name, lambda i, cell: repr(float(cell) * factor + add))

    def cell(self, name: str, row: int, text: str) -> Sheet:
        return self.column(name, lambda i, cell: text if i == row else cell)

    def called(self, name: str, other: str) -> Sheet:
        return replace(self, head=tuple(other if head == name else head for head in self.head))

    def without(self, name: str) -> Sheet:
        k = self.head.index(name)
        cut = [tuple(c for j, c in enumerate(row) if j != k) for row in (self.head, *self.rows)]
        return replace(self, head=cut[0], rows=tuple(cut[1:]))

    def beside(self, name: str, cells: Callable[[int], str]) -> Sheet:
        rows = tuple((*row, cells(i)) for i, row in enumerate(self.rows))
        return replace(self, head=(*self.head, name), rows=rows)

    def only(self, count: int) -> Sheet:
        return replace(self, rows=self.rows[:count])

    def again(self, *which: int) -> Sheet:
        return replace(self, rows=(*self.rows, *(self.rows[i] for i in which)))

    def stating(self, **stated: Any) -> Sheet:
        return replace(self, stated={**self.stated, **stated})


def sheet(columns: dict[str, np.ndarray], **stated: Any) -> Sheet:
    rows = zip(*(column.tolist() for column in columns.values()))
    return Sheet(tuple(columns), tuple(tuple(map(str, row)) for row in rows), stated)


def of_gpm2002(tracked: bool = False) -> Sheet:
    data = planned(n=30, repeats=2, visits=1, tracked=tracked)
    rng = np.random.default_rng(2)
    names = ["t_s", "pose_id", "visit_id", *(f"enc_{i}" for i in (1, 2, 3)), *("xy" if tracked else "")]
    sigma = {"e": 5e-5, "x": 0.02, "y": 0.02}
    columns = {n: data[n] + (sigma[n[0]] * rng.standard_normal(len(data)) if n[0] in sigma else 0) for n in names}
    columns["split"] = np.where(data["pose_id"] % 4 == 0, "hold", "train")
    return sheet(columns, sigma_enc=5e-5, **({"sigma_xy": 0.02} if tracked else {}))


def of_orthoglide() -> Sheet:
    data = printed("exp2")
    columns = {name: data[name] for name in ("leg", "direction", "posture", "level_mm", "deviation")}
    split = np.where(np.arange(len(data)) % 4 == 0, "hold", "train")
    return sheet({**columns, "split": split}, sigma=0.01, free="rho")


def of_arm() -> Sheet:
    data = readings()
    split = np.where(data["pose_id"] % 4 == 0, "hold", "train")
    return sheet({"t_s": np.arange(len(data)) * 2.0, **data.columns, "split": split})


MAKE = {"gpm2002": of_gpm2002, "tracked": lambda: of_gpm2002(True), "orthoglide": of_orthoglide, "arm": of_arm}
SHEETS = {name: make() for name, make in MAKE.items()}
READING = {"gpm2002": "enc_2", "tracked": "enc_2", "orthoglide": "deviation", "arm": "enc_2"}
NAMED = {"gpm2002": "gpm2002", "tracked": "gpm2002", "orthoglide": "orthoglide", "arm": "two_link"}


def machine_of(which: str) -> Any:
    return Arm(instruments=SENSORS) if which == "arm" else machines.make(NAMED[which])


def at_the_door(which: str, probe: Sheet, folder: Any, ending: str = ".csv") -> Any:
    """Return the formulation that the door lets pass."""
    path = folder / f"probe{ending}"
    path.write_bytes(probe.text())
    return validate(machine_of(which), read_measured(path, NAMED[which], probe.stated))


def refusal(which: str, probe: Sheet, folder: Any) -> str:
    with pytest.raises(DataError) as caught:
        at_the_door(which, probe, folder)
    line = str(caught.value)
    assert "\n" not in line
    assert len(line) < 700
    return line


def machines_of(where: str) -> list[str]:
    return ["gpm2002", "orthoglide", "arm"] if where == "all" else where.split()


def nothing(i: int, cell: str = "") -> str:
    return ""


REFUSED: dict[str, tuple[str, Callable[[Sheet, str], Sheet], str]] = {
    # name: (machines, what is wrong: (sheet, its reading) -> sheet, what is said)
    "a_split_of_another_word": ("all", lambda s, r: s.cell("split", 3, "test"), "split holds 'test'; train"),
    "a_split_that_is_misspelt": ("all", lambda s, r: s.cell("split", 3, "holdd"), "split holds 'holdd'; train"),
    "a_split_of_numbers": ("all", lambda s, r: s.column("split", lambda i, c: str(i % 2)), "split holds '0'; train"),
    "all_rows_are_held": (
        "all",
        lambda s, r: s.column("split", lambda i, c: "Hold"),
        "holds back every row; some must",
    ),
    "no_row_is_valid": ("all", lambda s, r: s.beside("valid", lambda i: "0"), "valid marks no row as valid; mark"),
    "valid_of_another_word": ("all", lambda s, r: s.beside("valid", lambda i: "maybe"), "valid holds 'maybe'; true or"),
    "a_unit_in_german": ("all", lambda s, r: s.called(r, f"{r} [Grad]"), "'Grad' may be degrees or gon"),
    "a_unit_in_round_brackets": ("all", lambda s, r: s.called(r, f"{r} (Grad)"), "'Grad' may be degrees or gon"),
    "a_unit_in_wide_brackets": ("all", lambda s, r: s.called(r, f"{r}【度】"), "'度' is unknown; choices"),
    "a_unit_behind_a_slash": ("all", lambda s, r: s.called(r, f"{r} / Grad"), "'Grad' may be degrees or gon"),
    "a_column_that_is_missing": ("all", lambda s, r: s.without(r), "missing; nearest|no column|is missing; there are"),
    "a_column_of_another_name": ("all", lambda s, r: s.called(r, "Winkel 2"), "Winkel 2"),
    "all_cells_are_missing": ("all", lambda s, r: s.column(r, nothing), "no row has|no finite number in|no row has a"),
    "all_values_are_infinite": ("all", lambda s, r: s.column(r, lambda i, c: "inf"), "no row has|no finite number in"),
    "most_cells_are_missing": (
        "arm",
        lambda s, r: s.column(r, lambda i, c: "" if i % 3 else c),
        "enc_2 holds no finite number in 120 of 180 rows",
    ),
    "one_row": ("gpm2002", lambda s, r: s.only(1).cell("split", 0, "train"), "too few for 11 parameters; measure"),
    "sigma_of_nothing": ("gpm2002", lambda s, r: s.stating(sigma_enc=0), "sigma_enc=0: a positive number is needed"),
    "sigma_below_nothing": ("gpm2002", lambda s, r: s.stating(sigma_enc=-1e-5), "sigma_enc=-1e-05: a positive number"),
    "sigma_of_words": ("gpm2002", lambda s, r: s.stating(sigma_enc="small"), "sigma_enc='small': a positive number"),
    "sigma_of_a_gauge_of_nothing": ("orthoglide", lambda s, r: s.stating(sigma=0), "sigma"),
    "degrees_that_are_not_stated": (
        "gpm2002 tracked",
        lambda s, r: s.times(r, 180 / np.pi),
        "radians are needed .mult",
    ),
    "metres_of_a_gauge": ("orthoglide", lambda s, r: s.times(r, 1e-3), "look like metres, millimetres are needed"),
    "micrometres_of_a_gauge": ("orthoglide", lambda s, r: s.times(r, 1e4), "look like micrometres, millimetres"),
    "metres_on_an_own_machine": (
        "arm",
        lambda s, r: s.times("x", 1e-3).times("y", 1e-3),
        "if x, y are multiplied by 1000: look like m; state",
    ),
    "one_coordinate_in_metres": ("arm", lambda s, r: s.times("y", 1e-3), "if y is multiplied by 1000: looks like m"),
    "degrees_on_an_own_machine": (
        "arm",
        lambda s, r: s.times("enc_1", 180 / np.pi).times("enc_2", 180 / np.pi),
        "if enc_1, enc_2 are multiplied by 0.0174533: look like deg; state the unit",
    ),
    "three_radians_off": (
        "arm",
        lambda s, r: s.times(r, 1, 3.0),
        r"if -2\.\d+ rad is added to enc_2.* start z2 at -2\.\d+, outside its bounds",
    ),
    "an_encoder_that_counts_backwards": ("arm", lambda s, r: s.times("enc_1", -1), "enc_1 is multiplied by -1"),
    "copies_of_some_rows": (
        "gpm2002 tracked arm",
        lambda s, r: s.again(3, 7),
        r"rows 4 and \d+, 8 and \d+ are the same",
    ),
    "copies_with_numbers_of_lines_of_their_own": (
        "gpm2002 tracked arm",
        lambda s, r: s.again(3, 7).beside("line", lambda i: str(10 * i + 10)),
        r"rows 4 and \d+, 8 and \d+ are the same in every column but line, which counts them",
    ),
    "copies_that_are_numbered_on_from_elsewhere": (
        "gpm2002 arm",
        lambda s, r: s.again(3, 7).beside("line", lambda i: str(i if i < len(s.rows) else i + 500)),
        r"rows 4 and \d+, 8 and \d+ are the same",
    ),
    "copies_with_names_of_their_own": (
        "gpm2002 arm",
        lambda s, r: s.again(3, 7).beside("line", lambda i: f"R{i:04d}"),
        r"rows 4 and \d+, 8 and \d+ are the same",
    ),
    "copies_with_numbers_of_lines_among_rows_that_are_not_valid": (
        "arm",
        lambda s, r: s.again(3, 7).beside("line", lambda i: str(5 * i)).beside("valid", lambda i: str(int(i % 9 != 5))),
        r"rows 4 and \d+, 8 and \d+ are the same",
    ),
    "copies_without_a_time": (
        "gpm2002 arm",
        lambda s, r: s.without("t_s").again(3),
        r"rows 4 and \d+ .*to the last digit",
    ),
    "copies_under_another_split": (
        "arm",
        lambda s, r: s.again(3).column("split", lambda i, c: "hold" if i == len(s.rows) else c),
        "rows 4 and",
    ),
    "a_time_of_words": (
        "arm gpm2002",
        lambda s, r: s.column("t_s", lambda i, c: "noon"),
        "t_s, reading 1: 'noon' is no",
    ),
    "too_few_poses": ("gpm2002", lambda s, r: s.only(10), "too few for 11 parameters; measure"),
    "columns_of_what_is_not_there": ("all", lambda s, r: s.stating(columns={r: "Winkle"}), "is to be 'Winkle'; "),
    "columns_of_words_for_numbers": (
        "gpm2002",
        lambda s, r: s.called(r, "Wert").column("Wert", lambda i, c: "rechts").stating(columns={r: "Wert"}),
        "is to be 'Wert', which holds 'rechts', no number",
    ),
    "columns_of_what_the_machine_has_not": (
        "gpm2002 orthoglide",
        lambda s, r: s.called(r, "Wert").stating(columns={"enc_9": "Wert"}),
        "is no column of",
    ),
    "columns_onto_what_is_there": (
        "all",
        lambda s, r: s.beside("Wert", lambda i: "1").stating(columns={r: "Wert"}),
        "already",
    ),
    "one_column_for_two": (
        "arm",
        lambda s, r: s.called("x", "W").without("y").stating(columns={"x": "W", "y": "W"}),
        "at once",
    ),
    "columns_of_no_sense": (
        "all",
        lambda s, r: s.stating(columns="enc_1"),
        "columns=enc_1: names with words are needed",
    ),
    "another_machine": (
        "all",
        lambda s, r: replace(s, before='# measured_data: {"machine": "lathe"}\n'),
        "'lathe' is none of",
    ),
    "an_encoder_that_never_varies": ("gpm2002", lambda s, r: s.column(r, lambda i, c: "1.5"), "enc_2 never varies: is"),
    "one_coordinate_of_every_kind_of_unit": (
        "arm",
        lambda s, r: s.called("x", "x [m]").called("y", "y [rad]"),
        "cannot be turned into mm|cannot be turned",
    ),
    "half_the_rows_in_another_world": (
        "arm",
        lambda s, r: s.column("x", lambda i, c: "1e9" if i % 5 == 0 else c),
        "times further from the model",
    ),
}
CASES = [(probe, which) for probe, (where, _, _) in REFUSED.items() for which in machines_of(where)]


@pytest.mark.parametrize(("probe", "which"), CASES)
def test_what_cannot_be_used_is_refused_in_a_line_that_says_what_to_do(probe: str, which: str, tmp_path: Any) -> None:
    _, spoil, said = REFUSED[probe]
    line = refusal(which, spoil(SHEETS[which], READING[which]), tmp_path)
    assert re.search(said, line), line


@pytest.mark.parametrize("which", list(SHEETS))
def test_what_is_sound_passes_the_door_without_a_remark(which: str, tmp_path: Any) -> None:
    formulation = at_the_door(which, SHEETS[which], tmp_path)
    assert len(formulation.data) == len(SHEETS[which].rows)
    of_the_door = "left out|copies|never varies|jumps|backwards|not valid|turned into|held out"
    assert not [note for note in formulation.data.notes if re.search(of_the_door, note.text)]


def semicolons(s: Sheet) -> Sheet:
    rows = tuple(tuple(cell.replace(".", ",") for cell in row) for row in s.rows)
    return replace(s, rows=rows, parted=";")


def iso(i: int, cell: str) -> str:
    return f"2026-03-01T12:{i // 60:02d}:{i % 60:02d}"


def wrapped(s: Sheet, name: str) -> Sheet:
    middle = float(np.median([float(row[s.head.index(name)]) for row in s.rows]))
    return s.column(name, lambda i, cell: repr(float(cell) + 2 * np.pi * (float(cell) < middle)))


_AS_IT_IS: dict[str, Any] = {}


def as_it_is(which: str, folder: Any) -> Any:
    if which not in _AS_IT_IS:
        _AS_IT_IS[which] = at_the_door(which, SHEETS[which], folder)
    return _AS_IT_IS[which]


ALIKE: dict[str, tuple[str, Callable[[Sheet, str], Sheet]]] = {  # other ways to write the same readings
    "decimal_commas": ("arm", lambda s, r: semicolons(s)),
    "windows_letters": ("arm", lambda s, r: replace(s.beside("Höhe", lambda i: "1"), encoding="cp1252")),
    "utf_16": ("arm", lambda s, r: replace(s, encoding="utf-16")),
    "a_preamble": ("arm", lambda s, r: replace(s, before="Tracker AT960\nOperator: Anna\n\n")),
    "capitals_of_split": ("all", lambda s, r: s.column("split", lambda i, cell: cell.upper())),
    "names_of_its_own": ("arm", lambda s, r: s.called(r, "Wert 2").stating(columns={r: "Wert 2"})),
    "names_as_a_word": ("arm", lambda s, r: s.called(r, "Wert 2").stating(columns=f"{r}:Wert 2")),
    "times_by_the_clock": ("arm", lambda s, r: s.column("t_s", iso)),
    "milliradians": ("arm gpm2002", lambda s, r: s.times(r, 1e3).called(r, f"{r} (mrad)")),
    "degrees_that_say_so": ("arm gpm2002", lambda s, r: s.times(r, 180 / np.pi).called(r, f"{r} [°]")),
    "degrees_by_name": (
        "arm gpm2002",
        lambda s, r: s.times(r, 180 / np.pi).called(r, "W2_deg").stating(columns={r: "W2_deg"}),
    ),
    "a_unit_that_is_stated_beside": (
        "arm gpm2002",
        lambda s, r: (
            s.times(r, 180 / np.pi).called(r, "Winkel (Grad)").stating(columns={r: "Winkel"}, units={r: "deg"})
        ),
    ),
    "micrometres": ("orthoglide", lambda s, r: s.times(r, 1e3).called(r, f"{r} / µm")),
}


@pytest.mark.parametrize(
    ("way", "which"),
    [(way, which) for way, (where, _) in ALIKE.items() for which in machines_of(where)],
)
def test_a_file_may_be_written_in_many_ways(way: str, which: str, tmp_path: Any) -> None:
    wanted = as_it_is(which, tmp_path)
    found = at_the_door(which, ALIKE[way][1](SHEETS[which], READING[which]), tmp_path)
    for name in (*wanted.readings, "split"):
        if wanted.data[name].dtype.kind == "f":
            np.testing.assert_allclose(found.data[name], wanted.data[name], rtol=1e-12)
        else:
            assert found.data[name].tolist() == wanted.data[name].tolist()


TOLD: dict[str, tuple[str, Callable[[Sheet, str], Sheet], str]] = {
    "some_cells_are_missing": (
        "all",
        lambda s, r: s.cell(r, 2, "n/a").cell(r, 5, "-").cell(r, 6, ""),
        "3 rows .*left out",
    ),
    "some_values_are_infinite": ("all", lambda s, r: s.cell(r, 2, "inf").cell(r, 3, "-inf"), "2 rows .*left out"),
    "some_rows_are_not_valid": ("all", lambda s, r: s.beside("valid", lambda i: str(int(i > 1))), "2 rows .* left out"),
    "a_time_that_runs_backwards": (
        "arm gpm2002",
        lambda s, r: s.column("t_s", lambda i, c: str(1000 - i)),
        "backwards",
    ),
    "an_angle_that_jumps_by_a_turn": ("arm", lambda s, r: wrapped(s, "enc_1"), "enc_1 jumps by whole turns"),
    "an_angle_that_jumps_there_too": (
        "gpm2002",
        lambda s, r: wrapped(s, r),
        "enc_2 jumps by a turn; whole turns are taken out",
    ),
    "a_few_copies_on_a_coarse_scale": (
        "orthoglide",
        lambda s, r: s.again(5),
        "rows 6 and 13 are the same .* leave out",
    ),
    "a_constant_column": ("arm", lambda s, r: s.column("y", lambda i, c: "1"), "y never varies: is it read"),
    "a_cell_out_of_this_world": ("arm", lambda s, r: s.cell("x", 4, "1e9"), r"row 5 left out.*x is 1e\+09"),
    "no_row_is_held": ("arm gpm2002", lambda s, r: s.column("split", lambda i, c: "train"), "no rows are held out"),
    "copies_on_a_coarse_scale": ("orthoglide", lambda s, r: s.again(*range(12)), "12 copies, more than .* no noise is"),
    "mixed_units": ("arm", lambda s, r: s.times("x", 1e-3).called("x", "x [m]"), "x: stated in m, turned into mm"),
    "empty_words_of_split": ("all", lambda s, r: s.cell("split", 1, ""), "1 rows have no split and are fitted"),
}


@pytest.mark.parametrize(
    ("probe", "which"),
    [(p, m) for p, (where, _, said) in TOLD.items() for m in machines_of(where)],
)
def test_what_only_costs_something_is_told(probe: str, which: str, tmp_path: Any) -> None:
    _, change, said = TOLD[probe]
    notes = at_the_door(which, change(SHEETS[which], READING[which]), tmp_path).data.notes
    assert any(re.search(said, note.text) for note in notes), notes


@dataclass(frozen=True)
class Many:
    """A machine of somebody's own with more parameters than it has equations."""

    name: str = "many"

    def formulate(self, data: discrepancy.MeasuredData) -> discrepancy.Constraints:
        names = [f"p{k}" for k in range(35)]

        def closure(q: Any) -> Any:
            return (q["y"] - sum(q[name] * np.cos(k * q["x"]) for k, name in enumerate(names)))[:, None]

        return discrepancy.Constraints(
            data, closure, tuple(Parameter(name, "mm", 0.1, -1.0, 1.0) for name in names), {"x": 1e-3, "y": 1e-2}
        )


def test_thirty_poses_with_thirty_five_parameters_are_answered_in_words() -> None:
    x = np.linspace(0.0, 3.0, 30)
    data = discrepancy.MeasuredData({"x": x, "y": np.cos(x)}, "many")
    try:
        said = " ".join(map(str, discrepancy.explain(Many(), data).notes))
    except DataError as error:
        said = str(error)
    assert re.search("30 .*35|35 .*30|held|not determined", said), said
    assert "\n" not in said


@pytest.mark.parametrize("sigma", [0.0, -1.0, float("nan"), "small"])
def test_a_noise_of_an_own_machine_that_is_none_is_refused(sigma: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    data = readings()
    monkeypatch.setitem(arm.SIGMA, "angle", sigma)
    with pytest.raises(DataError, match="noise of enc_1"):
        Arm().formulate(data)


@pytest.mark.parametrize(("which", "key"), [("gpm2002", "sigma"), ("gpm2002", "sigma_encc"), ("arm", "sigma_enc")])
def test_what_is_stated_and_read_by_nothing_is_refused(which: str, key: str, tmp_path: Any) -> None:
    path = tmp_path / "probe.csv"
    path.write_bytes(SHEETS[which].text())
    data = read_measured(path, NAMED[which], {**SHEETS[which].stated, key: 1e-5})
    with pytest.raises(DataError, match=rf"{key}= "):
        discrepancy.explain(machine_of(which), data)


def test_what_an_own_machine_reads_may_be_stated() -> None:
    @dataclass(frozen=True)
    class Stating:
        name: str = "two_link"

        def formulate(self, data: discrepancy.MeasuredData) -> discrepancy.Constraints:
            assert data.metadata["payload"] == 3
            return Arm().formulate(data)

    data = replace(readings(), metadata={"payload": 3}, stated=frozenset({"payload"}))
    assert discrepancy.explain(Stating(), data).verdict == "none"


def test_of_many_parameters_outside_their_bounds_the_furthest_have_their_numbers() -> None:
    parameters = [Parameter(f"p{k}", "mm", 0.0, -1.0, 1.0) for k in range(15)]
    ends = {p.name: 0.5 + k for k, p in enumerate(parameters)}
    out, shown = outside_bounds(parameters, ends)
    assert out == tuple(f"p{k}" for k in range(14, 0, -1))
    assert shown.startswith("p14 ends at 14.5 mm, outside -1 to 1; p13 ends at 13.5 mm")
    assert shown.count(" mm") == 3
    assert "; outside theirs are 11 more: p11, p10," in shown
    assert outside_bounds(parameters[:5], ends)[1].count(" mm") == 4
    assert outside_bounds([replace(parameters[1], unit="")], ends)[1] == "p1 ends at 1.5, outside -1 to 1"


def test_a_parameter_that_ends_outside_its_bounds_is_told_first(monkeypatch: pytest.MonkeyPatch) -> None:
    first = replace(arm.PARAMETERS[0], lower=399.0, upper=400.5)
    monkeypatch.setattr(arm, "PARAMETERS", (first, *arm.PARAMETERS[1:]))
    notes = discrepancy.explain(Arm(), readings()).notes
    assert re.match(r"la ends at 401\.\d+ mm, outside 399 to 400.5: the fit is free of bounds", notes[0].text)


@pytest.mark.parametrize(
    ("name", "values", "found"),
    [
        ("line", lambda i: 7 * i, True),
        ("line", lambda i: 3 - 2 * i, False),  # it runs down
        ("clock_ms", lambda i: 1000 * i + i * i % 7, False),  # a real time, under another name
        ("level", lambda i: i // 2, False),
        ("t_s", lambda i: 10.0 * i, False),  # read at regular moments
    ],
)
def test_a_column_makes_rows_differ_unless_it_only_counts_them(name: str, values: Any, found: bool) -> None:
    rows = np.r_[np.arange(12), np.arange(4)]
    data = printed("exp2").rows(rows)
    formulation = machines.make("orthoglide").formulate(data)
    told = data.with_columns({name: np.array([values(i) for i in range(16)])})
    _, note = copied_rows(told, np.arange(1, 17), formulation)
    assert (note is not None) == found
    if note is not None:
        assert f"are the same in every column but {name}, which counts them" in note.text


def test_no_noise_is_learned_from_copies() -> None:
    wanted = discrepancy.explain("orthoglide", printed("exp2"))
    rows = np.r_[np.arange(12), np.arange(12)]
    found = discrepancy.explain("orthoglide", printed("exp2").rows(rows))
    assert any("no noise is learned from them" in note.text for note in found.notes)
    assert found.gap == wanted.gap


def test_repeats_are_told_by_poses_alone() -> None:
    whole = readings()
    alone = replace(whole, columns={name: column for name, column in whole.columns.items() if name != "visit_id"})
    pairs = pairs_of(validate(Arm(), alone).data)
    assert sorted(zip(*pairs)) == sorted(zip(*pairs_of(whole)))


def test_a_sensor_declares_the_unit_of_its_column(tmp_path: Any) -> None:
    path = tmp_path / "probe.csv"
    sound = SHEETS["arm"].called("enc_1", "enc_1 [mrad]").times("enc_1 [mrad]", 1e3)
    path.write_bytes(sound.text())
    in_degrees = (replace(SENSORS[0], unit="deg"), *SENSORS[1:])
    found = Arm(instruments=in_degrees).formulate(read_measured(path, "two_link")).data
    np.testing.assert_allclose(np.deg2rad(found["enc_1"]), readings()["enc_1"])
    assert any("enc_1: in rad from the file, turned into deg" in note.text for note in found.notes)
