"""Noise other than stated: a sensor read in coarse steps, a sensor with outlying readings, heavy tails everywhere.

They move no mean, so a score test cannot find them. Each is fitted to the residuals of the model that is otherwise
best; `calibench.discrepancy.diagnostics` compares them with each other and with the noise as stated. `r` are whitened
residuals, (n, c); `signatures` are reading -> (n, c), what one stated standard deviation of it leaves in r.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured.sensor import Sensor
from calibench.discrepancy.noise.mixture import NoiseFinding, lattice, mixture
from calibench.discrepancy.noise.repeats import pairs_of
from calibench.discrepancy.noise.size import kurtosis_size, outlying_size, step_size
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array


def quantisation_of(
    formulation: Formulation, sensor: Sensor, r: Array, signatures: Mapping[str, Array]
) -> NoiseFinding:
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
    energy, share = _along(r, signatures[name])
    grown = 1.0 + extra / stated**2 * share
    gain = float((energy * (1.0 - 1.0 / grown) - np.log(grown)).sum()) if step else 0.0
    n = len(r)
    _, low, high = step_size(formulation.data[name], step) if step else (0.0, 0.0, 0.0)
    return NoiseFinding(
        "quantisation", sensor.part, step, sensor.unit, gain, 1, 1.0 if step else 0.0, 1.0,
        np.ones(n), {name: np.full(n, extra)}, (low, high),
    )  # fmt: skip


def _off_lattice(values: Array, step: float) -> float:
    """Return how far, root mean square, differences of neighbouring values lie from whole steps, in their unit."""
    between = np.diff(np.unique(values))
    return float(np.sqrt(np.mean((between - step * np.round(between / step)) ** 2)))


def outliers_of(
    formulation: Formulation, sensor: Sensor, alike: Sequence[Sensor], r: Array, signatures: Mapping[str, Array]
) -> NoiseFinding:
    """Return what outlying readings of one sensor explain; the amplitude is their spread, in its unit.

    `alike` are all sensors of its kind, itself among them.

    Two sources tell which sensor it is: the residuals, which hardly do with one constraint a reading, and the
    differences between back-to-back repeats, which do at once. `concentration` is this sensor's part in all outlying
    energy, where no single reading counts for more than ten deviations. Ask for .8 before one sensor is blamed, or
    heavy tails of all sensors will be blamed on it. Where neither source tells the sensors of a kind apart (no repeats,
    and one constraint a reading or the signatures of one sensor), each has an equal part.
    """
    encoder, names = sensor.column, [other.column for other in alike]
    stated, count = _sigma(formulation, encoder), len(names)
    energies = {name: _along(r, signatures[name]) for name in names if name in signatures}
    seen = mixture(*energies[encoder])
    first, second = pairs_of(formulation.data)
    gain, fraction, tau = seen.gain, seen.epsilon, seen.tau
    size, unit = outlying_size(*energies[encoder], seen.epsilon, seen.tau), stated
    if len(first) >= thresholds().repeat_pairs:
        changes = {name: _difference(formulation, name, first, second) for name in names}
        witnesses = {name: change**2 for name, (change, _) in changes.items()}
        told = mixture(witnesses[encoder], np.ones(len(first)))
        gain += told.gain
        if told.gain > seen.gain:
            fraction, tau = told.epsilon / 2, told.tau  # either of a pair may be the outlying one
        if told.gain > thresholds().wild_size_gain:  # nothing else that is missing shows between repeats
            size = outlying_size(witnesses[encoder], np.ones(len(first)), told.epsilon, told.tau)
            unit = changes[encoder][1]
    else:
        told_apart = r.shape[1] > 1 and len(energies) == len(names)
        witnesses = {name: energy for name, (energy, _) in energies.items()} if told_apart else {}
    value, low, high = (unit * end for end in size)
    return NoiseFinding(
        "outlier", sensor.part, value, sensor.unit, gain, 2, fraction, _part(witnesses, encoder, count), seen.weights,
        {encoder: seen.weights * (tau * stated) ** 2}, (low, high),
    )  # fmt: skip


def _part(witnesses: Mapping[str, Array], encoder: str, count: int) -> float:
    """Return an encoder's part in the outlying energies, (m,) each, in variances: those between 4^2 and 10^2."""
    outlying = {name: float(np.minimum(e[e > 16.0], 100.0).sum()) for name, e in witnesses.items()}
    whole = sum(outlying.values())
    return outlying[encoder] / whole if whole else 1.0 / count


def heavy_tails_in(formulation: Formulation, r: Array) -> NoiseFinding:
    """Return what is explained if some readings are noisier in all sensors; the amplitude is the excess kurtosis."""
    n, c = r.shape
    seen = mixture((r**2).sum(axis=1), np.ones(n), degrees=c)
    value, low, high = kurtosis_size(r)
    extra = {name: seen.weights * (seen.tau * _sigma(formulation, name)) ** 2 for name in formulation.readings}
    return NoiseFinding(
        "heavy_tails", "all", value, "1", seen.gain, 2, seen.epsilon, 1.0, seen.weights, extra, (low, high)
    )


def _along(r: Array, s: Array) -> tuple[Array, Array]:
    """Return the energy of r along s, and |s|^2, both (n,)."""
    share = (s**2).sum(axis=1)
    return (s * r).sum(axis=1) ** 2 / np.maximum(share, 1e-300), share


def _sigma(formulation: Formulation, name: str) -> float:
    return float(np.median(formulation.sigma[name]))


def _difference(formulation: Formulation, encoder: str, first: Array, second: Array) -> tuple[Array, float]:
    """Return the change of an encoder between repeats in its standard deviations, (m,), and one of these, rad.

    The machine may have moved a little between them: the spread of the middle half is taken for the deviation if it is
    wider than stated.
    """
    change = formulation.data[encoder][second] - formulation.data[encoder][first]
    change = change - np.median(change)
    spread = float(np.subtract(*np.percentile(change, [75, 25]))) / 1.349
    deviation = max(float(np.sqrt(2)) * _sigma(formulation, encoder), spread)
    return np.asarray(change / deviation), deviation
