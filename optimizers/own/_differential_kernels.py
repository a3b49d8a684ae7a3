"""The three steps of differential evolution as Cong et al. 2008, section 4.3, state them.

All random numbers of a generation are drawn at once, half a word each. A trial is made in one pass over its row, four
components at a time, and rows with a component outside the box are listed on the way, to be drawn anew afterwards: in a
search that has settled there are none.
"""

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit, part
from calibench.core.compilation.lanes import LANES, cross
from calibench.optimizers.base import Array
from calibench.optimizers.own._random_kernels import WHOLE, State, halves, scaled, singles


def initialize(size: int, lower: Array, upper: Array, state: State) -> Array:
    """Return a uniform random population, shape (size, dim)."""
    drawn = singles(state, size * len(lower)).reshape(size, -1)
    return np.minimum(lower + drawn * (upper - lower), upper)


@njit()
def propose(population: Array, f: float, cr: float, lower: Array, upper: Array, state: State, trial: Array) -> None:
    """Fill `trial`, shape (size, dim), with one trial vector for each member. All are in C order."""
    size, dim = population.shape
    drawn = halves(state, size * (4 + dim))
    others = np.empty((4, size), np.int64)
    listed = others[3]
    _three_others(drawn, others[0], others[1], others[2])
    for i in range(size):
        drawn[4 * size + i * dim + scaled(drawn[3 * size + i], dim)] = 0  # rnbr(i): this one is below any CR
    highest = np.uint32(min(int(cr * WHOLE), WHOLE - 1))  # randb(j) <= CR, both times 2^32
    members, trials = population.reshape(-1), trial.reshape(-1)
    count = _cross(members, others, f, drawn[4 * size :], highest, lower, upper, trials, listed)
    if count:
        _redraw(listed[:count], lower, upper, state, trial)


@njit()
def select(population: Array, values: Array, trial: Array, trial_values: Array) -> None:
    """Keep of each pair the better one, eq. (48); the member stays on a tie."""
    for i in range(population.shape[0]):
        if trial_values[i] < values[i]:
            values[i] = trial_values[i]
            for j in range(population.shape[1]):
                population[i, j] = trial[i, j]


@part()
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


@part()
def _cross(
    members: Array,
    others: NDArray[np.int64],
    f: float,
    chances: NDArray[np.uint32],
    highest: np.uint32,
    lower: Array,
    upper: Array,
    trials: Array,
    listed: NDArray[np.int64],
) -> int:
    """Fill `trials`, flat as `members` and `chances` are; list the rows that leave the box, and return their number.

    A component is the mutant's, eq. (46), where randb(j) <= CR, else the member's, eq. (47).
    """
    dim, count = lower.shape[0], 0
    whole = dim - dim % LANES
    for i in range(listed.shape[0]):
        own, a, b, c, outside = dim * i, dim * others[0, i], dim * others[1, i], dim * others[2, i], 0
        for j in range(0, whole, LANES):
            outside |= cross(
                members, own + j, a + j, b + j, c + j, f, chances, own + j, highest, lower, upper, j, trials
            )  # fmt: skip
        listed[i] = outside
    if whole < dim:
        for i in range(listed.shape[0]):
            own, a, b, c = dim * i, dim * others[0, i], dim * others[1, i], dim * others[2, i]
            for j in range(whole, dim):
                mutant = members[a + j] + f * (members[b + j] - members[c + j])
                value = mutant if chances[own + j] <= highest else members[own + j]
                trials[own + j] = value
                listed[i] |= 0 if (lower[j] <= value) & (value <= upper[j]) else 1
    for i in range(listed.shape[0]):
        outside = listed[i]
        listed[count] = i  # the next one goes here too, unless this one stays: no branch to guess
        count += outside != 0
    return count


@part()
def _redraw(rows: NDArray[np.int64], lower: Array, upper: Array, state: State, trial: Array) -> None:
    """Draw anew the components of these rows that are outside the box: "this parameter is randomly regenerated"."""
    dim = lower.shape[0]
    places = np.empty(rows.shape[0] * dim + 1, dtype=np.int64)
    count = 0
    for i in rows:
        for j in range(dim):
            places[count] = dim * i + j  # as above
            count += 0 if (lower[j] <= trial[i, j]) & (trial[i, j] <= upper[j]) else 1
    drawn, trials = singles(state, count), trial.reshape(-1)
    for k in range(count):
        j = places[k] % dim
        trials[places[k]] = min(lower[j] + drawn[k] * (upper[j] - lower[j]), upper[j])
