"""The fallback without a name: it predicts unseen poses where something smooth is hidden."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.search.smoother import Smooth


@pytest.mark.parametrize(("seed", "xy", "family"), [(961, True, "heading_tilt"), (962, False, "load_squared")])
def test_a_nameless_cause_is_predicted_on_poses_that_no_fit_has_seen(seed: int, xy: bool, family: str) -> None:
    sealed = case(seed, xy=xy, family=family, lam=2.0, noise="gauss")
    data = MeasuredData(sealed.columns, "gpm2002", sealed.metadata, "case")
    report = explain("gpm2002", data)
    assert report.verdict == "unknown"
    assert report.gap.excess_shrink > 0.8
    [smooth] = report.model.model.effects
    assert isinstance(smooth, Smooth)
    held = data.rows(data["split"] == "hold")
    left = report.model.predict(held)  # from the columns of a file alone
    assert np.sqrt(np.mean(left**2)) < 1.3 * report.gap.noise_floor


def test_a_smooth_function_stays_as_it_ends_beyond_what_was_fitted() -> None:
    sealed = case(962, xy=False, family="load_squared", lam=2.0, noise="gauss")
    data = MeasuredData(sealed.columns, "gpm2002", sealed.metadata, "case")
    [smooth] = explain("gpm2002", data).model.model.effects
    assert isinstance(smooth, Smooth)
    one = smooth.components[0]
    ends = {name: np.array([high, 10 * high]) for name, high in zip(one.columns, one.high)}
    at_the_end, beyond = one.waves(ends)[0] @ one.weights
    assert at_the_end == beyond
