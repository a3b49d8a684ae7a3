"""Whitening: the noise of the readings propagated into the constraints, r = L^-1 F with L L^T = B Sigma B^T.

B is the slope of the constraints in the noisy readings, Sigma the readings' covariance: independent sensors, each an
AR(1) in the order of reading, whatever the pause; then L is banded. Heavier tails are those of Student's t. `Noise`
turns whitened residuals into weights (for fitting), a cost (for comparing) and *scores* of unit variance (for testing),
clipped as Huber does, so that a single outlier cannot decide a test.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import final

import numpy as np
from scipy.linalg import cholesky_banded
from scipy.linalg.lapack import dtbtrs
from scipy.special import chdtri, fdtrc, gammaln, stdtr

from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

ROUNDING = 1e-6  # of the stated noise: what is smaller is rounding, in readings without noise
_NO_COST = 1e-12  # cost of all residuals together, below which a model meets every reading exactly
_MOST = 60.0  # largest exponent: gain a residual, whose exponential is still a number


@cache
def _huber(t_degrees: float, cut: float) -> tuple[float, float]:
    """Return the root mean square of a t variable clipped at `cut` scales, and its probability of not being clipped."""
    x = np.linspace(-cut, cut, 4001)
    inside = float(stdtr(t_degrees, cut) - stdtr(t_degrees, -cut))
    density = np.exp(gammaln((t_degrees + 1) / 2) - gammaln(t_degrees / 2)) / np.sqrt(t_degrees * np.pi)
    density = density * (1 + x**2 / t_degrees) ** (-(t_degrees + 1) / 2)
    square = float(np.trapezoid(x**2 * density, x)) + cut**2 * (1 - inside)
    return float(np.sqrt(square)), inside


@final
@dataclass(frozen=True)
class Noise:
    """The law of the readings' noise: `scale` times what is stated, AR(1), Gaussian or of a t distribution.

    `autocorrelation` is the correlation of the noise of two successive readings. `t_degrees` are the degrees of
    freedom of the t distribution, infinite for Gaussian noise. `from_repeats`: repeated readings contradicted the
    stated noise, and `scale` is estimated from them; otherwise `scale` is 1, the stated noise. `known` are the degrees
    of freedom of that estimate, or of an estimate from residuals where nobody states the noise; infinite for stated
    noise. `profiled`: nothing but the statement gives the size of the noise, so gains of models are computed with the
    likeliest scale of each. `extra` is added to the stated variance of some readings, name -> (n,) or a number, in the
    unit of the reading squared.
    """

    scale: float = 1.0
    autocorrelation: float = 0.0
    t_degrees: float = np.inf
    known: float = np.inf
    extra: Mapping[str, Array | float] = field(default_factory=dict)
    profiled: bool = False
    from_repeats: bool = False

    @property
    def core(self) -> float:
        """Return the scale of the t distribution whose standard deviation is `scale`."""
        if not np.isfinite(self.t_degrees):
            return self.scale
        return float(self.scale * np.sqrt(max(self.t_degrees - 2, 0.5) / self.t_degrees))

    def weights(self, r: Array) -> Array:
        """Return the weights of whitened residuals in a fit, of the shape of r."""
        if not np.isfinite(self.t_degrees):
            return np.full(r.shape, 1 / self.scale**2)
        return np.asarray((self.t_degrees + 1) / (self.t_degrees * self.core**2 + r**2))

    def cost(self, r: Array) -> float:
        """Return minus twice the log-likelihood of whitened residuals, without the part that no fit changes."""
        if not np.isfinite(self.t_degrees):
            return float(np.sum(r**2 / self.scale**2))
        return float(np.sum((self.t_degrees + 1) * np.log1p(r**2 / (self.t_degrees * self.core**2))))

    def scores(self, r: Array) -> Array:
        """Return scores of unit variance: r / scale; for heavy tails r is clipped at `residual_cut` scales (Huber).

        The score of the t distribution itself decreases again for large residuals: a strong local error would then
        count as bad readings.
        """
        if not np.isfinite(self.t_degrees):
            return np.asarray(r / self.scale)
        cut = thresholds().residual_cut
        return np.asarray(np.clip(r / self.core, -cut, cut) / _huber(self.t_degrees, cut)[0])

    @property
    def gain(self) -> float:
        """Return the factor from a unit of signal in the whitened residuals to one in the scores."""
        if not np.isfinite(self.t_degrees):
            return 1 / self.scale
        root, slope = _huber(self.t_degrees, thresholds().residual_cut)
        return float(slope / root / self.core)

    def gained(self, before: float, after: float, degrees: int) -> float:
        """Return the gain in twice the log-likelihood of a model whose cost is `after`, over one whose is `before`."""
        if not self.profiled:
            return before - after
        return degrees * float(np.log(max(before, _NO_COST) / max(after, _NO_COST)))

    def told_apart(self, difference: float, degrees: int) -> float:
        """Return a difference of two models' gains as the chi-square of one degree of freedom with the same p.

        `degrees` are those that the better model leaves. Where the noise is profiled, it is estimated from the
        residuals of both models together, with one degree less: the test is F of (1, degrees - 1), so with few degrees
        of freedom even a large difference is weak evidence.
        """
        if not self.profiled or difference <= 0:
            return difference
        if degrees < 2:
            return 0.0  # both models together meet every reading
        rest = degrees - 1
        p = fdtrc(1, rest, rest * float(np.expm1(min(difference / degrees, _MOST))))
        return float(chdtri(1, p)) if p > 0 else difference

    def size_of(self, gain: float, count: int) -> float:
        """Return the rms, in standard deviations of the noise over `count` residuals, of a signal with such a gain."""
        part = max(gain, 0.0) / count
        return float(np.sqrt(np.expm1(min(part, _MOST)) if self.profiled else part))

    def loglikelihood(self, r: Array) -> float:
        """Return the log-likelihood of whitened residuals under the law."""
        if not np.isfinite(self.t_degrees):
            return float(-0.5 * np.sum((r / self.scale) ** 2) - r.size * (np.log(self.scale) + 0.5 * np.log(2 * np.pi)))
        nu = self.t_degrees
        constant = gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * np.log(nu * np.pi) - np.log(self.core)
        return float(r.size * constant - 0.5 * self.cost(r))


def _solved(band: Array, columns: Array, trans: str = "N") -> Array:
    if not columns.size:  # SciPy's dtbtrs writes beyond an array of no columns
        return columns
    return np.asarray(dtbtrs(band, np.asfortranarray(columns), uplo="L", trans=trans)[0])


@final
@dataclass(frozen=True, eq=False)
class Whitener:
    """L^-1 of one set of constraints: blocks (n, c, c), or a band (w, n c) where noise is AR(1)."""

    blocks: Array
    band: Array | None

    def __call__(self, columns: Array) -> Array:
        """Return L^-1 times `columns`, shape (n, c, ...), as (n c, ...)."""
        n, c = columns.shape[:2]
        if self.band is not None:
            flat = columns.reshape(n * c, int(np.prod(columns.shape[2:])))
            return _solved(self.band, flat).reshape(n * c, *columns.shape[2:])
        if c == 1:
            white = columns * self.blocks.reshape(n, 1, *(1,) * (columns.ndim - 2))
        else:
            white = (self.blocks @ columns.reshape(n, c, -1)).reshape(columns.shape)
        return np.asarray(white.reshape(n * c, *columns.shape[2:]))

    def back(self, rows: Array) -> Array:
        """Return L^-T times `rows`, (n, c, t), whose products with columns are those of `rows` with whitened ones."""
        if self.band is None:
            return np.asarray(self.blocks.transpose(0, 2, 1) @ rows)
        n, c, t = rows.shape
        return _solved(self.band, rows.reshape(n * c, t), "T").reshape(n, c, t)


def whitener(slopes: Array, sigma: Array, autocorrelation: float, place: Array) -> Whitener:
    """Return the whitener of slopes B, (n, c, k), in readings of standard deviation `sigma`, (n, k)."""
    scaled = slopes * sigma[:, None, :]
    n, c = scaled.shape[:2]
    reach = int(np.ceil(np.log(thresholds().correlation_kept) / np.log(autocorrelation))) if autocorrelation > 0 else 0
    if not reach:
        return Whitener(_inverse_root(scaled @ scaled.transpose(0, 2, 1)), None)
    band = np.zeros((c * (reach + 1), n * c))
    for lag in range(min(reach + 1, n)):
        part = autocorrelation ** (place[lag:] - place[: n - lag]).astype(float)
        blocks = (scaled[lag:] @ scaled[: n - lag].transpose(0, 2, 1)) * part[:, None, None]
        for a in range(c):
            for b in range(c):
                below = lag * c + a - b
                if below >= 0:
                    band[below, b : (n - lag) * c : c] = blocks[:, a, b]
    return Whitener(np.empty(0), cholesky_banded(band, lower=True, check_finite=False))


def _inverse_root(covariance: Array) -> Array:
    """Return L^-1 of L L^T = covariance, (n, c, c), all rows at once: c is small and n is not. NaN where there is none.

    Row by row the entries of Cholesky's factor, then those of its inverse, as in textbooks.
    """
    n, c = covariance.shape[:2]
    L = [[np.empty(0)] * c for _ in range(c)]
    inverse = np.zeros((n, c, c))
    for i in range(c):
        for j in range(i + 1):
            left = covariance[:, i, j] - sum(L[i][k] * L[j][k] for k in range(j))
            L[i][j] = np.sqrt(left) if i == j else left / L[j][j]
        inverse[:, i, i] = 1 / L[i][i]
        for j in range(i):
            inverse[:, i, j] = -sum(L[i][k] * inverse[:, k, j] for k in range(j, i)) / L[i][i]
    return inverse
