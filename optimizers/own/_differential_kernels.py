"""The three steps of differential evolution as Cong et al. 2008, section 4.3, state them: rand/1/bin.

All random numbers of a generation are drawn at once, half a word each, and no branch depends on one but the redrawing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit
from calibench.optimizers.base import Array
from calibench.optimizers.own._random_kernels import WHOLE, State, between, halves, scaled


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
    """Fill `trial`, shape (size, dim), with one trial vector for each member. All are in C order."""
    size, dim = population.shape
    drawn = halves(state, size * (4 + dim))
    r1, r2, r3 = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size, np.int64)
    _three_others(drawn, r1, r2, r3)
    mutants = np.empty((size, dim))
    for i in range(size):
        a, b, c = r1[i], r2[i], r3[i]
        for j in range(dim):
            mutants[i, j] = population[a, j] + f * (population[b, j] - population[c, j])  # eq. (46)
    highest = np.uint32(min(int(cr * WHOLE), WHOLE - 1))  # randb(j) <= CR, both times 2^32
    _cross(population.reshape(-1), mutants.reshape(-1), drawn[4 * size :], highest, trial.reshape(-1))
    for i in range(size):
        j = scaled(drawn[3 * size + i], dim)  # rnbr(i)
        trial[i, j] = mutants[i, j]
    _redraw_outside(trial, lower, upper, state)


@njit()
def select(population: Array, values: Array, trial: Array, trial_values: Array) -> None:
    """Keep of each pair the better one, eq. (48); the member stays on a tie."""
    for i in range(population.shape[0]):
        if trial_values[i] < values[i]:
            values[i] = trial_values[i]
            for j in range(population.shape[1]):
                population[i, j] = trial[i, j]


@njit()
def _three_others(
    drawn: NDArray[np.uint32], r1: NDArray[np.int64], r2: NDArray[np.int64], r3: NDArray[np.int64]
) -> None:
    """Fill r1, r2, r3, shape (size,), with three different members that are not i: all triples equally likely.

    Each is drawn among as many as are left, and steps over those taken in ascending order: nothing is rejected.
    """
    size = r1.shape[0]
    for i in range(size):
        first = scaled(drawn[i], size - 1)
        first += first >= i
        low, high = min(i, first), max(i, first)
        second = scaled(drawn[size + i], size - 2)
        second += second >= low
        second += second >= high
        least, middle, most = min(low, second), max(low, min(high, second)), max(high, second)
        third = scaled(drawn[2 * size + i], size - 3)
        third += third >= least
        third += third >= middle
        third += third >= most
        r1[i], r2[i], r3[i] = first, second, third


@njit()
def _cross(members: Array, mutants: Array, drawn: NDArray[np.uint32], highest: np.uint32, trial: Array) -> None:
    """Take of each pair of components the mutant's where randb(j) <= CR, eq. (47): one long loop fills the lanes."""
    for k in range(members.shape[0]):
        trial[k] = mutants[k] if drawn[k] <= highest else members[k]


@njit()
def _redraw_outside(trial: Array, lower: Array, upper: Array, state: State) -> None:
    """Draw anew what is outside the box: "this parameter is randomly regenerated"."""
    size, dim = trial.shape
    for i in range(size):
        outside = 0
        for j in range(dim):
            outside += not ((lower[j] <= trial[i, j]) & (trial[i, j] <= upper[j]))
        if outside:
            for j in range(dim):
                if not lower[j] <= trial[i, j] <= upper[j]:
                    trial[i, j] = between(state, lower[j], upper[j])
