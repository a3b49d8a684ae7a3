"""Bad input to a machine that predicts what is measured, and whose encoders are inputs: the same door."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.discovery.page.words import FIRST
from calibench.core.notes import Code
from calibench.discrepancy import DataError, Joint, MeasuredData, Predicted, Roles, explain
from calibench.discrepancy.checks.validate import validate
from calibench.discrepancy.noise.repeats import pairs_of
from calibench.problems.base import Parameter
from tests.discrepancy import arm
from tests.discrepancy.arm import readings


@dataclass(frozen=True)
class Pointing:
    """An arm that predicts where its tip is; its encoders are inputs."""

    name: str = "pointing"

    def formulate(self, data: discrepancy.MeasuredData) -> discrepancy.Predicted:
        def tip(q: Any) -> Any:
            a = q["enc_1"] + q["z1"]
            b = a + q["enc_2"] + q["z2"]
            x, y = q["la"] * np.cos(a) + q["lb"] * np.cos(b), q["la"] * np.sin(a) + q["lb"] * np.sin(b)
            return np.stack([x, y], axis=-1)

        return discrepancy.Predicted(data, tip, arm.PARAMETERS, {"x": 0.02, "y": 0.02}, inputs=("enc_1", "enc_2"))


def commanded() -> discrepancy.MeasuredData:
    data = readings()
    first = data["pose_id"] * 3
    columns = {**data.columns, **{name: data[name][first] for name in ("enc_1", "enc_2")}}
    return replace(data, columns={n: c for n, c in columns.items() if n not in ("pose_id", "visit_id")})


def test_repeats_are_told_by_what_was_commanded() -> None:
    found = validate(Pointing(), commanded()).data
    assert sorted(zip(*pairs_of(found))) == sorted(zip(*pairs_of(readings())))
    assert any(
        "rows that follow each other at the same enc_1, enc_2 are taken as repeats" in n.text for n in found.notes
    )


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("enc_2", lambda c: np.rad2deg(c), "enc_1, enc_2|enc_2 is multiplied by 0.0174533"),
        ("enc_2", lambda c: c + 3, r"rad is added to enc_2.* start z2 at -\d"),
        ("x", lambda c: c / 1000, "x is multiplied by 1000"),
        ("x", lambda c: np.full_like(c, np.nan), "column x holds no finite number in 180 of 180 rows"),
    ],
)
def test_a_machine_that_predicts_has_the_same_door(name: str, change: Any, said: str) -> None:
    data = commanded()
    with pytest.raises(DataError, match=said):
        validate(Pointing(), data.with_columns({name: change(data[name])}))


def test_an_input_that_is_missing_costs_its_row() -> None:
    data = commanded()
    one = data.with_columns({"enc_1": np.where(np.arange(len(data)) == 7, np.nan, data["enc_1"])})
    found = validate(Pointing(), one).data
    assert len(found) == len(data) - 1
    assert any("enc_1 in 1" in note.text for note in found.notes)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: {"x": d["y"], "y": d["x"]}, "if x and y are exchanged"),
        (lambda d: {"x": np.roll(d["x"], -1), "y": np.roll(d["y"], -1)}, "are taken from the row after"),
        (lambda d: {"x": d["x"] / 1000, "y": d["y"] / 1000}, 'units={"x": "m", "y": "m"}; or as near if '),
    ],
)
def test_what_would_cure_readings_of_a_machine_with_a_slide_is_told(change: Any, said: str) -> None:
    data = polar_readings()
    with pytest.raises(DataError, match=re.escape(said)):
        explain(Polar(), data.with_columns(change(data)))


def test_readings_that_nothing_cures_are_told_first() -> None:
    data = polar_readings()
    lost = np.random.default_rng(1).permutation(len(data))
    report = explain(Polar(), data.with_columns({"x": data["x"][lost], "y": data["y"][lost]}))
    assert report.verdict == "unknown"
    assert Code.FAR_FROM_MODEL in FIRST & {note.code for note in report.notes}


ROUND = (Parameter("zero", "mm", 0.0, -3.0, 3.0), Parameter("beside", "mm", 0.0, -3.0, 3.0))


@dataclass(frozen=True)
class Polar:
    """A turntable below a slide."""

    name: str = "polar"

    def formulate(self, data: MeasuredData) -> Predicted:
        """Return where the slide stands over the table."""

        def place(q: Any) -> Any:
            r = q["r"] + q["zero"]
            x = r * np.cos(q["turn"]) - q["beside"] * np.sin(q["turn"])
            return np.stack([x, r * np.sin(q["turn"]) + q["beside"] * np.cos(q["turn"])], axis=-1)

        return Predicted(data, place, ROUND, {"x": 0.01, "y": 0.01}, inputs=("turn", "r"), roles=POLAR)


POLAR = Roles((Joint("table", "turn"), Joint("slide", "r", "sliding", period=8.0)))


def polar_readings() -> MeasuredData:
    rng = np.random.default_rng(0)
    turn, r = rng.uniform(0, 2 * np.pi, 120), rng.uniform(20, 140, 120)
    x, y = (r + 0.5) * np.cos(turn), (r + 0.5) * np.sin(turn)
    noise = 0.01 * rng.standard_normal((2, 120))
    return MeasuredData({"turn": turn, "r": r, "x": x + noise[0], "y": y + noise[1]}, "polar", {}, "polar")


def test_a_function_with_an_if_is_told_that_it_is_given_all_readings_at_once() -> None:
    with pytest.raises(DataError, match="no if, and no comparison"):
        Predicted(
            polar_readings(), lambda q: q["r"] if q["turn"] > 0 else 0.0, ROUND, {"x": 0.01}, inputs=("r", "turn")
        )
