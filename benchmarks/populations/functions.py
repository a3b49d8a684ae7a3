"""Functions that have nothing to do with robots: five of the shapes of the BBOB suite, written from its definitions.

Hansen, Finck, Ros, Auger, "Real-parameter black-box optimization benchmarking: noiseless functions definitions",
INRIA RR-6829 (2009). Our own: the optimum is uniform in +-4 of the box +-5, its value is 0, and the coordinates are
turned by a random rotation; both follow from (name, dimension, instance).
"""

from __future__ import annotations

from math import cos, exp, pi, sqrt
from typing import final

import numba
import numpy as np
from numpy.typing import NDArray

from calibench.core.seeds import seed_sequence

Array = NDArray[np.float64]


@numba.njit()
def ellipsoid(z: Array) -> float:
    """Return f10, a bowl of condition 1e6."""
    d, total = z.size, 0.0
    for i in range(d):
        total += 1e6 ** (i / max(1, d - 1)) * z[i] ** 2
    return total


@numba.njit()
def rosenbrock(z: Array) -> float:
    """Return f9, a bent valley."""
    d, total = z.size, 0.0
    c = max(1.0, sqrt(d) / 8)
    for i in range(d - 1):
        a, b = c * z[i] + 1, c * z[i + 1] + 1
        total += 100 * (a * a - b) ** 2 + (a - 1) ** 2
    return total


@numba.njit()
def different_powers(z: Array) -> float:
    """Return f14, whose curvature differs more and more near the optimum."""
    d, total = z.size, 0.0
    for i in range(d):
        total += abs(z[i]) ** (2 + 4 * i / max(1, d - 1))
    return sqrt(total)


@numba.njit()
def rastrigin(z: Array) -> float:
    """Return f15's core: many valleys over a bowl, without its asymmetries."""
    total = 0.0
    for v in z:
        total += 10 * (1 - cos(2 * pi * v)) + v * v
    return total


@numba.njit()
def ackley(z: Array) -> float:
    """Return Ackley's function: many valleys in a funnel."""
    d, squares, waves = z.size, 0.0, 0.0
    for v in z:
        squares += v * v
        waves += cos(2 * pi * v)
    return -20 * (exp(-0.2 * sqrt(squares / d)) - 1) - (exp(waves / d) - exp(1.0))


FUNCTIONS = ("ellipsoid", "rosenbrock", "different_powers", "rastrigin", "ackley")


@numba.njit()
def _value(function: int, turn: Array, optimum: Array, x: Array) -> float:
    z = np.zeros(x.size)
    for i in range(x.size):
        for j in range(x.size):
            z[i] += turn[i, j] * (x[j] - optimum[j])
    if function == 0:
        return ellipsoid(z)
    if function == 1:
        return rosenbrock(z)
    if function == 2:
        return different_powers(z)
    return rastrigin(z) if function == 3 else ackley(z)


@numba.njit()
def _values(function: int, turn: Array, optimum: Array, points: Array) -> Array:
    values = np.empty(len(points))
    for i in range(len(points)):
        values[i] = _value(function, turn, optimum, points[i])
    return values


@final
class Foreign:
    """One function of `FUNCTIONS`, moved and turned; the box is +-5 and the start random."""

    default_start = "random"

    def __init__(self, function: str, dimension: int, instance: int = 0) -> None:
        self.options = {"function": function, "dimension": dimension, "instance": instance}
        rng = np.random.default_rng(seed_sequence(function, dimension, repetition=instance))
        self.lower, self.upper = np.full(dimension, -5.0), np.full(dimension, 5.0)
        self.start = np.zeros(dimension)
        self._optimum = rng.uniform(-4, 4, dimension)
        self._turn = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
        self._number = FUNCTIONS.index(function)

    def __call__(self, x: Array) -> float:
        return float(_value(self._number, self._turn, self._optimum, x))

    def batch(self, points: Array) -> Array:
        """Return the values of points, shape (k, dimension)."""
        return np.asarray(_values(self._number, self._turn, self._optimum, np.ascontiguousarray(points)))

    def compile(self) -> None:
        """Compile before the clock starts."""
        self(self.start)
        self.batch(self.start[None])
