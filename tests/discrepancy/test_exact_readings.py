"""Places that were commanded, predicted from a camera that saw them: the noise is the camera's, and that is told."""

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.discovery.page.words import first_notes
from calibench.discrepancy import MeasuredData
from calibench.discrepancy.diagnostics.noise import EXACT, exact_readings
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.machines.table import Table
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise

pytestmark = pytest.mark.usefixtures("at_one_noise")

PLACES = np.repeat([0.0, 50.0, 100.0, 150.0], 9)


def table(**columns):
    return MeasuredData(columns, "table", {}, "made")


def notes(data, measured, of, model="line"):
    return exact_readings(fit(Model(Table(model=model, inputs=(of,), measured=measured).formulate(data)), Noise()))


def seen(seed=1):
    """Return places that a robot was sent to, to .02 mm, and where a camera saw it, to 1.5 mm."""
    rng = np.random.default_rng(seed)
    return table(arm=PLACES + 0.02 * rng.standard_normal(36), camera=1.01 * PLACES + 3 + 1.5 * rng.standard_normal(36))


def test_places_predicted_from_a_camera_are_told_before_the_verdict() -> None:
    """Eight waves were named, which brought the error to 0.01 times what it was."""
    report = discrepancy.explain(Table(model="line", inputs=("camera",), measured="arm"), seen())
    [note] = [note for note in report.notes if EXACT in note]
    assert "arm comes in 4 levels" in note
    assert "(camera); predict these from arm" in note
    assert note in first_notes(report)


@pytest.mark.parametrize("seed", range(10))
def test_the_other_way_round_nothing_is_told(seed: int) -> None:
    assert notes(seen(seed), "camera", "arm") == ()
    assert len(notes(seen(seed), "arm", "camera")) == 1


@pytest.mark.parametrize("seed", range(10))
def test_a_coarse_scale_repeats_at_settings_and_a_curve_are_no_commands(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = rng.uniform(0, 4, 60)
    assert notes(table(u=u, y=np.round(2 * u)), "y", "u") == ()
    settings = PLACES / 50
    curve = settings**2 + 0.01 * rng.standard_normal(36)
    assert notes(table(u=settings, y=curve), "y", "u") == ()
    assert notes(table(u=u, y=2 * u + 0.1 * rng.standard_normal(60)), "y", "u") == ()
