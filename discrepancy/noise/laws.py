"""Noise other than stated: a sensor read in coarse steps, a sensor with outlying readings, heavy tails everywhere.

They move no mean, so a score test cannot find them. Each is fitted to the residuals of the model that is otherwise
best; `calibench.discrepancy.diagnostics` compares them with each other and with the noise as stated. `r` are whitened
residuals, (n, c); a `signature`, (n, c), is what one stated standard deviation of a reading leaves in r.
"""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured.sensor import Sensor
from calibench.discrepancy.noise.mixture import NoiseFinding, lattice, mixture
from calibench.discrepancy.noise.repeats import pairs_of
from calibench.discrepancy.noise.size import kurtosis_size, outlying_size, step_size
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
        "quantisation", sensor.part, step, sensor.unit, gain, np.ones(n), {name: np.full(n, extra)}, (low, high)
    )  # fmt: skip


def _off_lattice(values: Array, step: float) -> float:
    """Return the rms distance of differences of neighbouring values from whole steps, in their unit."""
    between = np.diff(np.unique(values))
    return float(np.sqrt(np.mean((between - step * np.round(between / step)) ** 2)))


def outliers_of(formulation: Formulation, sensor: Sensor, r: Array, signature: Array) -> NoiseFinding:
    """Return what outlying readings of one sensor explain; the amplitude is their spread, in its unit.

    `signature` is that of the sensor, (n, c). The size is fitted to the differences between back-to-back repeats where
    these show the outlying readings clearly, else to the residuals. Which sensor of several is to blame is not decided
    here, but in `calibench.discrepancy.diagnostics.noise_diagnostic`.
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
        told = mixture(change**2, np.ones(len(first)))
        gain += told.gain
        tau = told.tau if told.gain > seen.gain else tau
        if told.gain > thresholds().wild_size_gain:  # nothing else that is missing shows between repeats
            size = outlying_size(change**2, np.ones(len(first)), told.epsilon, told.tau)
            unit = deviation
    value, low, high = (unit * end for end in size)
    return NoiseFinding(
        "outlier", sensor.part, value, sensor.unit, gain, seen.weights,
        {name: seen.weights * (tau * stated) ** 2}, (low, high),
    )  # fmt: skip


def heavy_tails_in(formulation: Formulation, r: Array) -> NoiseFinding:
    """Return what is explained if some readings are noisier in all sensors; the amplitude is the excess kurtosis."""
    n, c = r.shape
    seen = mixture((r**2).sum(axis=1), np.ones(n), degrees=c)
    value, low, high = kurtosis_size(r)
    extra = {name: seen.weights * (seen.tau * _sigma(formulation, name)) ** 2 for name in formulation.readings}
    return NoiseFinding("heavy_tails", "all", value, "1", seen.gain, seen.weights, extra, (low, high))


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
