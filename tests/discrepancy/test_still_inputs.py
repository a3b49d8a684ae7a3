"""An input of one's own machine that never varies: its effects cannot be told, and no other name takes their place."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.bench.discovery.page.words import FIRST, headline, notes_among
from calibench.discrepancy import Instrument, Joint, MeasuredData, Predicted, Roles, explain
from calibench.problems.base import Parameter

pytestmark = pytest.mark.usefixtures("at_one_noise", "without_formula")

PARAMETERS = (
    Parameter("cx", "mm", 0.0, -1.0, 1.0),
    Parameter("cy", "mm", 0.0, -1.0, 1.0),
    Parameter("c0", "rad", 0.0, -0.01, 0.01),
    Parameter("ball_x", "mm", 80.0, 70.0, 90.0),
    Parameter("ball_y", "mm", 10.0, 0.0, 20.0),
)
ROLES = Roles(
    (Joint("X axis", "X", "sliding"), Joint("Y axis", "Y", "sliding"), Joint("C axis", "C")),
    instruments=(Instrument("probe", ("u", "v"), frame=False),),
)


def seen(q):
    """Return where the ball on the table lies beside a probe at X, Y, in the frame of the table, (n, 2) mm."""
    x, y, c = q["X"] - q["cx"], q["Y"] - q["cy"], q["C"] + q["c0"]
    return np.stack(
        [x * np.cos(c) + y * np.sin(c) - q["ball_x"], -x * np.sin(c) + y * np.cos(c) - q["ball_y"]], axis=-1
    )


class Table:
    name = "ball on a turntable"

    def formulate(self, data):
        return Predicted(data, seen, PARAMETERS, {"u": 0.002, "v": 0.002}, ("X", "Y", "C"), roles=ROLES)


def _followed(n=120):
    """Return readings of a probe that follows the ball within .3 mm while the table turns."""
    rng = np.random.default_rng(3)
    c = rng.uniform(0, 2 * np.pi, n)
    true = {"cx": 0.2, "cy": -0.1, "c0": 0.002, "ball_x": 80.3, "ball_y": 9.8}
    x = true["cx"] + 80.3 * np.cos(c) - 9.8 * np.sin(c) + rng.uniform(-0.3, 0.3, n)
    y = true["cy"] + 80.3 * np.sin(c) + 9.8 * np.cos(c) + rng.uniform(-0.3, 0.3, n)
    d = {"X": x, "Y": y, "C": c - true["c0"]}
    uv = seen(d | {**true, "c0": 0.002}) + 0.002 * rng.standard_normal((n, 2))
    return MeasuredData(d | {"u": uv[:, 0], "v": uv[:, 1]}, Table.name, {}, "still")


@pytest.mark.parametrize(("column", "axis"), [("C", "C axis"), pytest.param("X", "X axis", marks=pytest.mark.slow)])
def test_an_axis_that_moved_unread_gives_no_other_axis_a_scale_that_no_machine_has(column, axis):
    sound = _followed()
    assert explain(Table(), sound).verdict == "none"
    report = explain(Table(), sound.with_columns({column: np.full(len(sound), 1.5)}))
    sizes = {f.effect: f.amplitude.value for f in report.findings if f.amplitude.unit == "1"}
    assert not {name: size for name, size in sizes.items() if abs(size) > 0.5}, headline(report)
    assert f"column {column} never varies: is it read at all? No effect that follows it can be told" in (
        notes_among(report.notes, FIRST)
    )
    reasons = {f"{u.family} {u.target}": u.reason for u in report.not_testable}
    assert reasons[f"gear {axis}"] == f"column {column} is constant"
    assert report.verdict in ("unknown", "partly")


def test_a_scale_that_no_machine_has_is_told_in_per_cent_as_impossible():
    sound = _followed()
    report = explain(Table(), sound.with_columns({"C": np.full(len(sound), 1.5)}))
    assert any("would have to be" in note.text and " %: taken for impossible" in note.text for note in report.notes)
