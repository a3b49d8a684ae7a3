"""Fit a model whose *readings* carry the noise: Gauss-Helmert adjustment with damped Gauss-Newton steps.

The noise sits inside the constraints, F(theta + noise, p), so their slopes in p, taken at the readings, carry the same
noise as the residual they are multiplied with. Summed over n readings that is a bias of order n sigma^2 in J^T r. In
most directions it is small against the noise. In a direction that calibration absorbs nearly completely (standard
deviation of order sqrt(n) sigma times its visible fraction) the bias is several standard deviations, although nothing
is missing. The cure is Pope's (1972): all slopes are taken at the *adjusted* readings theta - Sigma B^T (B Sigma
B^T)^-1 F, whose remaining noise does not correlate with the residual. `docs/discovery-statistics.md` has the numbers.

With very many readings, a part of them is fitted first; all of them are fitted from where that ends.

Projection off the Jacobian: remove the part of a signature that calibration absorbs. Data can show only the rest.

The 95 % interval of an amplitude: its range where the log-likelihood is within the limit for one parameter.

For one coefficient that is its estimate -+ 1.96 sd. The length of several (an eccentricity with its phase) has no
such formula: its range over the ellipsoid (c - c^)' C^-1 (c - c^) <= 1.96^2 is the profile interval, and it reaches 0
where zero coefficients lie within.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from scipy.linalg import lstsq, qr
from scipy.special import stdtrit

from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.machine import Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import ROUNDING, Noise, Whitener, whitener
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

PLACE = "reading_place"  # the column that holds a reading's place in the order of time
_REWEIGHTED = 30  # times at most, between two looks at the slopes
_BLOCK = 2048  # rows of a block that a processor's cache holds
_DESCENDED = 1e-3, 1e-6  # change of the cost, of itself and of the whole, at which a descent ends
_DIGITS = 1e-13  # of the numbers in a constraint: a model that is this near meets them in all digits
_CALM = 1e-5  # damping below which a step is one of Gauss and Newton


@final
@dataclass(frozen=True, eq=False)
class Linearised:
    """A model linearised at x and adjusted readings: misclosure f (n, c), slopes J (n, c, p), whitener, quantities."""

    model: Model
    misclosure: Array
    columns: Array
    whiten: Whitener
    recorded: Quantities
    slopes: dict[str, Array]
    reading_slopes: Array
    sigma: Array


@final
@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model: x, whitened residuals r (m,) and Jacobian J (m, p), both unscaled, and where they were taken."""

    model: Model
    x: Array
    noise: Noise
    at: Linearised
    r: Array
    J: Array
    converged: bool

    @property
    def cost(self) -> float:
        """Return minus twice the log-likelihood of the residuals, but for a constant."""
        return self.noise.cost(self.r)

    @property
    def exact(self) -> bool:
        """Return whether the model meets all readings to rounding, as it does those of a simulation without noise.

        What is left then tells nothing: neither a noise nor an effect. With a stated noise it is a millionth of that.
        """
        if np.all(np.abs(self.r) <= ROUNDING):
            return True
        size = np.zeros_like(self.at.misclosure)
        for name, slope in self.at.slopes.items():
            size += np.abs(slope) * np.abs(np.asarray(self.at.recorded[name], dtype=float))[..., None]
        return bool(np.all(np.abs(self.at.misclosure) <= _DIGITS * size))

    @property
    def degrees(self) -> int:
        """Return the degrees of freedom that the parameters leave, 1 at least."""
        return max(len(self.r) - len(self.x), 1)

    @property
    def reach(self) -> float:
        """Return how many standard deviations of `covariance` hold 95 %: Student's t where the noise is not known."""
        return float(stdtrit(self.degrees, 0.975)) if self.noise.profiled else REACH

    def covariance(self, stated: bool = False) -> Array:
        """Return the covariance of x, shape (p, p); where the noise is not known, it is estimated from the residuals.

        `stated`: use the stated noise in any case.
        """
        size = np.sqrt((self.J**2).sum(axis=0))
        size[size == 0] = 1.0
        R = (
            np.linalg.qr(self.J / size, mode="r")
            if len(self.J) < thresholds().many_readings
            else triangle(self.J) / size
        )
        spread = np.linalg.pinv(R) / self.noise.precision / size[:, None]
        learned = self.cost / self.degrees if self.noise.profiled and not stated else 1.0
        return np.asarray(learned * spread @ spread.T)


# a step beyond the machine's reach: its cost is not finite, so it is refused
@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def fit(
    model: Model, noise: Noise, start: Array | None = None, *, near: bool = True, steps: int = 60,
    about: Fit | None = None,
) -> Fit:  # fmt: skip
    """Return `model` fitted under `noise`: with damping from its nominal start; without from a `start` that is `near`.

    `about` is a fit of nearly the same model to the same rows: its adjusted readings are the first ones.
    """
    x = model.start if start is None else np.asarray(start, dtype=float).copy()
    readings = readings_of(model)
    many = len(readings) >= thresholds().many_readings
    if many:
        x = fit(*part_of(model, noise), start, near=near, steps=steps).x
    elif start is None or not near:
        x = _descend(model, noise, x, readings, steps)
    adjusted = readings if many or about is None else readings_of(about.at.model)
    converged = False
    for _ in range(8):
        at = linearise(model, noise, x, adjusted, readings)
        r, J = at.whiten(at.misclosure), at.whiten(at.columns)
        step = _step(r, J, noise) * noise.stride if many else _settled(r, J, noise)
        x = x + step
        left, moved = at.misclosure + at.columns @ step, J @ step
        last = thresholds().step_nearly if many and not np.isfinite(noise.t_degrees) else thresholds().step_still
        still = bool(np.sqrt(np.mean(moved**2)) < last * noise.scale)
        converged = still and adjusted is not readings  # slopes at the unadjusted readings do not decide convergence
        if converged and many:  # another evaluation of the slopes would change x by the square of the step only
            return Fit(model, x, noise, replace(at, misclosure=left), r + moved, J, converged)
        adjusted = readings - _noise_of(at, left, noise)
        if converged:
            break
    return fit_at(model, noise, x, adjusted, converged)


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def fit_at(model: Model, noise: Noise, x: Array, adjusted: Array, converged: bool) -> Fit:
    """Return the fit that ended at x and `adjusted` readings, (n, k)."""
    at = linearise(model, noise, x, adjusted, readings_of(model))
    return Fit(model, x, noise, at, at.whiten(at.misclosure), at.whiten(at.columns), converged)


def rests(found: Fit) -> bool:
    """Return whether a further step is as small as the last step of a converged fit."""
    step = _step(found.r, found.J, found.noise)
    return bool(np.sqrt(np.mean((found.J @ step) ** 2)) < thresholds().step_still * found.noise.scale)


def with_columns(found: Fit, extra: Mapping[str, Array]) -> Fit:
    """Return a fit whose data have `extra` columns, (n,) each, that no constraint reads."""

    def wider(model: Model) -> Model:
        return replace(model, formulation=model.formulation.on(model.formulation.data.with_columns(extra)))

    return replace(found, model=wider(found.model), at=replace(found.at, model=wider(found.at.model)))


def _settled(r: Array, J: Array, noise: Noise) -> Array:
    """Return the step for which the weights of heavy-tailed noise no longer change; slopes are kept."""
    step = _step(r, J, noise)
    for _ in range(_REWEIGHTED if np.isfinite(noise.t_degrees) else 0):
        further = _step(r + J @ step, J, noise)
        step = step + further
        if not np.sqrt(np.mean((J @ further) ** 2)) >= thresholds().step_still * noise.scale:
            break
    return step


def part_of(model: Model, noise: Noise) -> tuple[Model, Noise]:
    """Return the model and the noise of a random part of very many readings, the same at every call."""
    data = model.formulation.data
    some = np.sort(np.random.default_rng(0).choice(len(data), thresholds().part_readings, replace=False))
    extra = {name: v if np.ndim(v) == 0 else np.asarray(v)[some] for name, v in noise.extra.items()}
    return Model(model.formulation.on(data.rows(some)), model.effects), replace(noise, extra=extra)


def linearise(model: Model, noise: Noise, x: Array, adjusted: Array, readings: Array) -> Linearised:
    """Return `model` linearised at x and `adjusted` readings (n, k).

    The misclosure is that of the recorded readings.
    """
    formulation = model.formulation
    data = formulation.data
    if adjusted is not readings:
        data = data.with_columns({name: adjusted[:, j] for j, name in enumerate(formulation.readings)})
        model = Model(formulation.on(data), model.effects)
    recorded, true = model.quantities(x)
    slopes = model.formulation.slopes(true)
    B = np.stack([slopes[name] for name in formulation.readings], axis=-1)
    misclosure = np.asarray(model.formulation.constraints(true))
    if adjusted is not readings:
        misclosure = misclosure + np.einsum("nck,nk->nc", B, readings - adjusted)
    misclosure = model.formulation.decorrelate(misclosure)
    sigma = _sigma(model, noise)
    whiten = whitener(B, sigma, noise.autocorrelation, reading_order(data))
    return Linearised(
        model=model,
        misclosure=misclosure,
        columns=model.jacobian_of(x, recorded, slopes),
        whiten=whiten,
        recorded=recorded,
        slopes=slopes,
        reading_slopes=B,
        sigma=sigma,
    )


def readings_of(model: Model) -> Array:
    """Return the noisy readings, shape (n, k)."""
    data = model.formulation.data
    return np.stack([np.asarray(data[name], dtype=float) for name in model.formulation.readings], axis=-1)


def reading_order(data: MeasuredData) -> Array:
    """Return the place of each row in the order of reading, shape (n,)."""
    return np.asarray(data[PLACE]) if data.has(PLACE) else np.arange(len(data), dtype=float)


def _sigma(model: Model, noise: Noise) -> Array:
    """Return the standard deviation of each reading without `scale`, (n, k), from the stated and the extra variance."""
    n = len(model.formulation.data)
    stated = model.formulation.sigma
    variances = [np.asarray(stated[name]) ** 2 + noise.extra.get(name, 0.0) for name in model.formulation.readings]
    return np.sqrt(np.stack([np.broadcast_to(v, n) for v in variances], axis=-1))


def _noise_of(at: Linearised, misclosure: Array, noise: Noise) -> Array:
    """Return the readings' noise as estimated from the misclosure: Sigma B^T (B Sigma B^T)^-1 f, shape (n, k).

    It is computed row by row. The correlation with neighbouring rows is ignored, because the estimate only has to be
    uncorrelated with the residual of its own row.
    """
    scaled = at.reading_slopes * at.sigma[:, None, :]
    covariance = scaled @ scaled.transpose(0, 2, 1)
    right = misclosure[:, :, None]
    pull = right / covariance if covariance.shape[1] == 1 else np.linalg.solve(covariance, right)
    return np.asarray((scaled.transpose(0, 2, 1) @ pull)[:, :, 0] * at.sigma)


def _step(r: Array, J: Array, noise: Noise, damping: float = 0.0) -> Array:
    """Return the Gauss-Newton step by orthogonal decomposition, columns scaled, damped as Levenberg's where asked."""
    root = np.sqrt(noise.weights(r))
    A, b = (J * root[:, None], -root * r) if len(r) <= _BLOCK else _folded(J, r, root)
    size = np.sqrt((A**2).sum(axis=0))
    size[size == 0] = 1.0
    A = A / size
    if damping:
        A, b = np.vstack([A, np.sqrt(damping) * np.eye(A.shape[1])]), np.concatenate([b, np.zeros(A.shape[1])])
    Q, R, order = qr(A, mode="economic", pivoting=True, check_finite=False)
    diagonal = np.abs(np.diag(R))
    rank = int(np.sum(diagonal > 1e-11 * diagonal[0])) if diagonal[0] > 0 else 0
    step = np.zeros(A.shape[1])
    if rank:
        step[order[:rank]] = lstsq(R[:rank, :rank], (Q.T @ b)[:rank], check_finite=False)[0]
    return np.asarray(step / size)


def _folded(J: Array, r: Array, root: Array) -> tuple[Array, Array]:
    """Return the triangle R of the weighted rows of J, and -r transformed in the same way, block by block.

    Lengths and angles are those of all rows, to rounding, as in any orthogonal decomposition.
    """
    whole = triangle(np.column_stack([J, -r]), root)
    return whole[:, :-1], whole[:, -1]


def triangle(A: Array, root: Array | None = None) -> Array:
    """Return R of the decomposition of very many rows A, (N, p), each times its `root` if given, block by block."""
    blocks = [slice(start, start + _BLOCK) for start in range(0, len(A), _BLOCK)]
    parts = [np.linalg.qr(A[b] if root is None else A[b] * root[b, None], mode="r") for b in blocks]
    return np.asarray(np.linalg.qr(np.concatenate(parts), mode="r"))


def _descend(model: Model, noise: Noise, x: Array, readings: Array, steps: int) -> Array:
    """Return x after damped steps at the readings themselves; the damping falls to zero as steps succeed."""
    damping, at = 1e-3, linearise(model, noise, x, readings, readings)
    r, J = at.whiten(at.misclosure), at.whiten(at.columns)
    cost = noise.cost(r)
    for _ in range(steps):
        step = _step(r, J, noise, damping)
        trial = linearise(model, noise, x + step, readings, readings)
        trial_r = trial.whiten(trial.misclosure)
        trial_cost = noise.cost(trial_r)
        if np.isfinite(trial_cost) and trial_cost <= cost:
            gained, x, r, cost = cost - trial_cost, x + step, trial_r, trial_cost
            J = trial.whiten(trial.columns)
            damping = 0.0 if damping < 1e-9 else damping / 10
            if gained < _DESCENDED[0] + _DESCENDED[1] * cost and damping < _CALM:
                break
        elif damping > 1e8 or (damping <= _CALM and trial_cost - cost < _DESCENDED[0] + _DESCENDED[1] * cost):
            break  # the whitening moves with x: at the bottom a Gauss-Newton step may climb by a hair for ever
        else:
            damping = max(4 * damping, 1e-6)
    return x


def orthonormal(columns: Array, least: float) -> Array:
    """Return an orthonormal basis (n, m) of the span of `columns`, (n, p), each scaled to length 1.

    Directions whose singular value is not above `least` times the largest are left out.
    """
    lengths = np.linalg.norm(columns, axis=0)
    left, values, _ = np.linalg.svd(columns / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
    return np.asarray(left[:, values > least * values[0]])


def project_off(columns: Array, basis: Array, times: int = 1) -> Array:
    """Return `columns`, (..., n, k) or (n,), less their part in the span of an orthonormal `basis`, (n, p).

    Twice for what the basis all but holds: the second time takes away what rounding left of the first.
    """
    for _ in range(times):
        columns = columns - basis @ (basis.T @ columns)
    return columns


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
