"""From where on an effect acts is told with its size: a saturation's level, the time of a step."""

import json

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.discovery.page.words import coefficients_of, headline
from calibench.discrepancy import MeasuredData
from calibench.discrepancy.machines.table import Table
from calibench.discrepancy.report import Report


def searched(units=None, **columns):
    data = MeasuredData(columns, "table", {}, "made", units=units or {})
    inputs = [name for name in columns if name != "y"][:1]
    return discrepancy.explain(Table(model="line", inputs=tuple(inputs), measured="y"), data)


def test_a_saturation_says_from_which_level_on() -> None:
    """Without it nobody can correct a reading by the size that is told."""
    u = np.linspace(0.0, 200.0, 60)
    noise = 0.02 * np.random.default_rng(4).standard_normal(60)
    report = searched({"u": "K"}, u=u, y=0.04 * u - 3.0 * np.maximum(u - 140, 0) / 200 + noise)
    [found] = report.findings
    begins = found.coefficients[-1]
    assert (found.effect, begins.name, begins.unit) == ("saturation u", "from", "K")
    assert begins.value == pytest.approx(140, abs=10)
    assert f", from {begins.value:.0f} K on" in headline(report)
    assert coefficients_of(found) == f"from {begins.value:.0f} K on"


def test_a_step_says_from_which_time_on_and_a_report_that_was_read_says_so_too() -> None:
    t = np.arange(80.0)
    u = np.random.default_rng(5).uniform(-1, 1, 80)
    y = u + 0.5 * (t >= 50) + 0.02 * np.random.default_rng(6).standard_normal(80)
    report = searched(u=u, t_s=t, y=y)
    [found] = report.findings
    assert found.family == "step"
    assert found.coefficients[-1].value == pytest.approx(49.5, abs=1)
    assert " s on" in headline(report)
    again = Report.from_dict(json.loads(json.dumps(report.to_dict(), allow_nan=False)))
    assert headline(again) == headline(report)


def test_an_effect_that_acts_everywhere_begins_nowhere() -> None:
    u = np.linspace(-1, 1, 60)
    report = searched(u=u, y=u + 0.4 * u**3 + 0.01 * np.random.default_rng(7).standard_normal(60))
    [found] = report.findings
    assert [c.name for c in found.coefficients] == ["c"]
    assert ", from " not in headline(report)
