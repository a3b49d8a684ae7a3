"""Where no column tells from where joints came, nobody knows it of the first row: it says nothing of a play."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibench import calibration, discrepancy
from calibench.bench.measured import read_measured
from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.machines.arm import Arm
from calibench.discrepancy.machines.arm.readings import accepted
from calibench.discrepancy.model.measured import TO_PREDICT
from tests.bench.arm_by_hand import NAMES, measured, urdf

pytestmark = pytest.mark.usefixtures("at_one_noise")

_DEMO = Path(discrepancy.__file__).parent / "demo" / "arm"
_PLAY = 0.4e-3  # rad
SIX = calibration.Arm(Path("my.urdf"), calibration.parse_urdf(urdf()).chain())


def _rows(**more: np.ndarray) -> MeasuredData:
    q, seen, _ = measured(12)
    columns = dict(zip((*NAMES, "x", "y", "z"), np.column_stack([q, seen]).T, strict=True))
    return MeasuredData({**columns, **more}, "arm")


@pytest.mark.parametrize(("t_s", "lost"), [(np.arange(12.0), 0), (np.arange(12.0)[::-1], 11)])
def test_the_first_row_in_time_is_left_out(t_s: np.ndarray, lost: int) -> None:
    given = _rows(t_s=t_s)
    found, _ = accepted(given, SIX)
    np.testing.assert_array_equal(found["x"], np.delete(given["x"], lost))
    assert np.all(np.abs(found["direction_joint_1"]) == 1)


@pytest.mark.parametrize("more", ["direction", TO_PREDICT])
def test_directions_that_are_told_and_rows_to_predict_stay_whole(more: str) -> None:
    names = [f"direction_{name}" for name in NAMES] if more == "direction" else [more]
    assert len(accepted(_rows(**dict.fromkeys(names, np.ones(12))), SIX)[0]) == 12


@pytest.mark.parametrize(
    ("first", "told"), [(-1.0, False), pytest.param(1.0, False, marks=pytest.mark.slow), (1.0, True)]
)
def test_a_play_is_named_without_a_size_that_depends_on_its_own_direction(first: float, told: bool) -> None:
    arm, data = Arm(str(_DEMO / "six.urdf")), read_measured(_DEMO / "demo_sound.csv", "arm", {})
    assert "direction_pan" not in data
    data = data.with_columns({"split": np.where(np.arange(len(data)) % 5 == 4, "hold", "train")})
    whole = arm.formulate(data.with_columns({TO_PREDICT: np.arange(len(data))}))
    start = {p.name: p.start for p in whole.parameters}
    slope = whole.slopes({**whole.held, **start, **{n: np.asarray(whole.data[n]) for n in whole.inputs}})["q_pan"]
    pan = np.asarray(data["pan"])
    came = np.sign(np.diff(pan, prepend=pan[0]))
    came[0] = first
    seen = {name: np.asarray(data[name]) + slope[:, k] * _PLAY / 2 * came for k, name in enumerate("xyz")}
    driven = [n.removeprefix("q_") for n in whole.inputs if n.startswith("q_")]
    columns = {f"direction_{n}": np.sign(np.diff(data[n], prepend=data[n][0])) for n in driven}
    report = explain(arm, data.with_columns(seen | (columns if told else {})))
    assert [(f.effect, f.form) for f in report.findings] == [("backlash pan", "")]


def test_a_joint_that_stands_still_at_first_is_at_an_end_of_its_play_and_did_not_slip() -> None:
    arm, data = Arm(str(_DEMO / "six.urdf")), read_measured(_DEMO / "demo_sound.csv", "arm", {})
    whole = arm.formulate(data.with_columns({TO_PREDICT: np.arange(len(data))}))
    start = {p.name: p.start for p in whole.parameters}
    slope = whole.slopes({**whole.held, **start, **{n: np.asarray(whole.data[n]) for n in whole.inputs}})["q_pan"]
    came = np.random.default_rng(4).choice([-1.0, 1.0], len(data))
    came[: len(data) // 3] = 1.0
    told = np.where(np.arange(len(data)) < len(data) // 3, 0.0, came)
    seen = {name: np.asarray(data[name]) + slope[:, k] * _PLAY / 2 * came for k, name in enumerate("xyz")}
    [finding] = explain(arm, data.with_columns(seen | {"direction_pan": told})).findings
    assert finding.effect == "backlash pan"
    assert abs(finding.amplitude.value) == pytest.approx(_PLAY, rel=0.15)
