"""Bad input to a machine that predicts what is measured, and whose encoders are inputs: the same door."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from calibench import discrepancy
from calibench.discrepancy import DataError
from calibench.discrepancy.door.admit import admitted
from calibench.discrepancy.noise.repeats import pairs_of
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
    found = admitted(Pointing(), commanded()).data
    assert sorted(zip(*pairs_of(found))) == sorted(zip(*pairs_of(readings())))
    assert any("rows that follow each other at the same enc_1, enc_2 are taken as repeats" in n for n in found.notes)


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
        admitted(Pointing(), data.with_columns({name: change(data[name])}))


def test_an_input_that_is_missing_costs_its_row() -> None:
    data = commanded()
    one = data.with_columns({"enc_1": np.where(np.arange(len(data)) == 7, np.nan, data["enc_1"])})
    found = admitted(Pointing(), one).data
    assert len(found) == len(data) - 1
    assert any("enc_1 in 1" in note for note in found.notes)
