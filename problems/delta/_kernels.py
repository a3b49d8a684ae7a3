"""Heights and distances of a linear delta, compiled.

A candidate x, shape (9,), holds what is wrong with the nominal machine: endstops a b c, radius [mm], angles of towers a
and b [rad], rods a b c [mm]. `nominal` is (radius, rod, height of the carriages at their endstops), mm, `angles`, (3,),
those of the towers. `first` and `second`, (m, 3), are the carriages' travels down from there, mm. A row is a height of
the nozzle where `between` is 0, else the distance of its two places; each is multiplied with its `weight`.

The nozzle p has (p - C_i)^2 = L_i^2 about the carriages C_i. With differentials that is three linear equations,
(p - C_i) . (dp - dC_i) = L_i dL_i, from which the Jacobian follows. Where no nozzle hangs all is NaN.
"""

import math

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit, part
from calibench.problems.base import Array

Index = NDArray[np.int64]
FREE = 9


@njit()
def cost(
    x: Array, nominal: Array, angles: Array, first: Array, second: Array, between: Index, weight: Array, measured: Array
) -> float:
    """Return the sum of squared residuals [mm^2] of one candidate x, shape (9,)."""
    r = np.empty(measured.size)
    return _fill(x, nominal, angles, first, second, between, weight, measured, r, np.empty((3, 4)), np.empty((2, 3)))


@njit()
def batch(
    many: Array, nominal: Array, angles: Array, first: Array, second: Array, between: Index, weight: Array,
    measured: Array,
) -> Array:  # fmt: skip
    """Return the sums of squares, shape (k,), of candidates `many`, shape (k, 9): bit for bit those of `cost`."""
    values, r = np.empty(many.shape[0]), np.empty(measured.size)
    towers, ends = np.empty((3, 4)), np.empty((2, 3))
    for c in range(many.shape[0]):
        values[c] = _fill(many[c], nominal, angles, first, second, between, weight, measured, r, towers, ends)
    return values


@njit()
def residuals(
    x: Array, nominal: Array, angles: Array, first: Array, second: Array, between: Index, weight: Array, measured: Array
) -> Array:
    """Return weighted modelled minus measured heights and distances [mm], shape (m,)."""
    r = np.empty(measured.size)
    _fill(x, nominal, angles, first, second, between, weight, measured, r, np.empty((3, 4)), np.empty((2, 3)))
    return r


@njit()
def jacobian(
    x: Array, nominal: Array, angles: Array, first: Array, second: Array, between: Index, weight: Array, measured: Array
) -> Array:
    """Return the derivative of `residuals`, shape (m, 9)."""
    m = measured.size
    result, towers, ends = np.empty((m, FREE)), np.empty((3, 4)), np.empty((2, 3))
    moved = np.empty((2, 3, FREE))
    _towers(x, nominal, angles, towers)
    for k in range(m):
        _nozzle(towers, first, k, ends[0])
        _moves(towers, first, k, ends[0], moved[0])
        if between[k] == 0:
            for j in range(FREE):
                result[k, j] = weight[k] * moved[0, 2, j]
            continue
        _nozzle(towers, second, k, ends[1])
        _moves(towers, second, k, ends[1], moved[1])
        apart = _apart(ends)
        for j in range(FREE):
            along = 0.0
            for a in range(3):
                along += (ends[1, a] - ends[0, a]) * (moved[1, a, j] - moved[0, a, j])
            result[k, j] = weight[k] * along / apart
    return result


@part()
def _fill(
    x: Array, nominal: Array, angles: Array, first: Array, second: Array, between: Index, weight: Array,
    measured: Array, r: Array, towers: Array, ends: Array,
) -> float:  # fmt: skip
    """Write the residuals to r and return the sum of their squares."""
    _towers(x, nominal, angles, towers)
    total = 0.0
    for k in range(measured.size):
        _nozzle(towers, first, k, ends[0])
        if between[k] == 0:
            model = ends[0, 2]
        else:
            _nozzle(towers, second, k, ends[1])
            model = _apart(ends)
        r[k] = weight[k] * (model - measured[k])
        total += r[k] * r[k]
    return total


@njit()
def _towers(x: Array, nominal: Array, angles: Array, towers: Array) -> None:
    """Write x, y, height at the endstop, and rod of each tower to `towers`, shape (3, 4), mm."""
    out = nominal[0] + x[3]
    for i in range(3):
        angle = angles[i] + (x[4 + i] if i < 2 else 0.0)  # tower c keeps its angle: all three together turn the printer
        towers[i, 0], towers[i, 1] = out * math.cos(angle), out * math.sin(angle)
        towers[i, 2], towers[i, 3] = nominal[2] + x[i], nominal[1] + x[6 + i]


@njit()
def _nozzle(towers: Array, travel: Array, k: int, p: Array) -> None:
    """Write the lower point where the three spheres of row k meet to p, shape (3,)."""
    h0 = towers[0, 2] - travel[k, 0]
    ax, ay = towers[1, 0] - towers[0, 0], towers[1, 1] - towers[0, 1]
    bx, by = towers[2, 0] - towers[0, 0], towers[2, 1] - towers[0, 1]
    ah, bh = towers[1, 2] - travel[k, 1] - h0, towers[2, 2] - travel[k, 2] - h0
    own = towers[0, 3] * towers[0, 3]
    ar = (ax * ax + ay * ay + ah * ah + own - towers[1, 3] * towers[1, 3]) / 2
    br = (bx * bx + by * by + bh * bh + own - towers[2, 3] * towers[2, 3]) / 2
    area = ax * by - ay * bx
    u0, u1 = (ar * by - ay * br) / area, (ah * by - ay * bh) / area  # from carriage a: x = u0 - u1 z, y = v0 - v1 z
    v0, v1 = (ax * br - ar * bx) / area, (ax * bh - ah * bx) / area
    a, b, c = 1 + u1 * u1 + v1 * v1, u0 * u1 + v0 * v1, u0 * u0 + v0 * v0 - own
    inside = b * b - a * c
    z = (b - math.sqrt(inside)) / a if inside >= 0 else math.nan
    p[0], p[1], p[2] = towers[0, 0] + u0 - u1 * z, towers[0, 1] + v0 - v1 * z, h0 + z


@part()
def _moves(towers: Array, travel: Array, k: int, p: Array, moved: Array) -> None:
    """Write dp/dx of row k to `moved`, shape (3, 9): M dp = b, M with the rows p - C_i, by cofactors."""
    M = np.empty((3, 3))
    for i in range(3):
        M[i, 0], M[i, 1] = p[0] - towers[i, 0], p[1] - towers[i, 1]
        M[i, 2] = p[2] - (towers[i, 2] - travel[k, i])
    det = (
        M[0, 0] * (M[1, 1] * M[2, 2] - M[1, 2] * M[2, 1])
        - M[0, 1] * (M[1, 0] * M[2, 2] - M[1, 2] * M[2, 0])
        + M[0, 2] * (M[1, 0] * M[2, 1] - M[1, 1] * M[2, 0])
    )
    for a in range(3):
        for j in range(FREE):
            moved[a, j] = 0.0
        for i in range(3):
            u, v, s, t = (i + 1) % 3, (i + 2) % 3, (a + 1) % 3, (a + 2) % 3
            inverse = (M[u, s] * M[v, t] - M[u, t] * M[v, s]) / det  # of M, at (a, i): cyclic, so its sign is right
            out = math.hypot(towers[i, 0], towers[i, 1])
            moved[a, i] += inverse * M[i, 2]
            moved[a, 3] += inverse * (M[i, 0] * towers[i, 0] + M[i, 1] * towers[i, 1]) / out
            if i < 2:
                moved[a, 4 + i] += inverse * (M[i, 1] * towers[i, 0] - M[i, 0] * towers[i, 1])
            moved[a, 6 + i] += inverse * towers[i, 3]


@part()
def _apart(ends: Array) -> float:
    """Return the distance of two places, shape (2, 3)."""
    dx, dy, dz = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1], ends[1, 2] - ends[0, 2]
    apart: float = math.sqrt(dx * dx + dy * dy + dz * dz)
    return apart
