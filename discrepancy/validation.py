"""Validation: the error before and after, on fitted rows and on held-out poses, relative to the noise floor.

The error is the rms of the whitened constraints. On unseen rows noise has two parts: that of the readings, and that of
the calibrated parameters. Where nothing is held out, each fold is predicted by a calibration of the others.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from calibench.discrepancy.diagnostics.noise import outliers_under
from calibench.discrepancy.fitting.fit import Fit, fit, linearise, predicted, readings_of
from calibench.discrepancy.model.effect import ChangePoint
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.laws import NoiseFinding
from calibench.discrepancy.noise.repeats import pairs_of
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.report import Gap
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_MOST = 0.75  # of the sum of squares: without the reading the error is less than half
_FEW = 8  # readings: of fewer, one is more than an eighth of them all
_HELD = 1e-9  # part of a column's square that is added, so that what only left-out rows determine is held


# unseen readings, the row that makes most of their error, and how many times what it was before the error is without it
Lone = tuple[Formulation, int, float]


def gap_of(
    base: Fit, final: Fit, hold: Formulation | None, suspects: Sequence[NoiseFinding], rng: np.random.Generator
) -> tuple[Gap, Lone | None]:
    """Return the gap of the model without effects and of the final one; by cross-validation where nothing is held.

    Both errors are measured under one law of the noise: to trust readings less makes no error smaller. Where nothing
    but the noise is blamed, nothing of the excess is gone.
    """
    rows, blamed = base.model.formulation, bool(suspects) and not final.model.effects
    c = final.at.misclosure.shape[1]
    law = _law(final, rows, () if blamed else suspects)
    before = predicted(base.model, base.x, rows.data, law).reshape(-1, c)
    after = predicted(final.model, final.x, rows.data, law).reshape(-1, c)
    free = [np.sqrt(r.size / max(r.size - f.J.shape[1], 1)) for r, f in ((before, base), (after, final))]
    train = root(before) * free[0], root(after) * free[1]
    if hold is None:
        gap, lone = _crossed(base, final, train, suspects, rng)
        return (replace(gap, excess_shrink=float("nan")) if blamed else gap), lone
    sure = beside_steps(final, hold.data)
    hold = hold.on(hold.data.rows(sure)) if sure.any() and not sure.all() else hold
    law = _law(final, hold, () if blamed else suspects)
    unseen = predicted(base.model, base.x, hold.data, law)
    left = predicted(final.model, final.x, hold.data, law)
    floor, spread = _floor(final, [(final, hold, law)], hold.data, left, suspects)
    worse, better, ci95 = held_out(unseen, left, hold.data, rng, spread)
    gone = float("nan") if blamed else shrink(worse, better, floor)
    return Gap(floor, *train, worse, better, ci95, gone), _lone(unseen, left, hold)


def beside_steps(final: Fit, data: MeasuredData) -> NDArray[np.bool_]:
    """Return the rows of `data`, (n,), but those between the fitted readings around a step, whose side is unknown."""
    sure = np.ones(len(data), dtype=bool)
    for effect in final.model.effects:
        if isinstance(effect, ChangePoint):
            t, fitted = data[effect.clock], final.model.formulation.data[effect.clock]
            last, first = fitted[fitted < effect.at].max(), fitted[fitted >= effect.at].min()
            sure &= (t <= last) | (t >= first)
    return sure


def times_left(final: Fit, unseen: Formulation, suspects: Sequence[NoiseFinding]) -> float:
    """Return the error of unseen rows over what noise leaves there, where readings are trusted as far as was found."""
    law = _law(final, unseen, suspects)
    left = predicted(final.model, final.x, unseen.data, law)
    return root(left) / _floor(final, [(final, unseen, law)], unseen.data, left, suspects)[0]


def _crossed(
    base: Fit, final: Fit, train: tuple[float, float], suspects: Sequence[NoiseFinding], rng: np.random.Generator
) -> tuple[Gap, Lone | None]:
    rows, c, p = base.model.formulation, final.at.misclosure.shape[1], len(final.x)
    fold = folds(rows.data, thresholds().folds)
    nothing = float("nan")
    parts = [np.flatnonzero(fold == k) for k in range(thresholds().folds)]
    own = final.noise.scale
    untold = Gap(own, *train, nothing, nothing, (nothing, nothing), shrink(*train, own))
    if any(len(part) == 0 or c * (len(fold) - len(part)) < p + 1 for part in parts):
        return untold, None
    noise = Noise(final.noise.scale, 0.0, final.noise.t_degrees)
    learned: list[tuple[Fit, Formulation, Noise]] = []
    unseen: list[Array] = []
    left: list[Array] = []
    for part in parts:
        rest = rows.on(rows.data.rows(fold != fold[part[0]]))
        apart = rows.on(rows.data.rows(part))
        law = _law(final, apart, suspects if final.model.effects else ())
        for at, found in ((base, unseen), (final, left)):
            there = fit(Model(rest, at.model.effects), noise, at.x)
            if not np.isfinite(there.J).all():  # without these poses the calibration runs away
                return untold, None
            found.append(predicted(there.model, there.x, apart.data, law))
            if at is final:
                learned.append((there, apart, law))
    order = np.concatenate(parts)
    before, after = np.concatenate(unseen), np.concatenate(left)
    back = after[np.argsort(order)]
    floor, spread = _floor(final, learned, rows.data, back, suspects)
    if not floor <= thresholds().floor_unseen * own:  # the parameters are all but free without the rows left out
        return untold, None
    worse, better, ci95 = held_out(before, after, rows.data.rows(order), rng, spread)
    gap = Gap(floor, *train, worse, better, ci95, shrink(worse, better, floor), cross_validated=True)
    return gap, _lone(before[np.argsort(order)], back, rows)


def _lone(before: Array, after: Array, unseen: Formulation) -> Lone | None:
    """Return the unseen reading without which the error after, (n, c), is less than half; None without such a one."""
    squares = (after**2).sum(axis=1)
    k = int(np.argmax(squares))
    if len(squares) < _FEW or not squares[k] > _MOST * squares.sum():
        return None
    others = np.arange(len(squares)) != k
    return unseen, k, root(after[others]) / root(before[others])


def _floor(
    final: Fit, learned: Sequence[tuple[Fit, Formulation, Noise]], unseen: MeasuredData, left: Array,
    suspects: Sequence[NoiseFinding],
) -> tuple[float, float]:  # fmt: skip
    """Return the rms error of noise alone on unseen rows, of their readings and of the parameters, and its spread."""
    own, spread = final.noise.scale**2, 0.0
    estimated = not final.noise.profiled or final.noise.from_repeats  # else errors are compared with each other
    if np.isfinite(final.noise.known) and estimated:
        spread = 2 * own**2 / max(final.noise.known, 1.0)
    if np.isfinite(final.noise.t_degrees) or any(s.family in ("outlier", "heavy_tails") for s in suspects):
        first, second = pairs_of(unseen)
        squares = (left[first] - left[second]).ravel() ** 2 / 2
        if len(squares) >= thresholds().repeat_pairs:
            own, spread = float(np.mean(squares)), float(np.var(squares)) / len(squares)
    share, count = np.zeros((len(final.x), len(final.x))), 0
    for by, rows, law in learned:
        model = Model(rows, by.model.effects)
        readings = readings_of(model)
        J = linearise(model, law, by.x, readings, readings)
        white = J.whiten(J.columns)
        share, count = share + white.T @ white @ by.covariance(stated=True), count + len(white)
    share /= count
    square = own + float(np.trace(share))
    spread += 2 * float(np.sum(share * share.T))
    if not 0 < square < np.inf or spread < 0:  # a covariance beyond what numbers can hold
        return float("inf"), 0.0
    return float(np.sqrt(square)), float(np.sqrt(spread)) / (2 * square)


def _law(final: Fit, rows: Formulation, suspects: Sequence[NoiseFinding]) -> Noise:
    """Return the law of some rows' readings where the noise is blamed: coarse steps, and outlying readings."""
    extra = {name: variance for name, variance in final.noise.extra.items() if np.ndim(variance) == 0}  # all rows alike
    for suspect in suspects:
        if suspect.family == "quantisation":
            extra |= {name: extra.get(name, 0.0) + suspect.amplitude**2 / 12 for name in suspect.extra}
    for suspect in suspects:
        if suspect.family == "outlier":
            outlying = outliers_under(Model(rows, final.model.effects), final.x, suspect.target)
            extra |= {name: extra.get(name, 0.0) + variance for name, variance in outlying.extra.items()}
    return Noise(extra=extra)


def held_out(
    before: Array, after: Array, data: MeasuredData, rng: np.random.Generator, common: float
) -> tuple[float, float, tuple[float, float]]:
    """Return the rms of whitened residuals (n, c) before and after, and the interval of the latter by a bootstrap."""
    of_pose = np.asarray(data["pose_id"] if data.has("pose_id") else np.arange(len(data)))
    poses = np.unique(of_pose, return_inverse=True)[1]
    squares = np.bincount(poses, (after**2).mean(axis=1))
    counts = np.bincount(poses).astype(float)
    k = len(counts)
    few, draws = k <= 5000, thresholds().bootstrap_draws
    if few:
        drawn = rng.multinomial(k, np.full(k, 1 / k), size=draws)
        sums = drawn @ squares, drawn @ counts
    else:  # one after the other: all of them would take gigabytes
        both = np.column_stack([squares, counts])
        sums = tuple(np.array([rng.poisson(1.0, k) @ both for _ in range(200)]).T)
    logs = 0.5 * np.log(np.maximum(sums[0] / np.maximum(sums[1], 1), 1e-300))
    with np.errstate(divide="ignore"):  # readings that are met exactly: 0 with the interval 0 to 0
        middle = np.log(root(after))
    spread = float(np.hypot(np.std(logs) * np.sqrt(k / max(k - 1, 1)), common))
    reach = stdtrit(max(k - 1, 1), 0.975) * spread
    return root(before), root(after), (float(np.exp(middle - reach)), float(np.exp(middle + reach)))


def root(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def folds(data: MeasuredData, count: int) -> Array:
    """Return the fold of each row, (n,): whole poses, distributed in the order of their names."""
    name = next((name for name in ("shared_id", "pose_id") if data.has(name)), None)
    whole = np.asarray(data[name]) if name else np.arange(len(data))
    return np.asarray(np.unique(whole, return_inverse=True)[1] % count)


def errors_left_out(
    J: Array, y: Array, fold: Array, smooth: Array | None = None, square: float = 1.0
) -> Array:  # fmt: skip
    """Return the errors of y, (N,), in each fold left out in turn, predicted by the columns J, (N, p), of the others.

    A direction of J that only the rows left out determine is held. To the squares of `smooth` columns (N, m), whose
    weights are small before the data, a `square` is added.
    """
    size = np.sqrt((J**2).sum(axis=0))
    J, held = J / np.where(size > 0, size, 1.0), np.full(J.shape[1], _HELD)
    if smooth is not None:
        J, held = np.concatenate([J, smooth], axis=1), np.append(held, np.full(smooth.shape[1], square))
    whole, right, errors = J.T @ J, J.T @ y, np.empty(len(y))
    for k in np.unique(fold):
        out = fold == k
        part = J[out]
        w = np.linalg.solve(whole - part.T @ part + np.diag(held), right - part.T @ y[out])
        errors[out] = y[out] - part @ w
    return errors


def shrink(before: float, after: float, floor: float) -> float:
    """Return the part of the excess over the floor, in squares, that was removed; NaN where there was no excess."""
    excess = before**2 - floor**2
    return float(1 - max(after**2 - floor**2, 0.0) / excess) if excess > 0 else float("nan")
