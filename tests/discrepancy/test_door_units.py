"""Units that are stated for a part of the columns, or in the way that a shell leaves them."""

from __future__ import annotations

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.measured.files import pairs_of
from calibench.discrepancy import DataError, Joint, MeasuredData, Predicted, Roles
from calibench.problems.base import Parameter

NAMES = ("Winkel 1", "Winkel 2", "Winkel 3")
LENGTHS = (300.0, 250.0, 200.0)


def tip(q):
    at = sum(q[name] for name in NAMES[:1])
    x, y = q["l1"] * np.cos(at), q["l1"] * np.sin(at)
    for name, length in zip(NAMES[1:], LENGTHS[1:]):
        at = at + q[name]
        x, y = x + length * np.cos(at), y + length * np.sin(at)
    return np.stack([x, y], axis=-1)


class Arm:
    name = "arm_of_three_angles"

    def formulate(self, data):
        free = (Parameter("l1", "mm", 300.0, 290.0, 310.0),)
        roles = Roles(joints=tuple(Joint(name, name) for name in NAMES))
        return Predicted(data, tip, free, {"x": 0.02, "y": 0.02}, inputs=NAMES, roles=roles)


def readings(degrees, units):
    rng = np.random.default_rng(4)
    angles = {name: rng.uniform(-1.5, 1.5, 80) for name in NAMES}
    place = tip({**angles, "l1": 301.0}) + 0.02 * rng.standard_normal((80, 2))
    columns = {name: np.degrees(a) if name in degrees else a for name, a in angles.items()}
    return MeasuredData({**columns, "x": place[:, 0], "y": place[:, 1]}, Arm.name, units=units)


def test_columns_without_a_unit_beside_one_with_it_are_asked_for_theirs():
    data = readings(NAMES[1:], {"Winkel 1": "rad"})
    with pytest.raises(DataError, match=r"Winkel 2, Winkel 3 .* 0\.0174533") as told:
        discrepancy.explain(Arm(), data)
    assert 'units={"Winkel 2": "deg", "Winkel 3": "deg"}' in str(told.value)


def test_a_unit_that_is_stated_wrongly_is_not_asked_for_again():
    data = readings((), {"x": "mm", "y": "mm"})
    data = data.with_columns({"x": 1000 * data["x"], "y": 1000 * data["y"]})
    with pytest.raises(DataError, match="wrong by this factor"):
        discrepancy.explain(Arm(), data)


def test_braces_that_a_shell_left_without_quotation_marks_are_read():
    assert pairs_of("units", "{Winkel 1:deg,Winkel 2:deg}") == {"Winkel 1": "deg", "Winkel 2": "deg"}


def test_a_missing_column_is_told_among_those_of_the_file_alone():
    data = MeasuredData({"a": np.zeros(2), "reading_place": np.arange(2)}, "arm")
    with pytest.raises(DataError, match="there are a; where"):
        data["b"]
