"""The fallback without a name: it predicts unseen poses where something smooth is hidden."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.blind import orthoglide
from benchmarks.blind.gpm2002.simulate import case
from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.diagnostics.smooth_term import smooth_columns
from calibench.discrepancy.registries import machines
from calibench.discrepancy.search.smoother import Smooth
from tests.independent import delta

pytestmark = pytest.mark.usefixtures("at_one_noise", "without_formula")


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "xy", "family"), [(961, True, "heading_tilt"), (962, False, "load_squared")])
def test_a_nameless_cause_is_predicted_on_poses_that_no_fit_has_seen(seed: int, xy: bool, family: str) -> None:
    blind = case(seed, xy=xy, family=family, lam=2.0, noise="gauss")
    data = MeasuredData(blind.columns, "gpm2002", blind.metadata, "case")
    report = explain("gpm2002", data)
    assert report.verdict == "unknown"
    assert report.gap.excess_shrink > 0.8
    [smooth] = report.model.model.effects
    assert isinstance(smooth, Smooth)
    held = data.rows(data["split"] == "hold")
    left = report.model.predict(held)  # from the columns of a file alone
    assert np.sqrt(np.mean(left**2)) < 1.3 * report.gap.noise_floor


def test_a_smooth_function_stays_as_it_ends_beyond_what_was_fitted() -> None:
    blind = case(962, xy=False, family="load_squared", lam=2.0, noise="gauss")
    data = MeasuredData(blind.columns, "gpm2002", blind.metadata, "case")
    [smooth] = explain("gpm2002", data).model.model.effects
    assert isinstance(smooth, Smooth)
    one = smooth.components[0]
    ends = {name: np.array([high, 10 * high]) for name, high in zip(one.columns, one.high)}
    at_the_end, beyond = one.waves(ends)[0] @ one.weights
    assert at_the_end == beyond


@pytest.mark.parametrize("machine", ["orthoglide", "delta"])
def test_rows_that_vary_in_nothing_have_the_columns_of_all_rows(machine: str) -> None:
    """What was found with a covariate is asked of poses at which it is everywhere the same, or of one reading."""
    drawn = orthoglide.case(1) if machine == "orthoglide" else delta.case(1)
    whole = machines.make(machine).formulate(MeasuredData(drawn.columns, machine, drawn.metadata, "case"))
    x = np.array([p.start for p in whole.parameters])
    part = whole.on(whole.data.rows(np.arange(len(whole.data)) < 1))
    assert smooth_columns(part, x).keys() == smooth_columns(whole, x).keys() != set()
