"""NIST's models of the exponential class: each as its value and its slopes in the parameters.

A model takes the parameters `b`, shape (dim,), and the predictors `x`, shape (k, m); a value has shape (m,), slopes
(m, dim). Formulas are those that NIST prints with the data.
"""

from __future__ import annotations

import numpy as np

from calibench.problems.base import Array


def saturation(b: Array, x: Array) -> Array:
    """Return b1 (1 - exp(-b2 x)): Misra1a, BoxBOD."""
    return np.asarray(b[0] * -np.expm1(-b[1] * x[0]))


def saturation_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `saturation`."""
    return np.stack([-np.expm1(-b[1] * x[0]), b[0] * x[0] * np.exp(-b[1] * x[0])], axis=1)


def damped_fraction(b: Array, x: Array) -> Array:
    """Return exp(-b1 x) / (b2 + b3 x): Chwirut1, Chwirut2."""
    return np.asarray(np.exp(-b[0] * x[0]) / (b[1] + b[2] * x[0]))


def damped_fraction_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `damped_fraction`."""
    below = b[1] + b[2] * x[0]
    value = np.exp(-b[0] * x[0]) / below
    return np.stack([-x[0] * value, -value / below, -x[0] * value / below], axis=1)


def three_decays(b: Array, x: Array) -> Array:
    """Return b1 exp(-b2 x) + b3 exp(-b4 x) + b5 exp(-b6 x): Lanczos1, Lanczos2, Lanczos3."""
    return np.asarray(b[0] * np.exp(-b[1] * x[0]) + b[2] * np.exp(-b[3] * x[0]) + b[4] * np.exp(-b[5] * x[0]))


def three_decays_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `three_decays`."""
    columns = []
    for height, rate in (b[0:2], b[2:4], b[4:6]):
        decay = np.exp(-rate * x[0])
        columns += [decay, -height * x[0] * decay]
    return np.stack(columns, axis=1)


def decay_and_two_peaks(b: Array, x: Array) -> Array:
    """Return b1 exp(-b2 x) + b3 exp(-(x-b4)^2/b5^2) + b6 exp(-(x-b7)^2/b8^2): Gauss1, Gauss2, Gauss3."""
    peaks = [height * np.exp(-((x[0] - centre) ** 2) / width**2) for height, centre, width in (b[2:5], b[5:8])]
    return np.asarray(b[0] * np.exp(-b[1] * x[0]) + peaks[0] + peaks[1])


def decay_and_two_peaks_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `decay_and_two_peaks`."""
    decay = np.exp(-b[1] * x[0])
    columns = [decay, -b[0] * x[0] * decay]
    for height, centre, width in (b[2:5], b[5:8]):
        away = x[0] - centre
        peak = np.exp(-(away**2) / width**2)
        columns += [peak, height * peak * 2 * away / width**2, height * peak * 2 * away**2 / width**3]
    return np.stack(columns, axis=1)


def two_decays(b: Array, x: Array) -> Array:
    """Return b1 + b2 exp(-x b4) + b3 exp(-x b5): MGH17."""
    return np.asarray(b[0] + b[1] * np.exp(-x[0] * b[3]) + b[2] * np.exp(-x[0] * b[4]))


def two_decays_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `two_decays`."""
    first, second = np.exp(-x[0] * b[3]), np.exp(-x[0] * b[4])
    return np.stack([np.ones_like(first), first, second, -b[1] * x[0] * first, -b[2] * x[0] * second], axis=1)


def thermistor(b: Array, x: Array) -> Array:
    """Return b1 exp(b2 / (x + b3)): MGH10 (Meyer 1970)."""
    return np.asarray(b[0] * np.exp(b[1] / (x[0] + b[2])))


def thermistor_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `thermistor`."""
    shifted = x[0] + b[2]
    growth = np.exp(b[1] / shifted)
    return np.stack([growth, b[0] * growth / shifted, -b[0] * growth * b[1] / shifted**2], axis=1)


def normal_peak(b: Array, x: Array) -> Array:
    """Return (b1/b2) exp(-0.5 ((x-b3)/b2)^2): Eckerle4."""
    return np.asarray(b[0] / b[1] * np.exp(-0.5 * ((x[0] - b[2]) / b[1]) ** 2))


def normal_peak_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `normal_peak`."""
    z = (x[0] - b[2]) / b[1]
    peak = np.exp(-0.5 * z**2) / b[1]
    return np.stack([peak, b[0] * peak * (z**2 - 1) / b[1], b[0] * peak * z / b[1]], axis=1)


def logistic(b: Array, x: Array) -> Array:
    """Return b1 / (1 + exp(b2 - b3 x)): Rat42."""
    return np.asarray(b[0] / (1 + np.exp(b[1] - b[2] * x[0])))


def logistic_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `logistic`."""
    share = 1 / (1 + np.exp(b[1] - b[2] * x[0]))
    steep = b[0] * share * (1 - share)
    return np.stack([share, -steep, steep * x[0]], axis=1)


def richards(b: Array, x: Array) -> Array:
    """Return b1 / (1 + exp(b2 - b3 x))^(1/b4): Rat43."""
    return np.asarray(b[0] * np.exp(-np.logaddexp(0, b[1] - b[2] * x[0]) / b[3]))  # exp(1000) must not spoil it


def richards_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `richards`."""
    z = b[1] - b[2] * x[0]
    log = np.logaddexp(0, z)
    share = np.exp(-log / b[3])
    steep = b[0] * share / b[3] / (1 + np.exp(-z))
    return np.stack([share, -steep, steep * x[0], b[0] * share * log / b[3] ** 2], axis=1)


def degradation(b: Array, x: Array) -> Array:
    """Return b1 - b2 x1 exp(-b3 x2), which is log(y): Nelson."""
    return np.asarray(b[0] - b[1] * x[0] * np.exp(-b[2] * x[1]))


def degradation_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `degradation`."""
    rate = x[0] * np.exp(-b[2] * x[1])
    return np.stack([np.ones_like(rate), -rate, b[1] * rate * x[1]], axis=1)
