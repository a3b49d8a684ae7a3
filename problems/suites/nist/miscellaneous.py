"""NIST's models of the miscellaneous class: each as its value and its slopes in the parameters.

Shapes are those of `exponential`: parameters (dim,), predictors (k, m), values (m,), slopes (m, dim).
"""

from __future__ import annotations

import numpy as np

from calibench.problems.base import Array


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
