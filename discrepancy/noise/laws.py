"""Noise other than stated: a sensor read in coarse steps, a sensor with outlying readings, heavy tails everywhere.

They move no mean, so a score test cannot find them. What a law explains is a ratio of likelihoods over whitened
residuals r, (n, c), given the signature s, (n, c), that one standard deviation of each reading leaves there, with sum
over readings of s s^T = I: extra variance tau^2 on a part `epsilon` of readings turns N(0, I) into N(0, I + tau^2 s
s^T). The test uses a coarse grid of sizes; the size that is reported is fitted, with its 95 % interval.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.special import chdtri

from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured import Sensor
from calibench.discrepancy.noise.repeats import pairs_of
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

OF_NOISE = frozenset({"outlier", "quantisation", "heavy_tails"})  # nothing is corrected: readings are trusted less


def quantisation_of(formulation: Formulation, sensor: Sensor, r: Array, signature: Array) -> NoiseFinding:
    """Return what coarse steps of one sensor explain: steps coarser than its stated noise and resolution."""
    name, n, ends = sensor.column, len(r), (0.0, 0.0)
    stated, distinct = float(np.median(formulation.sigma[name])), np.unique(formulation.data[name])
    step = lattice(formulation.data[name], max(stated, 1.5 * sensor.resolution))
    if step:
        between = np.diff(distinct)
        if np.sqrt(np.mean((between - step * np.round(between / step)) ** 2)) > thresholds().off_step * stated:
            step = 0.0  # values that are nearly whole steps apart: equally spaced poses, not coarse readings
    extra = step**2 / 12.0  # the variance of a rounding
    energy, share = _energy_of(r, signature)
    grown = 1.0 + extra / stated**2 * share
    gain = float((energy * (1.0 - 1.0 / grown) - np.log(grown)).sum()) if step else 0.0
    if step:  # its interval is narrow where values span many steps
        cells = np.round((distinct - distinct[0]) / step)
        cells, at = cells - cells.mean(), distinct - distinct.mean()
        off = at - step * cells
        error = _Z * float(np.sqrt((off**2).mean() / max((cells**2).sum(), 1.0)))
        ends = (step - error, step + error)
    return NoiseFinding(
        family="quantisation", target=sensor.part, amplitude=step, unit=sensor.unit, gain=gain, weights=np.ones(n),
        extra={name: np.full(n, extra)}, ci95=ends,
    )  # fmt: skip


def outliers_of(formulation: Formulation, sensor: Sensor, r: Array, signature: Array) -> NoiseFinding:
    """Return what outlying readings of one sensor explain; the amplitude is their spread, in its unit."""
    name = sensor.column
    stated = float(np.median(formulation.sigma[name]))
    energy, share = _energy_of(r, signature)
    seen = mixture(energy, share)
    first, second = pairs_of(formulation.data)
    gain, tau = seen.gain, seen.tau
    size, unit = outlying_size(energy, share, seen.epsilon, seen.tau), stated
    if len(first) >= thresholds().repeat_pairs:
        change = (formulation.data[name][second] - formulation.data[name][first]) / (np.sqrt(2) * stated)
        (left, part), parts = changes_left(r, signature, first, second), np.ones(len(first))
        if not returned(change, left):
            change, parts = left, part
        change = change - np.median(change)
        deviation = max(1.0, middle_half(change))  # of a noise that is wider than stated
        squares = np.asarray(change / deviation) ** 2
        mixed = mixture(squares, parts)
        gain += mixed.gain
        tau = mixed.tau if mixed.gain > seen.gain else tau
        if mixed.gain > thresholds().wild_size_gain:  # nothing else that is missing shows between repeats
            size = outlying_size(squares, parts, mixed.epsilon, mixed.tau)
            unit = deviation * float(np.sqrt(2)) * stated
    value, low, high = (unit * end for end in size)
    return NoiseFinding(
        family="outlier", target=sensor.part, amplitude=value, unit=sensor.unit, gain=gain, weights=seen.weights,
        extra={name: seen.weights * (tau * stated) ** 2}, ci95=(low, high),
    )  # fmt: skip


def changes_left(r: Array, s: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Return what residuals r change between repeats along a sensor's signature s, of unit variance, (m,), and |s|^2.

    Where a machine came to a place a little beside the one before, all its readings tell of it, and nothing is left.
    """
    size = np.sqrt((s**2).sum(axis=1))
    along = (s * r).sum(axis=1) / np.maximum(size, 1e-300)
    return np.asarray(along[second] - along[first]) / np.sqrt(2), (size[first] ** 2 + size[second] ** 2) / 2


def returned(raw: Array, left: Array) -> bool:
    """Return whether a machine returned to the same place between repeats, as far as its noise shows.

    `raw` are the changes of its readings and `left` those of its residuals, in their standard deviations. Readings of
    a machine that came to another place change by more than the residuals, and by more at some places than at others.
    """
    doubt = _MOVED * QUARTILES * np.sqrt(2 / raw.size)
    return bool(middle_half(raw) <= (1 + doubt) * max(1.0, middle_half(left)))


def middle_half(values: Array) -> float:
    """Return the standard deviation of Gaussian values, (n, ...), told by their middle half."""
    return float(np.subtract(*np.percentile(values, [75, 25]))) / 1.349


def _energy_of(r: Array, s: Array) -> tuple[Array, Array]:
    """Return the energy of r along s, and |s|^2, both (n,)."""
    share = (s**2).sum(axis=1)
    return (s * r).sum(axis=1) ** 2 / np.maximum(share, 1e-300), share


def heavy_tails_in(formulation: Formulation, r: Array) -> NoiseFinding:
    """Return what is explained if some readings are noisier in all sensors; the amplitude is the excess kurtosis."""
    n, c = r.shape
    seen = mixture((r**2).sum(axis=1), np.ones(n), degrees=c)
    # the excess kurtosis, and its interval over samples drawn from the rows
    rng, most = np.random.default_rng(0), min(n, _MOST)
    drawn = []
    for sample in (r, *(r[rng.integers(0, n, most)] for _ in range(_DRAWN))):
        variance = float((sample**2).mean())
        drawn.append(float((sample**4).mean()) / variance**2 - 3.0 if variance else 0.0)
    value, ends = drawn[0], np.percentile(drawn[1:], [2.5, 97.5])
    narrower = np.sqrt(most / n)  # samples as large as the data scatter less
    low, high = value - narrower * max(value - float(ends[0]), 0.0), value + narrower * max(float(ends[1]) - value, 0.0)
    stated = {name: float(np.median(formulation.sigma[name])) for name in formulation.readings}
    extra = {name: seen.weights * (seen.tau * deviation) ** 2 for name, deviation in stated.items()}
    return NoiseFinding(
        family="heavy_tails", target="all", amplitude=value, unit="1", gain=seen.gain, weights=seen.weights,
        extra=extra, ci95=(low, high),
    )  # fmt: skip


_MOVED = 3.0  # standard errors by which readings change more than residuals where a machine moved between repeats
QUARTILES = 1.17  # standard deviations, times root n, of a spread told by the quartiles of n Gaussian values
_ROUNDS = 200
_DRAWN = 200
_MOST = 20_000  # numbers that a drawn sample holds
_Z = 1.959964


def outlying_size(energy: Array, share: Array, epsilon: float, tau: float) -> tuple[float, float, float]:
    """Return tau, the extra noise of outlying readings in stated deviations, and the ends of its interval."""
    epsilon, some = max(epsilon, 1e-6), share > 1e-12
    energy, share = energy[some], share[some]
    weights = np.zeros(len(energy))
    for _ in range(_ROUNDS):
        grown = 1.0 + tau**2 * share
        ratio = np.log(epsilon / (1 - epsilon)) - 0.5 * np.log(grown) + 0.5 * energy * (1 - 1 / grown)
        weights = 1 / (1 + np.exp(-np.clip(ratio, -500, 500)))
        whole = float(weights.sum())
        if whole < 1e-9:
            break
        size = float(np.sqrt(max((weights * (energy - 1) / share).sum() / whole, 0.0)))
        epsilon = float(np.clip(whole / len(weights), 1e-6, 1 - 1e-6))
        if abs(size - tau) < 1e-6 * tau:
            break
        tau = size
    degrees = max(float(weights.sum()), 1.0)
    ends = [np.sqrt(degrees / chdtri(degrees, above)) for above in (0.025, 0.975)]
    return tau, tau * float(ends[0]), tau * float(ends[1])


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
_EM_ROUNDS = 25


def mixture(energy: Array, share: Array, degrees: int = 1) -> Mixture:
    """Fit a `Mixture` to residuals, given the energy of each along the signature of the suspect, both (n,).

    `share` is |s|^2 and `energy` (s . r)^2 / |s|^2: a reading with the extra noise has energy (1 + tau^2 share) chi2 of
    `degrees` degrees of freedom, one without has chi2. EM over epsilon for each of a ladder of tau.
    """
    grown = 1.0 + _TAUS**2 * share[:, None]
    log_ratio = -0.5 * degrees * np.log(grown) + 0.5 * energy[:, None] * (1.0 - 1.0 / grown)
    ratio = np.exp(np.clip(log_ratio, -500, 500))
    epsilon = np.full(len(_TAUS), 0.02)
    for _ in range(_EM_ROUNDS):
        weights = ratio / (ratio + (1.0 / epsilon - 1.0))
        epsilon = np.clip(weights.mean(axis=0), 1e-6, 1 - 1e-6)
    gains = 2.0 * np.logaddexp(np.log1p(-epsilon), np.log(epsilon) + log_ratio).sum(axis=0)
    best = int(np.argmax(gains))
    return Mixture(float(epsilon[best]), float(_TAUS[best]), float(max(gains[best], 0.0)), weights[:, best])


def lattice(values: Array, least: float) -> float:
    """Return the step, at least `least`, of the lattice on which all `values`, (n,), lie; 0 if they lie on none."""
    distinct = np.unique(values)
    if len(distinct) < 6:
        return 0.0
    between = np.sort(np.diff(distinct))
    between = between[between > 1e-3 * least]  # two prints of one number
    if len(between) < 5:
        return 0.0
    for divisor in range(1, 1 + min(30, int(1.1 * between[0] / least))):
        step = float(between[0]) / divisor
        window = 2.0 * step
        while True:  # the step is fitted to whole numbers of it: first the smallest, then up to twice as many at a time
            near = between[between <= window + 0.5 * step]
            if len(near):
                cells = np.maximum(np.round(near / step), 1)
                step = float((near @ cells) / (cells @ cells))
            if window > between[-1]:
                break
            window *= 2
        if step >= least and np.exp(2j * np.pi * between / step).mean().real > 0.9:
            return step
    return 0.0
