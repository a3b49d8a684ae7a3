"""A size that depends on something stays of its order: form and effect that only cancel are no finding."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.measured import read_measured
from calibench.discrepancy import Joint, MeasuredData, Model, Predicted, Roles
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import Fit, fit
from calibench.discrepancy.machines.arm import Arm
from calibench.discrepancy.model.effect import Effect, name_of
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.report import Report
from calibench.discrepancy.search.form import SLOW, Modulated, Slow, runs_away, waves_over
from calibench.discrepancy.search.select import fit_with
from calibench.problems import Parameter

pytestmark = pytest.mark.usefixtures("at_one_noise")

_DEMO = Path(discrepancy.__file__).parent / "demo" / "arm"
_BEND = 0.3  # mm, of what the first joint's angle does to a coordinate, and no formula knows


@pytest.fixture(scope="module")
def bent() -> tuple[Fit, list[Effect]]:
    arm, data = Arm(str(_DEMO / "six.urdf")), read_measured(_DEMO / "demo_sound.csv", "arm", {})
    wave = _BEND * np.exp(-(((np.asarray(data["pan"]) - 0.3) / 0.2) ** 2))
    whole = arm.formulate(data.with_columns({"x": np.asarray(data["x"]) + wave}))
    return fit(Model(whole), Noise()), list(catalogue(whole).candidates)


@pytest.mark.parametrize(
    ("name", "numbers", "column", "away"),
    [
        ("angle_error pan", 6, "q_pan", True),  # a curve of that angle already
        ("angle_error pan", 6, "q_lift", False),
        ("backlash pan", 1, "q_lift", False),  # its size is negative here
    ],
)
def test_a_curve_of_an_angle_has_no_size_that_depends_on_the_same_angle(
    bent: tuple[Fit, list[Effect]], name: str, numbers: int, column: str, away: bool
) -> None:
    base, candidates = bent
    pick = next(e for e in candidates if name_of(e) == name and len(e.coefficients) == numbers)
    plain = fit_with(base, [pick])
    values = np.asarray(base.model.formulation.data[column])
    low, high = float(values.min()), float(values.max())
    middle = waves_over(values, low, high, SLOW).mean(axis=0)
    form = Modulated(pick, (Slow(column, column, low, high, tuple(middle.tolist())),))
    assert runs_away(plain, fit_with(plain, [form]), pick) is away


PULL = -2e-5  # mm/N, of the line nearest to what the spring gives


class Slide:
    """A slide whose place a laser reads, with the force on its drive."""

    name = "slide"

    def formulate(self, data: MeasuredData) -> Predicted:
        roles = Roles((Joint("axis", "s", "sliding", torque="force"),))
        parameters = (Parameter("zero", "mm", 0.0, -1.0, 1.0),)
        return Predicted(data, lambda q: q["s"] + q["zero"], parameters, {"laser": 1e-3}, inputs=("s",), roles=roles)


def sprung() -> Report:
    """Return the report on a slide with a spring in its drive that hardens."""
    rng = np.random.default_rng(3)
    s, force = rng.uniform(0.0, 200.0, 400), rng.uniform(-300.0, 300.0, 400)
    squared = force * np.abs(force)
    line, bend = force, squared - force * (force @ squared) / (force @ force)
    bend *= -0.6 * np.linalg.norm(line) / np.linalg.norm(bend)
    laser = s - PULL * (line + bend) + 1e-3 * rng.standard_normal(400)
    columns = {"s": s, "force": force, "laser": laser}
    return discrepancy.explain(Slide(), MeasuredData(columns, "slide", units={"force": "N"}))


def test_a_spring_that_hardens_has_the_size_of_the_line_that_is_nearest_to_it() -> None:
    [found] = sprung().findings
    told = (found.effect, found.form)
    assert told == ("compliance axis", "course over the force of axis is not that of its formula")
    low, high = found.amplitude.ci95
    assert found.amplitude.value == pytest.approx(PULL, rel=0.05)
    assert low <= PULL <= high
    assert high - low < 0.2 * abs(PULL)
    assert [c.value for c in found.coefficients] == [found.amplitude.value]
