"""The steps of particle swarm optimisation as Cong et al. 2008, section 4.2, state them.

The driver calls once a flight, with few arrays, as an array takes 60 ns to be handed over.
"""

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit, part
from calibench.optimizers.base import Array
from calibench.optimizers.own._random_kernels import WHOLE, State, between, half, halves

BEST, STILL, FLIGHT = range(3)  # of `memory`: the row of G_best, flights without an improvement, flights so far


@njit()
def advance(
    room: Array,
    values: Array,
    own_values: Array,
    memory: NDArray[np.int64],
    rules: Array,
    state: State,
) -> None:
    """Record the values of the positions, fly, and let half begin again after NR flights without improvement.

    `room`, shape (7, size, dim), holds position, velocity, P_best, and a row for each particle of G_best, the largest
    velocity and both bounds. `memory`, shape (3,), is brought up to date. `rules` are the options as numbers, as each
    of them would cost as much as all: w first and last, flights that w falls over, C1, C2, R1 and R2 by component,
    stop at the border, any P_best improves, NR, the worst begin again, they move, they forget.
    """
    w_first, w_last, flights, c1, c2, patience = rules[0], rules[1], rules[2], rules[3], rules[4], rules[8]
    by_component, stop_at_border, any_improves = rules[5] != 0.0, rules[6] != 0.0, rules[7] != 0.0
    worst, moving, forgets = rules[9] != 0.0, rules[10] != 0.0, rules[11] != 0.0
    position, velocity, own_best, best_place = room[0], room[1], room[2], room[3]
    improved = False
    if any_improves:
        for i in range(values.shape[0]):
            improved |= values[i] < own_values[i]
    before = own_values[memory[BEST]]
    best = record(position, values, own_best, own_values, memory[BEST])
    if own_values[best] < before:
        for i in range(best_place.shape[0]):
            for j in range(best_place.shape[1]):
                best_place[i, j] = own_best[best, j]
        improved = True
    still = 0 if improved else memory[STILL] + 1
    w = inertia(w_first, w_last, memory[FLIGHT], flights)
    fly(
        position, velocity, own_best, best_place, w, c1, c2, by_component, room[4], stop_at_border, room[5], room[6],
        state,
    )  # fmt: skip
    if still >= patience:
        still, renewed = 0, half(own_values, best, worst, state)
        place(renewed, position, velocity, moving, room[5, 0], room[6, 0], state)
        if forgets:
            for i in renewed:
                own_values[i] = np.inf  # the place it is set to becomes its P_best
    memory[BEST], memory[STILL] = best, still
    memory[FLIGHT] += 1


@njit()
def inertia(first: float, last: float, flight: int, flights: float) -> float:
    """Return w of a flight, 0 .. flights - 1: `first` at the first, `last` at the last, linear between."""
    return first + (last - first) * min(flight / max(flights - 1, 1), 1.0)


@njit()
def fly(
    position: Array,
    velocity: Array,
    own_best: Array,
    best_place: Array,
    w: float,
    c1: float,
    c2: float,
    by_component: bool,
    fastest: Array,
    stop_at_border: bool,
    lower: Array,
    upper: Array,
    state: State,
) -> None:
    """Move all particles, shape (size, dim); who outpaces the border is placed on it.

    `own_best` are P_best. `best_place`, G_best, `fastest`, the largest velocity, `lower` and `upper` have a row for
    each particle too, so that each line below is one long loop over all components: these fill the lanes.
    """
    size, dim = position.shape
    each = dim if by_component else 1
    drawn = halves(state, 2 * size * each)
    r1, r2 = drawn[: size * each], drawn[size * each : 2 * size * each]
    if not by_component:
        r1, r2 = np.repeat(r1, dim), np.repeat(r2, dim)
    _move(
        position.reshape(-1), velocity.reshape(-1), own_best.reshape(-1), best_place.reshape(-1), r1, r2, w, c1, c2,
        fastest.reshape(-1), stop_at_border, lower.reshape(-1), upper.reshape(-1),
    )  # fmt: skip


@part()
def _move(
    x: Array,
    v: Array,
    own: Array,
    best_place: Array,
    r1: NDArray[np.uint32],
    r2: NDArray[np.uint32],
    w: float,
    c1: float,
    c2: float,
    fastest: Array,
    stop_at_border: bool,
    lower: Array,
    upper: Array,
) -> None:
    """Bring velocities and places up to date, eq. (45), with R1 and R2 times 2^32."""
    scale1, scale2 = c1 / WHOLE, c2 / WHOLE
    for k in range(x.shape[0]):
        speed = w * v[k] + scale1 * r1[k] * (own[k] - x[k]) + scale2 * r2[k] * (best_place[k] - x[k])
        speed = min(max(speed, -fastest[k]), fastest[k])
        free = x[k] + speed
        there = min(max(free, lower[k]), upper[k])
        v[k] = speed if (not stop_at_border) | (there == free) else 0.0
        x[k] = there


@njit()
def record(position: Array, values: Array, own_best: Array, own_values: Array, best: int) -> int:
    """Update P_best and its values where a particle beats its own; return the row of G_best, which stays on a tie."""
    for i in range(position.shape[0]):
        if values[i] < own_values[i]:
            own_values[i] = values[i]
            for j in range(position.shape[1]):
                own_best[i, j] = position[i, j]
    for i in range(position.shape[0]):
        if own_values[i] < own_values[best]:
            best = i
    return best


@njit()
def place(
    particles: NDArray[np.int64],
    position: Array,
    velocity: Array,
    moving: bool,
    lower: Array,
    upper: Array,
    state: State,
) -> None:
    """Place these particles anywhere in the box: at rest, or `moving` by at most its width each way."""
    for i in particles:
        for j in range(lower.shape[0]):
            width = upper[j] - lower[j]
            position[i, j] = between(state, lower[j], upper[j])
            velocity[i, j] = between(state, -width, width) if moving else 0.0
