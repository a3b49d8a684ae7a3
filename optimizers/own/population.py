"""The traits that `de`, `ga` and `pso` share: each begins with a random population in the box, whatever the start.

Warm-up: a method runs a few rounds on a constant objective, so that its code is compiled before a clock starts.

The calls are the run's own, and so are their types: numba compiles anew for as little as an array that is read-only.
"""

from __future__ import annotations

from contextlib import suppress
from typing import final

import numpy as np

from calibench.optimizers.base import Array, Optimizer, Stop, Traits


def population_traits(population: int) -> Traits:
    """Return the traits of a method whose first sample is `population` random points of the box."""
    return Traits(
        stochastic=True,
        uses_start=False,
        minimum_budget=population,
        needs_finite_bounds=True,
        batches=True,
    )


_BATCHES = 5


def rehearse(optimizer: Optimizer) -> None:
    """Run `optimizer` until its objective, zero everywhere, has been asked for five batches."""
    with suppress(Stop):
        optimizer.minimize(_Flat(), np.random.default_rng(0))


@final
class _Flat:
    """Zero on the unit square."""

    has_residuals = has_jacobian = has_gradient = False
    dimension = 2

    def __init__(self) -> None:
        self.lower, self.upper, self.start = np.zeros(2), np.ones(2), np.zeros(2)
        for bounds in (self.lower, self.upper, self.start):
            bounds.flags.writeable = False  # as the gate's are
        self.remaining = 1000
        self._left = _BATCHES

    def batch(self, points: Array) -> Array:
        if not self._left:
            raise Stop
        self._left -= 1
        return np.zeros(len(points))

    def batch_below(self, points: Array, limits: Array) -> Array:
        return self.batch(points)

    def __call__(self, x: Array) -> float:
        raise AssertionError("a warm-up only asks for batches")

    def residuals(self, x: Array) -> Array:
        raise AssertionError("a warm-up only asks for batches")

    jacobian = gradient = residuals

    def value_and_gradient(self, x: Array) -> tuple[float, Array]:
        raise AssertionError("a warm-up only asks for batches")

    def restart(self) -> Array:
        raise AssertionError("a warm-up only asks for batches")
