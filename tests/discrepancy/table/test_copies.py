"""A column that is the measured one, or an input, in other numbers: told, and not named as what is missing."""

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.discovery.batch import read_discover
from calibench.bench.measured import read_measured
from calibench.discrepancy import MeasuredData
from calibench.discrepancy.machines.table import Table
from calibench.discrepancy.machines.table.formulation import said_again

N = 40


def table(**columns):
    return MeasuredData(columns, "table", {}, "made")


def readings(seed=1):
    """Return an input, and volts to four digits that follow it by a line and its cube."""
    rng = np.random.default_rng(seed)
    u = np.linspace(0, 4000, N)
    return u, np.round(0.3 * (u / 4000) + 0.5 * (u / 4000) ** 3 + 0.002 * rng.standard_normal(N), 4)


def test_what_was_computed_from_the_reading_is_no_cause_of_it() -> None:
    """It was named as what is missing, with no interval and an error of 0.00 times what it was."""
    u, volts = readings()
    report = discrepancy.explain(
        Table(model="line", inputs=("u",), measured="volts"), table(u=u, volts=volts, dbm=-40 * volts + 20)
    )
    assert [f.effect for f in report.findings] == ["power u cubed"]
    assert any("volts is -0.025 times dbm + 0.5 in all rows" in note.text for note in report.notes)


def test_a_correction_of_some_readings_is_the_same_reading() -> None:
    u, volts = readings()
    corrected = volts.copy()
    corrected[[5, 11, 23]] += 0.05
    report = discrepancy.explain(
        Table(model="line", inputs=("u",), measured="volts"), table(u=u, volts=volts, corrected=corrected)
    )
    assert [f.effect for f in report.findings] == ["power u cubed"]
    assert any("volts is 1 times corrected in 37 of 40 rows" in note.text for note in report.notes)


def test_an_input_in_another_unit_is_no_second_name() -> None:
    u, volts = readings()
    report = discrepancy.explain(
        Table(model="line", inputs=("u",), measured="volts"), table(u=u, kilo=u / 1000, volts=volts)
    )
    assert [f.effect for f in report.findings] == ["power u cubed"]
    assert len(report.findings[0].set) == 1
    assert any("u is 1000 times kilo in all rows" in note.text for note in report.notes)


def test_a_column_that_is_named_is_looked_at() -> None:
    u, volts = readings()
    report = discrepancy.explain(
        Table(model="line", inputs=("u",), measured="volts", covariates=("dbm",)),
        table(u=u, volts=volts, dbm=-40 * volts + 20),
    )
    assert [f.effect for f in report.findings] == ["power dbm"]


def test_the_only_column_is_looked_at_though_the_reading_is_a_line_of_it() -> None:
    u = np.linspace(0, 10, N)
    formulation = Table().formulate(table(u=u, y=np.round(2 * u, 3)))
    assert formulation.roles.columns == ("u",)
    assert formulation.data.notes == ()


def test_rounding_of_either_column_is_allowed_for_and_no_more() -> None:
    cm = np.arange(20.0, 220.0, 5.0)
    assert "in all rows" in said_again("cm", cm, "in", np.round(cm / 2.54))
    rng = np.random.default_rng(3)
    near = cm / 2.54 + 0.6 * rng.standard_normal(N)
    assert said_again("cm", cm, "near", near) == ""
    assert said_again("y", np.sign(cm - 100) + 0.01 * rng.standard_normal(N), "side", np.sign(cm - 100)) == ""
    assert said_again("y", np.ones(N), "c", cm) == ""


@pytest.mark.parametrize("typed", ["Raw Data", "Raw Data, kilo volts", "kilo volts,Raw Data"])
def test_a_column_with_a_space_in_its_name_can_be_an_input(tmp_path, typed) -> None:
    """`machine.inputs=Raw Data` was taken for two columns."""
    u, volts = readings()
    file = tmp_path / "run.csv"
    file.write_text("Raw Data,kilo volts,y\n" + "".join(f"{a:.3f},{b + 1:.4f},{b}\n" for a, b in zip(u, volts)))
    asked = read_discover(
        [f"data={file}", "machine=table", f"machine.inputs={typed}", "machine.measured=y", "machine.model=linear"]
    )
    formulation = asked.build_machine().formulate(read_measured(file, "table"))
    assert formulation.inputs == tuple(name.strip() for name in typed.split(","))
