"""Places that were commanded, predicted from a camera that saw them: the noise is the camera's, and that is told."""

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.discovery.page.words import FIRST
from calibench.core.notes import Code
from calibench.discrepancy import MeasuredData
from calibench.discrepancy.diagnostics.noise import exact_readings
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.machines.table import Table
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise

pytestmark = pytest.mark.usefixtures("at_one_noise")

PLACES = np.repeat([0.0, 50.0, 100.0, 150.0], 9)


def table(**columns):
    return MeasuredData(columns, "table", {}, "made")


def exact(data, measured, of, model="line"):
    return exact_readings(fit(Model(Table(model=model, inputs=(of,), measured=measured).formulate(data)), Noise()))


def seen(seed=1):
    """Return places that a robot was sent to, to .02 mm, and where a camera saw it, to 1.5 mm."""
    rng = np.random.default_rng(seed)
    return table(arm=PLACES + 0.02 * rng.standard_normal(36), camera=1.01 * PLACES + 3 + 1.5 * rng.standard_normal(36))


def test_places_predicted_from_a_camera_are_told_before_the_verdict() -> None:
    """Eight waves were named, which brought the error to 0.01 times what it was."""
    report = discrepancy.explain(Table(model="line", inputs=("camera",), measured="arm"), seen())
    [note] = [note for note in report.notes if note.code is Code.EXACT_READINGS]
    assert (note.columns, note.values["levels"]) == (("arm",), 4)
    assert "(camera); predict these from arm" in note.text
    assert note.code in FIRST


@pytest.mark.parametrize("seed", range(10))
def test_the_other_way_round_nothing_is_told(seed: int) -> None:
    assert not exact(seen(seed), "camera", "arm")
    assert list(exact(seen(seed), "arm", "camera")) == ["arm"]


@pytest.mark.parametrize("seed", range(10))
def test_a_coarse_scale_repeats_at_settings_and_a_curve_are_no_commands(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = rng.uniform(0, 4, 60)
    assert not exact(table(u=u, y=np.round(2 * u)), "y", "u")
    settings = PLACES / 50
    curve = settings**2 + 0.01 * rng.standard_normal(36)
    assert not exact(table(u=settings, y=curve), "y", "u")
    assert not exact(table(u=u, y=2 * u + 0.1 * rng.standard_normal(60)), "y", "u")
