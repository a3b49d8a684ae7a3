"""What a report predicts at readings that were not fitted, of machines that predict and of one that does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calibench import discrepancy
from calibench.bench.measured import read_measured, shipped_path
from calibench.bench.measured.sources import sources
from calibench.discrepancy import DataError, Instrument, Joint, Length, MeasuredData, Predicted, Roles
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.machines.orthoglide.formulation import planned
from calibench.discrepancy.machines.table import Table
from calibench.discrepancy.report import predicted_at
from calibench.problems.base import Parameter

pytestmark = pytest.mark.usefixtures("at_one_noise")

PARAMETERS = (Parameter("length", "mm", 300.0, 290.0, 310.0), Parameter("zero", "rad", 0.0, -0.1, 0.1))
ROLES = Roles(
    joints=(Joint("pivot", "angle", torque="load"),), lengths=(Length("rod", "length"),),
    instruments=(Instrument("tracker", ("x", "y")),),
)  # fmt: skip
GIVES = 3e-7  # rad/(N mm)
NOISE = 0.01  # mm


def tip(q):
    at = q["angle"] + q["zero"]
    return np.stack([q["length"] * np.cos(at), q["length"] * np.sin(at)], axis=-1)


def test_the_uncertainty_of_an_effect_is_its_own_where_rows_share_noise():
    data = planned("rich").rows(slice(0, 40))
    formulation = discrepancy.machines.make("orthoglide").formulate(data)
    effect = next(e for e in catalogue(formulation).candidates if e.family == "bar_skew" and len(e.coefficients) == 1)
    model = discrepancy.Model(formulation, (effect,))
    sd_of_effect = np.diag([*[0.0] * (model.size - 1), 0.1**2])
    x = model.start

    def deviation(x):
        return predicted_at(model, x, sd_of_effect, x[:-1], data, None).measured["deviation"]

    step = np.eye(model.size)[-1] * 1e-4
    slope = (deviation(x + step) - deviation(x - step)) / 2e-4
    told = predicted_at(model, x, sd_of_effect, x[:-1], data, None).sd["deviation"]
    assert np.ptp(slope) > 0
    np.testing.assert_allclose(told, 0.1 * np.abs(slope), rtol=1e-6, atol=1e-9)


class Pendulum:
    name = "pendulum_that_is_predicted"

    def formulate(self, data):
        return Predicted(data, tip, PARAMETERS, {"x": NOISE, "y": NOISE}, inputs=("angle",), roles=ROLES)


def readings(n, seed):
    """Readings of a rod whose drive gives way, and where its tip truly was: plain numbers, no framework."""
    rng = np.random.default_rng(seed)
    angle, load = rng.uniform(-1, 1, n), rng.normal(0, 2e3, n)
    true = angle + 0.02 - GIVES * load
    place = np.stack([301.3 * np.cos(true), 301.3 * np.sin(true)])
    x, y = place + NOISE * rng.standard_normal((2, n))
    return MeasuredData({"angle": angle, "load": load, "x": x, "y": y}, Pendulum.name), place


@pytest.fixture(scope="module")
def report():
    return discrepancy.explain(Pendulum(), readings(120, 0)[0])


def test_a_report_predicts_where_the_tip_will_be(report):
    new, place = readings(200, 1)
    assert report.findings[0].effect == "compliance pivot"
    told = report.predict(new)
    for name, true in zip("xy", place):
        assert np.all(np.abs(told.measured[name] - true) < 5 * told.sd[name] + 1e-9)
        np.testing.assert_allclose(np.asarray(new[name]) - told.measured[name], told.residuals[:, "xy".index(name)])
    assert np.sqrt(np.mean(told.residuals**2)) == pytest.approx(NOISE, rel=0.15)


def test_what_is_measured_need_not_be_known(report):
    new = readings(20, 2)[0]
    blind = replace(new, columns={name: new[name] for name in ("angle", "load")})
    told, seen = report.predict(blind), report.predict(new)
    np.testing.assert_allclose(told.measured["x"], seen.measured["x"], rtol=1e-12)
    assert np.isnan(told.residuals).all()


def test_an_input_that_is_missing_is_told(report):
    new = readings(20, 2)[0]
    for lost in ("angle", "load"):
        with pytest.raises(DataError, match=lost):
            report.predict(replace(new, columns={name: new[name] for name in new.columns if name != lost}))


def test_a_mount_predicts_from_the_columns_of_its_file():
    night = read_measured(shipped_path("demo_flexure", "mount"), "mount")
    last = np.arange(len(night)) >= len(night) - 10
    told = discrepancy.explain("mount", night.rows(~last)).predict(night.rows(last))
    assert set(told.measured) == {"dX", "dDec"}
    assert np.sqrt(np.mean(told.residuals**2)) < 12  # arcsec; the seeing of that night is 7


def test_a_printer_predicts_from_the_steps_of_its_file():
    """Motor steps become travels on the way in, also of rows that were not fitted and hold no height yet."""
    probes = sources("printer", "delta")[0].read({})
    report = discrepancy.explain("delta", probes)
    few = probes.rows(np.arange(5))
    told = report.predict(replace(few, columns={n: few[n] for n in few.columns if n not in ("height", "distance")}))
    np.testing.assert_allclose(told.measured["height"], report.predict(probes).measured["height"][:5])
    assert np.abs(report.predict(few).residuals).max() < 0.2


@pytest.mark.parametrize("kind", [dict, pd.DataFrame])
def test_heads_with_units_are_read_and_turned_into_those_of_the_fit(report, kind):
    new = readings(5, 3)[0]
    heads = {"angle [deg]": np.rad2deg(new["angle"]), "load [N m]": 1e-3 * new["load"], "x [um]": 1e3 * new["x"]}
    told = report.predict(kind(heads | {"y": new["y"], "day [d]": np.ones(5)}))
    np.testing.assert_allclose(told.residuals, report.predict(new).residuals, atol=1e-9)
    with pytest.raises(DataError, match="readings: column angle is in mm, and in the fit in rad"):
        report.predict({"angle [mm]": [0.1], "load": [0.0]})


def test_rows_beyond_what_was_fitted_are_told_by_column(report):
    assert report.predict({"angle": [0.5], "load": [0.0]}).beyond == {}
    beyond = report.predict({"angle": [0.5, 2.0, -3.0], "load": [0.0, 0.0, 0.0]}).beyond
    assert {name: out.tolist() for name, out in beyond.items()} == {"angle": [False, True, True]}


def test_data_are_shown_in_a_line():
    data = MeasuredData({f"column_{k}": np.zeros(900) for k in range(300)}, "table", {}, "run")
    assert repr(data).startswith("<run of table: 900 rows of column_0, column_1, ")
    assert len(repr(data)) < 200


def test_readings_may_be_a_mapping_of_columns(report):
    new = readings(5, 3)[0]
    told = report.predict({name: new[name].tolist() for name in new.columns})
    for name, values in report.predict(new).measured.items():
        np.testing.assert_array_equal(told.measured[name], values)


def test_a_machine_that_only_constrains_tells_its_constraints():
    data = read_measured(shipped_path("demo_backlash", "gpm2002"), "gpm2002")
    report = discrepancy.explain("gpm2002", data)
    told = report.predict(data.rows(np.arange(7)))
    assert not told.measured
    assert told.residuals.shape == (7, 1)
    with pytest.raises(DataError, match="predicts no reading"):
        report.predict(replace(data, columns={name: data[name] for name in data.columns if name != "enc_2"}))


def test_a_report_read_from_a_file_predicts_nothing(report):
    with pytest.raises(LookupError, match="read from a file"):
        discrepancy.Report.from_dict(report.to_dict()).predict(readings(5, 3)[0])


def test_no_rows_are_told(report):
    with pytest.raises(DataError, match="no rows"):
        report.predict({"angle": [], "load": []})


def test_words_in_a_column_of_numbers_are_refused_in_a_line(report):
    with pytest.raises(DataError, match="column load"):
        report.predict({"angle": [0.1, 0.2], "load": ["down", "up"]})


def test_one_reading_needs_no_list(report):
    one, listed = (report.predict({"angle": a, "load": b}) for a, b in ((0.1, 5.0), ([0.1], [5.0])))
    assert {name: values.tolist() for name, values in one.measured.items()} == {
        name: values.tolist() for name, values in listed.measured.items()
    }


@pytest.mark.parametrize("readings", [[1.0, 2.0], None, np.zeros((3, 2))])
def test_what_are_no_readings_is_told(report, readings):
    with pytest.raises(DataError, match="mapping of name to numbers"):
        report.predict(readings)


def test_a_row_of_which_an_input_is_not_known_has_no_prediction(report):
    told = report.predict({"angle": [0.1, float("nan")], "load": [5.0, 5.0]})
    for values in told.measured.values():
        assert np.isfinite(values).tolist() == [True, False]


def test_a_smooth_course_over_the_clock_says_nothing_of_another_run(without_formula):
    """The zero wanders while 150 rows are read; in the next run, numbered alike, it wanders otherwise."""
    part, u = np.linspace(0, 1, 150), np.random.default_rng(2).uniform(-1, 1, 150)
    wander = 0.4 * np.sign(np.sin(7 * part)) * np.exp(part) * np.abs(np.sin(9 * part**2))
    y = 1 + 2 * u + wander + 0.05 * np.random.default_rng(3).standard_normal(150)
    data = MeasuredData({"row": np.arange(1, 151), "u": u, "y": y}, "table", {}, "monday")
    report = discrepancy.explain(Table("line", measured="y", inputs=("u",), sigma=0.05), data)
    assert (report.verdict, report.unnamed[0].covariate) == ("unknown", "row")
    here, there = report.predict(data), report.predict(replace(data, name="tuesday"))
    assert here.beyond == {}
    assert np.std(here.residuals) < 0.5 * np.std(wander)
    assert {name: out.all() for name, out in there.beyond.items()} == {"row": True}
    np.testing.assert_allclose(there.measured["y"], 1 + 2 * u + np.mean(wander), atol=0.05)
    unnamed = report.predict({"row": data["row"], "u": u})
    np.testing.assert_allclose(unnamed.measured["y"], there.measured["y"], rtol=1e-12)
