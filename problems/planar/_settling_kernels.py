"""Where the three motors come to rest, for all samples of a path at once, in the SIMD lanes. No trigonometry is left.

A motor's error is the angle e from the direction w it is commanded to, turned back by the error dz of its offset, to
the direction u of its active link. With D = P - A, q = |D|^2, m = l_a^2 + q - l_b^2 and h^2 = 4 l_a^2 q - m^2, which
factors as ((l_a + l_b)^2 - q) (q - (l_a - l_b)^2), the closed loop gives

    u = (m D_x - h D_y, m D_y + h D_x) / (2 l_a q),     a x v = -h / 2,     a . D = m / 2

for the active link a = l_a u and the passive one v = D - a: a square root and a division a leg. sin e = w x u is small,
so e is its arcsine's Taylor series, cut where a term is below a quarter of the last bit. Where e is larger
(`_SERIES`), where a leg is out of reach, or where the search does not end, a lane is left to `_tracking_kernels`.

Lanes share one array, row after row of `LANES`: with the distances between rows known, the compiler needs no proof
that they do not overlap.
"""

import math

import numpy as np

from calibench.core.compilation.compiled import njit, part
from calibench.core.compilation.lanes import fma
from calibench.problems.base import Array

LANES = 64
SETTLED = 1e-7  # mm: Newton squares it over a link length, so what is left after such a step is rounding
SMALL = 1e-3  # mm: after a smaller step rounding may hide that f has fallen
STEPS = 50  # 4 to 7 are taken inside the box, up to a radius of 140 mm
ROWS = 8  # of a block of samples: its point, and for each leg the direction it is commanded to
ROOM = 19  # rows that a block needs to be settled
_X, _Y, _SX, _SY, _LEAST, _MOVING, _FAR = (row * LANES for row in range(7))  # pose, last step, least f, what is left
_E = 7 * LANES  # the errors of the three motors
_F, _FX, _FY, _NXX, _NXY, _NYY, _HXX, _HXY, _HYY = (row * LANES for row in range(10, 19))  # f, its slopes, in two parts
_SERIES = 0.25  # largest |sin e|
_A1, _A2, _A3, _A4, _A5, _A6, _A7, _A8, _A9, _A10, _A11, _A12 = (
    math.comb(2 * k, k) / (4**k * (2 * k + 1)) for k in range(1, 13)
)


@njit()
def samples_of(machine: Array, points: Array) -> Array:
    """Return what `settle` needs of a path, shape (blocks, 8 LANES): points, shape (n, 2), mm, and directions there.

    The last block is filled up with the last point.
    """
    n = points.shape[0]
    samples = np.empty(((n + LANES - 1) // LANES, ROWS * LANES))
    for j in range(samples.shape[0] * LANES):
        block, lane = j // LANES, j % LANES
        x, y = points[min(j, n - 1)]
        samples[block, lane], samples[block, LANES + lane] = x, y
        for i in range(3):
            ux, uy, _, _ = _link(machine[2 * i], machine[2 * i + 1], machine[6 + i], machine[9 + i], x, y)
            samples[block, (2 + 2 * i) * LANES + lane], samples[block, (3 + 2 * i) * LANES + lane] = ux, uy
    return samples


@part()
def settle(machine: Array, dz: Array, samples: Array, room: Array) -> None:
    """Find the pose of least f = sum e_i^2 of each lane of a block, by Newton's method from its point.

    `dz`, shape (3,), rad. `samples`, shape (8 LANES,), is a row of `samples_of`. `room`, shape (ROOM LANES,), gets the
    poses, mm, in its first two rows; `rests` tells of which lanes, `errors_at` the errors e there. A step that finds f
    larger, or a leg out of reach, is halved; where f is not convex it is that of Gauss and Newton.
    """
    cosines, sines = np.cos(dz), np.sin(dz)
    for j in range(LANES):
        room[_X + j], room[_Y + j], room[_SX + j], room[_SY + j] = samples[j], samples[LANES + j], 0.0, 0.0
        room[_LEAST + j], room[_MOVING + j], room[_FAR + j] = math.inf, 1.0, 0.0
    for _ in range(STEPS):
        for k in range(_F, _HYY + LANES):
            room[k] = 0.0
        for i in range(3):
            _add_leg(machine, i, cosines[i], sines[i], samples[(2 + 2 * i) * LANES :], room)
        if _step(room) == 0:
            break
    for i in range(3):
        _fill_errors(machine, i, cosines[i], sines[i], samples[(2 + 2 * i) * LANES :], room, room[_E + i * LANES :])


@part()
def rests(room: Array, lane: int) -> bool:
    """Tell whether `settle` has found where a lane's motors come to rest."""
    return room[_MOVING + lane] == 0.0 and room[_FAR + lane] == 0.0  # type: ignore[no-any-return]


@part()
def errors_at(room: Array, lane: int) -> tuple[float, float, float]:
    """Return the errors of the three motors of a lane, rad."""
    return room[_E + lane], room[_E + LANES + lane], room[_E + 2 * LANES + lane]


@part()
def _step(room: Array) -> int:
    """Take a step in each lane that still moves; return how many do."""
    moving = 0
    for j in range(LANES):
        sx, sy, f, fx, fy = room[_SX + j], room[_SY + j], room[_F + j], room[_FX + j], room[_FY + j]
        nxx, nxy, nyy = room[_NXX + j], room[_NXY + j], room[_NYY + j]
        mxx, mxy, myy = nxx + room[_HXX + j], nxy + room[_HXY + j], nyy + room[_HYY + j]
        convex = (mxx > 0.0) & (mxx * myy > mxy * mxy)
        mxx, mxy, myy = (mxx if convex else nxx), (mxy if convex else nxy), (myy if convex else nyy)
        each = 1.0 / (mxx * myy - mxy * mxy)
        falls = (f <= room[_LEAST + j]) | ((f < math.inf) & (sx * sx + sy * sy < SMALL * SMALL))
        sx = (mxy * fy - myy * fx) * each if falls else -0.5 * sx
        sy = (mxy * fx - mxx * fy) * each if falls else -0.5 * sy
        moves = room[_MOVING + j]
        room[_X + j] += moves * sx
        room[_Y + j] += moves * sy
        room[_SX + j], room[_SY + j] = sx, sy
        room[_LEAST + j] = f if falls else room[_LEAST + j]
        moves = 0.0 if falls & (sx * sx + sy * sy < SETTLED * SETTLED) else moves
        room[_MOVING + j] = moves
        moving += 1 if moves > 0.0 else 0
    return moving


@part()
def _add_leg(machine: Array, i: int, c: float, s: float, aim: Array, room: Array) -> None:
    """Add what leg i gives to f and its slopes, at each lane's (x, y).

    `aim`, shape (2 LANES or more,), are the directions it is commanded to, `c` and `s` the cosine and sine of dz.
    """
    ax, ay, la, lb = machine[2 * i], machine[2 * i + 1], machine[6 + i], machine[9 + i]
    for j in range(LANES):
        x, y, wx, wy = room[_X + j], room[_Y + j], aim[j], aim[LANES + j]
        ux, uy, m, ih = _link(ax, ay, la, lb, x, y)
        e, sine, cosine = _error(ux, uy, wx, wy, c, s)
        jx, jy, d, k = la * ux, la * uy, -2.0 * ih, 0.5 * m
        gx, gy = (x - ax - jx) * d, (y - ay - jy) * d
        room[_FAR + j] = room[_FAR + j] if (cosine > 0.0) & (abs(sine) < _SERIES) else 1.0
        room[_F + j] += e * e
        room[_FX + j] += e * gx
        room[_FY + j] += e * gy
        room[_NXX + j] += gx * gx
        room[_NXY + j] += gx * gy
        room[_NYY + j] += gy * gy
        room[_HXX + j] += e * ((1.0 + 2.0 * jy * gx + k * gx * gx) * d)
        room[_HXY + j] += e * ((jy * gy - jx * gx + k * gx * gy) * d)
        room[_HYY + j] += e * ((1.0 - 2.0 * jx * gy + k * gy * gy) * d)


@part()
def _fill_errors(machine: Array, i: int, c: float, s: float, aim: Array, poses: Array, errors: Array) -> None:
    """Fill `errors`, shape (LANES or more,), with motor i's errors [rad] at each lane's (x, y)."""
    ax, ay, la, lb = machine[2 * i], machine[2 * i + 1], machine[6 + i], machine[9 + i]
    for j in range(LANES):
        ux, uy, _, _ = _link(ax, ay, la, lb, poses[_X + j], poses[_Y + j])
        errors[j] = _error(ux, uy, aim[j], aim[LANES + j], c, s)[0]


@part()
def _error(ux: float, uy: float, wx: float, wy: float, c: float, s: float) -> tuple[float, float, float]:
    """Return the angle e [rad] from the direction w, turned back by dz, to u; its sine and its cosine."""
    across, along = wx * uy - wy * ux, wx * ux + wy * uy  # of the angle from w to u, which is small as dz is
    sine, cosine = fma(across, c, along * s), fma(along, c, -across * s)
    q = sine * sine
    t = fma(q, fma(q, fma(q, fma(q, fma(q, fma(q, _A12, _A11), _A10), _A9), _A8), _A7), _A6)
    t = fma(q, fma(q, fma(q, fma(q, fma(q, t, _A5), _A4), _A3), _A2), _A1)
    return fma(sine * q, t, sine), sine, cosine


@part()
def _link(ax: float, ay: float, la: float, lb: float, x: float, y: float) -> tuple[float, float, float, float]:
    """Return the direction u of the active link with the hand at (x, y), and its m and 1/h; NaN out of reach."""
    dx, dy = x - ax, y - ay
    q = dx * dx + dy * dy
    m = la * la + q - lb * lb
    h = math.sqrt(((la + lb) * (la + lb) - q) * (q - (la - lb) * (la - lb)))
    both = 1.0 / (h * q)
    half = 0.5 * both * h / la
    return half * (m * dx - h * dy), half * (m * dy + h * dx), m, both * q
