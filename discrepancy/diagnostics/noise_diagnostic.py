"""Test the stated noise: coarse steps or outlying readings of one sensor, heavy tails of all.

Coarse steps are found from the recorded values. Outlying readings and heavy tails must show between back-to-back
repeats, because there no missing effect can look like them: most differences are as small as stated, some are far
larger. Heavy tails within the stated standard deviation (a t law of that variance) are not reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import gammainc

from calibench.core.counted import plain
from calibench.discrepancy.fitting.fit import Fit, linearise, readings_of
from calibench.discrepancy.model.formulations.blocks import rows_read
from calibench.discrepancy.model.measured.sensor import Sensor, blamable, kinds_of, sensor_of
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import unknown_noise_of
from calibench.discrepancy.noise.laws import heavy_tails_in, outliers_of, quantisation_of
from calibench.discrepancy.noise.mixture import NoiseFinding, mixture
from calibench.discrepancy.noise.repeats import TAILS, pairs_of, variance
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_CORES = (0.75, 1.0)
_NOTHING, _FAR_LESS = 1e-4, 0.5  # times the stated noise: less than the first has no noise at all
_CHANCE = 1e-6  # that readings of the stated noise leave so little
_SCALES = 0.7, 1.05  # between which noise is as stated
_QUARTILES = 1.17  # standard deviations, times root n, of a spread told by the quartiles of n Gaussian values


def coarse_sensors(at: Fit) -> tuple[NoiseFinding, ...]:
    """Return the sensors whose values have steps coarse enough to matter, for a fit under the stated noise."""
    r, signatures = whitened(at)
    formulation = at.model.formulation
    sensors = blamable(formulation.sensors)
    found = [quantisation_of(formulation, sensor, r, signatures[sensor.column]) for sensor in sensors]
    return tuple(_counted_once(f, at) for f in found if f.amplitude > 0 and f.gain > thresholds().step_gain)


def less_than_stated(at: Fit) -> tuple[str, ...]:
    """Return a note where a fit leaves far less than the stated noise would by chance; none where it is learned."""
    if unknown_noise_of(at.model.formulation):
        return ()
    energy = float(np.sum(at.r**2))
    times = float(np.sqrt(energy / at.degrees))
    if at.exact or not _NOTHING < times < _FAR_LESS or gammainc(at.degrees / 2, energy / 2) > _CHANCE:
        return ()
    return (
        f"what is left is {plain(times, 2)} times the stated noise, which is too large: what is small beside it is "
        "not found; state it as it is, or leave it out to have it learned",
    )


def _counted_once(found: NoiseFinding, at: Fit) -> NoiseFinding:
    """Return the finding with its variance multiplied where readings repeat, because equal values have the same error.

    m readings of one value tell no more than one reading does; with m times the variance each, they weigh as one.
    """
    [(name, variance)] = found.extra.items()
    data = at.model.formulation.data
    step = np.round(np.asarray(data[name]) / found.amplitude)
    pose = np.unique(data["pose_id"], return_inverse=True)[1] if data.has("pose_id") else np.zeros(len(step))
    _, place, count = np.unique(np.stack([step, pose]), axis=1, return_inverse=True, return_counts=True)
    same = count[place.ravel()]
    return replace(found, extra={name: variance * same})


def outlying(at: Fit) -> tuple[NoiseFinding, ...]:
    """Return the cause of readings far beyond the stated noise: one sensor, or all; nothing without repeats.

    Only sensors of one kind are compared with each other, because each kind has its own noise.
    """
    found: list[NoiseFinding] = []
    for alike in kinds_of(blamable(at.model.formulation.sensors)):
        found += _outlying_among(at, alike)
    shared = [f for f in found if f.family != "outlier"]  # heavy tails are those of all readings: told once
    return (*(f for f in found if f.family == "outlier"), *shared[:1])


def _outlying_among(at: Fit, alike: Sequence[Sensor]) -> tuple[NoiseFinding, ...]:
    formulation = at.model.formulation
    first, second = pairs_of(formulation.data)
    names = [sensor.column for sensor in alike]
    read = rows_read(formulation, names)
    first, second = first[read[first]], second[read[first]]
    if len(first) < thresholds().repeat_pairs:
        return ()
    d = _changes(at, names, first, second)
    if not (_beyond(d) and _beyond(_elsewhere(d, first), thresholds().wild_elsewhere)):
        return ()
    worst = int(np.argmax([contamination(d[:, k]) for k in range(len(names))]))
    everywhere = mixture((d**2).ravel(), np.ones(d.size))
    weights = everywhere.weights.reshape(d.shape)
    energy = (weights * np.minimum(d**2, thresholds().wild_energy_most)).sum(axis=0)
    lone = mixture(d[:, worst] ** 2, np.ones(len(d)))
    one = float(1 / (1 + np.exp(np.clip((everywhere.gain - lone.gain) / 2, -50, 50))))  # weight of "one encoder"
    concentrated = bool(energy[worst] >= thresholds().wild_share * energy.sum())
    r, signatures = whitened(at)
    blamed = alike[worst]
    if concentrated or one > 0.5:
        found = outliers_of(formulation, blamed, r, signatures[blamed.column])
        rival = ("heavy_tails", "all", 1 - one)
    else:
        found, rival = heavy_tails_in(formulation, r), ("outlier", blamed.part, one)
    near = not concentrated and rival[2] > thresholds().wild_rival
    return (replace(found, rival=rival, alike=blamed.kind) if near else found,)


def _beyond(d: Array, part: float = 1.0) -> bool:
    """Return whether changes have readings far beyond the noise, for all sensors or one.

    `part` multiplies the thresholds.
    """
    if len(d) < thresholds().repeat_pairs:
        return False
    return contamination(d) > part * thresholds().wild_gain_all or any(
        contamination(one) > part * thresholds().wild_gain_one for one in d.T
    )


def _elsewhere(d: Array, first: Array) -> Array:
    """Return the changes without those around the largest in time.

    A step shows only there, wild readings show everywhere.
    """
    place = np.argsort(np.argsort(first, kind="stable"))
    away = np.abs(place - place[np.argmax(np.abs(d).max(axis=1))])
    return np.asarray(d[away > max(1.0, thresholds().wild_moment * len(d))])


def outliers_under(model: Model, x: Array, target: str) -> NoiseFinding:
    """Return the outlying readings of the sensor at `target` under a model at x, over all rows of its formulation."""
    formulation = model.formulation
    sensor = sensor_of(formulation.sensors, target)
    readings = readings_of(model)
    at = linearise(model, Noise(), x, readings, readings)
    r = at.whiten(at.misclosure).reshape(at.misclosure.shape)
    k = formulation.readings.index(sensor.column)
    trace = at.whiten((at.reading_slopes * at.sigma[:, None, :])[:, :, k]).reshape(r.shape)
    return outliers_of(formulation, sensor, r, trace)


def contamination(d: Array) -> float:
    """Return the gain of "small noise, and some values far beyond it" over laws without outliers, for differences d.

    The small noise is as stated, or less where noise is correlated between readings and cancels in differences.
    """
    seen = -np.inf
    for core in _CORES:
        told = mixture((d.ravel() / core) ** 2, np.ones(d.size))
        seen = max(seen, told.gain / 2 + Noise(core).loglikelihood(d))
    one = max(Noise(_scale(d, t_degrees), 0.0, t_degrees).loglikelihood(d) for t_degrees in (*TAILS, np.inf))
    return float(2 * (seen - one))


def _scale(d: Array, t_degrees: float) -> float:
    """Return the most likely scale of a law with such tails, limited to the neighbourhood of the stated one."""
    return float(np.clip(np.sqrt(variance(d.ravel(), t_degrees)), *_SCALES))


def _changes(at: Fit, names: Sequence[str], first: Array, second: Array) -> Array:
    """Return the changes of readings between repeats in their standard deviations, shape (m, k).

    Where the middle half of the changes is significantly wider than stated, of all sensors or of one, its spread
    replaces the stated deviation.
    """
    data, readings = at.model.formulation.data, at.model.formulation.readings
    change = np.stack([np.asarray(data[name])[second] - np.asarray(data[name])[first] for name in names], axis=-1)
    of = [readings.index(name) for name in names]
    change = change / np.hypot(at.at.sigma[first][:, of], at.at.sigma[second][:, of])
    change = change - np.median(change, axis=0)
    change = change / _wider(change.ravel(), thresholds().wide_core_all)
    return np.asarray(change / [_wider(one, thresholds().wide_core_one) for one in change.T])


def _wider(values: Array, deviations: float) -> float:
    """Return the spread of the middle half of `values` if it is significantly above 1, by `deviations`; else 1."""
    spread = float(np.subtract(*np.percentile(values, [75, 25]))) / 1.349
    return spread if spread > 1 + deviations * _QUARTILES / np.sqrt(len(values)) else 1.0


def whitened(at: Fit) -> tuple[Array, dict[str, Array]]:
    """Return the whitened residuals (n, c), and the signature of one stated deviation of each blamable reading.

    A signature has shape (n, c) as well.
    """
    shape = at.at.misclosure.shape
    names = at.model.formulation.readings
    blamed = {sensor.column for sensor in blamable(at.model.formulation.sensors)}
    scaled = at.at.reading_slopes * at.at.sigma[:, None, :]
    signatures = {name: at.at.whiten(scaled[:, :, k]).reshape(shape) for k, name in enumerate(names) if name in blamed}
    return at.r.reshape(shape), signatures
