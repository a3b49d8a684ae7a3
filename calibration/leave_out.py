"""How good a calibration is: errors of poses that were not fitted, and intervals of the parameters.

Every pose is held out once, with all its repeats. Each of five folds has every fifth pose (of a tool with sockets,
whole places), and is predicted by a fit to the other folds. Of a file that says which rows it holds back, these are
predicted by the fit to the others, and the folds are of the others. Intervals come from a bootstrap: poses are drawn
with replacement, with one step of the adjustment for each draw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.calibration.fit import Fit, fit_from, norms
from calibench.calibration.model import ArmModel
from calibench.calibration.readings import poses_of
from calibench.calibration.rigid import Array, Index, Mask

FOLDS = 5
_DRAWS = 1000  # of mean squares
_FAR = 6.0  # times the median: a posture beyond has no influence on the point of its own socket


@final
@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors of poses that were not fitted: `position` (n,) [mm], `rotation` (n,) [rad] or None; NaN where they were.

    `spans` (d,) [mm] are the distances of the two sockets of each place that was held out; empty without sockets.
    """

    position: Array
    rotation: Array | None
    spans: Array


def predict(fit: Fit, model: ArmModel, there: Mask) -> HeldOut:
    """Return the errors by `fit` of the poses of `model` that are `there` (n,), none of which it was fitted to."""
    position, turned = np.full(len(there), np.nan), np.full(len(there), np.nan)
    spans = _put(fit.p, model, there, position, turned)
    return HeldOut(position, None if model.turns is None else turned, spans)


def _put(p: Array, model: ArmModel, there: Mask, position: Array, turned: Array) -> Array:
    """Write the errors of the poses that are `there` into `position` and `turned` (n,); return the spans of sockets."""
    part = model.at(there).numbered()
    say = _influence(part, p)
    way, angle = part.errors(p, say)
    position[there] = norms((way, None))
    if angle is not None:
        turned[there] = np.sqrt((angle**2).sum(axis=1))
    return part.spans(p, say) if part.position is None else np.zeros(0)


def cross_validate(fit: Fit, order: Sequence[int]) -> HeldOut:
    """Return the errors of all poses of `fit`, each by a fit of the parameters in `order` to those of other folds."""
    return leave_out(fit, order, folds_of(fit.model))


def folds_of(model: ArmModel, count: int = FOLDS) -> Index:
    """Return the fold of each pose, (n,)."""
    places = np.unique(model.place)
    if model.position is None and len(places) > 1:
        return np.asarray(np.searchsorted(places, model.place) % min(count, len(places)))
    return poses_of(model.joints) % count


def leave_out(fit: Fit, order: Sequence[int], fold: Index) -> HeldOut:
    """Return the errors of all poses, each by a fit of the parameters in `order` to those of other folds."""
    n = len(fold)
    position, turned, spans = np.full(n, np.nan), np.full(n, np.nan), np.zeros(0)
    for k in range(int(fold.max()) + 1):
        there = fold == k
        p = fit_from(fit, order, ~there)
        spans = np.concatenate([spans, _put(p, fit.model, there, position, turned)])
    return HeldOut(position, None if fit.model.turns is None else turned, spans)


def _influence(part: ArmModel, p: Array) -> Array:
    """Return the weights with which the point of a socket is computed, (n,): wild postures have weight 0."""
    weights = np.ones(len(part.joints))
    for _ in range(3 if part.position is None else 0):
        size = norms(part.errors(p, weights))
        weights = np.where(size > _FAR * np.median(size[weights > 0]), 0.0, 1.0)
    return weights


def resample(fit: Fit, count: int, seed: int = 0) -> Array:
    """Return the kept parameters of `count` fits to poses drawn anew, (count, k); sockets are drawn within themselves.

    A pose is drawn with all its repeats. The points of sockets are parameters of their own: a draw moves them too, and
    with them their distance, of which a draw takes another length within what it is known to, one for all places.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, len(fit.kept), len(fit.weights)]))
    model, k = fit.model, len(fit.kept)
    rows, more = model.jacobian(fit.p, fit.kept, fit.weights)
    residuals, far = model.residuals(fit.p, fit.weights)
    groups = [np.flatnonzero(~fit.wild)]
    if model.position is None:
        groups = [group[model.socket[group] == s] for group in groups for s in np.unique(model.socket[group])]
        rows = np.concatenate([rows, _points(model.socket) / model.of_rows[:, None, None]], axis=2)
        more = np.hstack([more, np.zeros((len(more), rows.shape[2] - k))])
    scale = np.sqrt((rows**2).sum(axis=(0, 1)) + (more**2).sum(axis=0)) + 1e-12
    rows, more = rows / scale, more / scale
    grams = np.einsum("nci,ncj->nij", rows, rows).reshape(len(rows), -1)
    slopes = np.einsum("nci,nc->ni", rows, residuals)
    pose = np.arange(len(rows)) if model.position is None else poses_of(model.joints)
    poses = [np.unique(pose[group]) for group in groups]
    draws = np.empty((count, k))
    spans = _Spans.of(fit)
    for draw in range(count):
        weights = np.zeros(len(rows))
        for group, there in zip(groups, poses):
            weights[group] += np.bincount(rng.choice(there, len(there)), minlength=len(rows))[pose[group]]
        gram = (weights @ grams).reshape(rows.shape[2], -1) + more.T @ more
        drawn = far + spans.moved(weights) - (rng.normal() if len(far) else 0.0)
        step = np.linalg.lstsq(gram, -(weights @ slopes + more.T @ drawn), rcond=1e-12)[0] / scale
        draws[draw] = fit.p[fit.kept] + step[:k]
    return draws


@final
@dataclass(frozen=True, eq=False)
class _Spans:
    """The vector of each ball from its socket's point, (n, 3) [mm]; of each known distance its ends and direction."""

    vector: Array
    socket: Index
    pairs: tuple[tuple[int, int], ...]
    along: Array
    known_to: float

    @classmethod
    def of(cls, fit: Fit) -> _Spans:
        model = fit.model
        if model.position is not None or not model.distance:
            return cls(np.zeros((0, 3)), np.zeros(0, dtype=np.int64), (), np.zeros((0, 3)), 1.0)
        ball, vector = model.placed(fit.p)[:, :3, 3], model.errors(fit.p, fit.weights)[0]
        point = np.array([(ball - vector)[model.socket == k][0] for k in range(int(model.socket.max()) + 1)])
        ways = np.array([point[a] - point[b] for a, b in model.pairs()]).reshape(-1, 3)
        along = ways / np.linalg.norm(ways, axis=1, keepdims=True)
        return cls(vector, model.socket, tuple(model.pairs()), along, model.sigma_distance)

    def moved(self, weights: Array) -> Array:
        """Return by how much distances grow where postures count by `weights` (n,), over what they are known to."""
        if not self.pairs:
            return np.zeros(0)
        size = np.maximum(np.bincount(self.socket, weights), 1e-12)
        mean = np.stack([np.bincount(self.socket, weights * way) / size for way in self.vector.T], axis=-1)
        a, b = np.array(self.pairs).T
        return np.asarray(((mean[a] - mean[b]) * self.along).sum(axis=1) / self.known_to)


def _points(socket: Index) -> Array:
    """Return the slopes of the vector from a socket's point, in that point, (n, 3, 3 sockets)."""
    slopes = np.zeros((len(socket), 3, 3 * (int(socket.max()) + 1)))
    for axis in range(3):
        slopes[np.arange(len(socket)), axis, 3 * socket + axis] = -1.0
    return slopes


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
