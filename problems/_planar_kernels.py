"""The GPM2002's closed-loop error as the power of a radical centre, compiled. Equation numbers: Cong et al. 2008.

A machine is a vector q of 15 numbers,

    xa1 ya1 xa2 ya2 xa3 ya3  la1 la2 la3  lb1 lb2 lb3  z1 z2 z3        (mm, rad)

and a candidate x holds some of them: q = template, then q[free] = x. With `polar` false the slots of l_a and z hold
l_a cos z and l_a sin z, eq. (41), and no trigonometry is left. A sample is the row cos, sin of its three readings.

The end-effector is eliminated by (32)-(33): P is the radical centre of the circles about B_i, and then the three
components of E2, eq. (38), are one number, the power g of P. So J2 = 3 sum g^2, and a leg's error in E1, eq. (36),
is |P - B_i| - l_b = g / (sqrt(g + l_b^2) + l_b), which does not cancel near zero. Coordinates are centred at B_1,
which halves the rounding floor.

`batch` runs candidates in the SIMD lanes, `cost` one candidate; both sum the samples in the same order with the same
operations, so they agree to the last bit.
"""

from __future__ import annotations

import math

import numpy as np

from bedrock.compiled import njit
from problems.base import Array

Q = 15  # numbers that make a machine
_COEFFICIENTS = 16
_LANES = 32  # fewer are unrolled before the vectoriser sees them, more leave the cache
_COST = 3.0  # eq. (39): three equal components of E2 per sample


@njit()
def cost(x: Array, samples: Array, template: Array, free: Array, polar: bool, legs: bool) -> float:
    """Return J1 (`legs`) or J2 = J3 of one candidate x, shape (dim,)."""
    k = np.empty(_COEFFICIENTS)
    _coefficients(x, template, free, polar, k)
    n = samples.shape[0]
    terms = np.empty(n)
    for j in range(n):
        g = _power(
            k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8], k[9], k[10], k[11], k[12],
            samples[j, 0], samples[j, 1], samples[j, 2], samples[j, 3], samples[j, 4], samples[j, 5],
        )  # fmt: skip
        terms[j] = _leg_errors_squared(g, k[10], k[11], k[12], k[13], k[14], k[15]) if legs else g * g
    total = 0.0
    for j in range(n):
        total += terms[j]
    return total if legs else _COST * total


@njit()
def batch(points: Array, samples: Array, template: Array, free: Array, polar: bool, legs: bool) -> Array:
    """Return the costs, shape (k,), of candidates `points`, shape (k, dim): bit for bit those of `cost`."""
    count = points.shape[0]
    values = np.empty(count)
    lanes = np.empty((_COEFFICIENTS, _LANES))
    k = np.empty(_COEFFICIENTS)
    total = np.empty(_LANES)
    for first in range(0, count, _LANES):
        for lane in range(_LANES):  # spare lanes of the last block repeat its last candidate
            _coefficients(points[min(first + lane, count - 1)], template, free, polar, k)
            for i in range(_COEFFICIENTS):
                lanes[i, lane] = k[i]
            total[lane] = 0.0
        if legs:
            _sum_leg_errors(lanes, samples, total)
        else:
            _sum_powers(lanes, samples, total)
        for lane in range(min(_LANES, count - first)):
            values[first + lane] = total[lane] if legs else _COST * total[lane]
    return values


@njit()
def residuals(x: Array, samples: Array, template: Array, free: Array, polar: bool, legs: bool) -> Array:
    """Return the residuals, whose squares sum to the cost: sqrt(3) g_j, shape (n,), or the leg errors, shape (3n,)."""
    k = np.empty(_COEFFICIENTS)
    _coefficients(x, template, free, polar, k)
    n = samples.shape[0]
    r = np.empty(3 * n if legs else n)
    for j in range(n):
        g = _power(
            k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8], k[9], k[10], k[11], k[12],
            samples[j, 0], samples[j, 1], samples[j, 2], samples[j, 3], samples[j, 4], samples[j, 5],
        )  # fmt: skip
        if legs:
            for i in range(3):
                r[3 * j + i] = _leg_error(g, k[10 + i], k[13 + i])
        else:
            r[j] = math.sqrt(_COST) * g
    return r


@njit()
def jacobian(x: Array, samples: Array, template: Array, free: Array, polar: bool, legs: bool) -> Array:
    """Return the derivative of `residuals`, shape (m, dim).

    With barycentric weights w of P in the triangle B (sum w_i = 1, sum w_i (P - B_i) = 0), P drops out:
    dg = sum_i w_i (-2 (P - B_i) . dB_i - 2 l_b dl_b).
    """
    n, dim = samples.shape[0], free.shape[0]
    powers = power_derivatives(x, samples, template, free, polar)
    k = np.empty(_COEFFICIENTS)
    _coefficients(x, template, free, polar, k)
    result = np.empty((3 * n if legs else n, dim))
    for j in range(n):
        if not legs:
            for c in range(dim):
                result[j, c] = math.sqrt(_COST) * powers[j, free[c]]
            continue
        g = _power(
            k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8], k[9], k[10], k[11], k[12],
            samples[j, 0], samples[j, 1], samples[j, 2], samples[j, 3], samples[j, 4], samples[j, 5],
        )  # fmt: skip
        for i in range(3):
            reach = math.sqrt(max(g + k[10 + i], 0.0))  # |P - B_i|
            for c in range(dim):
                own = 1.0 if free[c] == 9 + i else 0.0
                result[3 * j + i, c] = (powers[j, free[c]] + 2.0 * k[13 + i] * own) / (2.0 * reach) - own
    return result


@njit()
def power_derivatives(x: Array, samples: Array, template: Array, free: Array, polar: bool) -> Array:
    """Return dg_j / dq, shape (n, 15), in the coordinates of q (so columns 12-14 are dg / d reading where polar)."""
    k = np.empty(_COEFFICIENTS)
    _coefficients(x, template, free, polar, k)
    n = samples.shape[0]
    result = np.empty((n, Q))
    w = np.empty(3)
    for j in range(n):
        ux, uy, vx, vy, fd, hd, d = _radical_centre(
            k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8], k[9], k[10], k[11], k[12],
            samples[j, 0], samples[j, 1], samples[j, 2], samples[j, 3], samples[j, 4], samples[j, 5],
        )  # fmt: skip
        px, py = fd / d, hd / d
        w[1] = (px * vy - py * vx) / d
        w[2] = (ux * py - uy * px) / d
        w[0] = 1.0 - w[1] - w[2]
        for i in range(3):
            rx = px - (ux if i == 1 else vx if i == 2 else 0.0)  # P - B_i
            ry = py - (uy if i == 1 else vy if i == 2 else 0.0)
            cos_r, sin_r = samples[j, 2 * i], samples[j, 2 * i + 1]
            p, q = k[4 + 2 * i], k[5 + 2 * i]
            result[j, 2 * i] = -2.0 * w[i] * rx
            result[j, 2 * i + 1] = -2.0 * w[i] * ry
            result[j, 9 + i] = -2.0 * w[i] * k[13 + i]
            if polar:
                bx, by = p * cos_r - q * sin_r, p * sin_r + q * cos_r  # B_i - A_i, turned by z
                la = math.sqrt(p * p + q * q)
                result[j, 6 + i] = -2.0 * w[i] * (rx * bx + ry * by) / la
                result[j, 12 + i] = -2.0 * w[i] * (ry * bx - rx * by)
            else:
                result[j, 6 + i] = -2.0 * w[i] * (rx * cos_r + ry * sin_r)
                result[j, 12 + i] = -2.0 * w[i] * (ry * cos_r - rx * sin_r)
    return result


@njit()
def positions(x: Array, samples: Array, template: Array, free: Array, polar: bool) -> Array:
    """Return the end-effector of each sample by eq. (33), shape (n, 2), mm."""
    k = np.empty(_COEFFICIENTS)
    _coefficients(x, template, free, polar, k)
    q = template.copy()
    q[free] = x
    result = np.empty((samples.shape[0], 2))
    for j in range(samples.shape[0]):
        _, _, _, _, fd, hd, d = _radical_centre(
            k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8], k[9], k[10], k[11], k[12],
            samples[j, 0], samples[j, 1], samples[j, 2], samples[j, 3], samples[j, 4], samples[j, 5],
        )  # fmt: skip
        result[j, 0] = q[0] + k[4] * samples[j, 0] - k[5] * samples[j, 1] + fd / d
        result[j, 1] = q[1] + k[4] * samples[j, 1] + k[5] * samples[j, 0] + hd / d
    return result


@njit()
def _coefficients(x: Array, template: Array, free: Array, polar: bool, k: Array) -> None:
    """Fill k with what does not change over the samples: A_2 - A_1, A_3 - A_1, (p, q) of each leg, l_b^2, l_b."""
    q = template.copy()
    for i in range(free.shape[0]):
        q[free[i]] = x[i]
    k[0], k[1] = q[2] - q[0], q[3] - q[1]
    k[2], k[3] = q[4] - q[0], q[5] - q[1]
    for i in range(3):
        if polar:
            k[4 + 2 * i] = q[6 + i] * math.cos(q[12 + i])
            k[5 + 2 * i] = q[6 + i] * math.sin(q[12 + i])
        else:
            k[4 + 2 * i] = q[6 + i]
            k[5 + 2 * i] = q[12 + i]
        k[10 + i] = q[9 + i] * q[9 + i]
        k[13 + i] = q[9 + i]


@njit()
def _sum_powers(lanes: Array, samples: Array, total: Array) -> None:
    for j in range(samples.shape[0]):
        c1, s1, c2, s2, c3, s3 = samples[j]
        for i in range(_LANES):
            g = _power(
                lanes[0, i], lanes[1, i], lanes[2, i], lanes[3, i], lanes[4, i], lanes[5, i], lanes[6, i],
                lanes[7, i], lanes[8, i], lanes[9, i], lanes[10, i], lanes[11, i], lanes[12, i],
                c1, s1, c2, s2, c3, s3,
            )  # fmt: skip
            total[i] += g * g


@njit()
def _sum_leg_errors(lanes: Array, samples: Array, total: Array) -> None:
    for j in range(samples.shape[0]):
        c1, s1, c2, s2, c3, s3 = samples[j]
        for i in range(_LANES):
            g = _power(
                lanes[0, i], lanes[1, i], lanes[2, i], lanes[3, i], lanes[4, i], lanes[5, i], lanes[6, i],
                lanes[7, i], lanes[8, i], lanes[9, i], lanes[10, i], lanes[11, i], lanes[12, i],
                c1, s1, c2, s2, c3, s3,
            )  # fmt: skip
            total[i] += _leg_errors_squared(
                g, lanes[10, i], lanes[11, i], lanes[12, i], lanes[13, i], lanes[14, i], lanes[15, i]
            )


@njit()
def _power(
    ax2: float, ay2: float, ax3: float, ay3: float,
    p1: float, q1: float, p2: float, q2: float, p3: float, q3: float, r1: float, r2: float, r3: float,
    c1: float, s1: float, c2: float, s2: float, c3: float, s3: float,
) -> float:  # fmt: skip
    """Return the power g of the radical centre, mm^2: each component of E2, eq. (38), with (x, y) from (33)."""
    _, _, _, _, fd, hd, d = _radical_centre(
        ax2, ay2, ax3, ay3, p1, q1, p2, q2, p3, q3, r1, r2, r3, c1, s1, c2, s2, c3, s3
    )
    return (fd * fd + hd * hd) / (d * d) - r1


@njit()
def _radical_centre(
    ax2: float, ay2: float, ax3: float, ay3: float,
    p1: float, q1: float, p2: float, q2: float, p3: float, q3: float, r1: float, r2: float, r3: float,
    c1: float, s1: float, c2: float, s2: float, c3: float, s3: float,
) -> tuple[float, float, float, float, float, float, float]:  # fmt: skip
    """Return u = B_2 - B_1, v = B_3 - B_1, and the radical centre relative to B_1 as numerators over d = u x v."""
    bx1, by1 = p1 * c1 - q1 * s1, p1 * s1 + q1 * c1  # eq. (30) with (41), less A_1
    ux, uy = (ax2 + (p2 * c2 - q2 * s2)) - bx1, (ay2 + (p2 * s2 + q2 * c2)) - by1
    vx, vy = (ax3 + (p3 * c3 - q3 * s3)) - bx1, (ay3 + (p3 * s3 + q3 * c3)) - by1
    f = 0.5 * ((ux * ux + uy * uy) + (r1 - r2))  # eq. (32), d_i with the squares lost in print, about B_1
    h = 0.5 * ((vx * vx + vy * vy) + (r1 - r3))
    d = ux * vy - uy * vx
    return ux, uy, vx, vy, f * vy - h * uy, h * ux - f * vx, d  # eq. (33)


@njit()
def _leg_error(g: float, r: float, lb: float) -> float:
    return g / (math.sqrt(max(g + r, 0.0)) + lb)


@njit()
def _leg_errors_squared(g: float, r1: float, r2: float, r3: float, lb1: float, lb2: float, lb3: float) -> float:
    e1, e2, e3 = _leg_error(g, r1, lb1), _leg_error(g, r2, lb2), _leg_error(g, r3, lb3)
    return (e1 * e1 + e2 * e2) + e3 * e3  # eq. (37)
