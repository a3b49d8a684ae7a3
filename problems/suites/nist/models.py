"""NIST's models: which data set has which, each as its value and its slopes, and how the readings are taken.

A model takes the parameters `b`, shape (dim,), and the predictors `x`, shape (k, m). A value has shape (m,); slopes are
a column (m,) for each parameter. Formulas are those that NIST prints with the data.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np

from calibench.problems.base import Array

Columns = Sequence[Array]


@final
@dataclass(frozen=True)
class Model:
    """A regression: ``value(b, x)``, shape (m,), is fitted to ``response(y)``; ``columns(b, x)`` are its slopes."""

    value: Callable[[Array, Array], Array]
    columns: Callable[[Array, Array], Columns]
    response: Callable[[Array], Array] = np.asarray


_saturation = Model(  # b1 (1 - exp(-b2 x))
    lambda b, x: b[0] * -np.expm1(-b[1] * x[0]),
    lambda b, x: (-np.expm1(-b[1] * x[0]), b[0] * x[0] * np.exp(-b[1] * x[0])),
)


def _damped_fraction_columns(b: Array, x: Array) -> Columns:
    below = b[1] + b[2] * x[0]
    value = np.exp(-b[0] * x[0]) / below
    return -x[0] * value, -value / below, -x[0] * value / below


_damped_fraction = Model(  # exp(-b1 x) / (b2 + b3 x)
    lambda b, x: np.exp(-b[0] * x[0]) / (b[1] + b[2] * x[0]), _damped_fraction_columns
)


def _three_decays_columns(b: Array, x: Array) -> Columns:
    columns = []
    for height, rate in (b[0:2], b[2:4], b[4:6]):
        decay = np.exp(-rate * x[0])
        columns += [decay, -height * x[0] * decay]
    return columns


_three_decays = Model(  # b1 exp(-b2 x) + b3 exp(-b4 x) + b5 exp(-b6 x)
    lambda b, x: b[0] * np.exp(-b[1] * x[0]) + b[2] * np.exp(-b[3] * x[0]) + b[4] * np.exp(-b[5] * x[0]),
    _three_decays_columns,
)


def _decay_and_two_peaks_columns(b: Array, x: Array) -> Columns:
    decay = np.exp(-b[1] * x[0])
    columns = [decay, -b[0] * x[0] * decay]
    for height, centre, width in (b[2:5], b[5:8]):
        away = x[0] - centre
        peak = np.exp(-(away**2) / width**2)
        columns += [peak, height * peak * 2 * away / width**2, height * peak * 2 * away**2 / width**3]
    return columns


_two_peaks = Model(  # b1 exp(-b2 x) + b3 exp(-(x-b4)^2/b5^2) + b6 exp(-(x-b7)^2/b8^2)
    lambda b, x: (
        b[0] * np.exp(-b[1] * x[0])
        + b[2] * np.exp(-((x[0] - b[3]) ** 2) / b[4] ** 2)
        + b[5] * np.exp(-((x[0] - b[6]) ** 2) / b[7] ** 2)
    ),
    _decay_and_two_peaks_columns,
)
_two_decays = Model(  # b1 + b2 exp(-x b4) + b3 exp(-x b5)
    lambda b, x: b[0] + b[1] * np.exp(-x[0] * b[3]) + b[2] * np.exp(-x[0] * b[4]),
    lambda b, x: (
        np.ones_like(x[0]),
        np.exp(-x[0] * b[3]),
        np.exp(-x[0] * b[4]),
        -b[1] * x[0] * np.exp(-x[0] * b[3]),
        -b[2] * x[0] * np.exp(-x[0] * b[4]),
    ),
)


def _thermistor_columns(b: Array, x: Array) -> Columns:
    shifted = x[0] + b[2]
    growth = np.exp(b[1] / shifted)
    return growth, b[0] * growth / shifted, -b[0] * growth * b[1] / shifted**2


_thermistor = Model(lambda b, x: b[0] * np.exp(b[1] / (x[0] + b[2])), _thermistor_columns)  # b1 exp(b2 / (x + b3))


def _normal_peak_columns(b: Array, x: Array) -> Columns:
    z = (x[0] - b[2]) / b[1]
    peak = np.exp(-0.5 * z**2) / b[1]
    return peak, b[0] * peak * (z**2 - 1) / b[1], b[0] * peak * z / b[1]


_normal_peak = Model(  # (b1/b2) exp(-0.5 ((x-b3)/b2)^2)
    lambda b, x: b[0] / b[1] * np.exp(-0.5 * ((x[0] - b[2]) / b[1]) ** 2), _normal_peak_columns
)


def _logistic_columns(b: Array, x: Array) -> Columns:
    share = 1 / (1 + np.exp(b[1] - b[2] * x[0]))
    steep = b[0] * share * (1 - share)
    return share, -steep, steep * x[0]


_logistic = Model(lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x[0])), _logistic_columns)  # b1 / (1 + exp(b2 - b3 x))


def _richards_columns(b: Array, x: Array) -> Columns:
    z = b[1] - b[2] * x[0]
    log = np.logaddexp(0, z)
    share = np.exp(-log / b[3])
    steep = b[0] * share / b[3] / (1 + np.exp(-z))
    return share, -steep, steep * x[0], b[0] * share * log / b[3] ** 2


_richards = Model(  # b1 / (1 + exp(b2 - b3 x))^(1/b4), and exp(1000) must not spoil it
    lambda b, x: b[0] * np.exp(-np.logaddexp(0, b[1] - b[2] * x[0]) / b[3]), _richards_columns
)

_degradation = Model(  # b1 - b2 x1 exp(-b3 x2), which is log(y)
    lambda b, x: b[0] - b[1] * x[0] * np.exp(-b[2] * x[1]),
    lambda b, x: (np.ones_like(x[0]), -(x[0] * np.exp(-b[2] * x[1])), b[1] * (x[0] * np.exp(-b[2] * x[1])) * x[1]),
    response=np.log,
)


def _polynomials(degree: int, b: Array, x: Array) -> tuple[Array, Array]:
    """Return the polynomial above the line, of `degree`, and the one below it, whose constant is 1."""
    above, below = b[degree] + 0 * x[0], b[-1] + 0 * x[0]
    for k in range(degree - 1, -1, -1):  # Horner
        above = above * x[0] + b[k]
        below = below * x[0] + (b[degree + k] if k else 1.0)
    return above, below


def _fraction_columns(degree: int, b: Array, x: Array) -> Columns:
    above, below = _polynomials(degree, b, x)
    powers = np.stack([x[0] ** k for k in range(degree + 1)], axis=1) / below[:, None]
    return [*powers.T, *(-(above / below)[:, None] * powers[:, 1:]).T]


# (b1 + b2 x + b3 x^2) / (1 + b4 x + b5 x^2), and (b1 + ... + b4 x^3) / (1 + b5 x + b6 x^2 + b7 x^3)
_quadratics = Model(lambda b, x: np.divide(*_polynomials(2, b, x)), partial(_fraction_columns, 2))
_cubics = Model(lambda b, x: np.divide(*_polynomials(3, b, x)), partial(_fraction_columns, 3))


def _enzyme_columns(b: Array, x: Array) -> Columns:
    below = x[0] ** 2 + x[0] * b[2] + b[3]
    share = (x[0] ** 2 + x[0] * b[1]) / below
    return share, b[0] * x[0] / below, -b[0] * share * x[0] / below, -b[0] * share / below


_enzyme = Model(  # b1 (x^2 + x b2) / (x^2 + x b3 + b4)
    lambda b, x: b[0] * (x[0] ** 2 + x[0] * b[1]) / (x[0] ** 2 + x[0] * b[2] + b[3]), _enzyme_columns
)

_inverse_square = Model(  # b1 (1 - (1 + b2 x/2)^-2)
    lambda b, x: b[0] * (1 - (1 + b[1] * x[0] / 2) ** -2),
    lambda b, x: (1 - (1 + b[1] * x[0] / 2) ** -2, b[0] * x[0] * (1 + b[1] * x[0] / 2) ** -3),
)

_inverse_root = Model(  # b1 (1 - (1 + 2 b2 x)^-0.5)
    lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x[0]) ** -0.5),
    lambda b, x: (1 - (1 + 2 * b[1] * x[0]) ** -0.5, b[0] * x[0] * (1 + 2 * b[1] * x[0]) ** -1.5),
)

_adsorption = Model(  # b1 b2 x / (1 + b2 x)
    lambda b, x: b[0] * b[1] * x[0] / (1 + b[1] * x[0]),
    lambda b, x: (b[1] * x[0] / (1 + b[1] * x[0]), b[0] * x[0] / (1 + b[1] * x[0]) ** 2),
)
_power = Model(  # b1 x^b2
    lambda b, x: b[0] * x[0] ** b[1], lambda b, x: (x[0] ** b[1], b[0] * x[0] ** b[1] * np.log(x[0]))
)


def _magnetisation_columns(b: Array, x: Array) -> Columns:
    shifted = b[1] + x[0]
    grown = shifted ** (-1 / b[2])
    return grown, -b[0] * grown / (b[2] * shifted), b[0] * grown * np.log(shifted) / b[2] ** 2


_magnetisation = Model(lambda b, x: b[0] * (b[1] + x[0]) ** (-1 / b[2]), _magnetisation_columns)  # b1 (b2 + x)^(-1/b3)


def _quantum_defect_columns(b: Array, x: Array) -> Columns:
    away = x[0] - b[3]
    spread = np.pi * (away**2 + b[2] ** 2)
    return np.ones_like(away), -x[0], -away / spread, -b[2] / spread


_quantum_defect = Model(  # b1 - b2 x - arctan(b3 / (x - b4)) / pi
    lambda b, x: b[0] - b[1] * x[0] - np.arctan(b[2] / (x[0] - b[3])) / np.pi, _quantum_defect_columns
)


def _three_cycles(b: Array, x: Array) -> Array:
    value = b[0] + 0 * x[0]
    for period, cosine, sine in ((12.0, b[1], b[2]), b[3:6], b[6:9]):
        angle = 2 * np.pi * x[0] / period
        value = value + cosine * np.cos(angle) + sine * np.sin(angle)
    return np.asarray(value)


def _three_cycles_columns(b: Array, x: Array) -> Columns:
    year = 2 * np.pi * x[0] / 12
    columns = [np.ones_like(year), np.cos(year), np.sin(year)]
    for period, cosine, sine in (b[3:6], b[6:9]):
        angle = 2 * np.pi * x[0] / period
        turned = -angle / period * (sine * np.cos(angle) - cosine * np.sin(angle))
        columns += [turned, np.cos(angle), np.sin(angle)]
    return columns


_cycles = Model(_three_cycles, _three_cycles_columns)  # b1 and three cycles, of 12, b4 and b7 months

MODELS = {
    "Misra1a": _saturation, "Chwirut2": _damped_fraction, "Chwirut1": _damped_fraction, "Lanczos3": _three_decays,
    "Gauss1": _two_peaks, "Gauss2": _two_peaks, "DanWood": _power, "Misra1b": _inverse_square, "Kirby2": _quadratics,
    "Hahn1": _cubics, "Nelson": _degradation, "MGH17": _two_decays, "Lanczos1": _three_decays,
    "Lanczos2": _three_decays, "Gauss3": _two_peaks, "Misra1c": _inverse_root, "Misra1d": _adsorption,
    "Roszman1": _quantum_defect, "ENSO": _cycles,
    "MGH09": _enzyme,  # Kowalik and Osborne 1978
    "Thurber": _cubics, "BoxBOD": _saturation, "Rat42": _logistic,
    "MGH10": _thermistor,  # Meyer 1970
    "Eckerle4": _normal_peak, "Rat43": _richards, "Bennett5": _magnetisation,
}  # fmt: skip
