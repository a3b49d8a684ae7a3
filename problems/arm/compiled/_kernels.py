"""Where an arm's target is, compiled: candidates in the lanes for values, screws of one candidate for the Jacobian.

The joints' frames are turned so that each axis is z. Then a posture is a product of constant frames C_k, which a
candidate decides once, and of plain turns (or slides) about z:

    target = C_0 Z(s_1) C_1 Z(s_2) ... Z(s_J) C_J,     s_k = gain_k (q_k + zero_k)

A point goes through it from the tool to the world: a turn in a plane and one affine map a joint, without a branch, so
that candidates stand side by side in the SIMD lanes. `cost` is the same code with one lane: the same bits.

`template`, (P,), holds all parameters (`kinematics.parameter_names`, then three a plane), x the `free` ones of them.
`fixed`, (J + 2, 12), are rotation and shift before each placement, `align`, (J, 9), what turns z into the joint's axis.
`sliding`, (J,), is 1 for a sliding joint; `stands`, (n, J), are the positions of the joints. What is compared with what
is in `groups`, `values`, `weight` and `planes`, as `readings` says; `limit` is the size [mm] above which a reading
counts less, infinite for plain squares.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import njit
from calibench.core.compilation.fused import fma
from calibench.core.compilation.trigonometry import FAR, cos_sin, near_cos_sin
from calibench.problems.arm.compiled._reading_kernels import means_of, reads_alone, rows_of, slopes_of, total_of
from calibench.problems.base import Array

Index = NDArray[np.int64]
_LANES = 32


@njit()
def cost(
    x: Array, template: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array, oriented: bool,
    groups: Index, values: Array, weight: Array, planes: Array, sockets: int, limit: float, size: int,
) -> float:  # fmt: skip
    """Return the sum of squared residuals [mm^2] of one candidate x, shape (dim,)."""
    full, seen = np.empty((template.size, 1)), np.empty((stands.shape[0], 9 if oriented else 3, 1))
    _fill(full, template, 1)
    for c in range(free.size):
        full[free[c], 0] = x[c]
    _targets(full, fixed, align, sliding, stands, oriented, seen, 1)
    return total_of(full, seen, 0, groups, values, weight, planes, sockets, limit, np.empty(size))


@njit()
def batch(
    many: Array, template: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array,
    oriented: bool, groups: Index, values: Array, weight: Array, planes: Array, sockets: int, limit: float, size: int,
) -> Array:  # fmt: skip
    """Return the sums of squares, shape (k,), of candidates `many`, shape (k, dim): bit for bit those of `cost`."""
    found, r = np.empty(many.shape[0]), np.empty(size)
    full = np.empty((template.size, _LANES))
    seen = np.empty((stands.shape[0], 9 if oriented else 3, _LANES))
    _fill(full, template, _LANES)
    for first in range(0, many.shape[0], _LANES):
        live = min(_LANES, many.shape[0] - first)
        for c in range(free.size):
            for i in range(live):
                full[free[c], i] = many[first + i, c]
        _targets(full, fixed, align, sliding, stands, oriented, seen, live)
        for i in range(live):
            found[first + i] = total_of(full, seen, i, groups, values, weight, planes, sockets, limit, r)
    return found


@njit()
def residuals(
    x: Array, template: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array, oriented: bool,
    groups: Index, values: Array, weight: Array, planes: Array, sockets: int, limit: float, size: int,
) -> Array:  # fmt: skip
    """Return weighted modelled minus measured readings [mm], shape (size,)."""
    full, seen = np.empty((template.size, 1)), np.empty((stands.shape[0], 9 if oriented else 3, 1))
    r = np.empty(size)
    _fill(full, template, 1)
    for c in range(free.size):
        full[free[c], 0] = x[c]
    _targets(full, fixed, align, sliding, stands, oriented, seen, 1)
    rows_of(full, seen, 0, groups, values, weight, planes, sockets, limit, r)
    return r


@njit()
def jacobian(
    x: Array, template: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array, oriented: bool,
    groups: Index, values: Array, weight: Array, planes: Array, sockets: int, limit: float, size: int,
) -> Array:  # fmt: skip
    """Return the derivative of `residuals`, shape (size, dim)."""
    full, seen = np.empty((template.size, 1)), np.empty((stands.shape[0], 9 if oriented else 3, 1))
    _fill(full, template, 1)
    for c in range(free.size):
        full[free[c], 0] = x[c]
    _targets(full, fixed, align, sliding, stands, oriented, seen, 1)
    joints = sliding.size
    local, own = np.empty((joints + 2, 18)), np.empty((joints + 2, 12))
    before, placed, held = np.empty((joints + 2, 12)), np.empty((joints + 2, 12)), np.empty((1, 12))
    _constants(full, joints, local, own)
    alone = reads_alone(groups)
    screws = np.empty((1 if alone else stands.shape[0], 6 if oriented else 3, free.size))
    result, mean, moved = np.empty((size, free.size)), np.zeros((sockets, 3)), np.zeros((sockets, 3, free.size))
    if not alone:
        for n in range(stands.shape[0]):
            _screws(
                full, free, fixed, align, sliding, stands, n, seen, local, own, before, placed, held, screws, n
            )  # fmt: skip
        means_of(seen, screws, groups, mean, moved)
    last = -1
    for g in range(groups.shape[0]):
        if alone and groups[g, 1] != last:  # one posture's screws stay in the nearest cache
            last = groups[g, 1]
            _screws(
                full, free, fixed, align, sliding, stands, last, seen, local, own, before, placed, held, screws, 0
            )  # fmt: skip
        slopes_of(full, free, seen, screws, alone, g, groups, values, weight, planes, mean, moved, limit, result)
    return result


@njit()
def targets(
    x: Array, template: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array
) -> Array:  # fmt: skip
    """Return the targets of one candidate, (n, 9): place [mm], and the x and y axes of its frame."""
    full, seen = np.empty((template.size, 1)), np.empty((stands.shape[0], 9, 1))
    _fill(full, template, 1)
    for c in range(free.size):
        full[free[c], 0] = x[c]
    _targets(full, fixed, align, sliding, stands, True, seen, 1)
    return seen[:, :, 0].copy()


@njit()
def _fill(full: Array, template: Array, lanes: int) -> None:
    for k in range(template.size):
        for i in range(lanes):
            full[k, i] = template[k]


@njit()
def _targets(
    full: Array, fixed: Array, align: Array, sliding: Index, stands: Array, oriented: bool, seen: Array, lanes: int
) -> None:
    """Write place, and where `oriented` the x and y axes, of each target to `seen`, shape (n, 3 or 9, lanes)."""
    joints = sliding.size
    frames = np.empty((joints + 1, 12, lanes))
    _frames(full, fixed, align, frames, lanes)
    v, cs = np.empty((9, lanes)), np.empty((2, lanes))
    last = frames[joints]
    for n in range(stands.shape[0]):
        for i in range(lanes):
            v[0, i], v[1, i], v[2, i] = last[9, i], last[10, i], last[11, i]
        if oriented:
            for i in range(lanes):
                v[3, i], v[4, i], v[5, i] = last[0, i], last[3, i], last[6, i]
                v[6, i], v[7, i], v[8, i] = last[1, i], last[4, i], last[7, i]
        for k in range(joints - 1, -1, -1):
            q, zero, gain = stands[n, k], full[12 + 8 * k], full[13 + 8 * k]
            if sliding[k] == 1:
                for i in range(lanes):
                    v[2, i] += gain[i] * (q + zero[i])
            else:
                _turned(q, zero, gain, cs, lanes)
                _turn(v, 0, cs, lanes)
                if oriented:
                    _turn(v, 3, cs, lanes)
                    _turn(v, 6, cs, lanes)
            frame = frames[k]
            _through(v, 0, frame, lanes)
            for i in range(lanes):
                v[0, i], v[1, i], v[2, i] = v[0, i] + frame[9, i], v[1, i] + frame[10, i], v[2, i] + frame[11, i]
            if oriented:
                _through(v, 3, frame, lanes)
                _through(v, 6, frame, lanes)
        for c in range(9 if oriented else 3):
            for i in range(lanes):
                seen[n, c, i] = v[c, i]


@njit()
def _turned(q: float, zero: Array, gain: Array, cs: Array, lanes: int) -> None:
    for i in range(lanes):
        cs[0, i], cs[1, i] = near_cos_sin(gain[i] * (q + zero[i]))
    for i in range(lanes):
        if not abs(gain[i] * (q + zero[i])) <= FAR:
            cs[0, i], cs[1, i] = cos_sin(gain[i] * (q + zero[i]))


@njit()
def _turn(v: Array, at: int, cs: Array, lanes: int) -> None:
    for i in range(lanes):
        c, s, x, y = cs[0, i], cs[1, i], v[at, i], v[at + 1, i]
        v[at, i], v[at + 1, i] = fma(c, x, -(s * y)), fma(s, x, c * y)


@njit()
def _through(v: Array, at: int, frame: Array, lanes: int) -> None:
    for i in range(lanes):
        x, y, z = v[at, i], v[at + 1, i], v[at + 2, i]
        v[at, i] = fma(frame[0, i], x, fma(frame[1, i], y, frame[2, i] * z))
        v[at + 1, i] = fma(frame[3, i], x, fma(frame[4, i], y, frame[5, i] * z))
        v[at + 2, i] = fma(frame[6, i], x, fma(frame[7, i], y, frame[8, i] * z))


@njit()
def _frames(full: Array, fixed: Array, align: Array, frames: Array, lanes: int) -> None:
    """Write C_0 .. C_J to `frames`, shape (J + 1, 12, lanes): the base goes into the first."""
    joints = align.shape[0]
    one, base, held = np.empty(12), np.empty(12), np.empty(12)
    angles = np.empty(6)
    for i in range(lanes):
        _placement(full, 0, i, fixed[0], angles, base)
        for k in range(joints + 1):
            at = 6 + 8 * k
            _placement(full, at, i, fixed[k + 1], angles, one)
            if k < joints:
                for a in range(3):
                    for b in range(3):
                        held[3 * a + b] = (
                            one[3 * a] * align[k, b]
                            + one[3 * a + 1] * align[k, 3 + b]
                            + one[3 * a + 2] * align[k, 6 + b]
                        )
                    held[9 + a] = one[9 + a]
            else:
                held[:] = one
            if k == 0:
                _after(base, held, one)
                for a in range(12):
                    frames[0, a, i] = one[a]
            else:
                for a in range(12):
                    frames[k, a, i] = held[a]


@njit()
def _placement(full: Array, at: int, i: int, fixed: Array, turned: Array, frame: Array) -> None:
    """Write fixed . Trans(x, y, z) Rz(rz) Ry(ry) Rx(rx) to `frame`, shape (12,); `turned` are cosines and sines."""
    for a in range(3):
        turned[2 * a], turned[2 * a + 1] = cos_sin(full[at + 3 + a, i])
    cx, sx, cy, sy, cz, sz = turned[0], turned[1], turned[2], turned[3], turned[4], turned[5]
    x, y, z = full[at, i], full[at + 1, i], full[at + 2, i]
    for a in range(3):
        u, v, w = fixed[3 * a], fixed[3 * a + 1], fixed[3 * a + 2]
        along, up = u * cz + v * sz, v * cz - u * sz  # the row times Rz, then Ry, then Rx
        frame[3 * a] = along * cy - w * sy
        over = along * sy + w * cy
        frame[3 * a + 1] = up * cx + over * sx
        frame[3 * a + 2] = over * cx - up * sx
        frame[9 + a] = fixed[9 + a] + (u * x + v * y + w * z)


@njit()
def _after(first: Array, second: Array, product: Array) -> None:
    for a in range(3):
        u, v, w = first[3 * a], first[3 * a + 1], first[3 * a + 2]
        for b in range(3):
            product[3 * a + b] = u * second[b] + v * second[3 + b] + w * second[6 + b]
        product[9 + a] = first[9 + a] + (u * second[9] + v * second[10] + w * second[11])


@njit()
def _constants(full: Array, joints: int, local: Array, own: Array) -> None:
    """Write what a candidate decides once: directions (J + 2, 18), placements (J + 2, 12) of base, joints and tool."""
    angles = np.empty(6)
    none = np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    for k in range(joints + 2):
        at = 0 if k == 0 else 6 + 8 * (k - 1)
        _directions(full, at, local[k])
        _placement(full, at, 0, none, angles, own[k])


@njit()
def _screws(
    full: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array, n: int, seen: Array,
    local: Array, own: Array, before: Array, placed: Array, held: Array, screws: Array, to: int,
) -> None:  # fmt: skip
    """Write the shift [mm] and, where there is room, the turn of target n to ``screws[to]``, shape (3 or 6, dim).

    `before`, `placed`, (J + 2, 12), and `held`, (1, 12), are room for the frames before and after each placement.
    Arrays are indexed and not cut, as each cut costs as much as a product.
    """
    joints, turns = sliding.size, screws.shape[1] == 6
    for a in range(12):
        before[0, a] = fixed[0, a]
    for k in range(joints + 2):
        _joined(before, k, own, k, placed, k)
        if k == 0:
            _joined(placed, 0, fixed, 1, before, 1)
        elif k <= joints:
            _moved(placed, k, align, full, sliding, stands[n, k - 1], held)
            _joined(held, 0, fixed, k + 1, before, k + 1)
    for c in range(free.size):
        f = free[c]
        if f >= 12 + 8 * joints:  # a plane's
            for a in range(screws.shape[1]):
                screws[to, a, c] = 0.0
            continue
        k = 0 if f < 6 else (f - 6) // 8 + 1
        what = f if f < 6 else (f - 6) % 8
        size = 1.0
        if what < 6:
            ex, ey, ez = local[k, 3 * what], local[k, 3 * what + 1], local[k, 3 * what + 2]
            ux = before[k, 0] * ex + before[k, 1] * ey + before[k, 2] * ez
            uy = before[k, 3] * ex + before[k, 4] * ey + before[k, 5] * ez
            uz = before[k, 6] * ex + before[k, 7] * ey + before[k, 8] * ez
        else:
            ex, ey, ez = align[k - 1, 2], align[k - 1, 5], align[k - 1, 8]
            ux = placed[k, 0] * ex + placed[k, 1] * ey + placed[k, 2] * ez
            uy = placed[k, 3] * ex + placed[k, 4] * ey + placed[k, 5] * ez
            uz = placed[k, 6] * ex + placed[k, 7] * ey + placed[k, 8] * ez
            size = full[13 + 8 * (k - 1), 0] if what == 6 else stands[n, k - 1] + full[12 + 8 * (k - 1), 0]
        if what < 3 or (what > 5 and sliding[k - 1] == 1):
            screws[to, 0, c], screws[to, 1, c], screws[to, 2, c] = size * ux, size * uy, size * uz
            if turns:
                screws[to, 3, c] = screws[to, 4, c] = screws[to, 5, c] = 0.0
            continue
        lx = seen[n, 0, 0] - placed[k, 9]  # the place of a placement is its turns' centre
        ly = seen[n, 1, 0] - placed[k, 10]
        lz = seen[n, 2, 0] - placed[k, 11]
        screws[to, 0, c] = size * (uy * lz - uz * ly)
        screws[to, 1, c] = size * (uz * lx - ux * lz)
        screws[to, 2, c] = size * (ux * ly - uy * lx)
        if turns:
            screws[to, 3, c], screws[to, 4, c], screws[to, 5, c] = size * ux, size * uy, size * uz


@njit()
def _joined(first: Array, i: int, second: Array, j: int, product: Array, k: int) -> None:
    """Write frame i of `first` times frame j of `second` to frame k of `product`."""
    for a in range(3):
        u, v, w = first[i, 3 * a], first[i, 3 * a + 1], first[i, 3 * a + 2]
        for b in range(3):
            product[k, 3 * a + b] = u * second[j, b] + v * second[j, 3 + b] + w * second[j, 6 + b]
        product[k, 9 + a] = first[i, 9 + a] + (u * second[j, 9] + v * second[j, 10] + w * second[j, 11])


@njit()
def _directions(full: Array, at: int, local: Array) -> None:
    """Write the unit vectors that a placement's six parameters move along or turn about, (18,), in the frame before."""
    cy, sy = cos_sin(full[at + 4, 0])
    cz, sz = cos_sin(full[at + 5, 0])
    local[:] = 0.0
    local[0] = local[4] = local[8] = local[17] = 1.0
    local[9], local[10], local[11] = cz * cy, sz * cy, -sy
    local[12], local[13] = -sz, cz


@njit()
def _moved(placed: Array, k: int, align: Array, full: Array, sliding: Index, q: float, moved: Array) -> None:
    """Write the frame behind the motion of joint k (1 ..) to `moved`, (1, 12), with z along its axis."""
    j = k - 1
    for a in range(3):
        u, v, w = placed[k, 3 * a], placed[k, 3 * a + 1], placed[k, 3 * a + 2]
        for b in range(3):
            moved[0, 3 * a + b] = u * align[j, b] + v * align[j, 3 + b] + w * align[j, 6 + b]
        moved[0, 9 + a] = placed[k, 9 + a]
    s = full[13 + 8 * j, 0] * (q + full[12 + 8 * j, 0])
    if sliding[j] == 1:
        for a in range(3):
            moved[0, 9 + a] += moved[0, 3 * a + 2] * s
        return
    cosine, sine = cos_sin(s)
    for a in range(3):
        u, v = moved[0, 3 * a], moved[0, 3 * a + 1]
        moved[0, 3 * a], moved[0, 3 * a + 1] = u * cosine + v * sine, v * cosine - u * sine
