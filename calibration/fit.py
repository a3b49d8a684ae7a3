"""The adjustment of an arm: damped Gauss-Newton over the parameters that the readings determine; wild readings named.

The noise of each kind of reading is estimated from what is left, and decides with `determined` which parameters are
free: both are found in turn until neither changes. The others keep their nominal values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.calibration.determined import select_determined
from calibench.calibration.model import ArmModel, stacked, stacked_residuals
from calibench.calibration.rigid import Array, Index, Mask
from calibench.core.words import plain

_STEPS, _SETTLED = 60, 1e-9
_ROUNDS, _SAME = 8, 0.02  # until the noise that is left changes by less
_WILD = 6.0  # times the median error: a reading beyond is wild; noise alone has one in 10^9 poses
_FLOOR = 1e-9
_KNOWN, _AGAIN = 30.0, 3
_MOST, _MOST_IN_SOCKETS = 0.35, 0.2  # part of the readings that may be wild; more than that is no accident


@final
@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters `p` of which `kept` were free; `wild` (n,) marks the readings that had no influence.

    `covariance` (k, k) is that of the kept ones, at the scatter that is left.
    """

    model: ArmModel
    p: Array
    kept: Index
    wild: Mask
    covariance: Array

    @property
    def weights(self) -> Array:
        """Return 1 for the readings that had an influence, 0 for the wild, (n,)."""
        return np.where(self.wild, 0.0, 1.0)


def fit_arm(model: ArmModel, order: Sequence[int], start: Array | None = None) -> Fit:
    """Return the fit of the parameters in `order` that are determined; wild readings are left out and named.

    The noise of position and rotation is estimated from the residuals, where both were read.
    """
    begin = model.start if start is None else start
    p, n = begin, len(model.joints)
    wild = np.zeros(n, dtype=bool)
    for turn in range(_ROUNDS):
        weights = np.where(wild, 0.0, 1.0)
        kept = select_determined(model, p, order, weights, first=turn == 0)
        p = _adjust(model, _held(begin, p, kept), kept, weights, soft=not wild.any())
        before, sigma = wild, model.sigma
        model, wild = _with_noise(model, p, wild)
        model = _with_scatter(model, p, np.where(wild, 0.0, 1.0))
        if turn and np.array_equal(wild, before) and np.allclose(model.sigma, sigma, rtol=_SAME, atol=0.0):
            break  # the noise decides what is determined, and what is determined decides the noise
    weights = np.where(wild, 0.0, 1.0)
    kept = select_determined(model, p, order, weights)
    if not len(kept):
        rest = float(np.median(norms(model.errors(p, weights))))
        raise ValueError(
            f"nothing of the arm is determined: {plain(rest, 3)} mm are left of the middle reading; do the joints "
            "and the reading of a row belong together, and did the tracker stand still?"
        )
    p = _adjust(model, _held(begin, p, kept), kept, weights, soft=False)
    return Fit(model, p, kept, wild, _covariance(model, p, kept, weights))


def fit_from(fit: Fit, order: Sequence[int], keep: Mask) -> Array:
    """Return the parameters of a fit to the poses of `keep` (n,) alone, by steps from a fit to all of them."""
    model = fit.model.at(keep).numbered()
    weights = fit.weights[keep]
    kept = select_determined(model, fit.p, order, weights)
    start = model.start
    frames = [k for k, name in enumerate(model.names) if name.startswith(("base_", "tool_"))]
    start[frames], start[kept] = fit.p[frames], fit.p[kept]
    p = _adjust(model, start, kept, weights, soft=False)
    for _ in range(_AGAIN if model.position is None else 0):  # these sockets by what they leave themselves
        model = _with_scatter(model, p, weights)
        p = _adjust(model, p, kept, weights, soft=False)
    return p


def _held(begin: Array, p: Array, kept: Index) -> Array:
    """Return `p` in the parameters that are kept, and `begin` in all others."""
    made = begin.copy()
    made[kept] = p[kept]
    return made


def norms(errors: tuple[Array, Array | None]) -> Array:
    """Return the length of the position errors, (n,) [mm]."""
    return np.asarray(np.sqrt((errors[0] ** 2).sum(axis=1)))


def _adjust(model: ArmModel, p: Array, kept: Index, weights: Array, soft: bool) -> Array:
    """Return the least squares solution by Levenberg's damping; `soft` reduces the weight of far readings (soft L1)."""
    p = p.copy()
    if not len(kept):
        return p
    parts = model.residuals(p, weights)
    damping, value = 1e-6, _value(*parts, weights, soft)
    for _ in range(_STEPS):
        by_row = _soft_weights(parts[0], weights) if soft else weights
        rows = stacked(*model.jacobian(p, kept, weights), by_row)
        residuals = stacked_residuals(*parts, by_row)
        scale = np.linalg.norm(rows, axis=0) + _FLOOR
        q, r = np.linalg.qr(np.vstack([rows / scale, np.zeros((len(kept), len(kept)))]))
        wanted = -(q.T @ np.concatenate([residuals, np.zeros(len(kept))]))
        improved = False
        for _ in range(12):
            damped = np.vstack([r, np.sqrt(damping) * np.eye(len(kept))])
            step = np.linalg.lstsq(damped, np.concatenate([wanted, np.zeros(len(kept))]), rcond=None)[0] / scale
            tried = p.copy()
            tried[kept] += step
            there = model.residuals(tried, weights)
            cost = _value(*there, weights, soft)
            if cost <= value:
                improved = True
                break
            damping = max(damping, 1e-9) * 10
        if not improved:
            break
        gained = value - cost
        p, parts, value, damping = tried, there, cost, max(damping / 10, 1e-12)
        if gained <= _SETTLED * (1 + value):
            break
    return p


def _with_noise(model: ArmModel, p: Array, wild: Mask) -> tuple[ArmModel, Mask]:
    """Return the model with the noise estimated from the residuals of each kind of reading; which readings are wild."""
    weights = np.where(wild, 0.0, 1.0)
    position, turned = model.errors(p, weights)
    far = np.zeros(len(position), dtype=bool)
    sigma = list(model.sigma)
    for k, part in enumerate([position] if turned is None else [position, turned]):
        size = np.sqrt((part**2).sum(axis=1))
        middle = float(np.median(size[~wild]))
        sigma[k] = max(middle / 1.538, _FLOOR)  # the median length of three unit normals is 1.538
        far |= size > _WILD * max(middle, 1e3 * _FLOOR)
    if far.mean() > (_MOST_IN_SOCKETS if model.position is None else _MOST):  # so many cannot be exceptions
        far = wild
    return replace(model, sigma=(sigma[0], sigma[1])), far


def far_out(size: Array) -> Mask:
    """Return which errors (n,) are wild beside the others, (n,); none where so many are that they are no accident."""
    far: Mask = np.asarray(size > _WILD * max(float(np.median(size)), 1e3 * _FLOOR))
    return np.zeros(len(size), dtype=bool) if far.mean() > _MOST else far


def _with_scatter(model: ArmModel, p: Array, weights: Array) -> ArmModel:
    """Return the model with a separate scatter for each socket: errors that no geometry explains differ by place.

    Each is that of its postures, mixed with `_KNOWN` numbers of the usual scatter.
    """
    if model.position is not None:
        return model
    square = weights * (model.errors(p, weights)[0] ** 2).sum(axis=1)
    count, usual = np.bincount(model.socket, weights), model.sigma[0] ** 2
    scatter = (np.bincount(model.socket, square) + _KNOWN * usual) / (3 * np.maximum(count - 1, 0) + _KNOWN)
    return replace(model, scatter=np.sqrt(scatter / usual)[model.socket])


def _value(over: Array, more: Array, weights: Array, soft: bool) -> float:
    square = (over**2).sum(axis=1)
    loss = weights @ (2 * (np.sqrt(1 + square / 9) - 1) * 9 if soft else square)
    value = float(loss + more @ more)
    return value if np.isfinite(value) else np.inf


def _soft_weights(over: Array, weights: Array) -> Array:
    """Return the weight of each reading under the soft L1 loss of the length of its residual, (n,)."""
    square = (over**2).sum(axis=1)
    return np.asarray(weights / np.sqrt(1 + square / 9))


def _covariance(model: ArmModel, p: Array, kept: Index, weights: Array) -> Array:
    rows = stacked(*model.jacobian(p, kept, weights), weights)
    residuals = stacked_residuals(*model.residuals(p, weights), weights)
    spare = max(1, int((weights > 0).sum()) * model.residuals(p, weights)[0].shape[1] - len(kept))
    scale = np.linalg.norm(rows, axis=0) + _FLOOR
    inverse = np.linalg.pinv((rows / scale).T @ (rows / scale), rcond=1e-13)
    return np.asarray(inverse / np.outer(scale, scale) * float(residuals @ residuals) / spare)
