"""The leg parallelism of an Orthoglide, compiled. Equation numbers: Pashkevich et al. 2008.

`full`, shape (6,), are the errors drho_x drho_y drho_z dL_x dL_y dL_z, mm, of the machine; a candidate x holds those at
the indices `free`, the rest is zero. `joints`, shape (k, 3), mm, are the commanded joints of the postures: row 0 is the
Zero posture. A reading is a row of `rows`, shape (m, 4): leg, direction, posture, posture it is compared with. The
gauge stands at the share `gauge` of the leg from the joint centre (0) to the tool centre point (1), where the leg is at
the Zero posture, and its plane across the leg is kept. With `linear` the residuals are `offset + slope x` instead.
Where the machine cannot be closed all is NaN.
"""

import math

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit, part
from calibench.problems.base import Array

Index = NDArray[np.int64]


@njit()
def cost(
    x: Array, free: Index, length: float, joints: Array, rows: Index, gauge: Array, measured: Array,
    linear: bool, offset: Array, slope: Array,
) -> float:  # fmt: skip
    """Return the sum of squared residuals [mm^2] of one candidate x, shape (dim,)."""
    r, full, places = np.empty(measured.size), np.zeros(6), np.empty(joints.shape)
    return _fill(x, free, length, joints, rows, gauge, measured, linear, offset, slope, full, places, r)


@njit()
def batch(
    many: Array, free: Index, length: float, joints: Array, rows: Index, gauge: Array, measured: Array,
    linear: bool, offset: Array, slope: Array,
) -> Array:  # fmt: skip
    """Return the sums of squares, shape (n,), of candidates `many`, shape (n, dim): bit for bit those of `cost`."""
    values = np.empty(many.shape[0])
    r, full, places = np.empty(measured.size), np.zeros(6), np.empty(joints.shape)
    for c in range(many.shape[0]):
        values[c] = _fill(many[c], free, length, joints, rows, gauge, measured, linear, offset, slope, full, places, r)
    return values


@njit()
def residuals(
    x: Array, free: Index, length: float, joints: Array, rows: Index, gauge: Array, measured: Array,
    linear: bool, offset: Array, slope: Array,
) -> Array:  # fmt: skip
    """Return modelled minus measured deviations [mm], shape (m,)."""
    r, full, places = np.empty(measured.size), np.zeros(6), np.empty(joints.shape)
    _fill(x, free, length, joints, rows, gauge, measured, linear, offset, slope, full, places, r)
    return r


@njit()
def jacobian(
    x: Array, free: Index, length: float, joints: Array, rows: Index, gauge: Array, measured: Array,
    linear: bool, offset: Array, slope: Array,
) -> Array:  # fmt: skip
    """Return the derivative of `residuals`, shape (m, dim)."""
    m, dim = measured.size, free.size
    result = np.empty((m, dim))
    if linear:
        for k in range(m):
            for c in range(dim):
                result[k, c] = slope[k, c]
        return result
    full = np.zeros(6)
    for c in range(dim):
        full[free[c]] = x[c]
    places, slopes = np.empty(joints.shape), np.empty((joints.shape[0], 3, 6))
    _places(full, length, joints, places)
    for k in range(joints.shape[0]):
        for a in range(3):
            for b in range(3):
                inverse = _inverse(full, joints, places, k, a, b)
                slopes[k, a, b] = inverse * (places[k, b] - joints[k, b] - full[b])  # eq. (5), J_rho
                slopes[k, a, 3 + b] = inverse * (length + full[3 + b])  # eq. (5), J_L
    for k in range(m):
        for c in range(dim):
            after = _height_slope(full, joints, places, slopes, rows[k, 0], rows[k, 1], rows[k, 2], gauge[k], free[c])
            before = _height_slope(full, joints, places, slopes, rows[k, 0], rows[k, 1], rows[k, 3], gauge[k], free[c])
            result[k, c] = after - before
    return result


@njit()
def direct(joints: Array, full: Array, length: float) -> Array:
    """Return the tool centre points, shape (k, 3), mm, at the joints, shape (k, 3)."""
    places = np.empty(joints.shape)
    _places(full, length, joints, places)
    return places


@part()
def _fill(
    x: Array, free: Index, length: float, joints: Array, rows: Index, gauge: Array, measured: Array,
    linear: bool, offset: Array, slope: Array, full: Array, places: Array, r: Array,
) -> float:  # fmt: skip
    """Write the residuals of x to `r` and return the sum of their squares; `full` and `places` are room to work."""
    for c in range(free.size):
        full[free[c]] = x[c]
    if not linear:
        _places(full, length, joints, places)
    total = 0.0
    for k in range(measured.size):
        if linear:
            value = offset[k]
            for c in range(free.size):
                value += slope[k, c] * x[c]
        else:
            leg, direction = rows[k, 0], rows[k, 1]
            value = _height(full, joints, places, leg, direction, rows[k, 2], gauge[k])
            value -= _height(full, joints, places, leg, direction, rows[k, 3], gauge[k])
            value -= measured[k]
        r[k] = value
        total += value * value
    return total


@part()
def _height(full: Array, joints: Array, places: Array, leg: int, direction: int, posture: int, gauge: float) -> float:
    """Return where the leg's line stands along `direction` in the plane of the gauge, mm, section 3.2."""
    height: float = _share(full, joints, places, leg, posture, gauge) * places[posture, direction]
    return height  # s = mu p + (1 - mu) r, and r is on the leg's own axis


@part()
def _share(full: Array, joints: Array, places: Array, leg: int, posture: int, gauge: float) -> float:
    """Return mu, the share of the leg at which it meets the gauge's plane."""
    if posture == 0:
        return gauge
    plane = gauge * places[0, leg] + (1.0 - gauge) * (joints[0, leg] + full[leg])  # eq. (10) for a gauge at one half
    centre = joints[posture, leg] + full[leg]
    share: float = (plane - centre) / (places[posture, leg] - centre)
    return share


@part()
def _height_slope(
    full: Array, joints: Array, places: Array, slopes: Array, leg: int, direction: int, posture: int, gauge: float,
    parameter: int,
) -> float:  # fmt: skip
    """Return the derivative of `_height` in one of the six errors."""
    share = _share(full, joints, places, leg, posture, gauge)
    moved = 1.0 if parameter == leg else 0.0  # the joint centre moves with its own offset only
    slope: float = share * slopes[posture, direction, parameter]
    if posture == 0:
        return slope
    plane = gauge * slopes[0, leg, parameter] + (1.0 - gauge) * moved
    span = places[posture, leg] - joints[posture, leg] - full[leg]
    turn: float = (plane - moved - share * (slopes[posture, leg, parameter] - moved)) / span
    slope += turn * places[posture, direction]
    return slope


@part()
def _places(full: Array, length: float, joints: Array, places: Array) -> None:
    """Write the tool centre points of all postures to `places`, eq. (4) with the root that closes the Zero posture.

    The printed root (-B + sqrt(...)) / 2A belongs to the other assembly; -B is above 0 here, so 2C / (-B + sqrt(...))
    is the right one without cancellation.
    """
    for k in range(joints.shape[0]):
        rx, ry, rz = joints[k, 0] + full[0], joints[k, 1] + full[1], joints[k, 2] + full[2]
        lx, ly, lz = length + full[3], length + full[4], length + full[5]
        qx, qy, qz = rx * rx, ry * ry, rz * rz
        mx, my, mz = lx * lx, ly * ly, lz * lz
        a = qx * qy + qy * qz + qx * qz
        b = qx * qy * qz - mx * qy * qz - my * qx * qz - mz * qx * qy
        c = qx * qy * qz * ((qx + qy + qz) / 4 - (mx + my + mz) / 2)
        c += (mx * mx * qy * qz + my * my * qx * qz + mz * mz * qx * qy) / 4
        inside = b * b - 4 * a * c
        t = 2 * c / (-b + math.sqrt(inside)) if inside >= 0 else math.nan
        places[k, 0] = rx / 2 + t / rx - mx / (2 * rx)  # eq. (4)
        places[k, 1] = ry / 2 + t / ry - my / (2 * ry)
        places[k, 2] = rz / 2 + t / rz - mz / (2 * rz)


@part()
def _inverse(full: Array, joints: Array, places: Array, k: int, a: int, b: int) -> float:
    """Return an entry of M^-1, where M has the rows p - r_i, the left-hand side of the relations before eq. (5).

    M is a vector product minus a diagonal, 1 p^T - diag(r), so Sherman and Morrison's formula inverts it.
    """
    rest = 1.0
    for i in range(3):
        rest -= places[k, i] / (joints[k, i] + full[i])
    ra, rb = joints[k, a] + full[a], joints[k, b] + full[b]
    value: float = -places[k, b] / (ra * rb * rest)
    if a == b:
        value -= 1.0 / ra
    return value
