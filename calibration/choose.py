"""How much of an arm is freed, and how near the maker's numbers it stays: chosen, and judged, by poses left out.

A candidate is a level and a tolerance of the maker's lengths and angles: a ridge, where what the readings do not know
stays nominal. Each is fitted without each fold of the poses, by the sums of its normal equations less the fold's; the
nearest on what was left out is written, fitted to all. The error that is told is of the same choice made without the
fold that it is told of (nested folds, Varma and Simon 2006): of the procedure that writes the file, with its choice.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.calibration.determined import information_of
from calibench.calibration.fit import Fit, HeldOut, folds_of, judge, noise_of, refit
from calibench.calibration.model import WITHIN
from calibench.calibration.normal import Blocks, normal_blocks, whitening_of
from calibench.calibration.rigid import Array, Index

FOLDS = 20  # with a twentieth of the poses each: fits to the others are nearly the fit to all
TOLERANCES = (WITHIN, 2.0, 0.5, 0.1)  # mm, mrad; the first is hardly one
_ALL = 1.0 - 1e-6  # of what is known of a direction: that much comes of one fold
_ROUNDS, _BENT = 12, 1e-2  # at most, and the part of what is left that a step may miss its forecast by
_TINY = 1e-12  # of a column's square: two directions that neither readings nor maker know


@final
@dataclass(frozen=True, eq=False)
class _Candidate:
    """Parameters without each fold, (f, P), and squares (f, f): of fold h fitted without f and h at [f, h]."""

    level: str
    fit: Fit
    without: Array
    squares: Array


def choose(
    fits: Mapping[str, Fit], levels: Sequence[str], common: Fit
) -> tuple[str, dict[str, Fit], dict[str, HeldOut], int]:
    """Return which of `levels` predicts poses best that were left out, with the fits, their errors, and the folds.

    The fit of each level is that by its best tolerance, its errors are of poses left out, and of the best level those
    of the whole choice, of levels too; folds are counted. `common` says what is wild, and the noise.
    """
    fold = folds_of(common.model, FOLDS)
    candidates = [one for level, fit in fits.items() for one in _candidates(level, fit, common, fold)]
    of_level = {level: [one for one in candidates if one.level == level] for level in fits}
    best = {level: _best(some, None) for level, some in of_level.items()}
    allowed = [one for one in candidates if one.level in levels]
    level = _best(allowed, None).level
    written = {one: refit(best[one].fit) for one in fits}
    unseen = {}
    for one, some in of_level.items():  # the errors of each fold by the candidate that the others choose
        others = allowed if one == level else some
        without = [_best(others, f).without[f] for f in range(int(fold.max()) + 1)]
        alone, shared, ahead = _moments(written[one], fold)
        judged = judge(written[one].model, fold, without)
        turned = None if judged.rotation is None else ahead * judged.rotation
        unseen[one] = replace(judged, position=ahead * judged.position, rotation=turned, alone=alone, shared=shared)
    return level, written, unseen, int(fold.max()) + 1


def _best(candidates: Sequence[_Candidate], without: int | None) -> _Candidate:
    """Return the candidate with the least squares of poses left out, of all folds or `without` one.

    The arm is left as it is unless a calibration is better by a standard error: it can make an arm worse.
    """
    squares = np.array([np.diag(one.squares) if without is None else one.squares[without] for one in candidates])
    if without is not None:
        squares = np.delete(squares, without, axis=1)
    best = int(np.argmin(squares.sum(axis=1)))
    if candidates[0].level == "frames" and squares.shape[1] > 1:
        gain = squares[0] - squares[best]
        best = best if gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)) else 0
    return candidates[best]


def _moments(fit: Fit, fold: Index) -> tuple[float, float, float]:
    """Return the variance of the mean square left out, over 2 / count: as each differs, and as fits share poses;

    and the rms that the fit to all has at other poses, over that left out: it has more readings than fits without a
    fold, which matters where a dozen poses tell the numbers barely.

    Of noise with covariance 1 a fold f has errors with I + J_f C_f J_f', two folds with J_f C_f P C_g J_g', where P is
    the information of all poses and of the maker, and C_f the inverse of it without f. Squares of these covariances are
    summed where P is 1. To first order the second is J_f C J_g' of a fit to the other folds: so it is the variance of
    the fit's own mean square at other poses, too. Another pose would have the errors of a fold that is left out beside
    these K: of what is known of a direction K + 1 folds have each K / (K + 1) of the share that they have of K. Where
    hardly a reading is to spare that is too little: normal rows leave it k / (n - k - 1) of the noise of n readings and
    k numbers, no surer than n - k - 1 readings tell.
    """
    sums = normal_blocks(fit.model, fit.p, fit.kept, fit.weights, fold)
    whole = sums.sum()
    count = float(whole.count[0])
    known = information_of(fit.model)[fit.kept]
    way = whitening_of(whole.gram[0] + np.diag(noise_of(whole, known) * known))
    values, vectors = np.linalg.eigh(way @ sums.gram @ way.T)
    values = np.clip(values, 0.0, _ALL)
    left = values / (1.0 - values)
    pairs = vectors * (left / (1.0 - values))[:, None] @ vectors.swapaxes(1, 2)
    mean = 1.0 + left.sum() / count
    folds = len(sums.gram)
    other = 1.0 + (values / (1.0 + 1.0 / folds - values)).sum() / count
    spare = count - values.sum() - 1.0
    other = min(max(other, 1.0 + values.sum() / max(spare, 1.0)), mean) if spare > 0 else mean  # no noise is known
    spare = max(spare, 1.0)
    alone = 1.0 + (2 * left + left**2).sum() / count
    shared = ((pairs.sum(axis=0) ** 2).sum() - (pairs**2).sum()) / count
    shared = max(shared / mean**2, (1.0 - 1.0 / other) ** 2 * count / spare)
    return float(alone / mean**2), float(shared), float(np.sqrt(other / mean))


def _candidates(level: str, fit: Fit, common: Fit, fold: Index) -> list[_Candidate]:
    """Return the candidates of one level: tolerances of the maker's numbers, each by steps from its own fit."""
    kept, count, found = fit.kept, int(fold.max()) + 1, []
    one, other = np.triu_indices(count)
    again = (one != other).astype(float)[:, None]  # a fold by itself is left out once
    model = replace(fit.model, sigma=common.model.sigma, scatter=common.model.scatter)
    at = (fit.p, normal_blocks(model, fit.p, kept, common.weights, fold))
    for tolerance in TOLERANCES[:1] if level == "frames" else TOLERANCES:
        model = replace(model, tolerance=tolerance)
        known, (p, blocks) = information_of(model)[kept], at
        for _ in range(_ROUNDS):
            off, whole = (p - model.wanted)[kept], blocks.sum()
            step, noise, left = _of_all(whole, known, off)
            tried = p.copy()
            tried[kept] += step
            over, far = model.residuals(tried, common.weights)
            square = float(common.weights @ (over**2).sum(axis=1) + far @ far)
            if abs(square - left) <= _BENT * left:
                break
            p, blocks = tried, normal_blocks(model, tried, kept, common.weights, fold)
        grams = whole.gram - blocks.gram[one] - again[:, :, None] * blocks.gram[other]
        slopes = whole.slope - blocks.slope[one] - again * blocks.slope[other]
        steps = np.empty((count, count, len(kept)))
        steps[one, other] = steps[other, one] = _solved(grams, slopes, noise * known, off)
        squares = blocks.square + 2 * np.einsum("fhk,hk->fh", steps, blocks.slope)
        squares += np.einsum("fhk,hkl,fhl->fh", steps, blocks.gram, steps, optimize=True)
        without = np.tile(p, (count, 1))
        without[:, kept] += steps[np.arange(count), np.arange(count)]
        sigma = (model.sigma[0] * np.sqrt(noise), model.sigma[1] * np.sqrt(noise))
        within = replace(fit, model=replace(model, sigma=sigma), p=p, wild=common.wild)
        found.append(_Candidate(level, within, without, squares))
    return found


def _of_all(whole: Blocks, known: Array, off: Array) -> tuple[Array, float, float]:
    """Return the step (k,) of all poses, the noise, and the squares that the step leaves, of the common noise.

    From more noise on: with as many numbers as readings, none is a solution, too.
    """
    undone = np.where(known > 0, -off, 0.0)
    noise = float(whole.square[0] + 2 * undone @ whole.slope[0] + undone @ whole.gram[0] @ undone) / whole.count[0]
    for _ in range(_ROUNDS):
        step = _solved(whole.gram, whole.slope, noise * known, off)[0]
        left = whole.square + 2 * step @ whole.slope[0] + step @ whole.gram[0] @ step
        before, noise = noise, noise_of(replace(whole, square=left), known, noise)
        if abs(noise - before) < _BENT * noise:
            break
    return step, noise, max(float(left[0]), 0.0)


def _solved(gram: Array, slope: Array, information: Array, off: Array) -> Array:
    """Return the steps (b, k) of normal equations (b, k, k), (b, k), `information` wanting all `off` (k,) undone."""
    scale = np.sqrt(np.einsum("bkk->bk", gram).max(axis=0) + information) + np.finfo(float).tiny
    information = information + _TINY * scale**2
    scaled = (gram + np.diag(information)) / np.outer(scale, scale)
    return np.asarray(np.linalg.solve(scaled, -((slope + information * off) / scale)[..., None])[..., 0] / scale)
