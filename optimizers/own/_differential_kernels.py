"""The three steps of differential evolution as Cong et al. 2008, section 4.3, state them: rand/1/bin.

All random numbers of a generation are drawn at once, half a word each, and no branch depends on one: what is outside
the box is listed first and then drawn anew. The loop's driver calls once a generation, with few arrays, as an array
takes 60 ns to be handed over.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit
from calibench.core.compilation.lanes import LANES, combine
from calibench.optimizers.base import Array
from calibench.optimizers.own._random_kernels import WHOLE, State, between, halves, scaled, singles

_ROWS = 16  # of the population are bred at a time: what they need besides stays in the innermost cache


@njit()
def initialize(size: int, lower: Array, upper: Array, state: State) -> Array:
    """Return a uniform random population, shape (size, dim)."""
    population = np.empty((size, lower.shape[0]))
    for i in range(size):
        for j in range(lower.shape[0]):
            population[i, j] = between(state, lower[j], upper[j])
    return population


@njit()
def advance(room: Array, values: Array, trial_values: Array, f: float, cr: float, state: State) -> None:
    """Select between the members and their trials, and propose the next trials.

    `room`, shape (4, size, dim), holds the population, the trials, and both bounds in all rows.
    """
    population, trial = room[0], room[1]
    select(population, values, trial, trial_values)
    propose(population, f, cr, room[2], room[3], state, trial)


@njit()
def propose(population: Array, f: float, cr: float, lower: Array, upper: Array, state: State, trial: Array) -> None:
    """Fill `trial`, shape (size, dim), with one trial vector for each member. All are in C order.

    The bounds, shape (min(16, size), dim) or more, are the same in all rows: each check is a loop over many components.
    """
    size, dim = population.shape
    drawn = halves(state, size * (4 + dim))
    r1, r2, r3 = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size, np.int64)
    _three_others(drawn, r1, r2, r3)
    for i in range(size):
        drawn[4 * size + i * dim + scaled(drawn[3 * size + i], dim)] = 0  # rnbr(i): this one is below any CR
    highest = np.uint32(min(int(cr * WHOLE), WHOLE - 1))  # randb(j) <= CR, both times 2^32
    members, trials, low, high = population.reshape(-1), trial.reshape(-1), lower.reshape(-1), upper.reshape(-1)
    mutants, outside = np.empty(_ROWS * dim), np.empty(_ROWS * dim, dtype=np.uint8)  # 16 rows: a multiple of 8 bytes
    eights = outside.view(np.uint64)
    for first in range(0, size, _ROWS):
        last = min(first + _ROWS, size)
        _mutate(members, r1, r2, r3, first, last, dim, f, mutants)
        for k in range(eights.shape[0]):
            eights[k] = 0
        _cross(members, mutants, drawn, 4 * size, highest, low, high, trials, first * dim, last * dim, outside)
        if eights.any():
            _redraw(outside, low, high, state, trials, first * dim)


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
def _mutate(
    members: Array,
    r1: NDArray[np.int64],
    r2: NDArray[np.int64],
    r3: NDArray[np.int64],
    first: int,
    last: int,
    dim: int,
    f: float,
    mutants: Array,
) -> None:
    """Fill `mutants` with those of rows `first` to `last`, flat as `members` are, by eq. (46)."""
    whole = dim - dim % LANES
    for i in range(first, last):
        a, b, c, at = dim * r1[i], dim * r2[i], dim * r3[i], dim * (i - first)
        for j in range(0, whole, LANES):
            combine(members, a + j, b + j, c + j, f, mutants, at + j)
        for j in range(whole, dim):
            mutants[at + j] = members[a + j] + f * (members[b + j] - members[c + j])


@njit()
def _cross(
    members: Array,
    mutants: Array,
    drawn: NDArray[np.uint32],
    skipped: int,
    highest: np.uint32,
    lower: Array,
    upper: Array,
    trial: Array,
    first: int,
    last: int,
    outside: NDArray[np.uint8],
) -> None:
    """Take of each pair of components the mutant's where randb(j) <= CR, eq. (47), and tell which are `outside`.

    Components `first` to `last`; of `drawn` so many are `skipped`. One loop over many fills the lanes: so both sides
    are read before one is chosen, and an index is told to be no negative one, as Python would count that from the end.
    """
    for k in range(last - first):
        at = np.uint64(first + k)
        mutant, member, low, high = mutants[k], members[at], lower[k], upper[k]
        value = mutant if drawn[np.uint64(skipped + first + k)] <= highest else member
        trial[at] = value
        outside[k] = 0 if (low <= value) & (value <= high) else 1


@njit()
def _redraw(outside: NDArray[np.uint8], lower: Array, upper: Array, state: State, trial: Array, first: int) -> None:
    """Draw anew the components from `first` on that are outside the box: "this parameter is randomly regenerated"."""
    places = np.empty(outside.shape[0] + 1, dtype=np.int64)
    count = 0
    for k in range(outside.shape[0]):
        places[count] = k  # the next one goes here too, unless this one stays: no branch to guess
        count += outside[k]
    drawn = singles(state, count)
    for i in range(count):
        k = places[i]
        trial[first + k] = min(lower[k] + drawn[i] * (upper[k] - lower[k]), upper[k])
