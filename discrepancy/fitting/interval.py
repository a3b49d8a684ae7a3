"""The 95 % interval of an amplitude: its range where the log-likelihood is within the limit for one parameter.

For one coefficient that is its estimate -+ 1.96 sd. The length of several (an eccentricity with its phase) has no
such formula: its range over the ellipsoid (c - c^)' C^-1 (c - c^) <= 1.96^2 is the profile interval, and it reaches 0
where zero coefficients lie within.
"""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.model.effect import Effect
from calibench.problems.base import Array

REACH = 1.959964

_POINTS = 2000


def amplitude_interval(effect: Effect, c: Array, covariance: Array, reach: float = REACH) -> tuple[float, float]:
    """Return the 95 % interval of the amplitude at coefficients c, (k,), of `covariance` (k, k).

    `reach` is that of a Gaussian in its standard deviations; Student's where the variance was learned as well.
    """
    k = len(c)
    if k == 1:
        ends = [effect.amplitude(c + side * reach * np.sqrt(covariance[0])) for side in (-1, 1)]
        return float(min(ends)), float(max(ends))
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    directions = _directions(k)
    sizes = [effect.amplitude(c + reach * root @ d) for d in directions]
    signed = effect.amplitude(-c) < 0 or effect.amplitude(c) < 0
    inside = float(c @ np.linalg.pinv(covariance) @ c) <= reach**2
    return float(0.0 if inside and not signed else min(sizes)), float(max(sizes))


def _directions(k: int) -> Array:
    """Return points on the unit sphere, always the same."""
    if k == 2:
        angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)
        return np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    drawn = np.random.default_rng(0).standard_normal((_POINTS, k))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))
