"""A joint that errs with a period that nobody states: waves of a rotary joint, one after another, and silence."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calibench.bench.discovery.page.words import coefficients_of
from calibench.discrepancy import Joint, MeasuredData, Predicted, Roles, explain
from calibench.discrepancy.diagnostics.score import projected_scores, score_all
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.effects.general.harmonics import PERIODIC
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.model.effect import OfFreePeriod, has_free_period, is_possible
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.search.finding import amplitude_of
from calibench.problems import Parameter
from tests.discrepancy.test_general_families import OUTSIDE, WEATHER, Arm, readings

pytestmark = pytest.mark.usefixtures("at_one_noise", "without_formula")

BARE = Roles((Joint("shoulder", "a"), Joint("elbow", "b")))


def _waves(q, d):
    return {"b": q["b"] + 6e-4 * np.sin(17 * q["b"] + 1.0) + 3e-4 * np.sin(21.4 * q["b"] + 0.3)}


@cache
def _two_waves():
    return explain(Arm(BARE), readings(5, _waves))


def test_waves_of_a_rotary_joint_of_unknown_orders_are_named_one_after_another():
    report = _two_waves()
    assert [found.effect for found in report.findings] == ["periodic_error elbow", "second_periodic_error elbow"]
    orders = [2 * np.pi / found.period for found in report.findings]
    assert orders == pytest.approx([17, 21.4], abs=0.15)
    assert [found.amplitude.value for found in report.findings] == pytest.approx([6e-4, 3e-4], rel=0.15)


def _more_waves(q, d):
    return {"b": _waves(q, d)["b"] + 4e-4 * np.sin(11.2 * q["b"] - 0.5)}


def test_the_height_of_a_wave_is_a_size_and_none_per_unit_of_what_it_repeats_over():
    sizes = [amplitude_of(e, np.array([3.0, 4.0, 0.0]), np.eye(3), 2.0) for e in _of_free_period()]
    assert {size.value for size in sizes} == {5.0}
    assert np.isnan([size.span for size in sizes]).all()


def _of_free_period():
    known = catalogue(Arm(replace(BARE, columns=("weather",))).formulate(readings(5))).candidates
    found = {e.family: e for e in known if has_free_period(e)}
    assert {"cycle", "periodic_error"} <= {*found}
    return found.values()


@pytest.mark.slow
def test_three_waves_of_one_joint_are_told_to_be_a_shape_and_no_cause():
    said = "the 3 waves of elbow tell together what its error is like"
    report = explain(Arm(BARE), readings(5, _more_waves))
    assert sum(f.family in PERIODIC for f in report.findings) == 3
    assert [note for note in report.notes if said in note.text]
    assert not [note for note in _two_waves().notes if "waves of elbow" in note.text]


def test_the_orders_of_stated_teeth_have_a_name_of_their_own():
    known = Roles((Joint("shoulder", "a", teeth=30), Joint("elbow", "b")))
    found = catalogue(Arm(known).formulate(readings())).candidates
    assert ("cyclic", "shoulder") in {(e.family, e.target) for e in found}
    orders = np.array([2 * np.pi / e.start for e in found if e.family == PERIODIC[0] and e.target == "shoulder"])
    resolved = 2 * np.pi / next(e.reach for e in found if e.family in PERIODIC and e.target == "shoulder")
    assert np.abs(orders[:, None] - [30.0, 60.0]).min() >= resolved
    assert np.ptp(orders) > 40


class Slide:
    """A slide whose place a laser reads; its screw has a pitch of 10 mm."""

    name = "slide"

    def formulate(self, data):
        roles = Roles((Joint("axis", "s", "sliding", period=10.0),))
        parameters = (Parameter("zero", "mm", 0.0, -1.0, 1.0),)
        return Predicted(data, lambda q: q["s"] + q["zero"], parameters, {"laser": 1e-3}, inputs=("s",), roles=roles)


@pytest.mark.parametrize(
    ("period", "effect"), [(23.7, "periodic_error"), (2.5, "periodic_error"), (10.0, "screw_error")]
)
def test_a_screw_of_known_pitch_may_err_with_another_period(period, effect):
    rng = np.random.default_rng(3)
    s = rng.uniform(0.0, 200.0, 200)
    laser = s + 3e-3 * np.sin(2 * np.pi * s / period + 0.4) + 1e-3 * rng.standard_normal(200)
    report = explain(Slide(), MeasuredData({"s": s, "laser": laser}, "slide"))
    assert [(found.effect, report.verdict) for found in report.findings] == [(f"{effect} axis", "named")]
    if effect == "periodic_error":
        assert report.findings[0].period == pytest.approx(period, rel=0.01)


def test_orders_that_have_names_of_their_own_are_no_waves():
    found = catalogue(Arm(BARE).formulate(readings())).candidates
    orders = [2 * np.pi / e.start for e in found if e.family in PERIODIC]
    assert 3 <= min(orders) < 3.5
    assert 60 < max(orders) <= 64
    shorter = next(e for e in found if e.family in PERIODIC)
    assert shorter.amplitude(np.array([1e-4, 0.0, -2.0 * shorter.reach])) == np.inf


def test_sums_score_a_wave_as_its_columns_do():
    formulation = Arm(BARE).formulate(readings(5, _waves))
    model = Model(formulation)
    at = fit(model, Noise(), model.start)
    waves = [e for e in catalogue(formulation).candidates if isinstance(e, OfFreePeriod)][::37]
    on = projected_scores(at)
    for (quick, _), (slow, U) in zip(score_all(at, on, waves, sums=True), score_all(at, on, waves, bases=True)):
        assert len(U) == len(on.y)
        assert (quick.m, quick.T) == (slow.m, pytest.approx(slow.T, rel=1e-9))
        assert quick.coefficients == pytest.approx(slow.coefficients, rel=1e-7)


def test_a_wave_of_free_period_has_no_form_beside_it():
    """A form would be a second wave, of the period that was tried first and not of the one that was fitted."""
    both = Roles((Joint("shoulder", "a"), Joint("elbow", "b", direction="side_b")))

    def one_way(q, d):
        return {"b": q["b"] + 6e-4 * (1 + 0.3 * d["side_b"]) * np.sin(17.2 * q["b"] + 1.0)}

    found = explain(Arm(both), readings(6, one_way)).findings
    assert found[0].effect == "periodic_error elbow"
    assert 2 * np.pi / found[0].period == pytest.approx(17.2, abs=0.15)
    assert not any(one.form for one in found)


def test_a_fitted_period_is_told_in_the_unit_of_its_joint_and_as_waves_a_turn():
    found = _two_waves().findings
    assert found[0].coefficients[-1].unit == "rad"
    assert re.search(
        r"period 3\d\d\.\d+ mrad \(95 %: 3\d\d\.\d+ to 3\d\d\.\d+ mrad; 2\d\.\d+°\), 1[67]\.\d a turn$",
        coefficients_of(found[0]),
    )


@pytest.mark.slow
def test_a_fitted_period_is_told_in_the_unit_that_the_file_states_of_its_column():
    hidden = OUTSIDE["cycle weather in y"]
    data = replace(readings(3, measured=hidden), units={"weather": "kPa"})
    [found] = explain(Arm(WEATHER), data).findings
    assert re.search(r"period 13\.\d+ \(95 %: 13\.\d+ to 13\.\d+ kPa\)|period 13\.\d+ kPa", coefficients_of(found))
    [bare] = explain(Arm(WEATHER), replace(data, units={"weather": "1"})).findings
    assert re.search(r"period 13\.\d+ \(95 %: 13\.\d+ to 13\.\d+\)$", coefficients_of(bare))


def test_a_slide_has_no_wave_that_is_not_seen_twice():
    rng = np.random.default_rng(3)
    data = MeasuredData({"s": (s := rng.uniform(0.0, 200.0, 200)), "laser": s}, "slide")
    for wave in (e for e in catalogue(Slide().formulate(data)).candidates if e.family in PERIODIC):
        reach = 0.5 * np.ptp(s)
        for times, possible in ((0.9, True), (1.2, False)):
            c = np.array([1e-3, 0.0, (1 / (times * reach) - 1 / wave.start) * wave.reach])
            assert wave.period(c) == pytest.approx(times * reach)
            assert is_possible(wave, wave.amplitude(c)) is possible


@pytest.mark.parametrize("seed", range(2))
def test_a_guide_that_bends_is_not_told_as_waves(seed):
    rng = np.random.default_rng(seed)
    s = rng.uniform(0.0, 200.0, 200)
    bend = 0.02 * np.exp(-(((s - rng.uniform(60, 140)) / rng.uniform(30, 50)) ** 2))
    report = explain(Slide(), MeasuredData({"s": s, "laser": s + bend + 1e-3 * rng.standard_normal(200)}, "slide"))
    assert all(found.period < 100 for found in report.findings)
    assert all(np.isfinite(found.amplitude.value) for found in report.findings)
