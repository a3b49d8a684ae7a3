"""Waves over columns that go together: a clock and the number of a trial, a clock and the time within a trial."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.bench.discovery.page.words import doubt_sentences
from calibench.discrepancy import MeasuredData, Predicted, Roles, explain
from calibench.discrepancy.report import Caution, Doubt
from calibench.problems.base import Parameter

pytestmark = pytest.mark.usefixtures("at_one_noise")


class Trials:
    """A constant, read in trials."""

    name = "constant_in_trials"

    def formulate(self, data):
        return Predicted(data, lambda q: q["mean"] + 0 * q["zero"], (Parameter("mean", "1", 1.0, 0.0, 2.0),),
                         {"y": 0.1}, ("zero", "t"), unit="", roles=Roles(columns=("trial", "clock")))  # fmt: skip


def _found(error, spacing):
    """Return what is found where 24 trials of 20 readings within 6 s begin each `spacing` s, and `error` acts."""
    rng = np.random.default_rng(2)
    trial = np.repeat(np.arange(24.0), 20)
    t = np.sort(rng.uniform(0.2, 6, (24, 20)), axis=1).ravel()
    clock = spacing * trial + t
    y = 1 + error(clock, t) + 0.1 * rng.standard_normal(len(t))
    columns = {"trial": trial, "clock": clock, "t": t, "zero": 0 * t, "y": y}
    return explain(Trials(), MeasuredData(columns, Trials.name))


def test_a_slow_wave_is_as_well_one_of_any_column_that_rises_with_its_own():
    report = _found(lambda clock, t: 0.2 * np.sin(2 * np.pi * clock / 396), 60.0)
    assert report.verdict == "ambiguous"
    assert {rival.effect for rival in report.findings[0].set} == {"cycle clock", "cycle trial"}


def test_a_wave_as_long_as_the_time_from_trial_to_trial_is_told_to_follow_the_time_within_one():
    """A creep of any form: its curves over a trial are the same in each, so over the clock it is a wave."""
    report = _found(lambda clock, t: 0.4 * np.exp(-np.sqrt(t)), 30.0)
    assert [f.effect for f in report.findings] == ["cycle clock"]
    assert report.findings[0].period == pytest.approx(30.0, rel=0.01)
    assert report.findings[0].caution[-1] == Caution(Doubt.UNCONFIRMED, ("t",))
    assert any(", in which a curve over t tells the same;" in line for line in doubt_sentences(report))
