"""Members follow the thermometer late; the catalogue knows it, and says so only where it shows."""

import numpy as np
import pytest

from benchmarks.blind.gpm2002 import member_effects
from benchmarks.blind.gpm2002.simulate import case
from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.effects.general.lengths import warmth
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")


def test_members_that_follow_one_thermometer_share_its_lag():
    t, warm = np.arange(50.0), np.linspace(0, 3, 50)
    data = MeasuredData({"t_s": t, "temp_K": warm}, "gpm2002", {})
    other = data.with_columns({"enc_1": t})  # as a fit has other columns, and the same times
    felt = warmth(data, 5.0, "temp_K", "t_s", data)
    assert warmth(other, 5.0, "temp_K", "t_s", data) is felt
    assert warmth(data.rows(t < 25), 5.0, "temp_K", "t_s", data) == pytest.approx(felt[:25], abs=1e-12)


def test_warmth_follows_a_step_of_temperature_by_its_lag():
    t = np.arange(0.0, 300.0, 1.0)
    data = MeasuredData({"t_s": t, "temp_K": np.where(t < 100, 0.0, 5.0)}, "gpm2002")
    felt = warmth(data, 60.0, "temp_K", "t_s", data)
    assert felt[160] == pytest.approx(5 * (1 - np.exp(-60.5 / 60)), rel=1e-2)
    assert felt[0] == 0
    assert 4.5 < felt[-1] < 5


@pytest.mark.parametrize(("seed", "xy"), few(1, [(1, False), (5, False), (3, True)]))
def test_links_that_warm_late_are_named_alone(seed, xy):
    hidden = case(seed, xy=xy, family="thermal_links", lam=1.5, noise="gauss", kind="one")
    report = explain("gpm2002", MeasuredData(hidden.columns, "gpm2002", hidden.metadata))
    assert len(report.findings) == 1
    names = {rival.effect for rival in report.findings[0].set}
    assert "thermal_links all" in names
    assert names <= {"thermal_links all"} if xy else names <= {"thermal_links all", "thermal_base all"}
    if xy:  # with angles alone the name, and so the meaning of the number, is either of two
        assert report.findings[0].amplitude.value == pytest.approx(hidden.truth["effects"][0]["amplitude"], rel=0.15)


@pytest.mark.slow
def test_members_that_warm_much_later_are_named_too(monkeypatch):
    def heavy(plan, rng):
        return plan.temperature[0] + _first_order(plan.t, plan.temperature, rng.uniform(600, 900))

    monkeypatch.setattr(member_effects, "_late", heavy)
    told = 0
    for seed in range(8):
        hidden = case(seed, xy=False, family="thermal_leg", lam=2.5, noise="gauss", kind="one")
        report = explain("gpm2002", MeasuredData(hidden.columns, "gpm2002", hidden.metadata))
        true = f"thermal_leg {hidden.truth['effects'][0]['target']}"
        told += any(rival.effect == true for finding in report.findings for rival in finding.set)
    assert told >= 7


def _first_order(t, shown, late):
    """Return the rise of what follows `shown` from row to row, exact for a temperature that moves in steps."""
    felt = np.zeros(len(t))
    for k in range(1, len(t)):
        felt[k] = felt[k - 1] - np.expm1(-(t[k] - t[k - 1]) / late) * (shown[k] - shown[0] - felt[k - 1])
    return felt


def test_rows_of_a_run_are_as_warm_as_the_rows_before_have_made_them():
    """The rows a fit leaves out, and those that a report is asked for, begin no run of their own."""
    t = np.arange(0.0, 900.0, 5.0)
    run = MeasuredData({"t_s": t, "temp_K": 6 * t / t[-1] + np.sin(t / 60)}, "gpm2002")
    felt = warmth(run, 200.0, "temp_K", "t_s", run)
    fold = np.arange(len(t)) % 7 == 5
    assert warmth(run.rows(fold), 200.0, "temp_K", "t_s", run) == pytest.approx(felt[fold], abs=1e-12)
    held = warmth(run.rows(fold), 200.0, "temp_K", "t_s", run.rows(~fold))
    assert held == pytest.approx(felt[fold], abs=0.05)
    alone = warmth(run.rows(fold), 200.0, "temp_K", "t_s", run.rows(fold))
    assert np.max(np.abs(alone - felt[fold])) > 0.2  # what such rows were told: as warm as the thermometer at first


def test_rows_of_another_run_begin_as_warm_as_their_thermometer():
    t = np.arange(0.0, 900.0, 5.0)
    run = MeasuredData({"t_s": t, "temp_K": 6 * t / t[-1]}, "gpm2002")
    evening = MeasuredData({"t_s": t[:60] + 1.0, "temp_K": np.full(60, 9.0)}, "gpm2002")
    assert warmth(evening, 200.0, "temp_K", "t_s", run) == pytest.approx(9.0)
