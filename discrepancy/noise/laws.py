"""Noise other than stated: a sensor read in coarse steps, a sensor with outlying readings, heavy tails everywhere.

They move no mean, so a score test cannot find them. Each is fitted to the residuals of the model that is otherwise
best; `calibench.discrepancy.diagnostics` compares them with each other and with the noise as stated. `r` are whitened
residuals, (n, c); a `signature`, (n, c), is what one stated standard deviation of a reading leaves in r.

The size of a noise effect: a value with its 95 % interval, separate from the test whether it exists.

That test uses a coarse grid of sizes, which is enough to decide, but too coarse to report. Here the size is fitted.

Mixture noise: some readings have a larger variance than stated. It shifts no mean; such readings get less weight.

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
from scipy.special import chdtri

from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured import Sensor
from calibench.discrepancy.noise.repeats import pairs_of
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array


def quantisation_of(formulation: Formulation, sensor: Sensor, r: Array, signature: Array) -> NoiseFinding:
    """Return what coarse steps of one sensor explain: steps coarser than its stated noise and resolution.

    The step is read off the recorded values, which is practically certain; the gain says whether it matters. Gain and
    amplitude are 0 where there is no step.
    """
    name = sensor.column
    stated = _sigma(formulation, name)
    step = lattice(formulation.data[name], max(stated, 1.5 * sensor.resolution))
    if step and _off_lattice(formulation.data[name], step) > thresholds().off_step * stated:
        step = 0.0  # values that are nearly whole steps apart: equally spaced poses, not coarse readings
    extra = step**2 / 12.0  # the variance of a rounding
    energy, share = _along(r, signature)
    grown = 1.0 + extra / stated**2 * share
    gain = float((energy * (1.0 - 1.0 / grown) - np.log(grown)).sum()) if step else 0.0
    n = len(r)
    _, low, high = step_size(formulation.data[name], step) if step else (0.0, 0.0, 0.0)
    return NoiseFinding(
        family="quantisation",
        target=sensor.part,
        amplitude=step,
        unit=sensor.unit,
        gain=gain,
        weights=np.ones(n),
        extra={name: np.full(n, extra)},
        ci95=(low, high),
    )


def _off_lattice(values: Array, step: float) -> float:
    """Return the rms distance of differences of neighbouring values from whole steps, in their unit."""
    between = np.diff(np.unique(values))
    return float(np.sqrt(np.mean((between - step * np.round(between / step)) ** 2)))


def outliers_of(formulation: Formulation, sensor: Sensor, r: Array, signature: Array) -> NoiseFinding:
    """Return what outlying readings of one sensor explain; the amplitude is their spread, in its unit.

    `signature` is that of the sensor, (n, c). The size is fitted to the differences between back-to-back repeats where
    these show the outlying readings clearly, else to the residuals. Which sensor of several is to blame is not decided
    here, but in `calibench.discrepancy.diagnostics.noise`.
    """
    name = sensor.column
    stated = _sigma(formulation, name)
    energy, share = _along(r, signature)
    seen = mixture(energy, share)
    first, second = pairs_of(formulation.data)
    gain, tau = seen.gain, seen.tau
    size, unit = outlying_size(energy, share, seen.epsilon, seen.tau), stated
    if len(first) >= thresholds().repeat_pairs:
        change, deviation = _difference(formulation, name, first, second)
        mixed = mixture(change**2, np.ones(len(first)))
        gain += mixed.gain
        tau = mixed.tau if mixed.gain > seen.gain else tau
        if mixed.gain > thresholds().wild_size_gain:  # nothing else that is missing shows between repeats
            size = outlying_size(change**2, np.ones(len(first)), mixed.epsilon, mixed.tau)
            unit = deviation
    value, low, high = (unit * end for end in size)
    return NoiseFinding(
        family="outlier",
        target=sensor.part,
        amplitude=value,
        unit=sensor.unit,
        gain=gain,
        weights=seen.weights,
        extra={name: seen.weights * (tau * stated) ** 2},
        ci95=(low, high),
    )


def heavy_tails_in(formulation: Formulation, r: Array) -> NoiseFinding:
    """Return what is explained if some readings are noisier in all sensors; the amplitude is the excess kurtosis."""
    n, c = r.shape
    seen = mixture((r**2).sum(axis=1), np.ones(n), degrees=c)
    value, low, high = kurtosis_size(r)
    extra = {name: seen.weights * (seen.tau * _sigma(formulation, name)) ** 2 for name in formulation.readings}
    return NoiseFinding(
        family="heavy_tails",
        target="all",
        amplitude=value,
        unit="1",
        gain=seen.gain,
        weights=seen.weights,
        extra=extra,
        ci95=(low, high),
    )


def _along(r: Array, s: Array) -> tuple[Array, Array]:
    """Return the energy of r along s, and |s|^2, both (n,)."""
    share = (s**2).sum(axis=1)
    return (s * r).sum(axis=1) ** 2 / np.maximum(share, 1e-300), share


def _sigma(formulation: Formulation, name: str) -> float:
    return float(np.median(formulation.sigma[name]))


def _difference(formulation: Formulation, name: str, first: Array, second: Array) -> tuple[Array, float]:
    """Return the changes of a reading between repeats in their standard deviation, (m,), and that deviation.

    The machine may have moved a little between repeats: where the spread of the middle half of the changes is larger
    than the stated noise, that spread is the deviation.
    """
    change = formulation.data[name][second] - formulation.data[name][first]
    change = change - np.median(change)
    spread = float(np.subtract(*np.percentile(change, [75, 25]))) / 1.349
    deviation = max(float(np.sqrt(2)) * _sigma(formulation, name), spread)
    return np.asarray(change / deviation), deviation


Size = tuple[float, float, float]  # value, and the ends of its interval

_ROUNDS = 200
_DRAWN = 200
_MOST = 20_000  # numbers that a drawn sample holds
_Z = 1.959964


def outlying_size(energy: Array, share: Array, epsilon: float, tau: float) -> Size:
    """Return tau, the extra noise of the outlying readings in stated deviations, from `energy` and `share`, (n,).

    The mixture of `discrepancy.noise.laws` is fitted from `epsilon` and `tau` until it converges. The interval is
    that of a variance estimated from as many readings as are outlying.
    """
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


def kurtosis_size(r: Array) -> Size:
    """Return the excess kurtosis of residuals, (n,) or (n, c), with its interval over samples drawn from its rows."""
    rng, rows = np.random.default_rng(0), r.reshape(len(r), -1)
    value = _kurtosis(rows)
    most = min(len(rows), _MOST)
    drawn = [_kurtosis(rows[rng.integers(0, len(rows), most)]) for _ in range(_DRAWN)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    narrower = np.sqrt(most / len(rows))  # samples as large as the data scatter less
    return value, value - narrower * max(value - float(low), 0.0), value + narrower * max(float(high) - value, 0.0)


def step_size(values: Array, step: float) -> Size:
    """Return the step of the lattice on which `values` lie, with its interval: narrow where they span many steps."""
    distinct = np.unique(values)
    cells = np.round((distinct - distinct[0]) / step)
    cells, at = cells - cells.mean(), distinct - distinct.mean()
    off = at - step * cells
    error = _Z * float(np.sqrt((off**2).mean() / max((cells**2).sum(), 1.0)))
    return step, step - error, step + error


def _kurtosis(r: Array) -> float:
    variance = float((r**2).mean())
    return float((r**4).mean()) / variance**2 - 3.0 if variance else 0.0


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
