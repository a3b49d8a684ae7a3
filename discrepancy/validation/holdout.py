"""The gap on held-out poses: rms of the whitened constraints relative to the noise floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.special import stdtrit

from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array


@final
@dataclass(frozen=True)
class HeldOut:
    """Root mean squares before and after, and the 95 % interval of the one after."""

    before: float
    after: float
    ci95: tuple[float, float]


def held_out(before: Array, after: Array, data: MeasuredData, rng: np.random.Generator, common: float = 0.0) -> HeldOut:
    """Return the gap of whitened residuals (n, c) on held-out rows; its interval by a bootstrap over whole poses.

    The interval is symmetric in the logarithm, Student's with one degree of freedom a pose: percentiles of the
    resamples themselves are too narrow for the few dozen poses that are held out. `common` is the part of the spread
    that all rows share: the standard deviation of the logarithm that the errors of the parameters add.
    """
    poses = np.unique(
        np.asarray(data["pose_id"] if data.has("pose_id") else np.arange(len(data))), return_inverse=True
    )[1]
    squares = np.bincount(poses, (after**2).mean(axis=1))
    counts = np.bincount(poses).astype(float)
    k = len(counts)
    drawn = (
        rng.multinomial(k, np.full(k, 1 / k), size=thresholds().bootstrap_draws)
        if k <= 5000
        else rng.poisson(1.0, (200, k))
    )
    logs = 0.5 * np.log(np.maximum((drawn @ squares) / np.maximum(drawn @ counts, 1), 1e-300))
    with np.errstate(divide="ignore"):  # readings that are met exactly: 0 with the interval 0 to 0
        middle = np.log(root(after))
    spread = float(np.hypot(np.std(logs) * np.sqrt(k / max(k - 1, 1)), common))
    reach = stdtrit(max(k - 1, 1), 0.975) * spread
    return HeldOut(root(before), root(after), (float(np.exp(middle - reach)), float(np.exp(middle + reach))))


def root(values: Array) -> float:
    """Return the root of the mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def folds(data: MeasuredData, count: int) -> Array:
    """Return the fold of each row, (n,): whole poses, distributed in the order of their names.

    Where data have a `shared_id`, of poses whose readings share noise, all rows of one are in one fold: noise in both
    the fit and the left-out rows would look like a prediction.
    """
    name = next((name for name in ("shared_id", "pose_id") if data.has(name)), None)
    whole = np.asarray(data[name]) if name else np.arange(len(data))
    return np.asarray(np.unique(whole, return_inverse=True)[1] % count)


def shrink(before: float, after: float, floor: float) -> float:
    """Return the part of the excess over the floor, in squares, that was removed; NaN where there was no excess."""
    excess = before**2 - floor**2
    return float(1 - max(after**2 - floor**2, 0.0) / excess) if excess > 0 else float("nan")
