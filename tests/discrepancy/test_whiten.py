"""Whitening: AR(1) noise becomes independent, and an outlying reading counts up to a limit only."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.discrepancy.noise import whiten
from calibench.discrepancy.noise.whiten import Noise, whitener


@pytest.mark.parametrize("constraints", [1, 3])
@pytest.mark.parametrize("autocorrelation", [0.0, 0.45])
def test_whitened_noise_has_unit_covariance(constraints: int, autocorrelation: float) -> None:
    rng = np.random.default_rng(1)
    n, k = 40, 5
    B, sigma = rng.standard_normal((n, constraints, k)), rng.uniform(0.5, 2.0, (n, k))
    place = np.cumsum(rng.integers(1, 3, n)).astype(float)  # some readings in between are held out
    lags = np.abs(place[:, None] - place[None, :])
    R = autocorrelation**lags if autocorrelation else (lags == 0).astype(float)
    scaled = B * sigma[:, None, :]
    V = np.einsum("iak,jbk,ij->iajb", scaled, scaled, R).reshape(n * constraints, n * constraints)
    white = whitener(B, sigma, autocorrelation, place)
    half = white(np.linalg.cholesky(V).reshape(n, constraints, -1))
    np.testing.assert_allclose(half @ half.T, np.eye(n * constraints), atol=0.02)  # the band ends at 1e-3
    columns, scores = rng.standard_normal((n, constraints, 4)), rng.standard_normal((n, constraints, 2))
    across = columns.reshape(-1, 4).T @ white.back(scores).reshape(-1, 2)
    np.testing.assert_allclose(across, white(columns).T @ scores.reshape(-1, 2), atol=1e-10)


def test_no_columns_reach_no_lapack_which_would_write_beyond_them(monkeypatch: pytest.MonkeyPatch) -> None:
    slopes = np.random.default_rng(3).standard_normal((40, 2, 3))
    white = whitener(slopes, np.ones((40, 3)), 0.4, np.arange(40.0))
    monkeypatch.setattr(whiten, "dtbtrs", None)
    assert white(np.zeros((40, 2, 0))).shape == (80, 0)
    assert white.back(np.zeros((40, 2, 0))).shape == (40, 2, 0)


def test_scores_of_heavy_tails_have_unit_variance_and_a_slope_of_their_gain() -> None:
    rng = np.random.default_rng(2)
    law = Noise(scale=2.0, t_degrees=3.0)
    r = law.core * rng.standard_t(3, 200_000)
    assert np.mean(law.scores(r) ** 2) == pytest.approx(1.0, abs=0.01)
    assert np.mean(law.scores(r + 0.05) - law.scores(r)) / 0.05 == pytest.approx(law.gain, rel=0.02)


def test_the_cost_of_a_gaussian_is_its_sum_of_squares() -> None:
    r = np.array([1.0, -2.0, 3.0])
    assert Noise(scale=2.0).cost(r) == pytest.approx(14.0 / 4.0)
