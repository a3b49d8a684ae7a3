"""The adjustment of an arm, wild readings named; the errors of poses that were not fitted, and intervals of parameters.

What is left gives the noise of each kind of reading, and with `determined` which parameters are free. Every pose is
held out once with its repeats, in five folds (of sockets, whole places). Intervals come from a bootstrap of one step a
draw.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.calibration.determined import select_determined
from calibench.calibration.model import ArmModel, stacked
from calibench.calibration.readings import poses_of
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
    """Parameters `p`, of which `kept` with `covariance` were free; `wild` (n,) are the readings without influence."""

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
    """Return the fit of the parameters in `order` that are determined; wild readings are left out and named."""
    begin = model.start if start is None else start
    p, wild = begin, np.zeros(len(model.joints), dtype=bool)
    for turn in range(_ROUNDS):
        weights = np.where(wild, 0.0, 1.0)
        kept = select_determined(model, p, order, weights, first=turn == 0)
        p = _adjust(model, p, kept, weights, soft=not wild.any(), begin=begin)

        # the noise of each kind of reading, and which readings are wild
        before, far, sigma = wild, np.zeros(len(wild), dtype=bool), list(model.sigma)
        for k, part in enumerate(part for part in model.errors(p, weights) if part is not None):
            size = np.sqrt((part**2).sum(axis=1))
            middle = float(np.median(size[~wild]))
            sigma[k] = max(middle / 1.538, _FLOOR)  # the median length of three unit normals is 1.538
            far |= size > _WILD * max(middle, 1e3 * _FLOOR)
        if far.mean() <= (_MOST_IN_SOCKETS if model.position is None else _MOST):  # else they cannot be exceptions
            wild = far
        settled = np.allclose(sigma, model.sigma, rtol=_SAME, atol=0.0)
        model = _with_scatter(replace(model, sigma=(sigma[0], sigma[1])), p, np.where(wild, 0.0, 1.0))
        if turn and np.array_equal(wild, before) and settled:
            break  # the noise decides what is determined, and what is determined decides the noise

    weights = np.where(wild, 0.0, 1.0)
    kept = select_determined(model, p, order, weights)
    if not len(kept):
        rest = float(np.median(norms(model.errors(p, weights))))
        raise ValueError(
            f"nothing of the arm is determined: {plain(rest, 3)} mm are left of the middle reading; do the joints "
            "and the reading of a row belong together, and did the tracker stand still?"
        )
    p = _adjust(model, p, kept, weights, soft=False, begin=begin)

    rows, over = stacked(*model.jacobian(p, kept, weights), weights), model.residuals(p, weights)
    residuals = stacked(*over, weights)
    spare = max(1, int((weights > 0).sum()) * over[0].shape[1] - len(kept))
    scale = np.linalg.norm(rows, axis=0) + _FLOOR
    inverse = np.linalg.pinv((rows / scale).T @ (rows / scale), rcond=1e-13)
    covariance = inverse / np.outer(scale, scale) * float(residuals @ residuals) / spare
    return Fit(model, p, kept, wild, np.asarray(covariance))


def fit_from(fit: Fit, order: Sequence[int], keep: Mask) -> Array:
    """Return the parameters of a fit to the poses of `keep` (n,) alone, by steps from a fit to all of them."""
    model, weights = fit.model.at(keep), fit.weights[keep]
    kept = select_determined(model, fit.p, order, weights)
    start = model.start
    frames = [k for k, name in enumerate(model.names) if name.startswith(("base_", "tool_"))]
    start[frames], start[kept] = fit.p[frames], fit.p[kept]
    p = _adjust(model, start, kept, weights, soft=False)
    for _ in range(_AGAIN if model.position is None else 0):  # these sockets by what they leave themselves
        model = _with_scatter(model, p, weights)
        p = _adjust(model, p, kept, weights, soft=False)
    return p


def norms(errors: tuple[Array, Array | None]) -> Array:
    """Return the length of the position errors, (n,) [mm]."""
    return np.asarray(np.sqrt((errors[0] ** 2).sum(axis=1)))


def _adjust(model: ArmModel, p: Array, kept: Index, weights: Array, soft: bool, begin: Array | None = None) -> Array:
    """Return the least squares solution by Levenberg's damping; what is not `kept` is as in `begin`, or in `p`."""
    held = (p if begin is None else begin).copy()
    held[kept] = p[kept]
    p = held
    if not len(kept):
        return p
    parts = model.residuals(p, weights)
    damping, value = 1e-6, _value(*parts, weights, soft)
    for _ in range(_STEPS):
        by_row = weights / np.sqrt(1 + (parts[0] ** 2).sum(axis=1) / 9) if soft else weights
        rows = stacked(*model.jacobian(p, kept, weights), by_row)
        residuals = stacked(*parts, by_row)
        scale = np.linalg.norm(rows, axis=0) + _FLOOR
        q, r = np.linalg.qr(np.vstack([rows / scale, np.zeros((len(kept), len(kept)))]))
        wanted = -(q.T @ np.concatenate([residuals, np.zeros(len(kept))]))
        for _ in range(12):
            damped = np.vstack([r, np.sqrt(damping) * np.eye(len(kept))])
            step = np.linalg.lstsq(damped, np.concatenate([wanted, np.zeros(len(kept))]), rcond=None)[0] / scale
            tried = p.copy()
            tried[kept] += step
            there = model.residuals(tried, weights)
            cost = _value(*there, weights, soft)
            if cost <= value:
                break
            damping = max(damping, 1e-9) * 10
        else:
            break
        gained = value - cost
        p, parts, value, damping = tried, there, cost, max(damping / 10, 1e-12)
        if gained <= _SETTLED * (1 + value):
            break
    return p


def far_out(size: Array) -> Mask:
    """Return which errors (n,) are wild beside the others, (n,); none where so many are that they are no accident."""
    far: Mask = np.asarray(size > _WILD * max(float(np.median(size)), 1e3 * _FLOOR))
    return np.zeros(len(size), dtype=bool) if far.mean() > _MOST else far


def _with_scatter(model: ArmModel, p: Array, weights: Array) -> ArmModel:
    """Return the model with a separate scatter for each socket: errors that no geometry explains differ by place."""
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


FOLDS = 5
_DRAWS = 1000  # of mean squares
_FAR = 6.0  # times the median: a posture beyond has no influence on the point of its own socket


@final
@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors of poses not fitted, `position` [mm] and `rotation` [rad], NaN for others; `spans` [mm] of two sockets."""

    position: Array
    rotation: Array | None
    spans: Array


def predict(fit: Fit, model: ArmModel, there: Mask) -> HeldOut:
    """Return the errors by `fit` of the poses of `model` that are `there` (n,), none of which it was fitted to."""
    position, turned = np.full((2, len(there)), np.nan)
    return HeldOut(position, None if model.turns is None else turned, _put(fit.p, model, there, position, turned))


def cross_validate(fit: Fit, order: Sequence[int]) -> HeldOut:
    """Return the errors of all poses of `fit`, each by a fit of the parameters in `order` to those of other folds."""
    model = fit.model
    places = np.unique(model.place)
    if model.position is None and len(places) > 1:
        fold = np.searchsorted(places, model.place) % min(FOLDS, len(places))
    else:
        fold = poses_of(model.joints) % FOLDS
    position, turned = np.full((2, len(fold)), np.nan)
    spans = [np.zeros(0)]
    for k in range(int(fold.max()) + 1):
        there = np.asarray(fold == k)
        spans.append(_put(fit_from(fit, order, ~there), model, there, position, turned))
    return HeldOut(position, None if model.turns is None else turned, np.concatenate(spans))


def _put(p: Array, model: ArmModel, there: Mask, position: Array, turned: Array) -> Array:
    """Write the errors of the poses that are `there` into `position` and `turned` (n,); return the spans of sockets."""
    part = model.at(there)
    say = np.ones(len(part.joints))  # of each posture in the point of its socket: wild ones have none
    for _ in range(3 if part.position is None else 0):
        size = norms(part.errors(p, say))
        say = np.where(size > _FAR * np.median(size[say > 0]), 0.0, 1.0)
    way, angle = part.errors(p, say)
    position[there] = norms((way, None))
    if angle is not None:
        turned[there] = np.sqrt((angle**2).sum(axis=1))
    return part.spans(p, say) if part.position is None else np.zeros(0)


def resample(fit: Fit, count: int, seed: int = 0) -> Array:
    """Return the kept parameters of `count` fits to poses drawn anew, (count, k); sockets are by themselves."""
    # a draw moves the points of sockets too, and takes another length of their distance within what it is known to
    rng = np.random.default_rng(np.random.SeedSequence([seed, len(fit.kept), len(fit.weights)]))
    model, k = fit.model, len(fit.kept)
    rows, more = model.jacobian(fit.p, fit.kept, fit.weights)
    residuals, far = model.residuals(fit.p, fit.weights)
    groups = [np.flatnonzero(~fit.wild)]
    if model.position is None:
        socket, n = model.socket, len(model.socket)
        groups = [group[socket[group] == s] for group in groups for s in np.unique(socket[group])]
        points = np.zeros((n, 3, 3 * (int(socket.max()) + 1)))  # slopes of the vector from a socket's point, in it
        for axis in range(3):
            points[np.arange(n), axis, 3 * socket + axis] = -1.0
        rows = np.concatenate([rows, points / model.of_rows[:, None, None]], axis=2)
        more = np.hstack([more, np.zeros((len(more), rows.shape[2] - k))])
    scale = np.sqrt((rows**2).sum(axis=(0, 1)) + (more**2).sum(axis=0)) + 1e-12
    rows, more = rows / scale, more / scale
    grams = np.einsum("nci,ncj->nij", rows, rows).reshape(len(rows), -1)
    slopes = np.einsum("nci,nc->ni", rows, residuals)
    pose = np.arange(len(rows)) if model.position is None else poses_of(model.joints)
    poses = [np.unique(pose[group]) for group in groups]

    if len(far):  # the ball's vector from its socket's point, and the direction of each known distance
        vector = model.errors(fit.p, fit.weights)[0]
        seat = model.placed(fit.p)[:, :3, 3] - vector
        one, other = np.array(model.pairs()).T
        middle = np.array([seat[socket == s][0] for s in range(int(socket.max()) + 1)])
        along = middle[one] - middle[other]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)

    draws = np.empty((count, k))
    for draw in range(count):
        weights = np.zeros(len(rows))
        for group, there in zip(groups, poses):
            weights[group] += np.bincount(rng.choice(there, len(there)), minlength=len(rows))[pose[group]]
        gram = (weights @ grams).reshape(rows.shape[2], -1) + more.T @ more
        drawn = far
        if len(far):  # by how much distances grow with the mean place of a socket
            size = np.maximum(np.bincount(socket, weights), 1e-12)
            mean = np.stack([np.bincount(socket, weights * way) / size for way in vector.T], axis=-1)
            grown = ((mean[one] - mean[other]) * along).sum(axis=1) / model.sigma_distance
            drawn = far + grown - rng.normal()
        step = np.linalg.lstsq(gram, -(weights @ slopes + more.T @ drawn), rcond=1e-12)[0] / scale
        draws[draw] = fit.p[fit.kept] + step[:k]
    return draws


def rms(errors: Array) -> float:
    """Return the root mean square of the values that are not NaN."""
    known = errors[np.isfinite(errors)]
    return float(np.sqrt((known**2).mean())) if len(known) else float("nan")


def rms_interval(errors: Array, seed: int = 0, poses: Index | None = None) -> tuple[float, float]:
    """Return the 95 % interval of the rms of errors (n,), by drawing anew the poses, which `poses` (n,) numbers."""
    there = np.isfinite(errors)
    squares = errors[there] ** 2
    pose = np.arange(len(squares)) if poses is None else np.unique(poses[there], return_inverse=True)[1]
    known, count = np.bincount(pose, squares), np.bincount(pose)
    if len(known) < 2:
        return float("nan"), float("nan")
    rng = np.random.default_rng(np.random.SeedSequence([seed, len(known)]))
    drawn = rng.integers(len(known), size=(_DRAWS, len(known)))
    means = known[drawn].sum(axis=1) / count[drawn].sum(axis=1)
    low, high = np.sqrt(np.quantile(means, [0.025, 0.975]))
    return float(low), float(high)
