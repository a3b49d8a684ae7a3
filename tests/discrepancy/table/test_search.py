"""What a table's base function misses is named: cycles, shapes, lags; and a shuffled column is not."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.measured import read_measured
from calibench.discrepancy import DataError, MeasuredData
from calibench.discrepancy.machines.table import Table
from calibench.discrepancy.report import Doubt
from calibench.problems.suites.nist.regression import table
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")

GIVEN = Path(os.environ.get("CALIBENCH_DATA", Path(__file__).parents[4] / "shared" / "data"))
SILVERBOX = GIVEN / "silverbox" / "SNLS80mV.csv"
N = 200


def rows(seed=0, **columns):
    rng = np.random.default_rng(seed)
    return {"u": rng.uniform(-1, 1, N), "v": rng.uniform(-1, 1, N), **columns}, 0.05 * rng.standard_normal(N)


def searched(columns, y, **options):
    data = MeasuredData({**columns, "y": y}, "table", options.pop("metadata", {}), "made")
    return discrepancy.explain(Table(**options), data)


@pytest.fixture(scope="module")
def enso():
    known = table("ENSO")
    data = MeasuredData({"month": known.x[0].copy(), "y": known.y.copy()}, "table", {}, "enso")
    return discrepancy.explain(Table(), data)


def test_the_three_cycles_of_enso_are_named_and_no_fourth(enso):
    assert [f.effect for f in enso.findings] == ["cycle month", "cycle second month", "cycle third month"]
    assert enso.verdict == "named"
    assert all(len(f.set) == 1 for f in enso.findings)


def test_the_periods_of_enso_are_those_that_nist_certifies(enso):
    known = table("ENSO")
    certified = dict(zip(known.names, zip(known.certified, known.deviations)))
    for finding, name in zip(enso.findings[1:], ("b4", "b7")):
        value, deviation = certified[name]
        assert abs(finding.period - value) < 1.96 * deviation
    year = enso.findings[0]
    reach = 1.96 * year.coefficients[-1].sd
    assert abs(year.period - 12) < reach < 0.3


def test_shuffled_months_have_no_cycle():
    known = table("ENSO")
    months = np.random.default_rng(1).permutation(known.x[0])
    report = discrepancy.explain(Table(), MeasuredData({"month": months, "y": known.y.copy()}, "table", {}, "mixed"))
    assert report.findings == ()


SHAPES = {
    "power u squared": lambda c: 0.2 * c["u"] ** 2,
    "power u cubed": lambda c: 0.3 * c["u"] ** 3,
    "magnitude u": lambda c: 0.2 * np.abs(c["u"]),
    "sign u": lambda c: 0.1 * np.sign(c["u"]),
    "saturation u": lambda c: -0.8 * np.sign(c["u"]) * np.maximum(np.abs(c["u"]) - 0.7, 0),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_of_a_column_is_named(name):
    columns, noise = rows()
    report = searched(
        columns, 1 + columns["u"] + SHAPES[name](columns) + noise, model="line", inputs=("u",), sigma=0.05
    )
    assert report.findings[0].effect == name


def test_a_shuffled_column_loses_the_name():
    columns, noise = rows()
    y = 1 + 0.3 * columns["u"] ** 3 + noise
    assert [f.effect for f in searched(columns, y).findings] != []
    mixed = {**columns, "u": np.random.default_rng(9).permutation(columns["u"])}
    report = searched(mixed, y)
    assert [f.effect for f in report.findings if " u" in f.effect] == []


def test_a_period_that_is_stated_is_named():
    t = np.arange(N, dtype=float) + 0.5
    columns, noise = rows(month=t)
    y = 3 + 0.2 * np.sin(2 * np.pi * t / 12) + noise
    report = searched(columns, y, sigma=0.05, metadata={"periods": {"month": 12}}, covariates=("month",))
    assert "known_cycle once in month" in [r.effect for r in report.findings[0].set]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["column_lag x", "drift y", "step y"])
def test_what_changes_with_time_is_named(name):
    t = np.linspace(0, 100, N)
    x = np.sin(t / 3) + 0.5 * np.sin(t / 1.3)
    _, noise = rows()
    y = 2 * x + noise
    y += {"column_lag x": -0.4 * np.gradient(x, t), "drift y": 0.005 * t, "step y": 0.4 * (t > 61)}[name]
    report = searched({"t_s": t, "x": x}, y, model="line", sigma=0.05, covariates=("x",))
    assert report.findings[0].effect == name


@pytest.mark.parametrize(("unit", "turn"), few(1, [("deg", 360.0), ("rad", 2 * np.pi)]))
def test_of_an_angle_that_covers_a_turn_the_turn_is_a_known_period(unit, turn):
    angle = turn * np.arange(72) / 36
    rng = np.random.default_rng(4)
    y = (
        8 * np.sin(2 * np.pi * angle / turn + 1)
        + 1.5 * np.cos(4 * np.pi * angle / turn)
        + 0.25 * rng.standard_normal(72)
    )
    data = MeasuredData({"Winkel": angle, "y": y}, "table", {}, "turned", units={"Winkel": unit})
    report = discrepancy.explain(Table(), data)
    assert [f.effect for f in report.findings] == ["known_cycle once in Winkel", "known_cycle twice in Winkel"]
    assert not [note for note in report.notes if "too large" in note.text]  # what was learned before is no statement
    half = data.rows(angle < 0.5 * turn)
    assert not [f for f in discrepancy.explain(Table(), half).findings if f.family == "known_cycle"]


@pytest.mark.parametrize(("sigma", "told"), [(0.5, True), (0.05, False), (0.005, False), (None, False)])
def test_a_noise_that_is_stated_too_large_is_told(sigma, told):
    columns, noise = rows()
    options = {} if sigma is None else {"sigma": sigma}
    notes = [
        note for note in searched(columns, noise, **options).notes if "stated noise, which is too large" in note.text
    ]
    assert len(notes) == told
    assert all(re.search(r"what is left is 0\.(09|1)\d* times the stated noise", note.text) for note in notes)


def test_a_period_of_a_column_that_is_not_there_is_refused():
    columns, noise = rows()
    with pytest.raises(DataError, match="did you mean 'u'"):
        searched(columns, noise, metadata={"periods": {"U": 12}})


def test_a_regression_of_nist_lacks_nothing_where_its_data_are_its_own():
    known = table("Misra1a")
    x = np.linspace(50, 800, N)
    b1, b2 = known.certified
    y = b1 * (1 - np.exp(-b2 * x)) + 0.1 * np.random.default_rng(3).standard_normal(N)
    report = searched({"x": x}, y, model="Misra1a", sigma=0.1)
    assert report.verdict == "none"


def test_one_s_own_function_is_a_base(tmp_path):
    file = tmp_path / "of_mine.py"
    file.write_text("def f(u, v, a=1.0, b=0.0):\n    return a * u * v + b\n")
    columns, noise = rows()
    y = 2 * columns["u"] * columns["v"] + 0.5 + noise
    report = searched(columns, y, model=f"{file}:f", sigma=0.05)
    assert report.verdict == "none"
    assert report.parameters["a"].after == pytest.approx(2, abs=0.05)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"measured": "z"}, "machine.measured=z"),
        ({"model": "cubik"}, "machine.model=cubik: unknown model 'cubik'; did you mean 'cubic'"),
        ({"model": "./nothing.py:f"}, "machine.model=./nothing.py:f: .*there is no file"),
        ({"model": "line"}, "machine.inputs=x"),
        ({"model": "line", "inputs": ("u", "v")}, "function of 1 column: x"),
        ({"start": {"b7": 1.0}}, "no parameter 'b7'"),
        ({"held": ("b7",)}, "machine.held=b7"),
        ({"model": "line", "inputs": ("y",)}, "can be no input"),
        ({"back": 500}, "machine.back=500"),
    ],
)
def test_what_does_not_fit_is_told(options, words):
    columns, noise = rows()
    with pytest.raises(DataError, match=words):
        searched(columns, noise, **options)


@pytest.mark.parametrize(
    ("y", "said"), [(np.full(N, 0.1), "y reads 0.1 in all 200 fitted rows"), (np.zeros(N), "y reads 0 in all 200")]
)
def test_a_measured_column_that_never_varies_is_told_by_name(y, said):
    with pytest.raises(DataError, match=said):
        searched(rows()[0], y)
    assert searched(rows()[0], y, sigma=0.05).verdict == "none"


def test_a_measured_column_that_counts_on_by_one_is_no_number_of_rows():
    counter = np.arange(1, 41)
    report = discrepancy.explain(Table(), MeasuredData({"u": counter**2 % 17, "y": counter}, "table", {}, "made"))
    assert not any("are the same in every column" in note.text for note in report.notes)


def test_a_single_row_to_fit_is_told():
    columns, noise = rows(split=np.array(["train", *["hold"] * (N - 1)]))
    with pytest.raises(DataError, match="in the only fitted row"):
        searched(columns, noise)


@pytest.mark.slow
@pytest.mark.skipif(not SILVERBOX.is_file(), reason=f"no measured data at {GIVEN}; CALIBENCH_DATA names a folder")
def test_the_cubic_spring_of_the_silverbox_comes_first():
    whole = read_measured(SILVERBOX, "table")
    part = whole.rows(np.arange(60_000, 60_600))
    machine = Table("linear", "V2", ("V1", "V1_1", "V1_2", "V2_1", "V2_2"), back=2, covariates=("V2_1",), unit="V")
    report = discrepancy.explain(machine, part)
    assert report.findings[0].effect == "power V2_1 cubed"
    assert report.gap.held_out_after < 0.6 * report.gap.held_out_before


def test_a_cause_whose_column_has_a_few_empty_cells_is_named_all_the_same():
    columns, noise = rows()
    y = noise + 0.4 * columns["v"]
    columns["v"] = np.where(np.arange(N) % 20 == 3, np.nan, columns["v"])
    report = searched(columns, y, inputs=("u",), sigma=0.05, model="line")
    assert [f.target for f in report.findings] == ["v"]
    assert any(
        "10 rows are left out for cells that hold no finite number: v in 10" in note.text for note in report.notes
    )


def test_a_column_with_many_empty_cells_costs_no_row_and_is_not_called_constant():
    columns, noise = rows()
    columns["v"] = np.where(np.arange(N) % 3 == 0, np.nan, columns["v"])
    report = searched(columns, noise, inputs=("u",), sigma=0.05, model="line")
    said = "column v holds no finite number in 67 of 200 rows"
    assert any(note.text.startswith(said) for note in report.notes)
    reasons = {one.reason for one in report.not_testable if said[:8] in one.reason}
    assert reasons == {said}


def test_a_column_of_two_values_has_one_name():
    side = np.where(np.arange(N) % 2, 1.0, -1.0)
    columns, noise = rows(side=side)
    report = searched(columns, 0.1 * side + noise)
    [found] = report.findings
    assert (report.verdict, found.effect, len(found.set)) == ("named", "power side", 1)
    reasons = {f"{u.family} {u.target}": u.reason for u in report.not_testable}
    assert reasons["sign side"] == "column side has 2 values: a simpler term of it is the same"


def test_a_line_in_the_time_is_a_drift_and_nothing_else():
    columns, noise = rows(t_s=np.arange(N) * 10.0)
    report = searched(columns, 0.2 * np.linspace(0, 1, N) + noise)
    [found] = report.findings
    assert (report.verdict, found.effect, len(found.set)) == ("named", "drift y", 1)


@pytest.mark.parametrize(("centre", "name"), [(27.0, "power warm squared"), (None, "power warm")])
def test_a_parabola_about_a_centre_that_nobody_knows_is_named_and_a_line_is_none(centre, name):
    rng = np.random.default_rng(11)
    warm, force = rng.uniform(10, 40, 150), rng.uniform(-1, 1, 150)
    hidden = 0.004 * (warm - 20) if centre is None else 0.02 * ((warm - centre) / 10) ** 2
    y = force / 1.9 + hidden + 0.005 * rng.standard_normal(150)
    report = searched({"force": force, "warm": warm}, y, model="line", inputs=("force",), sigma=0.005)
    [found] = report.findings
    assert (report.verdict, found.effect, len(found.set)) == ("named", name, 1)
    if centre is not None:
        square, line = found.coefficients
        assert abs(-line.value / (2 * square.value) * np.max(warm) - centre) < 1.0


def test_a_formula_of_what_is_measured_has_its_own_sign():
    rng = np.random.default_rng(8)
    x, y = rng.uniform(-150, 150, (2, 200))
    columns = {"x": x, "y": y, "z": 0.1 + 2.6e-6 * x * y + 0.005 * rng.standard_normal(200)}
    machine = Table(measured="z", sigma=0.005)
    report = discrepancy.explain(machine, MeasuredData(columns, "table", {}, "bed"))
    formula = report.formula
    assert formula.text.startswith("z = model + a x ")  # and y, or a play of y that is hardly less than y
    assert formula.sizes[0].value == pytest.approx(2.6e-6, rel=0.05)
    namespace = {}
    exec(formula.to_effect().replace(").enter()", ")"), namespace)
    [effect] = namespace["build"](machine.formulate(MeasuredData(columns, "table", {}, "bed")), "machine")
    change = effect.shift({"z": columns["z"]}, MeasuredData(columns, "table", {}, "bed"), np.array([2.6e-6]))["z"]
    np.testing.assert_allclose(change, -2.6e-6 * x * y, atol=0.01)  # taken off the reading


def test_a_name_beside_a_formula_has_the_size_that_the_model_gives_it():
    rng = np.random.default_rng(8)
    x, y = rng.uniform(-150, 150, (2, 200))
    z = 0.1 + 2e-6 * x * y + 1.2e-5 * x**2 + 0.005 * rng.standard_normal(200)
    machine = Table(measured="z", sigma=0.005)
    report = discrepancy.explain(machine, MeasuredData({"x": x, "y": y, "z": z}, "table", {}, "bed"))
    [finding] = report.findings
    assert report.formula is not None
    low, high = finding.amplitude.ci95
    assert finding.amplitude.value == pytest.approx(1.2e-5 * np.max(x**2), rel=0.02)
    assert high - low < 0.02  # and not that of a fit with the formula's part as its noise


def test_a_formula_over_the_clock_is_of_this_run_alone():
    rng = np.random.default_rng(4)
    t, u = np.arange(N) * 20.0, rng.uniform(-1, 1, N)
    for units, told in (({"t": "s"}, True), ({}, False)):
        y = 3.0 * u * np.exp(-t / 600) + 0.05 * rng.standard_normal(N)
        data = MeasuredData({"t": t, "u": u, "y": y}, "table", {}, "made", units=units)
        report = discrepancy.explain(Table(measured="y", sigma=0.05), data)
        assert report.formula.over_time == told
        here, there = (report.predict(replace(data, name=name)).measured["y"] for name in ("made", "other"))
        np.testing.assert_allclose(there, np.mean(3.0 * np.exp(-t / 600)) * u if told else here, atol=0.1)


@pytest.mark.parametrize(("cause", "plain"), [(lambda far: np.exp(-far), False), (lambda far: far, True)])
def test_one_function_of_three_columns_is_no_three_names(cause, plain):
    """A bell over u, v and w is no sum of functions of each; the sum of three squares is one."""
    rng = np.random.default_rng(0)
    u, v, w = rng.uniform(-1, 1, (3, 150))
    far = cause(u**2 + v**2 + w**2)
    y = u + 0.5 * v - 0.7 * w + 0.03 * (far - far.mean()) / far.std() + 0.01 * rng.standard_normal(150)
    machine = Table("linear", measured="y", inputs=("u", "v", "w"), sigma=0.01)
    report = discrepancy.explain(machine, MeasuredData({"u": u, "v": v, "w": w, "y": y}, "table", {}, "made"))
    assert {finding.family for finding in report.findings} == {"power"}
    assert len(report.findings) == 3
    assert report.verdict == ("named" if plain else "partly")
    assert all([one.code for one in f.caution] == [Doubt.ONE_CAUSE] * (not plain) for f in report.findings)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_twin_over_another_column_is_a_rival_though_it_has_more_numbers(seed):
    """The torque grows with the distance from the middle of the table: its square is a parabola of the way."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 400, 120)
    y = 6e-7 * (x - 200) ** 2 + 0.005 * rng.standard_normal(120)
    data = MeasuredData({"x": x, "torque": np.abs(x - 200) / 100, "y": y}, "table", {}, "mill")
    [finding] = discrepancy.explain(Table(measured="y", sigma=0.005), data).findings
    assert {"power torque squared", "power x squared"} <= {rival.effect for rival in finding.set}
