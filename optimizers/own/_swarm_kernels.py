"""The steps of particle swarm optimisation as Cong et al. 2008, section 4.2, state them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit
from calibench.optimizers.base import Array
from calibench.optimizers.own._random_kernels import WHOLE, State, between, halves


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
    x, v = position.reshape(-1), velocity.reshape(-1)
    _accelerate(x, v, own_best.reshape(-1), best_place.reshape(-1), r1, r2, w, c1, c2, fastest.reshape(-1))
    _step(x, v, stop_at_border, lower.reshape(-1), upper.reshape(-1))


@njit()
def _accelerate(
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
) -> None:
    """Bring the velocities up to date, eq. (45), with R1 and R2 times 2^32."""
    scale1, scale2 = c1 / WHOLE, c2 / WHOLE
    for k in range(x.shape[0]):
        v[k] = w * v[k] + scale1 * r1[k] * (own[k] - x[k]) + scale2 * r2[k] * (best_place[k] - x[k])
    for k in range(x.shape[0]):
        v[k] = min(max(v[k], -fastest[k]), fastest[k])


@njit()
def _step(x: Array, v: Array, stop_at_border: bool, lower: Array, upper: Array) -> None:
    """Move by the velocities, eq. (45), and place on the border who is beyond it."""
    if not stop_at_border:
        for k in range(x.shape[0]):
            x[k] = min(max(x[k] + v[k], lower[k]), upper[k])
        return
    for k in range(x.shape[0]):
        free = x[k] + v[k]
        x[k] = min(max(free, lower[k]), upper[k])
        v[k] = v[k] if x[k] == free else 0.0


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
