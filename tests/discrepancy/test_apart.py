"""A cell that stands apart from its column costs its row and is told; levels and far ends that are meant do not."""

import numpy as np
import pytest

from calibench import discrepancy
from calibench.discrepancy import Joint, MeasuredData, Predicted, Roles
from calibench.discrepancy.checks.validate import validate
from calibench.discrepancy.design.detectability import design
from calibench.problems.base import Parameter

pytestmark = pytest.mark.usefixtures("at_one_noise")

N = 100
PARAMETERS = (Parameter("zero", "rad", 0.0, -0.1, 0.1), Parameter("radius", "mm", 200.0, 190.0, 210.0))


def tip(q):
    angle = q["theta"] + q["zero"]
    return np.stack([q["radius"] * np.cos(angle), q["radius"] * np.sin(angle)], axis=-1)


class Turning:
    name = "turning"

    def formulate(self, data):
        roles = Roles(
            joints=(Joint("axis", "theta", temperature="warmth", torque="load"),), time="clock", columns=("pressure",)
        )
        return Predicted(data, tip, PARAMETERS, {"x": 0.01, "y": 0.01}, inputs=("theta",), roles=roles)


def readings(**cells):
    rng = np.random.default_rng(0)
    theta, warmth = rng.uniform(-0.3, 0.3, N), rng.uniform(0.0, 8.0, N)
    true = theta + 0.003 + 2e-5 * warmth
    xy = 201.0 * np.stack([np.cos(true), np.sin(true)]) + 0.01 * rng.standard_normal((2, N))
    columns = {"theta": theta, "warmth": warmth, "x": xy[0], "y": xy[1], "load": rng.choice([0.0, 5.0], N)}
    columns |= {"pressure": rng.uniform(1.0, 2.0, N), "clock": np.arange(N) + 0.0}
    for name, value in cells.items():
        column = columns[name].copy()
        column[17] = value
        columns[name] = column
    return MeasuredData(columns, "turning", {}, "run")


@pytest.mark.parametrize(("name", "code"), [("warmth", 9999.9), ("pressure", -999.0), ("theta", 9999.9)])
def test_a_code_for_no_value_costs_its_row_and_not_the_verdict(name, code):
    report = discrepancy.explain(Turning(), readings(**{name: code}))
    assert [finding.effect for finding in report.findings] == ["thermal_zero axis"]
    [note] = [note for note in report.notes if "all others lie between" in note.text]
    assert note.text.startswith(f"row 18 left out: {name} is {code:g}, ")
    assert note.text.endswith("correct it, or mark it valid=0")


@pytest.mark.parametrize("cells", [{"load": 500.0}, {"clock": 1e6}, {"warmth": 100.0}, {}])
def test_a_level_a_late_reading_and_a_far_end_are_kept(cells):
    assert len(validate(Turning(), readings(**cells)).data) == N


def test_two_codes_are_left_out_together():
    data = readings(warmth=9999.0)
    warmth = data["warmth"].copy()
    warmth[40] = 9999.0
    assert len(validate(Turning(), data.with_columns({"warmth": warmth})).data) == N - 2


def test_a_design_is_of_the_rows_that_a_search_would_have() -> None:
    plan = design(Turning(), readings(warmth=9999.9))
    assert plan.readings == N - 1
    assert any("warmth is 9999.9" in note.text for note in plan.notes)


def test_a_design_lists_of_waves_that_come_one_after_another_the_first() -> None:
    plan = design(Turning(), readings())
    told = [sight.effect for sight in plan.candidates if sight.family.endswith("periodic_error")]
    assert told == ["periodic_error axis"]
    assert not [names for names in plan.classes if "periodic_error axis" in names and len(names) > 1]
