"""The adjustment of an arm, wild readings named; the errors of poses that were not fitted, and intervals of parameters.

What is left gives the noise of each kind of reading, and with `determined` which parameters are free. Every pose is
held out once with its repeats, in five folds (of sockets, whole places). Intervals come from a bootstrap of one step a
draw.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from scipy.special import chdtri, fdtri

from calibench.calibration.determined import WORST, information_of, is_length, select_determined
from calibench.calibration.model import ArmModel
from calibench.calibration.normal import Blocks, covariance_of, descend, normal_blocks, solve
from calibench.calibration.readings import poses_of
from calibench.calibration.rigid import Array, Index, Mask
from calibench.core.words import plain

_ROUNDS, _SAME = 8, 0.02  # until the noise that is left changes by less
_WILD = 6.0  # times the median error: a reading beyond is wild; noise alone has one in 10^9 poses
_FLOOR, _NONE = 1e-9, 1e-12
_FEW = 1e-3  # of a reading
_KNOWN = 30.0
_SPARE = 1.5  # times the numbers of a fit: so many readings tell which of them are wild
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

    @property
    def undetermined(self) -> str:
        """Return why not one number of the arm is determined, "" where some are."""
        names = [self.model.names[place] for place in self.kept]
        bounds = np.array([WORST if is_length(name) else 1e-3 * WORST for name in names])
        frames = np.array([name.startswith(("base_", "tool_")) for name in names])
        if not (np.sqrt(np.diag(self.covariance)) > bounds)[frames].all():
            return ""
        rest = float(np.median(norms(self.model.errors(self.p, self.weights))))
        return (
            f"nothing of the arm is determined: {plain(rest, 3)} mm are left of the middle reading; do the joints and "
            "the reading of a row belong together, and did tracker and target stay where they were?"
        )


def fit_arm(model: ArmModel, order: Sequence[int], start: Array | None = None) -> Fit:
    """Return the fit of the parameters in `order` that are determined; wild readings are left out and named."""
    begin = model.start if start is None else start
    p, wild = begin, np.zeros(len(model.joints), dtype=bool)
    kept = select_determined(model, p, order, np.ones(len(wild)))
    for turn in range(_ROUNDS):
        weights = np.where(wild, 0.0, 1.0)
        p = _adjust(model, p, kept, weights, soft=not wild.any(), begin=begin)

        # the noise of each kind of reading, and which readings are wild
        before, far, sigma = wild, np.zeros(len(wild), dtype=bool), list(model.sigma)
        for k, part in enumerate(part for part in model.errors(p, weights) if part is not None):
            size = np.sqrt((part**2).sum(axis=1))
            middle = float(np.median(size[~wild]))
            sigma[k] = max(middle / 1.538, _FLOOR)  # the median length of three unit normals is 1.538
            far |= size > _WILD * max(middle, 1e3 * _FLOOR)
        if model.loci is not None:  # by the kinds of what was read of fixtures
            size = norms((model.errors(p, weights)[0], None))
            kind, noise = model.loci.kind * 4 + model.counted.astype(int), np.ones(len(size))
            for one in np.unique(kind):
                there = kind == one
                usual = float(np.sqrt(chdtri(one % 4, 0.5)))  # the median length of so many unit normals
                noise[there] = max(float(np.median(size[there & ~wild])) / usual, _FLOOR)
            far = np.asarray(size > _WILD * 1.538 * np.maximum(noise, 1e3 * _FLOOR))
            model, sigma[0] = replace(model, scatter=noise / noise[0]), float(noise[0])
        few = far.mean() <= (_MOST_IN_SOCKETS if model.position is None else _MOST)  # else they are no exceptions
        if few and model.counted[~far].sum() >= _SPARE * len(kept):  # nor where any reading can be fitted
            wild = far
        settled = np.allclose(sigma, model.sigma, rtol=_SAME, atol=0.0)
        model = replace(model, sigma=(sigma[0], sigma[1]))
        if model.position is None:  # a scatter for each socket: errors that no geometry explains differ by place
            weights = np.where(wild, 0.0, 1.0)
            square = weights * (model.errors(p, weights)[0] ** 2).sum(axis=1)
            count, usual = np.bincount(model.socket, weights), model.sigma[0] ** 2
            scatter = (np.bincount(model.socket, square) + _KNOWN * usual) / (3 * np.maximum(count - 1, 0) + _KNOWN)
            model = replace(model, scatter=np.sqrt(scatter / usual)[model.socket])
        if turn and np.array_equal(wild, before) and settled:
            break  # the noise decides what is wild, and what is wild decides the noise

    return refit(Fit(model, begin, kept, wild, np.zeros((0, 0))), p)


def refit(fit: Fit, p: Array | None = None) -> Fit:
    """Return the fit of the same parameters to the same readings by the noise and tolerance of its model, from `p`."""
    model, kept, weights = fit.model, fit.kept, fit.weights
    p = _adjust(model, fit.p if p is None else p, kept, weights, soft=False, begin=fit.p)
    sums = normal_blocks(model, p, kept, weights)
    known = information_of(model)[kept]
    noise = noise_of(sums, known)
    covariance = noise * covariance_of(sums.gram[0] + np.diag(noise * known))
    return replace(fit, p=p, covariance=covariance)


def noise_of(sums: Blocks, known: Array, noise: float = 1.0) -> float:
    """Return what is left of one group over what its numbers did not take up, in squares of the stated noise.

    Numbers count less that are `known` before, by a `noise` of about this size: so there is a noise where there are as
    many numbers as readings, too (MacKay 1992).
    """
    taken = len(known) - float(noise * known @ np.diag(covariance_of(sums.gram[0] + np.diag(noise * known))))
    return max(float(sums.square[0]) / max(float(sums.count[0]) - taken, _FEW), _NONE)


def norms(errors: tuple[Array, Array | None]) -> Array:
    """Return the length of the position errors, (n,) [mm]."""
    return np.asarray(np.sqrt((errors[0] ** 2).sum(axis=1)))


def _adjust(model: ArmModel, p: Array, kept: Index, weights: Array, soft: bool, begin: Array) -> Array:
    """Return the least squares solution by Levenberg's damping; what is not `kept` is as in `begin`."""
    held = begin.copy()
    held[kept] = p[kept]
    p = held
    if not len(kept):
        return p
    wanted, information = model.wanted[kept], information_of(model)[kept]

    def value_of(p: Array) -> float:
        over, more = model.residuals(p, weights)
        square = (over**2).sum(axis=1)
        loss = weights @ (2 * (np.sqrt(1 + square / 9) - 1) * 9 if soft else square)
        value = float(loss + more @ more)
        return (value if np.isfinite(value) else np.inf) + float(information @ (p[kept] - wanted) ** 2)

    def equations(p: Array) -> tuple[Array, Array]:
        sums = normal_blocks(model, p, kept, weights, soft=soft)
        return sums.gram[0] + np.diag(information), sums.slope[0] + information * (p[kept] - wanted)

    def moved(p: Array, step: Array) -> Array:
        tried = p.copy()
        tried[kept] += step
        return tried

    return descend(p, value_of, equations, moved)


def far_out(size: Array) -> Mask:
    """Return which errors (n,) are wild beside the others, (n,); none where so many are that they are no accident."""
    far: Mask = np.asarray(size > _WILD * max(float(np.median(size)), 1e3 * _FLOOR))
    return np.zeros(len(size), dtype=bool) if far.mean() > _MOST else far


FOLDS = 5  # of pairs of a camera
_APART = 2000  # poses that are drawn each by itself
_FAR = 6.0  # times the median: a posture beyond has no influence on the point of its own socket


@final
@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors of poses not fitted, `position` [mm] and `rotation` [rad], NaN for others; `spans` [mm] of two sockets.

    `alone` and `shared` make the variance of their mean square, in units of that of noise: as each error differs from
    others, and as their fits have readings in common.
    """

    position: Array
    rotation: Array | None
    spans: Array
    alone: float = 1.0
    shared: float = 0.0


def folds_of(model: ArmModel, most: int) -> Index:
    """Return the fold of each reading, (n,) 0, 1, ...: repeats of a pose are in one, and so is a place of sockets."""
    places = np.unique(model.place)
    if model.position is None and len(places) > 1:
        return np.asarray(np.searchsorted(places, model.place) % most, dtype=np.int64)
    return np.asarray(poses_of(model.joints) % most, dtype=np.int64)


def judge(model: ArmModel, fold: Index, by_fold: Sequence[Array]) -> HeldOut:
    """Return the errors of all poses, those of a fold by the parameters that are given for it; none of fold -1."""
    position, turned, spans = np.full(len(fold), np.nan), np.full(len(fold), np.nan), [np.zeros(0)]
    for k, p in enumerate(by_fold):
        there = np.asarray(fold == k)
        part = model.at(there)
        say = np.ones(len(part.joints))  # of each posture in the point of its socket: wild ones have none
        for _ in range(3 if part.position is None else 0):
            size = norms(part.errors(p, say))
            say = np.where(size > _FAR * np.median(size[say > 0]), 0.0, 1.0)
        way, angle = part.errors(p, say)
        position[there] = norms((way, None))
        if angle is not None:
            turned[there] = np.sqrt((angle**2).sum(axis=1))
        if part.position is None:
            spans.append(part.spans(p, say))
    return HeldOut(position, None if model.turns is None else turned, np.concatenate(spans))


def resample(fit: Fit, count: int) -> Array:
    """Return the kept parameters of `count` fits to poses drawn anew, (count, k); sockets are by themselves."""
    rng = np.random.default_rng(np.random.SeedSequence([0, len(fit.kept), len(fit.weights)]))
    if fit.model.position is None:
        return _resample_sockets(fit, count, rng)
    pose = poses_of(fit.model.joints) % _APART  # of more, some are drawn together
    sums, there = normal_blocks(fit.model, fit.p, fit.kept, fit.weights, pose), np.unique(pose[~fit.wild])
    weights = [np.bincount(rng.choice(there, len(there)), minlength=len(sums.gram)) for _ in range(count)]
    drawn = sums.by(np.array(weights, dtype=float))
    known, off = information_of(fit.model)[fit.kept], (fit.p - fit.model.wanted)[fit.kept]
    priors = known * off + np.sqrt(known) * rng.normal(size=(count, len(known)))  # before any reading, drawn anew too
    steps = [solve(gram + np.diag(known), slope) for gram, slope in zip(drawn.gram, drawn.slope + priors, strict=True)]
    return np.asarray(fit.p[fit.kept] + np.array(steps))


def _resample_sockets(fit: Fit, count: int, rng: np.random.Generator) -> Array:
    # a draw moves the points of sockets too, and takes another length of their distance within what it is known to
    model, k, socket, n = fit.model, len(fit.kept), fit.model.socket, len(fit.weights)
    rows, more = model.jacobian(fit.p, fit.kept, fit.weights)
    residuals, far = model.residuals(fit.p, fit.weights)
    points = np.zeros((n, 3, 3 * (int(socket.max()) + 1)))  # slopes of the vector from a socket's point, in it
    for axis in range(3):
        points[np.arange(n), axis, 3 * socket + axis] = -1.0
    rows = np.concatenate([rows, points / model.of_rows[:, None, None]], axis=2)
    more = np.hstack([more, np.zeros((len(more), rows.shape[2] - k))])
    known, off = np.zeros(rows.shape[2]), np.zeros(rows.shape[2])  # before any reading, drawn anew too
    known[:k], off[:k] = information_of(model)[fit.kept], (fit.p - model.wanted)[fit.kept]
    scale = np.sqrt((rows**2).sum(axis=(0, 1)) + (more**2).sum(axis=0) + known) + 1e-12
    known, off = known / scale**2, off * scale
    rows, more = rows / scale, more / scale
    grams = np.einsum("nci,ncj->nij", rows, rows).reshape(n, -1)
    slopes = np.einsum("nci,nc->ni", rows, residuals)
    groups = [np.flatnonzero(~fit.wild & (socket == s)) for s in np.unique(socket[~fit.wild])]

    if len(far):  # the ball's vector from its socket's point, and the direction of each known distance
        vector = model.errors(fit.p, fit.weights)[0]
        seat = model.placed(fit.p)[:, :3, 3] - vector
        one, other = np.array(model.pairs()).T
        middle = np.array([seat[socket == s][0] for s in range(int(socket.max()) + 1)])
        along = middle[one] - middle[other]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)

    draws = np.empty((count, k))
    for draw in range(count):
        weights = np.zeros(n)
        for group in groups:
            weights += np.bincount(rng.choice(group, len(group)), minlength=n)
        gram = (weights @ grams).reshape(rows.shape[2], -1) + more.T @ more + np.diag(known)
        drawn, prior = far, known * off + np.sqrt(known) * rng.normal(size=len(known))
        if len(far):  # by how much distances grow with the mean place of a socket
            size = np.maximum(np.bincount(socket, weights), 1e-12)
            mean = np.stack([np.bincount(socket, weights * way) / size for way in vector.T], axis=-1)
            grown = ((mean[one] - mean[other]) * along).sum(axis=1) / model.sigma_distance
            drawn = far + grown - rng.normal()
        step = np.linalg.lstsq(gram, -(weights @ slopes + more.T @ drawn + prior), rcond=1e-12)[0] / scale
        draws[draw] = fit.p[fit.kept] + step[:k]
    return draws


def rms(errors: Array) -> float:
    """Return the root mean square of the values that are not NaN."""
    known = errors[np.isfinite(errors)]
    return float(np.sqrt((known**2).mean())) if len(known) else float("nan")


def rms_interval(
    errors: Array, poses: Index, alone: float = 1.0, shared: float = 0.0, numbers: float = 3.0
) -> tuple[float, float]:
    """Return the 95 % interval of the rms at other poses, by errors (n,) of poses not fitted, which `poses` numbers.

    `numbers` is how many were read at a reading, in the mean. The mean square of these errors is to that of other poses
    as two independent chi-squares (Satterthwaite 1946): an F interval. Its variance is what the spread over the poses
    says, or more by the fits if that is larger, `alone`; what fits share is in it once, and once more in the error of
    the fit to all, which other poses will meet (see `HeldOut`).
    """
    there = np.isfinite(errors)
    pose = np.unique(poses[there], return_inverse=True)[1]
    means = np.bincount(pose, errors[there] ** 2) / np.bincount(pose)
    if len(means) < 2:
        return float("nan"), float("nan")
    mean = float((errors[there] ** 2).mean())
    if not mean > 0:
        return 0.0, 0.0
    own = max(float(means.var(ddof=1)) / len(means) / mean**2, 2 * alone / (numbers * there.sum()))
    common = own * shared / alone
    freedom = max(2 / max(common, _NONE), 1.0), max(2 / (own + common), 1.0)  # of one reading at the least
    low, high = np.sqrt(mean * fdtri(*freedom, [0.025, 0.975]))
    return float(low), float(high)
