"""The three steps of differential evolution as Cong et al. 2008, section 4.3, state them: rand/1/bin."""

from __future__ import annotations

import numpy as np

from bedrock.compiled import njit
from optimizers._random_kernels import State, between, index, uniform
from optimizers.base import Array


@njit()
def initialize(size: int, lower: Array, upper: Array, state: State) -> Array:
    """Return a uniform random population, shape (size, dim)."""
    population = np.empty((size, lower.shape[0]))
    for i in range(size):
        for j in range(lower.shape[0]):
            population[i, j] = between(state, lower[j], upper[j])
    return population


@njit()
def propose(population: Array, f: float, cr: float, lower: Array, upper: Array, state: State, trial: Array) -> None:
    """Fill `trial`, shape (size, dim), with one trial vector for each member."""
    size, dim = population.shape
    for i in range(size):
        r1 = index(state, size)
        while r1 == i:
            r1 = index(state, size)
        r2 = index(state, size)
        while r2 in (i, r1):
            r2 = index(state, size)
        r3 = index(state, size)
        while r3 in (i, r1, r2):
            r3 = index(state, size)
        forced = index(state, dim)
        for j in range(dim):
            if uniform(state) <= cr or j == forced:  # eq. (47)
                v = population[r1, j] + f * (population[r2, j] - population[r3, j])  # eq. (46)
                if not lower[j] <= v <= upper[j]:
                    v = between(state, lower[j], upper[j])  # "randomly regenerated"
                trial[i, j] = v
            else:
                trial[i, j] = population[i, j]


@njit()
def select(population: Array, values: Array, trial: Array, trial_values: Array) -> None:
    """Keep of each pair the better one, eq. (48); the member stays on a tie."""
    for i in range(population.shape[0]):
        if trial_values[i] < values[i]:
            values[i] = trial_values[i]
            for j in range(population.shape[1]):
                population[i, j] = trial[i, j]
