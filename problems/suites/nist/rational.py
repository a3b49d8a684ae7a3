"""NIST's models of the rational class: each as its value and its slopes in the parameters.

Shapes are those of `exponential`: parameters (dim,), predictors (k, m), values (m,), slopes (m, dim).
"""

from __future__ import annotations

import numpy as np

from calibench.problems.base import Array


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
