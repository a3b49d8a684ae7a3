"""The GPM2002's closed-loop error as the power of a radical centre, compiled. Equation numbers: Cong et al. 2008.

A machine is a vector q of 15 numbers,

    xa1 ya1 xa2 ya2 xa3 ya3  la1 la2 la3  lb1 lb2 lb3  z1 z2 z3        (mm, rad)

and a candidate x holds some of them: q = template, then q[free] = x. With `polar` false the slots of l_a and z hold
l_a cos z and l_a sin z, eq. (41), and no trigonometry is left. All that is fixed comes in one flat array, `packed`, as
each further array costs a call from Python 60 ns.

The end-effector is eliminated by (32)-(33): P is the radical centre of the circles about B_i, and then the three
components of E2, eq. (38), are one number, the power g of P. So J2 = 3 sum g^2, and a leg's error in E1, eq. (36),
is |P - B_i| - l_b = g / (sqrt(g + l_b^2) + l_b), which does not cancel near zero. Coordinates are centred at B_1, and
g is kept as a fraction w / d^2: that leaves one division a sample, and the least rounding.

`batch` runs candidates in the SIMD lanes, `cost` the samples of one candidate; both add the samples in the same order
with the same operations, so they agree to the last bit.

Early abandonment: a candidate is given up as soon as its partial sum is above its limit.

A term is never negative and rounding is monotone, so the cost over the first samples is a lower bound of the cost over
all, to the last bit. In a search of de that has settled the first four samples, one for each running sum of `batch`,
give up nine candidates in ten; looking again later, sample by sample or in stages, saved less than it took.
"""

import math

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit, part
from calibench.core.compilation.lanes import FAR, cos_sin, fma, near_cos_sin
from calibench.problems.base import Array

Q = 15  # numbers that make a machine
_COEFFICIENTS = 16
_LANES = 64  # fewer set up too often, more leave the cache
_WIDTH = 8  # the widest vector's: loops run over multiples of it
_SUMS = 4  # samples are added by turns into so many sums, as one sum has to wait for itself
_COST = 3.0  # eq. (39): three equal components of E2 per sample
_TEMPLATE, _FREE = 4, 4 + Q  # where these begin in row 0 of `packed`


def pack(readings: Array, template: Array, free: NDArray[np.int64], polar: bool, legs: bool) -> Array:
    """Return what the kernels need besides x as one array: sizes, choices, template, free, cos and sin of readings.

    `readings` has shape (n, 3), rad. Row 0 holds the first four; the six rows of cos and sin are filled up, to whole
    vectors and to the length of row 0, with the last sample.
    """
    head = np.concatenate([[len(readings), len(free), polar, legs], template, free])
    whole = np.pad(readings, ((0, max(len(head) - len(readings), 0)), (0, 0)), mode="edge")
    whole = np.pad(whole, ((0, -len(whole) % _WIDTH), (0, 0)), mode="edge")
    packed = np.zeros((7, len(whole)))
    packed[0, : len(head)] = head
    packed[1::2], packed[2::2] = np.cos(whole.T), np.sin(whole.T)
    packed.flags.writeable = False
    return packed


@njit()
def cost(x: Array, packed: Array) -> float:
    """Return J1 (`legs`) or J2 = J3 of one candidate x, shape (dim,)."""
    legs = packed[0, 3] != 0.0
    samples, k = packed[1:], _one(x, packed)
    n = int(packed[0, 0])
    terms = np.empty((n + _WIDTH - 1) // _WIDTH * _WIDTH)
    if legs:
        lb1, lb2, lb3 = k[13, 0], k[14, 0], k[15, 0]
        for j in range(terms.size):
            w, d = _power_of(k, samples, j)
            terms[j] = _leg_errors_squared(w, d, lb1, lb2, lb3)
    else:
        for j in range(terms.size):
            w, d = _power_of(k, samples, j)
            terms[j] = w / (d * d)
    for j in range(n, terms.size):
        terms[j] = 0.0
    t0, t1, t2, t3 = 0.0, 0.0, 0.0, 0.0
    for j in range(0, terms.size, _SUMS):
        a, b, c, d = terms[j], terms[j + 1], terms[j + 2], terms[j + 3]
        if legs:
            t0, t1, t2, t3 = t0 + a, t1 + b, t2 + c, t3 + d
        else:
            t0, t1, t2, t3 = fma(a, a, t0), fma(b, b, t1), fma(c, c, t2), fma(d, d, t3)
    total = (t0 + t1) + (t2 + t3)
    return total if legs else _COST * total


@njit()
def batch(points: Array, packed: Array) -> Array:
    """Return the costs, shape (k,), of candidates `points`, shape (k, dim): bit for bit those of `cost`."""
    count, dim, n, legs = points.shape[0], int(packed[0, 1]), int(packed[0, 0]), packed[0, 3] != 0.0
    if points.shape[1] != dim:
        raise ValueError("points have another dimension than the problem")
    samples = packed[1:]
    values = np.empty(count)
    room = _aligned(Q + _COEFFICIENTS + _SUMS, _LANES)
    q, k, total = room[:Q], room[Q : Q + _COEFFICIENTS], room[Q + _COEFFICIENTS :]
    _fill(q, packed)
    for first in range(0, count, _LANES):
        live = min(_LANES, count - first)
        lanes = (live + _WIDTH - 1) // _WIDTH * _WIDTH  # the spare ones hold a machine of an earlier block, or template
        block, out = points[first : first + live], values[first : first + live]  # an index first + lane fills no lanes
        for c in range(dim):
            slot = int(packed[0, _FREE + c])
            for lane in range(live):
                q[slot, lane] = block[lane, c]
        _coefficients(q, packed, k, lanes)
        for turn in range(_SUMS):
            for lane in range(_LANES):
                total[turn, lane] = 0.0
        for turn in range(_SUMS):
            if legs:
                _sum_leg_errors(k, samples, turn, n, total[turn], lanes)
            else:
                _sum_powers(k, samples, turn, n, total[turn], lanes)
        for lane in range(live):
            value = (total[0, lane] + total[1, lane]) + (total[2, lane] + total[3, lane])
            out[lane] = value if legs else _COST * value
    return values


@njit()
def residuals(x: Array, packed: Array) -> Array:
    """Return the residuals, whose squares sum to the cost: sqrt(3) g_j, shape (n,), or the leg errors, shape (3n,)."""
    n, legs = int(packed[0, 0]), packed[0, 3] != 0.0
    samples, k = packed[1:], _one(x, packed)
    r = np.empty(3 * n if legs else n)
    for j in range(n):
        w, d = _power_of(k, samples, j)
        if legs:
            for i in range(3):
                r[3 * j + i] = w / (abs(d) * _reach_and_link(w, d, k[13 + i, 0]))
        else:
            r[j] = math.sqrt(_COST) * (w / (d * d))
    return r


@njit()
def jacobian(x: Array, packed: Array) -> Array:
    """Return the derivative of `residuals`, shape (m, dim).

    With barycentric weights b of P in the triangle B (sum b_i = 1, sum b_i (P - B_i) = 0), P drops out:
    dg = sum_i b_i (-2 (P - B_i) . dB_i - 2 l_b dl_b).
    """
    n, dim, legs = int(packed[0, 0]), int(packed[0, 1]), packed[0, 3] != 0.0
    samples, k = packed[1:], _one(x, packed)
    powers = np.empty(Q)
    result = np.empty((3 * n if legs else n, dim))
    for j in range(n):
        _power_slopes(k, samples, j, packed[0, 2] != 0.0, powers)
        if not legs:
            for c in range(dim):
                result[j, c] = math.sqrt(_COST) * powers[int(packed[0, _FREE + c])]
            continue
        w, d = _power_of(k, samples, j)
        g = w / (d * d)
        for i in range(3):
            half = 0.5 / math.sqrt(_positive(fma(k[13 + i, 0], k[13 + i, 0], g)))  # 1 / (2 |P - B_i|)
            for c in range(dim):
                slot = int(packed[0, _FREE + c])
                own = 1.0 if slot == 9 + i else 0.0
                result[3 * j + i, c] = (powers[slot] + 2.0 * k[13 + i, 0] * own) * half - own
    return result


@njit()
def positions(x: Array, packed: Array) -> Array:
    """Return the end-effector of each sample by eq. (33), shape (n, 2), mm."""
    samples, k = packed[1:], _one(x, packed)
    q = np.empty((Q, 1))
    _fill(q, packed)
    _put(x, packed, q)
    result = np.empty((int(packed[0, 0]), 2))
    for j in range(result.shape[0]):
        _, _, _, _, fd, hd, d = _radical_centre(
            k[0, 0], k[1, 0], k[2, 0], k[3, 0], k[4, 0], k[5, 0], k[6, 0],
            k[7, 0], k[8, 0], k[9, 0], k[11, 0], k[12, 0],
            samples[0, j], samples[1, j], samples[2, j], samples[3, j], samples[4, j], samples[5, j],
        )  # fmt: skip
        c1, s1 = samples[0, j], samples[1, j]
        result[j, 0] = q[0, 0] + 2.0 * (k[4, 0] * c1 - k[5, 0] * s1) + fd / d
        result[j, 1] = q[1, 0] + 2.0 * (k[4, 0] * s1 + k[5, 0] * c1) + hd / d
    return result


@part()
def _aligned(rows: int, columns: int) -> Array:
    """Return room that begins at a multiple of 64 bytes: a vector across two cache lines is loaded twice."""
    room = np.empty(rows * columns + _WIDTH)
    first = -(room.ctypes.data // 8) % _WIDTH
    return room[first : first + rows * columns].reshape(rows, columns)


@part()
def _one(x: Array, packed: Array) -> Array:
    """Return the coefficients of one candidate, shape (16, 1)."""
    room = np.empty((Q + _COEFFICIENTS, 1))
    q, k = room[:Q], room[Q:]
    _fill(q, packed)
    _put(x, packed, q)
    _coefficients(q, packed, k, 1)
    return k


@part()
def _fill(q: Array, packed: Array) -> None:
    for i in range(Q):
        for lane in range(q.shape[1]):
            q[i, lane] = packed[0, _TEMPLATE + i]


@part()
def _put(x: Array, packed: Array, q: Array) -> None:
    if x.shape[0] != packed[0, 1]:
        raise ValueError("x has another dimension than the problem")
    for c in range(x.shape[0]):
        q[int(packed[0, _FREE + c]), 0] = x[c]


@part()
def _coefficients(q: Array, packed: Array, k: Array, lanes: int) -> None:
    """Fill k, shape (16, lanes), with what does not change over the samples.

    A_2 - A_1, A_3 - A_1, (p, q) of each leg, all halved; l_b1^2; (l_b1^2 - l_b2^2) / 4, (l_b1^2 - l_b3^2) / 4; l_b of
    each leg. In halved lengths eq. (32) has no factor of 1/2 left, and no bit is lost.
    """
    for i in range(lanes):
        k[0, i], k[1, i] = 0.5 * (q[2, i] - q[0, i]), 0.5 * (q[3, i] - q[1, i])
        k[2, i], k[3, i] = 0.5 * (q[4, i] - q[0, i]), 0.5 * (q[5, i] - q[1, i])
    for leg in range(3):
        if packed[0, 2] == 0.0:
            for i in range(lanes):
                k[4 + 2 * leg, i], k[5 + 2 * leg, i] = 0.5 * q[6 + leg, i], 0.5 * q[12 + leg, i]
        else:
            for i in range(lanes):
                cosine, sine = near_cos_sin(q[12 + leg, i])
                k[4 + 2 * leg, i], k[5 + 2 * leg, i] = 0.5 * q[6 + leg, i] * cosine, 0.5 * q[6 + leg, i] * sine
            for i in range(lanes):
                if abs(q[12 + leg, i]) > FAR:
                    cosine, sine = cos_sin(q[12 + leg, i])
                    k[4 + 2 * leg, i], k[5 + 2 * leg, i] = 0.5 * q[6 + leg, i] * cosine, 0.5 * q[6 + leg, i] * sine
    for i in range(lanes):
        k[10, i] = q[9, i] * q[9, i]
        k[11, i] = 0.25 * (q[9, i] - q[10, i]) * (q[9, i] + q[10, i])
        k[12, i] = 0.25 * (q[9, i] - q[11, i]) * (q[9, i] + q[11, i])
        k[13, i], k[14, i], k[15, i] = q[9, i], q[10, i], q[11, i]


@part()
def _sum_powers(k: Array, samples: Array, turn: int, n: int, total: Array, lanes: int) -> None:
    for j in range(turn, n, _SUMS):
        c1, s1, c2 = samples[0, j], samples[1, j], samples[2, j]
        s2, c3, s3 = samples[3, j], samples[4, j], samples[5, j]
        for i in range(lanes):
            w, d = _power(
                k[0, i], k[1, i], k[2, i], k[3, i], k[4, i], k[5, i], k[6, i],
                k[7, i], k[8, i], k[9, i], k[10, i], k[11, i], k[12, i],
                c1, s1, c2, s2, c3, s3,
            )  # fmt: skip
            g = w / (d * d)
            total[i] = fma(g, g, total[i])


@part()
def _sum_leg_errors(k: Array, samples: Array, turn: int, n: int, total: Array, lanes: int) -> None:
    for j in range(turn, n, _SUMS):
        c1, s1, c2 = samples[0, j], samples[1, j], samples[2, j]
        s2, c3, s3 = samples[3, j], samples[4, j], samples[5, j]
        for i in range(lanes):
            w, d = _power(
                k[0, i], k[1, i], k[2, i], k[3, i], k[4, i], k[5, i], k[6, i],
                k[7, i], k[8, i], k[9, i], k[10, i], k[11, i], k[12, i],
                c1, s1, c2, s2, c3, s3,
            )  # fmt: skip
            total[i] += _leg_errors_squared(w, d, k[13, i], k[14, i], k[15, i])


@part()
def _power_of(k: Array, samples: Array, j: int) -> tuple[float, float]:
    power: tuple[float, float] = _power(
        k[0, 0], k[1, 0], k[2, 0], k[3, 0], k[4, 0], k[5, 0], k[6, 0],
        k[7, 0], k[8, 0], k[9, 0], k[10, 0], k[11, 0], k[12, 0],
        samples[0, j], samples[1, j], samples[2, j], samples[3, j], samples[4, j], samples[5, j],
    )  # fmt: skip
    return power


@part()
def _power_slopes(k: Array, samples: Array, j: int, polar: bool, slopes: Array) -> None:
    """Write dg_j / dq, shape (15,), in the coordinates of q (so 12-14 are dg / d reading where polar)."""
    ux, uy, vx, vy, fd, hd, d = _radical_centre(
        k[0, 0], k[1, 0], k[2, 0], k[3, 0], k[4, 0], k[5, 0], k[6, 0], k[7, 0], k[8, 0], k[9, 0], k[11, 0], k[12, 0],
        samples[0, j], samples[1, j], samples[2, j], samples[3, j], samples[4, j], samples[5, j],
    )  # fmt: skip
    inverse = 1.0 / d
    px, py = fd * inverse, hd * inverse
    b2, b3 = 0.5 * (px * vy - py * vx) * inverse, 0.5 * (ux * py - uy * px) * inverse
    for i in range(3):
        weight = b2 if i == 1 else b3 if i == 2 else 1.0 - b2 - b3
        rx = px - 2.0 * (ux if i == 1 else vx if i == 2 else 0.0)  # P - B_i
        ry = py - 2.0 * (uy if i == 1 else vy if i == 2 else 0.0)
        cosine, sine = samples[2 * i, j], samples[2 * i + 1, j]
        p, q = 2.0 * k[4 + 2 * i, 0], 2.0 * k[5 + 2 * i, 0]
        slopes[2 * i] = -2.0 * weight * rx
        slopes[2 * i + 1] = -2.0 * weight * ry
        slopes[9 + i] = -2.0 * weight * k[13 + i, 0]
        if polar:
            bx, by = p * cosine - q * sine, p * sine + q * cosine  # B_i - A_i, turned by z
            slopes[6 + i] = -2.0 * weight * (rx * bx + ry * by) / math.sqrt(p * p + q * q)
            slopes[12 + i] = -2.0 * weight * (ry * bx - rx * by)
        else:
            slopes[6 + i] = -2.0 * weight * (rx * cosine + ry * sine)
            slopes[12 + i] = -2.0 * weight * (ry * cosine - rx * sine)


@part()
def _power(
    ax2: float, ay2: float, ax3: float, ay3: float,
    p1: float, q1: float, p2: float, q2: float, p3: float, q3: float, r1: float, r12: float, r13: float,
    c1: float, s1: float, c2: float, s2: float, c3: float, s3: float,
) -> tuple[float, float]:  # fmt: skip
    """Return w, d with w / d^2 = g, the power of the radical centre, mm^2.

    It is each component of E2, eq. (38), with (x, y) from (33).
    """
    _, _, _, _, fd, hd, d = _radical_centre(
        ax2, ay2, ax3, ay3, p1, q1, p2, q2, p3, q3, r12, r13, c1, s1, c2, s2, c3, s3
    )
    return fma(-r1, d * d, fma(fd, fd, hd * hd)), d


@part()
def _radical_centre(
    ax2: float, ay2: float, ax3: float, ay3: float,
    p1: float, q1: float, p2: float, q2: float, p3: float, q3: float, r12: float, r13: float,
    c1: float, s1: float, c2: float, s2: float, c3: float, s3: float,
) -> tuple[float, float, float, float, float, float, float]:  # fmt: skip
    """Return u = (B_2 - B_1) / 2, v = (B_3 - B_1) / 2, d = u x v, and P - B_1 as numerators over d, not halved."""
    bx1, by1 = fma(p1, c1, -(q1 * s1)), fma(p1, s1, q1 * c1)  # eq. (30) with (41), less A_1
    ux, uy = fma(p2, c2, fma(-q2, s2, ax2 - bx1)), fma(p2, s2, fma(q2, c2, ay2 - by1))
    vx, vy = fma(p3, c3, fma(-q3, s3, ax3 - bx1)), fma(p3, s3, fma(q3, c3, ay3 - by1))
    f = fma(ux, ux, fma(uy, uy, r12))  # eq. (32), half of d_i with the squares lost in print, about B_1
    h = fma(vx, vx, fma(vy, vy, r13))
    d = fma(ux, vy, -(uy * vx))
    return ux, uy, vx, vy, fma(f, vy, -(h * uy)), fma(h, ux, -(f * vx)), d  # eq. (33)


@part()
def _leg_errors_squared(w: float, d: float, lb1: float, lb2: float, lb3: float) -> float:
    """Return the sum of the three (w / (|d| a_i))^2, eq. (37), by one division."""
    a1, a2, a3 = _reach_and_link(w, d, lb1), _reach_and_link(w, d, lb2), _reach_and_link(w, d, lb3)
    a12, a13, a23 = a1 * a2, a1 * a3, a2 * a3
    below = d * (a12 * a3)
    return (w * w) * fma(a12, a12, fma(a13, a13, a23 * a23)) / (below * below)


@njit()
def _reach_and_link(w: float, d: float, lb: float) -> float:
    """Return a = |d| (|P - B_i| + l_b), by which the leg's error is w / (|d| a)."""
    link = lb * abs(d)
    return math.sqrt(_positive(fma(link, link, w))) + link


@part()
def _positive(value: float) -> float:
    return value if value > 0.0 else 0.0


_FIRST = 4  # samples


def screen(packed: Array) -> Array:
    """Return what `batch` needs besides the candidates to take the first samples only."""
    few = packed.copy()
    few[0, 0] = min(few[0, 0], _FIRST)
    few.flags.writeable = False
    return few


@njit()
def batch_below(points: Array, limits: Array, packed: Array, few: Array) -> Array:
    """Return the costs, shape (k,), of `points`, shape (k, dim), that are below `limits`, shape (k,).

    Those have the bits of `batch`. Any other value is that of all samples or of the first `few`, and not below its
    limit.
    """
    values = batch(points, few)
    staying = np.empty(points.shape, dtype=np.float64)
    at = np.empty(points.shape[0], dtype=np.int64)
    left = 0
    for candidate in range(points.shape[0]):
        if not values[candidate] >= limits[candidate]:  # what is not a number may still become one: it stays
            for c in range(points.shape[1]):
                staying[left, c] = points[candidate, c]
            at[left] = candidate
            left += 1
    whole = batch(staying[:left], packed)
    for i in range(left):
        values[at[i]] = whole[i]
    return values
