"""The steps of particle swarm optimisation as Cong et al. 2008, section 4.2, state them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bedrock.compiled import njit
from optimizers._random_kernels import State, between, uniform
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
    for i in range(size):
        r1, r2 = 0.0, 0.0
        if not by_component:
            r1, r2 = uniform(state), uniform(state)
        for j in range(dim):
            if by_component:
                r1, r2 = uniform(state), uniform(state)
            x = position[i, j]
            v = w * velocity[i, j] + c1 * r1 * (own_best[i, j] - x) + c2 * r2 * (own_best[best, j] - x)  # eq. (45)
            v = min(max(v, -fastest[j]), fastest[j])
            x = x + v  # eq. (45)
            if not lower[j] <= x <= upper[j]:
                x = min(max(x, lower[j]), upper[j])
                if stop_at_border:
                    v = 0.0
            position[i, j], velocity[i, j] = x, v


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
