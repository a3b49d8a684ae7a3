"""The small work of the sweeps: a sphere in five dimensions, and a search at random, as a user would write them."""

from __future__ import annotations

import numpy as np


class Sphere:
    lower, upper, start, minimum = np.full(5, -5.0), np.full(5, 5.0), np.zeros(5), 0.0

    def __call__(self, x):
        return float(np.sum((x - 0.3) ** 2))


class Wanderer:
    def __init__(self):
        from calibench import optimizers

        self.traits = optimizers.Traits(stochastic=True, uses_start=False)

    def minimize(self, objective, rng):
        while True:
            objective(objective.lower + rng.random(objective.dimension) * (objective.upper - objective.lower))


def search_at_random(function, lower, upper, budget, seed):
    """Return the lowest of `budget` values at points drawn in the box: the work of a small run."""
    rng = np.random.default_rng(seed)
    return min(function(lower + rng.random(len(lower)) * (upper - lower)) for _ in range(budget))
