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

from typing import cast

import numpy as np

from calibench.calibration._reading_kernels import means_of, reads_alone, rows_of, slopes_of, total_of
from calibench.calibration._screw_kernels import ALONE, WIDE, after, links, placement, screws_of, turned
from calibench.calibration.rigid import Array, Index
from calibench.core.compilation.compiled import njit, part
from calibench.core.compilation.lanes import FAR, cos_sin, fma, near_cos_sin

_LANES = 32
_BASE = cast(int, np.int64(0))  # the base's first parameter; no literal, as `ALONE` is none


@njit()
def cost(
    x: Array, template: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array, oriented: bool,
    groups: Index, values: Array, weight: Array, planes: Array, sockets: int, limit: float, size: int,
) -> float:  # fmt: skip
    """Return the sum of squared residuals [mm^2] of one candidate x, shape (dim,)."""
    full, seen = _whole(x, template, free), np.empty((stands.shape[0], 9 if oriented else 3, 1))
    _targets(full, fixed, align, sliding, stands, oriented, seen, 1)
    return total_of(full, seen, ALONE, groups, values, weight, planes, sockets, limit, np.empty(size))


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
    full, seen = _whole(x, template, free), np.empty((stands.shape[0], 9 if oriented else 3, 1))
    r = np.empty(size)
    _targets(full, fixed, align, sliding, stands, oriented, seen, 1)
    rows_of(full, seen, ALONE, groups, values, weight, planes, sockets, limit, r)
    return r


@njit()
def jacobian(
    x: Array, template: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array, oriented: bool,
    groups: Index, values: Array, weight: Array, planes: Array, sockets: int, limit: float, size: int,
) -> Array:  # fmt: skip
    """Return the derivative of `residuals`, shape (size, dim)."""
    full, seen = _whole(x, template, free), np.empty((stands.shape[0], 9 if oriented else 3, 1))
    joints, n, alone = sliding.size, stands.shape[0], reads_alone(groups)
    link, ways, moved = np.empty((joints + 2, 12)), np.empty((joints + 2, 18)), np.empty(6 * free.size * WIDE)
    frames, places = np.empty((joints + 3) * 12 * WIDE), np.empty((joints + 2) * 3 * WIDE)
    links(full, fixed, align, link, ways, frames)
    screws = np.empty((WIDE if alone else n, 6 if oriented else 3, free.size))
    result, mean, slid = np.empty((size, free.size)), np.zeros((sockets, 3)), np.zeros((sockets, 3, free.size))
    which, count = np.empty(WIDE, dtype=np.int64), groups.shape[0] if alone else n
    for first in range(0, count, WIDE):  # of readings of one posture each, a few screws stay in the nearest cache
        for i in range(WIDE):
            at = min(first + i, count - 1)
            which[i] = groups[at, 1] if alone else at
        live, to = min(WIDE, count - first), 0 if alone else first
        screws_of(
            which, full, free, sliding, stands, link, ways, frames, places, moved, seen, screws, to, live
        )  # fmt: skip
        if alone:
            for i in range(live):
                slopes_of(
                    full, free, seen, screws, i, first + i, groups, values, weight, planes, mean, slid, limit, result
                )  # fmt: skip
    if not alone:
        means_of(seen, screws, groups, mean, slid)
        for g in range(groups.shape[0]):
            at = groups[g, 1]
            slopes_of(full, free, seen, screws, at, g, groups, values, weight, planes, mean, slid, limit, result)
    return result


@njit()
def targets(
    x: Array, template: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array
) -> Array:  # fmt: skip
    """Return the targets of one candidate, (n, 9): place [mm], and the x and y axes of its frame."""
    full, seen = _whole(x, template, free), np.empty((stands.shape[0], 9, 1))
    _targets(full, fixed, align, sliding, stands, True, seen, 1)
    return seen[:, :, 0].copy()


@part()
def _whole(x: Array, template: Array, free: Index) -> Array:
    """Return all parameters of one candidate, shape (P, 1)."""
    full = np.empty((template.size, 1))
    _fill(full, template, 1)
    for c in range(free.size):
        full[free[c], 0] = x[c]
    return full


@part()
def _fill(full: Array, template: Array, lanes: int) -> None:
    for k in range(template.size):
        for i in range(lanes):
            full[k, i] = template[k]


@part()
def _targets(
    full: Array, fixed: Array, align: Array, sliding: Index, stands: Array, oriented: bool, seen: Array, lanes: int
) -> None:
    """Write place, and where `oriented` the x and y axes, of each target to `seen`, shape (n, 3 or 9, lanes)."""
    joints, rows = sliding.size, 9 if oriented else 3
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
                for at in range(0, rows, 3):
                    _turn(v, at, cs, lanes)
            frame = frames[k]
            for at in range(0, rows, 3):
                _through(v, at, frame, lanes)
            for i in range(lanes):
                v[0, i], v[1, i], v[2, i] = v[0, i] + frame[9, i], v[1, i] + frame[10, i], v[2, i] + frame[11, i]
        for c in range(rows):
            for i in range(lanes):
                seen[n, c, i] = v[c, i]


@part()
def _turned(q: float, zero: Array, gain: Array, cs: Array, lanes: int) -> None:
    for i in range(lanes):
        cs[0, i], cs[1, i] = near_cos_sin(gain[i] * (q + zero[i]))
    for i in range(lanes):
        if not abs(gain[i] * (q + zero[i])) <= FAR:
            cs[0, i], cs[1, i] = cos_sin(gain[i] * (q + zero[i]))


@part()
def _turn(v: Array, at: int, cs: Array, lanes: int) -> None:
    for i in range(lanes):
        c, s, x, y = cs[0, i], cs[1, i], v[at, i], v[at + 1, i]
        v[at, i], v[at + 1, i] = fma(c, x, -(s * y)), fma(s, x, c * y)


@part()
def _through(v: Array, at: int, frame: Array, lanes: int) -> None:
    for i in range(lanes):
        x, y, z = v[at, i], v[at + 1, i], v[at + 2, i]
        v[at, i] = fma(frame[0, i], x, fma(frame[1, i], y, frame[2, i] * z))
        v[at + 1, i] = fma(frame[3, i], x, fma(frame[4, i], y, frame[5, i] * z))
        v[at + 2, i] = fma(frame[6, i], x, fma(frame[7, i], y, frame[8, i] * z))


@part()
def _frames(full: Array, fixed: Array, align: Array, frames: Array, lanes: int) -> None:
    """Write C_0 .. C_J to `frames`, shape (J + 1, 12, lanes): the base goes into the first."""
    joints = align.shape[0]
    one, base, held = np.empty(12), np.empty(12), np.empty(12)
    angles = np.empty(6)
    for i in range(lanes):
        placement(full, _BASE, i, fixed[0], angles, base)
        for k in range(joints + 1):
            at = 6 + 8 * k
            placement(full, at, i, fixed[k + 1], angles, one)
            if k < joints:
                turned(one, align[k], held)
            else:
                for a in range(12):
                    held[a] = one[a]
            if k == 0:
                after(base, held, one)
                for a in range(12):
                    frames[0, a, i] = one[a]
            else:
                for a in range(12):
                    frames[k, a, i] = held[a]
