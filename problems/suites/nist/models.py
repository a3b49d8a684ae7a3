"""Which data set has which model, by NIST's names: the value, its slopes, and how the readings are taken.

NIST's models of the exponential class: each as its value and its slopes in the parameters.

A model takes the parameters `b`, shape (dim,), and the predictors `x`, shape (k, m); a value has shape (m,), slopes
(m, dim). Formulas are those that NIST prints with the data.

NIST's models of the rational class: each as its value and its slopes in the parameters.

Shapes are those of `exponential`: parameters (dim,), predictors (k, m), values (m,), slopes (m, dim).

NIST's models of the miscellaneous class: each as its value and its slopes in the parameters.

Shapes are those of `exponential`: parameters (dim,), predictors (k, m), values (m,), slopes (m, dim).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

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


def quadratics(b: Array, x: Array) -> Array:
    """Return (b1 + b2 x + b3 x^2) / (1 + b4 x + b5 x^2): Kirby2."""
    above, below = _parts(b, x, degree=2)
    return np.asarray(above / below)


def quadratics_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `quadratics`."""
    return _slopes(b, x, degree=2)


def cubics(b: Array, x: Array) -> Array:
    """Return (b1 + b2 x + b3 x^2 + b4 x^3) / (1 + b5 x + b6 x^2 + b7 x^3): Hahn1, Thurber."""
    above, below = _parts(b, x, degree=3)
    return np.asarray(above / below)


def cubics_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `cubics`."""
    return _slopes(b, x, degree=3)


def enzyme(b: Array, x: Array) -> Array:
    """Return b1 (x^2 + x b2) / (x^2 + x b3 + b4): MGH09 (Kowalik and Osborne 1978)."""
    return np.asarray(b[0] * (x[0] ** 2 + x[0] * b[1]) / (x[0] ** 2 + x[0] * b[2] + b[3]))


def enzyme_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `enzyme`."""
    below = x[0] ** 2 + x[0] * b[2] + b[3]
    share = (x[0] ** 2 + x[0] * b[1]) / below
    return np.stack([share, b[0] * x[0] / below, -b[0] * share * x[0] / below, -b[0] * share / below], axis=1)


def _parts(b: Array, x: Array, degree: int) -> tuple[Array, Array]:
    """Return the polynomial above the line, of `degree`, and the one below it, whose constant is 1."""
    above, below = b[degree] + 0 * x[0], b[-1] + 0 * x[0]
    for k in range(degree - 1, -1, -1):  # Horner
        above = above * x[0] + b[k]
        below = below * x[0] + (b[degree + k] if k else 1.0)
    return above, below


def _slopes(b: Array, x: Array, degree: int) -> Array:
    above, below = _parts(b, x, degree)
    powers = np.stack([x[0] ** k for k in range(degree + 1)], axis=1) / below[:, None]
    return np.concatenate([powers, -(above / below)[:, None] * powers[:, 1:]], axis=1)


def inverse_square(b: Array, x: Array) -> Array:
    """Return b1 (1 - (1 + b2 x/2)^-2): Misra1b."""
    return np.asarray(b[0] * (1 - (1 + b[1] * x[0] / 2) ** -2))


def inverse_square_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `inverse_square`."""
    grown = 1 + b[1] * x[0] / 2
    return np.stack([1 - grown**-2, b[0] * x[0] * grown**-3], axis=1)


def inverse_root(b: Array, x: Array) -> Array:
    """Return b1 (1 - (1 + 2 b2 x)^-0.5): Misra1c."""
    return np.asarray(b[0] * (1 - (1 + 2 * b[1] * x[0]) ** -0.5))


def inverse_root_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `inverse_root`."""
    grown = 1 + 2 * b[1] * x[0]
    return np.stack([1 - grown**-0.5, b[0] * x[0] * grown**-1.5], axis=1)


def adsorption(b: Array, x: Array) -> Array:
    """Return b1 b2 x / (1 + b2 x): Misra1d."""
    return np.asarray(b[0] * b[1] * x[0] / (1 + b[1] * x[0]))


def adsorption_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `adsorption`."""
    grown = 1 + b[1] * x[0]
    return np.stack([b[1] * x[0] / grown, b[0] * x[0] / grown**2], axis=1)


def power(b: Array, x: Array) -> Array:
    """Return b1 x^b2: DanWood."""
    return np.asarray(b[0] * x[0] ** b[1])


def power_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `power`."""
    grown = x[0] ** b[1]
    return np.stack([grown, b[0] * grown * np.log(x[0])], axis=1)


def magnetisation(b: Array, x: Array) -> Array:
    """Return b1 (b2 + x)^(-1/b3): Bennett5."""
    return np.asarray(b[0] * (b[1] + x[0]) ** (-1 / b[2]))


def magnetisation_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `magnetisation`."""
    shifted = b[1] + x[0]
    grown = shifted ** (-1 / b[2])
    return np.stack([grown, -b[0] * grown / (b[2] * shifted), b[0] * grown * np.log(shifted) / b[2] ** 2], axis=1)


def quantum_defect(b: Array, x: Array) -> Array:
    """Return b1 - b2 x - arctan(b3 / (x - b4)) / pi: Roszman1."""
    return np.asarray(b[0] - b[1] * x[0] - np.arctan(b[2] / (x[0] - b[3])) / np.pi)


def quantum_defect_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `quantum_defect`."""
    away = x[0] - b[3]
    spread = np.pi * (away**2 + b[2] ** 2)
    return np.stack([np.ones_like(away), -x[0], -away / spread, -b[2] / spread], axis=1)


def three_cycles(b: Array, x: Array) -> Array:
    """Return b1 and three cycles, of 12, b4 and b7 months: ENSO."""
    value = b[0] + 0 * x[0]
    for period, cosine, sine in ((12.0, b[1], b[2]), b[3:6], b[6:9]):
        angle = 2 * np.pi * x[0] / period
        value = value + cosine * np.cos(angle) + sine * np.sin(angle)
    return np.asarray(value)


def three_cycles_slopes(b: Array, x: Array) -> Array:
    """Return the slopes of `three_cycles`."""
    year = 2 * np.pi * x[0] / 12
    columns = [np.ones_like(year), np.cos(year), np.sin(year)]
    for period, cosine, sine in (b[3:6], b[6:9]):
        angle = 2 * np.pi * x[0] / period
        turned = -angle / period * (sine * np.cos(angle) - cosine * np.sin(angle))
        columns += [turned, np.cos(angle), np.sin(angle)]
    return np.stack(columns, axis=1)


Formula = Callable[[Array, Array], Array]


@final
@dataclass(frozen=True)
class Model:
    """A regression: ``value(b, x)``, shape (m,), is fitted to ``response(y)``; ``slopes(b, x)``, (m, dim)."""

    value: Formula
    slopes: Formula
    response: Callable[[Array], Array] = np.asarray


MODELS = {
    "Misra1a": Model(saturation, saturation_slopes),
    "Chwirut2": Model(damped_fraction, damped_fraction_slopes),
    "Chwirut1": Model(damped_fraction, damped_fraction_slopes),
    "Lanczos3": Model(three_decays, three_decays_slopes),
    "Gauss1": Model(decay_and_two_peaks, decay_and_two_peaks_slopes),
    "Gauss2": Model(decay_and_two_peaks, decay_and_two_peaks_slopes),
    "DanWood": Model(power, power_slopes),
    "Misra1b": Model(inverse_square, inverse_square_slopes),
    "Kirby2": Model(quadratics, quadratics_slopes),
    "Hahn1": Model(cubics, cubics_slopes),
    "Nelson": Model(degradation, degradation_slopes, response=np.log),
    "MGH17": Model(two_decays, two_decays_slopes),
    "Lanczos1": Model(three_decays, three_decays_slopes),
    "Lanczos2": Model(three_decays, three_decays_slopes),
    "Gauss3": Model(decay_and_two_peaks, decay_and_two_peaks_slopes),
    "Misra1c": Model(inverse_root, inverse_root_slopes),
    "Misra1d": Model(adsorption, adsorption_slopes),
    "Roszman1": Model(quantum_defect, quantum_defect_slopes),
    "ENSO": Model(three_cycles, three_cycles_slopes),
    "MGH09": Model(enzyme, enzyme_slopes),
    "Thurber": Model(cubics, cubics_slopes),
    "BoxBOD": Model(saturation, saturation_slopes),
    "Rat42": Model(logistic, logistic_slopes),
    "MGH10": Model(thermistor, thermistor_slopes),
    "Eckerle4": Model(normal_peak, normal_peak_slopes),
    "Rat43": Model(richards, richards_slopes),
    "Bennett5": Model(magnetisation, magnetisation_slopes),
}
