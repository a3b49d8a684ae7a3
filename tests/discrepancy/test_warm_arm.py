"""Joints that drift while the room warms up: what is told of them, and of the zeros that calibration finds."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.discrepancy import explain
from calibench.problems.base import Array
from tests.discrepancy.warm_arm import ZEROS, WarmArm, run

pytestmark = pytest.mark.usefixtures("at_one_noise")

N = 120
EVEN = np.arange(N) / N


def _celsius(seed: int) -> Array:
    return 18 + 17 * EVEN + 0.15 * np.random.default_rng(1000 + seed).standard_normal(N)


@pytest.mark.parametrize("seed", [11, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (15, 17, 21))])
def test_two_joints_that_drift_as_it_warms_up_are_each_a_set_of_drift_and_warmth(seed: int) -> None:
    """Together they look like a forearm that grows; and of time and temperature, which go together, neither wins."""
    bend = np.random.default_rng(seed).uniform(0.85, 1.15, 2)
    drifts = np.stack([3e-4 * EVEN ** bend[0], -4e-4 * EVEN ** bend[1]], axis=-1)
    report = explain(WarmArm(), run(seed, drifts, _celsius(seed)))
    assert report.verdict == "ambiguous"
    sets = {frozenset(rival.effect for rival in finding.set) for finding in report.findings}
    assert sets == {frozenset({f"drift joint {k}", f"thermal_zero joint {k}"}) for k in (1, 2)}


def _warming(seed: int) -> tuple[Array, Array]:
    temp = 26 + 8 * np.sin(9 * EVEN)  # as read, in °C, and not as time goes
    return temp, np.stack([3e-5 * (temp - 26), np.zeros(N)], axis=-1)


def test_a_zero_that_moves_with_degrees_celsius_is_told_at_the_mean_of_the_run() -> None:
    """Told at 0 °C, where nobody read anything, it would be .8 mrad from what the joint had in the run."""
    temp, shift = _warming(3)
    report = explain(WarmArm(), run(3, shift, temp))
    assert [finding.effect for finding in report.findings] == ["thermal_zero joint 1"]
    assert report.findings[0].amplitude.value == pytest.approx(3e-5, rel=0.1)
    at_the_mean = ZEROS[0] + float(np.mean(shift[:, 0]))
    assert report.parameters["z1"].after == pytest.approx(at_the_mean, abs=5e-5)
    rows = {"enc_1": [0.3, 0.3], "enc_2": [1.0, 1.0], "temp": [20.0, 32.0], "t_s": [100.0, 900.0]}
    told = report.predict(rows)
    assert told.measured["y"][1] - told.measured["y"][0] == pytest.approx(
        12 * 3e-5 * (401.3 * np.cos(0.313) + 298.9 * np.cos(1.292)), rel=0.1
    )


def test_a_zero_that_is_held_is_that_of_the_zero_of_the_thermometer() -> None:
    temp = 3 + 8 * EVEN  # above the temperature at which the zeros were found
    shift = np.stack([3e-5 * temp, np.zeros(N)], axis=-1)
    report = explain(WarmArm(held=("z1", "z2")), run(4, shift, temp))
    assert "thermal_zero joint 1" in {rival.effect for rival in report.findings[0].set}
    assert len(report.findings) == 1
    assert report.findings[0].amplitude.value == pytest.approx(3e-5, rel=0.1)


@pytest.mark.parametrize("seed", [17, 30])
def test_chance_in_the_middle_of_a_few_residuals_is_no_misfit(seed: int) -> None:
    """Nobody states the noise, and the median of 40 residuals says it a third too small or too large."""
    report = explain(WarmArm(sigma=None), run(seed, np.zeros((60, 2)), np.full(60, 20.0) + EVEN[:60]))
    assert report.verdict == "none"


def test_columns_of_one_instrument_have_one_unknown_noise_unless_they_differ_beyond_chance() -> None:
    """Of few rows each column alone is told to a sixth: the quieter one by chance would show effects."""
    data = run(1, np.zeros((N, 2)), np.full(N, 20.0))
    sigma = WarmArm(sigma=None).formulate(data).sigma
    assert sigma["x"] == sigma["y"] == pytest.approx(0.02, rel=0.2)
    loud = data["y"] + 0.06 * np.random.default_rng(2).standard_normal(N)
    sigma = WarmArm(sigma=None).formulate(data.with_columns({"y": loud})).sigma
    assert sigma["x"] == pytest.approx(0.02, rel=0.3)
    assert sigma["y"] == pytest.approx(0.063, rel=0.3)
