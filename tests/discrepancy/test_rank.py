"""A parameter that data do not determine is named and held, without a standard error; equations count by rank."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from calibench import discrepancy
from calibench.discrepancy import DataError, MeasuredData, Predicted, explain
from calibench.problems.base import Parameter
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")

NUMBERS = (
    Parameter("la", "mm", 400.0, 390.0, 410.0),
    Parameter("z1", "rad", 0.0, -0.1, 0.1),
    Parameter("base", "rad", 0.0, -0.1, 0.1),
    Parameter("unseen", "mm", 5.0, 0.0, 10.0),
)


def tip(q):
    angle = q["one"] + q["z1"] + q["base"]
    return np.stack([q["la"] * np.cos(angle), q["la"] * np.sin(angle)], axis=-1)


@dataclass(frozen=True)
class Pointer:
    numbers: tuple[Parameter, ...] = NUMBERS
    name: str = "pointer"
    predict: object = field(default=tip)

    def formulate(self, data):
        return Predicted(data, self.predict, self.numbers, {"x": 0.02, "y": 0.02}, inputs=("one",))


def readings(n=40, seed=3):
    rng = np.random.default_rng(seed)
    one = rng.uniform(-1.5, 1.5, n)
    x, y = 401.0 * np.cos(one + 0.02), 401.0 * np.sin(one + 0.02)
    noise = 0.02 * rng.standard_normal((2, n))
    return MeasuredData({"one": one, "x": x + noise[0], "y": y + noise[1]}, "pointer")


@pytest.fixture(scope="module")
def report():
    return discrepancy.explain(Pointer(), readings())


def test_what_the_data_cannot_tell_is_named_and_held(report):
    assert report.verdict == "none"
    notes = " ".join(map(str, report.notes))
    assert "these data do not determine unseen: unseen is held at 5 mm and has no standard error" in notes
    assert "cannot tell base from z1: only a combination of them is determined; base is held at 0 rad" in notes


def test_what_is_held_carries_no_error_and_the_rest_does(report):
    told = report.parameters
    assert set(told) == {"la", "z1", "base", "unseen"}
    assert np.isnan([told[name].sd for name in ("z1", "base", "unseen")]).all()
    assert (told["base"].after, told["unseen"].after) == (0.0, 5.0)
    assert told["la"].after == pytest.approx(401.0, abs=4 * told["la"].sd)
    assert 0.001 < told["la"].sd < 0.02
    assert told["z1"].after == pytest.approx(0.02, abs=2e-4)  # with base held


def test_errors_are_those_of_the_machine_that_has_only_what_is_determined(report):
    few = Pointer(NUMBERS[:2], predict=lambda q: tip({**q, "base": 0.0}))
    known = discrepancy.explain(few, readings()).parameters
    assert report.parameters["la"].sd == pytest.approx(known["la"].sd, rel=1e-9)
    assert report.parameters["z1"].after == pytest.approx(known["z1"].after, abs=1e-9)
    assert known["z1"].sd > 0


def test_equations_count_and_not_rows():
    rows = readings(3)  # six equations for two numbers
    assert discrepancy.explain(Pointer(NUMBERS[:3]), rows).verdict == "none"
    with pytest.raises(DataError, match="1 row cannot carry 3 parameters"):
        discrepancy.explain(Pointer(NUMBERS[:3]), readings(1))


def test_a_start_in_another_valley_is_told():
    def wave(q):
        return np.sin(q["rate"] * q["one"])

    @dataclass(frozen=True)
    class Wave:
        name: str = "wave"

        def formulate(self, data):
            rate = Parameter("rate", "1", 2.0, 0.5, 12.0)
            return Predicted(data, wave, (rate,), {"y": 1e-3}, inputs=("one",))

    rng = np.random.default_rng(1)
    one = np.sort(rng.uniform(0.0, 6.0, 60))
    data = MeasuredData({"one": one, "y": np.sin(7.3 * one) + 1e-3 * rng.standard_normal(60)}, "wave")
    report = discrepancy.explain(Wave(), data)
    assert report.parameters["rate"].after == pytest.approx(7.3, abs=1e-3)
    assert "other starts in the box of the parameters lead to the one" in " ".join(map(str, report.notes))


@dataclass(frozen=True)
class Gantry:
    """Two drives carry a beam: its angle and the zero of the second drive are the same but for a cosine."""

    name: str = "gantry"

    def formulate(self, data: MeasuredData) -> Predicted:
        """Return where the camera is."""
        zeros = (Parameter("x0", "mm", 0.0, -5.0, 5.0), Parameter("y0", "mm", 0.0, -5.0, 5.0))
        free = (*zeros, Parameter("skew", "rad", 0.0, -0.01, 0.01), Parameter("rack", "mm", 0.0, -3.0, 3.0))

        def spot(q: Any) -> Any:
            tilt = (q["second"] + q["rack"] - q["first"]) / 1200
            x = q["x0"] + q["u"] * np.cos(tilt + q["skew"])
            return np.stack([x, q["y0"] + q["first"] + q["u"] * (tilt + np.sin(q["skew"]))], axis=-1)

        return Predicted(data, spot, free, {"x": 0.005, "y": 0.005}, inputs=("u", "first", "second"))


@pytest.mark.parametrize("seed", few(2, range(4)))
def test_what_is_nearly_undetermined_leads_no_fit_away(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u, first, apart = rng.uniform(50, 1150, 200), rng.uniform(0, 800, 200), rng.uniform(-0.3, 0.3, 200)
    tilt = (apart + 0.7) / 1200
    x = 1.1 + u * np.cos(tilt + 0.001) + 0.005 * rng.standard_normal(200) - 0.01 * (play := rng.choice([-1, 1], 200))
    y = -0.4 + first + u * (tilt + np.sin(0.001)) + 0.005 * rng.standard_normal(200)
    columns = {"u": u, "first": first, "second": first + apart, "x": x, "y": y, "side": play}
    report = explain(Gantry(), MeasuredData(columns, "gantry", {}, "run"))
    assert any("only a combination of them is determined; " in note.text for note in report.notes)
    skew, rack = (report.parameters[name].before for name in ("skew", "rack"))
    assert abs(skew + rack / 1200 - (0.001 + 0.7 / 1200)) < 1e-4
    assert not any("outside" in note.text or "other starts" in note.text for note in report.notes)
