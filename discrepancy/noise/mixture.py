"""Mixture noise: some readings have a larger variance than stated. It shifts no mean; such readings get less weight.

Every law here adds variance to some readings. What it explains is a ratio of likelihoods over whitened residuals r,
(n, c), given what one standard deviation of each reading leaves there: its whitened signature s, (n, c), with
sum over readings of s s^T = I. Extra variance tau^2 (in units of the stated one) on a reading turns the law of r from
N(0, I) into N(0, I + tau^2 s s^T); a part `epsilon` of readings may have it, all others being as stated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.problems.base import Array


@final
@dataclass(frozen=True, eq=False)
class NoiseFinding:
    """One law fitted: `gain` is twice the log-likelihood it brings over noise as stated, before any penalty.

    Each reading is outlying with probability `weights`, (n,); `extra` is what to add to the variance of a reading,
    (n,), in its own unit squared. `ci95` is the interval of the amplitude. `rival` is another family and target that
    explains nearly as much, with its weight: then one of the two blames a single sensor of the kind `alike`.
    """

    family: str
    target: str
    amplitude: float
    unit: str
    gain: float
    weights: Array
    extra: Mapping[str, Array]
    ci95: tuple[float, float]
    rival: tuple[str, str, float] | None = None
    alike: str = ""


@final
@dataclass(frozen=True, eq=False)
class Mixture:
    """A part `epsilon` of the readings has `tau` times the stated noise on top: fitted by maximum likelihood."""

    epsilon: float
    tau: float
    gain: float
    weights: Array


_TAUS = np.geomspace(2.0, 400.0, 14)
_ROUNDS = 25


def mixture(energy: Array, share: Array, degrees: int = 1) -> Mixture:
    """Fit a `Mixture` to residuals, given the energy of each along the signature of the suspect, both (n,).

    `share` is |s|^2 and `energy` (s . r)^2 / |s|^2: a reading with the extra noise has energy (1 + tau^2 share) chi2 of
    `degrees` degrees of freedom, one without has chi2. EM over epsilon for each of a ladder of tau.
    """
    grown = 1.0 + _TAUS**2 * share[:, None]
    log_ratio = -0.5 * degrees * np.log(grown) + 0.5 * energy[:, None] * (1.0 - 1.0 / grown)
    ratio = np.exp(np.clip(log_ratio, -500, 500))
    epsilon = np.full(len(_TAUS), 0.02)
    for _ in range(_ROUNDS):
        weights = ratio / (ratio + (1.0 / epsilon - 1.0))
        epsilon = np.clip(weights.mean(axis=0), 1e-6, 1 - 1e-6)
    gains = 2.0 * np.logaddexp(np.log1p(-epsilon), np.log(epsilon) + log_ratio).sum(axis=0)
    best = int(np.argmax(gains))
    return Mixture(float(epsilon[best]), float(_TAUS[best]), float(max(gains[best], 0.0)), weights[:, best])


def lattice(values: Array, least: float) -> float:
    """Return the step, at least `least`, of the lattice on which all `values`, (n,), lie; 0 if they lie on none.

    Trial steps are the smallest difference and whole parts of it. Each is fitted to the differences of neighbours,
    small ones first; it is accepted if these are whole numbers of steps to within a tenth or so. The lattice may itself
    be recorded with a finer one, or printed with few digits.
    """
    distinct = np.unique(values)
    if len(distinct) < 6:
        return 0.0
    between = np.sort(np.diff(distinct))
    between = between[between > 1e-3 * least]  # two prints of one number
    if len(between) < 5:
        return 0.0
    for divisor in range(1, 1 + min(30, int(1.1 * between[0] / least))):
        step = _fitted(between, float(between[0]) / divisor)
        if step >= least and np.exp(2j * np.pi * between / step).mean().real > 0.9:
            return step
    return 0.0


def _fitted(between: Array, step: float) -> float:
    """Return `step` fitted to whole numbers of it: first the smallest, then up to twice as many at a time."""
    window = 2.0 * step
    while True:
        near = between[between <= window + 0.5 * step]
        if len(near):
            cells = np.maximum(np.round(near / step), 1)
            step = float((near @ cells) / (cells @ cells))
        if window > between[-1]:
            return step
        window *= 2
