"""A set is told as it is beside all that was found, under the noise that is left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibench.bench.measured import read_measured, shipped_path
from calibench.discrepancy import MeasuredData, explain
from tests.independent.delta import Firmware, honest, measured, places, shown, spoilt

pytestmark = pytest.mark.usefixtures("at_one_noise")


def test_twins_of_which_the_first_was_fitted_beside_more_have_one_size() -> None:
    """With angles alone links that grow are a base that shrinks; a leg that was found later changes both."""
    report = explain("gpm2002", read_measured(shipped_path("demo_warm", "gpm2002"), "gpm2002"))
    first, later = report.findings
    assert (first.effect, later.effect) == ("thermal_links all", "thermal_leg leg 3")
    [twin] = [rival for rival in first.set if rival.effect == "thermal_base all"]
    assert twin.amplitude is not None
    assert twin.amplitude.value == pytest.approx(-first.amplitude.value, rel=0.01)


def _printer(seed: int, causes: dict[str, float]) -> MeasuredData:
    """Return a delta printer with `causes` of a visible size each, every place probed twice."""
    rng = np.random.default_rng([4343, seed])
    rod = rng.uniform(220, 400)
    radius = rod * rng.uniform(0.43, 0.5)
    firmware = Firmware(radius=radius, rods=np.full(3, rod), endstops=np.full(3, rng.uniform(250, 450)))
    sigma, bed = (0.02, 0.05), radius * 0.85
    probed, *ends = places(rng, 37, 24, bed)
    bare = replace(honest(firmware, rng), bed_radius=bed)
    printer = bare
    for cause, visible in causes.items():
        size, form = 1e-3, rng.bit_generator.state
        for _ in range(6):
            rng.bit_generator.state = form
            alone = spoilt(bare, cause, size, rng)
            size *= visible / max(shown(alone, bare, firmware, probed, ends, sigma), 1e-12)
        rng.bit_generator.state = form
        printer = spoilt(printer, cause, size, rng)
    twice = [np.repeat(one, 2, axis=0) for one in (probed, *ends)]
    columns, metadata = measured(printer, firmware, twice[0], twice[1:], sigma, rng)
    return MeasuredData(columns, "delta", metadata, "printer")


def test_the_scale_of_one_belt_stays_in_the_set_where_a_bed_that_has_no_name_is_left() -> None:
    """It is told from the scale of all belts by the stated noise, and not by what is left."""
    report = explain("delta", _printer(12, {"tower_radius tower c": 12.0, "belt_scale tower a": 2.2, "saddle": 1.4}))
    sets = [{rival.effect for rival in finding.set} for finding in report.findings]
    assert any("tower_radius tower c" in own for own in sets)
    assert any({"belt_scale all", "belt_scale tower a"} <= own for own in sets)
