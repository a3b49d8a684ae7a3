"""The adjustment of an arm: the parameters that the readings determine, damped Gauss-Newton, wild readings named.

A parameter is determined if it changes the residuals in a way that no earlier one does, by so much that it and all
earlier ones are known better than `WORST`. The order decides which of several similar parameters is kept: first the
frames, which nobody knew, then joint zeros, then lengths, then angles, so that a shift of a millimetre is not reported
as some degrees about a short link. The others keep their nominal values. (The placement of the first joint cannot be
distinguished from the base; nor can, for parallel axes, the shifts along them: Hayati and Mirmirani 1985 keep an angle
there.)
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.bench.calibration.model import ArmModel
from calibench.bench.calibration.readings import Index, Mask
from calibench.core.words import plain
from calibench.problems.arm.gauge import MIDDLE, WORST, standard_errors, told_apart, unexplained, well_told
from calibench.problems.base import Array

_ALIKE = 5e-3  # part of a column: less than this beside the others may only come from the arm's other errors
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


LEVELS = ("frames", "zeros", "geometry", "gains")
_RANK = {
    "base": 0, "tool": 1, "zero": 2, "x": 3, "y": 3, "z": 5, "rx": 4, "ry": 4, "rz": 6, "gain": 7,
    "theta": 2, "a": 3, "alpha": 4, "beta": 5, "d": 6,
}  # fmt: skip  # of a URDF, and of a table
_OF_SLIDING = {"d": 2, "theta": 4}  # the zero of a joint that slides is a length
_PLACES = {f"{frame}_{axis}" for frame in ("base", "tool") for axis in "xyz"}
_UP_TO = {"frames": 1, "zeros": 2, "geometry": 6, "gains": 7}


def order_of(names: Sequence[str], level: str, sliding: Collection[str] = ()) -> list[int]:
    """Return which parameters a level frees, in the order in which similar ones are kept.

    `frames` are base and tool, which must be found even for a perfect arm; `zeros` are the joints' zeros beside them,
    `geometry` lengths and angles as well, `gains` the scale of each joint's reading too. Of a table's offsets d along
    axes that are parallel the last is kept, as Hayati and Mirmirani have it. `sliding` names the joints that slide.
    """
    ranks = []
    for k, name in enumerate(names):
        kind, _, joint = name.partition("_")
        rank = _OF_SLIDING.get(kind, _RANK[kind]) if joint in sliding else _RANK[kind]
        ranks.append((rank, -k if kind == "d" else k, k))
    return [k for rank, _, k in sorted(ranks) if rank <= _UP_TO[level]]


def determined(model: ArmModel, p: Array, order: Sequence[int], weights: Array, first: bool = False) -> Index:
    """Return which of the parameters in `order` the readings determine, as places in p, sorted.

    What all of `order` leave of the residuals gives the noise: far from the solution, residuals are what the parameters
    explain. `first` does not take the noise of the model for the least. Of a model with `every`, all of them. None
    where no number of the frames is told.
    """
    order = list(order)
    if model.every:
        return np.array(sorted(order), dtype=np.int64)
    rows = _stacked(*model.jacobian(p, np.array(order, dtype=np.int64), weights), weights)
    residuals = _stacked_residuals(*model.residuals(p, weights), weights)
    used = rows.any(axis=1)  # not the wild ones
    noise = float(np.median(np.abs(unexplained(rows[used], residuals[used])))) / MIDDLE
    noise = noise if first else max(1.0, noise)
    bounds = np.array([bound_of(model, place) for place in order])
    frames = np.array([model.names[place].startswith(("base_", "tool_")) for place in order])
    seats = told_apart(rows[:, frames], _ALIKE)
    errors = noise * standard_errors(rows[:, frames][:, seats])
    if (errors > bounds[frames][seats]).all():  # not even by themselves
        return np.zeros(0, dtype=np.int64)
    taken = well_told(rows, _ALIKE, np.where(frames, np.inf, bounds), noise)  # nobody states a frame
    return np.array(sorted(order[k] for k in taken), dtype=np.int64)


def told_of(model: ArmModel, p: Array, order: Sequence[int], weights: Array) -> Index:
    """Return which of the parameters in `order` the readings tell apart, however well, as places in p, sorted."""
    rows = _stacked(*model.jacobian(p, np.array(order, dtype=np.int64), weights), weights)
    return np.array(sorted(order[k] for k in told_apart(rows, _ALIKE)), dtype=np.int64)


def bound_of(model: ArmModel, place: int) -> float:
    """Return the largest standard error of a number that is calibrated, in mm or rad."""
    return WORST if is_length(model.names[place], model.sliding) else 1e-3 * WORST


def fitted(model: ArmModel, order: Sequence[int], start: Array | None = None) -> Fit:
    """Return the fit of the parameters in `order` that are determined; wild readings are left out and named.

    The noise of position and rotation is estimated from the residuals, where both were read.
    """
    begun = model.start if start is None else start
    p, n = begun, len(model.joints)
    wild = np.zeros(n, dtype=bool)
    for turn in range(_ROUNDS):
        weights = np.where(wild, 0.0, 1.0)
        kept = determined(model, p, order, weights, first=turn == 0)
        p = _adjusted(model, _held(begun, p, kept), kept, weights, soft=not wild.any())
        before, sigma = wild, model.sigma
        model, wild = _scattered(model, p, wild)
        model = _by_socket(model, p, np.where(wild, 0.0, 1.0))
        if turn and np.array_equal(wild, before) and np.allclose(model.sigma, sigma, rtol=_SAME, atol=0.0):
            break  # the noise decides what is determined, and what is determined decides the noise
    weights = np.where(wild, 0.0, 1.0)
    kept = determined(model, p, order, weights)
    if not len(kept):
        left = float(np.median(norms(model.errors(p, weights))))
        raise ValueError(
            f"nothing of the arm is determined: {plain(left, 3)} mm are left of the middle reading; do the joints "
            "and the reading of a row belong together, and did the tracker stand still?"
        )
    p = _adjusted(model, _held(begun, p, kept), kept, weights, soft=False)
    return Fit(model, p, kept, wild, _covariance(model, p, kept, weights))


def fitted_from(fit: Fit, order: Sequence[int], keep: Mask) -> Array:
    """Return the parameters of a fit to the poses of `keep` (n,) alone, by steps from a fit to all of them."""
    model = fit.model.at(keep).numbered()
    weights = fit.weights[keep]
    kept = determined(model, fit.p, order, weights)
    start = model.start
    frames = [k for k, name in enumerate(model.names) if name.startswith(("base_", "tool_"))]
    start[frames], start[kept] = fit.p[frames], fit.p[kept]
    p = _adjusted(model, start, kept, weights, soft=False)
    for _ in range(_AGAIN if model.position is None else 0):  # these sockets by what they leave themselves
        model = _by_socket(model, p, weights)
        p = _adjusted(model, p, kept, weights, soft=False)
    return p


def _held(begun: Array, p: Array, kept: Index) -> Array:
    """Return `p` in the parameters that are kept, and `begun` in all others."""
    made = begun.copy()
    made[kept] = p[kept]
    return made


def norms(errors: tuple[Array, Array | None]) -> Array:
    """Return the length of the position errors, (n,) [mm]."""
    return np.asarray(np.sqrt((errors[0] ** 2).sum(axis=1)))


def _adjusted(model: ArmModel, p: Array, kept: Index, weights: Array, soft: bool) -> Array:
    """Return the least squares solution by Levenberg's damping; `soft` reduces the weight of far readings (soft L1)."""
    p = p.copy()
    if not len(kept):
        return p
    left = model.residuals(p, weights)
    damping, value = 1e-6, _value(*left, weights, soft)
    for _ in range(_STEPS):
        by_row = _soft_weights(left[0], weights) if soft else weights
        rows = _stacked(*model.jacobian(p, kept, weights), by_row)
        residuals = _stacked_residuals(*left, by_row)
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
            found = _value(*there, weights, soft)
            if found <= value:
                improved = True
                break
            damping = max(damping, 1e-9) * 10
        if not improved:
            break
        gained = value - found
        p, left, value, damping = tried, there, found, max(damping / 10, 1e-12)
        if gained <= _SETTLED * (1 + value):
            break
    return p


def _scattered(model: ArmModel, p: Array, wild: Mask) -> tuple[ArmModel, Mask]:
    """Return the model with the noise estimated from the residuals of each kind of reading; which readings are wild."""
    weights = np.where(wild, 0.0, 1.0)
    left, turned = model.errors(p, weights)
    far = np.zeros(len(left), dtype=bool)
    sigma = list(model.sigma)
    for k, part in enumerate([left] if turned is None else [left, turned]):
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


def _by_socket(model: ArmModel, p: Array, weights: Array) -> ArmModel:
    """Return the model with a separate scatter for each socket: errors that no geometry explains differ by place.

    Each is that of its postures, mixed with `_KNOWN` numbers of the usual scatter.
    """
    if model.position is not None:
        return model
    square = weights * (model.errors(p, weights)[0] ** 2).sum(axis=1)
    count, usual = np.bincount(model.socket, weights), model.sigma[0] ** 2
    own = (np.bincount(model.socket, square) + _KNOWN * usual) / (3 * np.maximum(count - 1, 0) + _KNOWN)
    return replace(model, scatter=np.sqrt(own / usual)[model.socket])


def _value(over: Array, more: Array, weights: Array, soft: bool) -> float:
    square = (over**2).sum(axis=1)
    told = weights @ (2 * (np.sqrt(1 + square / 9) - 1) * 9 if soft else square)
    value = float(told + more @ more)
    return value if np.isfinite(value) else np.inf


def _soft_weights(over: Array, weights: Array) -> Array:
    """Return the weight of each reading under the soft L1 loss of the length of its residual, (n,)."""
    square = (over**2).sum(axis=1)
    return np.asarray(weights / np.sqrt(1 + square / 9))


def _covariance(model: ArmModel, p: Array, kept: Index, weights: Array) -> Array:
    rows = _stacked(*model.jacobian(p, kept, weights), weights)
    residuals = _stacked_residuals(*model.residuals(p, weights), weights)
    spare = max(1, int((weights > 0).sum()) * model.residuals(p, weights)[0].shape[1] - len(kept))
    scale = np.linalg.norm(rows, axis=0) + _FLOOR
    inverse = np.linalg.pinv((rows / scale).T @ (rows / scale), rcond=1e-13)
    return np.asarray(inverse / np.outer(scale, scale) * float(residuals @ residuals) / spare)


def _stacked(rows: Array, more: Array, weights: Array) -> Array:
    return np.vstack([(np.sqrt(weights)[:, None, None] * rows).reshape(-1, rows.shape[2]), more])


def _stacked_residuals(rows: Array, more: Array, weights: Array) -> Array:
    return np.concatenate([(np.sqrt(weights)[:, None] * rows).ravel(), more])


def is_length(name: str, sliding: Collection[str] = ()) -> bool:
    """Return whether a parameter is a length [mm], as the zero of a joint in `sliding` is, and no angle or gain."""
    kind, _, of = name.partition("_")
    return kind in ("x", "y", "z", "a", "d") or (of in sliding if kind == "zero" else name in _PLACES)
