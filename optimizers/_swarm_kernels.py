"""The steps of particle swarm optimisation as Cong et al. 2008, section 4.2, state them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bedrock.compiled import njit
from optimizers._random_kernels import WHOLE, State, between, halves
from optimizers.base import Array


@njit()
def fly(
    position: Array,
    velocity: Array,
    own_best: Array,
    best: int,
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

    `own_best` are P_best, and its row `best` is G_best. `fastest`, shape (dim,), is the largest velocity.
    """
    size, dim = position.shape
    columns = dim if by_component else 1
    drawn = halves(state, 2 * size * columns)
    r1 = drawn[: size * columns].reshape(size, columns)  # R1 and R2, times 2^32
    r2 = drawn[size * columns : 2 * size * columns].reshape(size, columns)
    scale1, scale2 = c1 / WHOLE, c2 / WHOLE
    everywhere, free = own_best[best].copy(), np.empty(dim)
    for i in range(size):  # short loops that write one array each: the vectoriser takes no others
        for j in range(dim):
            column = j if by_component else 0
            x = position[i, j]
            velocity[i, j] = (
                w * velocity[i, j]
                + scale1 * r1[i, column] * (own_best[i, j] - x)
                + scale2 * r2[i, column] * (everywhere[j] - x)
            )  # eq. (45)
        for j in range(dim):
            velocity[i, j] = min(max(velocity[i, j], -fastest[j]), fastest[j])
        for j in range(dim):
            free[j] = position[i, j] + velocity[i, j]  # eq. (45)
        for j in range(dim):
            position[i, j] = min(max(free[j], lower[j]), upper[j])
        if stop_at_border:
            for j in range(dim):
                if position[i, j] != free[j]:
                    velocity[i, j] = 0.0


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
