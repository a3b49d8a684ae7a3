"""Estimate from repeated readings whether the stated noise of one kind of sensor is wrong by a factor.

One scale for all sensors, as `repeats` estimates it, cannot correct that, because the constraints would still have the
wrong weights. The scale of each kind's noise is found by maximum likelihood from differences of the constraints between
back-to-back readings: a missing effect cancels in these. The law is a t law, so that single bad readings do not decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.optimize import minimize

from calibench.core.counted import plain
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.model.measured.sensor import kinds_of
from calibench.discrepancy.model.roles import unknown_noise_of
from calibench.discrepancy.noise.repeats import pairs_of
from calibench.discrepancy.noise.whiten import ROUNDING
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_GRIDDED = 3  # kinds of sensors up to which every combination of scales is tried to begin with


def sensor_scales(at: Fit) -> tuple[dict[str, float], tuple[str, ...]]:
    """Return what to add to the stated variance of each reading whose kind has the wrong stated noise, and a note."""
    names = at.model.formulation.readings
    kinds = [tuple(sensor.column for sensor in alike) for alike in kinds_of(at.model.formulation.sensors)]
    first, second = pairs_of(at.model.formulation.data)
    if len(first) < thresholds().repeat_pairs or len(kinds) < 2:
        return {}, ()
    shape = at.at.misclosure.shape
    white = at.r.reshape(shape)
    scatter = float(np.median((white[second] - white[first]) ** 2) / 2 / 0.455)
    if np.all(np.abs(white[second] - white[first]) <= ROUNDING):
        return {}, ()  # repeats that are the same tell no noise
    if 1 / thresholds().scatter_asked < scatter < thresholds().scatter_asked:
        return {}, ()
    parts = [_part(at, kind, first, second) for kind in kinds]
    same = [_mostly_the_same(at, kind, first, second) for kind in kinds]
    read = [k for k, part in enumerate(parts) if part.any() and not same[k]]  # the others keep their statement
    if not read:
        return {}, ()
    scales = [1.0] * len(kinds)
    for k, scale in zip(read, _scales(at, [parts[k] for k in read], first, second)):
        scales[k] = scale
    if len(read) < len(kinds):  # a t law's scale is not a deviation; the others' scales are
        left = _whitened(at, np.asarray(sum(scales[k] ** 2 * parts[k] for k in read)), first, second)[0]
        deviation = float(np.sqrt(np.median(left**2) / 0.455))
        scales = [scale * deviation if k in read else scale for k, scale in enumerate(scales)]
    if max(scales) < thresholds().scale_ratio * min(scales):
        return {}, ()
    extra: dict[str, float] = {}
    for kind, scale in ((kinds[k], scales[k]) for k in read):
        extra |= {name: (scale**2 - 1) * float(np.mean(at.at.sigma[:, names.index(name)] ** 2)) for name in kind}
    told = "; ".join(f"{', '.join(kinds[k])}: {plain(scales[k], 2)} times" for k in read)
    return extra, (f"repeats scatter otherwise than the stated noise ({told}); their scatter is used",)


def _mostly_the_same(at: Fit, kind: tuple[str, ...], first: Array, second: Array) -> bool:
    """Return whether repeats of a kind of unknown noise are mostly the same number, and show none of it."""
    data, unknown = at.model.formulation.data, unknown_noise_of(at.model.formulation)
    change = np.stack([np.asarray(data[name])[second] - np.asarray(data[name])[first] for name in kind])
    return set(kind) <= set(unknown) and not np.median(np.abs(change))


def _part(at: Fit, kind: tuple[str, ...], first: Array, second: Array) -> Array:
    """Return what the stated noise of one kind adds to the differences of pairs, (m, c, c).

    It is 0 where no pair reads the kind.
    """
    names = at.model.formulation.readings
    own = (at.at.reading_slopes * at.at.sigma[:, None, :])[:, :, [names.index(name) for name in kind]]
    spread = own @ own.transpose(0, 2, 1)
    return np.asarray((spread[first] + spread[second]) / 2)


def _scales(at: Fit, parts: list[Array], first: Array, second: Array) -> list[float]:
    """Return the factors by which the stated noise of each kind must be multiplied.

    `parts` are their shares of the variance.
    """
    white = at.r.reshape(at.at.misclosure.shape)
    tails = thresholds().scale_tails

    def cost(logs: Sequence[float] | Array) -> float:
        covariance = sum(np.exp(2 * log) * part for log, part in zip(logs, parts))
        z, size = _whitened(at, covariance, first, second)
        return float(2 * size + (tails + z.shape[1]) * np.log1p((z**2).sum(axis=1) / tails).sum())

    level = np.log(np.mean((white[second] - white[first]) ** 2) / 2 + 1e-12) / 2
    grid = np.linspace(-1.0, 2.0, 7) * max(abs(level), 1.0) * np.sign(level or 1.0)
    start: Sequence[float] = [float(level)] * len(parts)  # of many kinds a grid would cost more than it finds
    if len(parts) <= _GRIDDED:
        start = min(product(grid, repeat=len(parts)), key=cost)
    best = minimize(cost, np.array(start), method="Nelder-Mead", options={"maxiter": 120})
    return [float(np.exp(log)) for log in best.x]


def _whitened(at: Fit, covariance: Array, first: Array, second: Array) -> tuple[Array, float]:
    """Return the differences of pairs whitened by `covariance` (m, c, c), (m, c), and the logarithm of its root."""
    f = at.at.misclosure
    d = (f[second] - f[first]) / np.sqrt(2)
    lower = np.linalg.cholesky(covariance)
    z = np.linalg.solve(lower, d[:, :, None])[:, :, 0]
    return np.asarray(z), float(np.log(np.diagonal(lower, axis1=1, axis2=2)).sum())
