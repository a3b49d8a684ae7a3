"""Where an arm's target is, compiled: candidates in the lanes for values, screws of one candidate for the Jacobian.

The joints' frames are turned so that each axis is z. Then a posture is a product of constant frames C_k, which a
candidate decides once, and of plain turns (or slides) about z:

    target = C_0 Z(s_1) C_1 Z(s_2) ... Z(s_J) C_J,     s_k = gain_k (q_k + zero_k)

A point goes through it from the tool to the world: a turn in a plane and one affine map a joint, without a branch, so
that candidates stand side by side in the SIMD lanes. `cost` is the same code with one lane: the same bits.

`template`, (P,), holds all parameters (`kinematics.parameter_units`), x the `free` ones of them. `fixed`, (J + 2, 12),
are rotation and shift before each placement, `align`, (J, 9), what turns z into the joint's axis. `sliding`, (J,), is 1
for a sliding joint; `stands`, (n, J), are the positions of the joints. Frames are flat: nine numbers of a rotation by
rows, then three of a place.

Groups (kind, first, second, row) say what is compared, of which poses or sockets, and its first residual:

    kind      residuals                                                 values
    POSITION  place less measured place (3)                             x y z
    POSE      the same, then how the target is turned past it (3)       x y z, rotation (9)
    SOCKET    place less the mean place in its socket (3)               x y z beside it
    GAP       distance of two sockets' mean places less the known (1)   d

A turn of R past the measured M is the vector of (R M' - M R') / 2: its length is the sine of the angle, without a
branch. Rows are multiplied with `weight`, (groups, 2): of lengths, and of turns [mm/rad]. A socket's point is unknown
and linear in all that is seen of it: its least squares value is the mean, and so it needs no place in x. With a finite
`limit` c a group of length s counts as c sqrt(log(1 + s^2 / c^2)): as it is where small, and hardly more where wild
(Cauchy's function of the whole reading, so that no direction is preferred).

For the Jacobian postures stand side by side in the lanes. Behind joint k a frame of the arm is that behind the joint
before, through a link that the candidate decides once, and a turn (or slide) about z by the joint's own motion:

    R_k = R_{k-1} . L_k . Z(s_k),     L_k = fixed_k . placement_k . align_k

A shift along a direction u moves the target by u, a turn about u through a place p by u x (target - p): all that is
needed are the R_k and the places. `WIDE` postures are gone through at once; arrays of them are flat, `WIDE` numbers in
a row for each entry, so that every distance is known when the loops are compiled.
"""

import math
from typing import cast

import numpy as np

from calibench.calibration.kinematics import GAP, POSE, POSITION, SOCKET
from calibench.calibration.rigid import Array, Index
from calibench.core.compilation.compiled import njit, part
from calibench.core.compilation.lanes import FAR, cos_sin, fma, near_cos_sin

_LANES = 32
_BASE = cast(int, np.int64(0))  # the base's first parameter; no literal, as `ALONE` is none


@njit()
def cost(
    x: Array, template: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array, oriented: bool,
    groups: Index, values: Array, weight: Array, sockets: int, limit: float, size: int,
) -> float:  # fmt: skip
    """Return the sum of squared residuals [mm^2] of one candidate x, shape (dim,)."""
    full, seen = _whole(x, template, free), np.empty((stands.shape[0], 9 if oriented else 3, 1))
    _targets(full, fixed, align, sliding, stands, oriented, seen, 1)
    return total_of(seen, ALONE, groups, values, weight, sockets, limit, np.empty(size))


@njit()
def batch(
    many: Array, template: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array,
    oriented: bool, groups: Index, values: Array, weight: Array, sockets: int, limit: float, size: int,
) -> Array:  # fmt: skip
    """Return the sums of squares, shape (k,), of candidates `many`, shape (k, dim): bit for bit those of `cost`."""
    found, r = np.empty(many.shape[0]), np.empty(size)
    full = np.empty((template.size, _LANES))
    seen = np.empty((stands.shape[0], 9 if oriented else 3, _LANES))
    for k in range(template.size):
        for i in range(_LANES):
            full[k, i] = template[k]
    for first in range(0, many.shape[0], _LANES):
        live = min(_LANES, many.shape[0] - first)
        for c in range(free.size):
            for i in range(live):
                full[free[c], i] = many[first + i, c]
        _targets(full, fixed, align, sliding, stands, oriented, seen, live)
        for i in range(live):
            found[first + i] = total_of(seen, i, groups, values, weight, sockets, limit, r)
    return found


@njit()
def residuals(
    x: Array, template: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array, oriented: bool,
    groups: Index, values: Array, weight: Array, sockets: int, limit: float, size: int,
) -> Array:  # fmt: skip
    """Return weighted modelled minus measured readings [mm], shape (size,)."""
    full, seen = _whole(x, template, free), np.empty((stands.shape[0], 9 if oriented else 3, 1))
    r = np.empty(size)
    _targets(full, fixed, align, sliding, stands, oriented, seen, 1)
    rows_of(seen, ALONE, groups, values, weight, sockets, limit, r)
    return r


@njit()
def jacobian(
    x: Array, template: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array, oriented: bool,
    groups: Index, values: Array, weight: Array, sockets: int, limit: float, size: int,
) -> Array:  # fmt: skip
    """Return the derivative of `residuals`, shape (size, dim)."""
    full, seen = _whole(x, template, free), np.empty((stands.shape[0], 9 if oriented else 3, 1))
    joints, n = sliding.size, stands.shape[0]
    link, ways, moved = np.empty((joints + 2, 12)), np.empty((joints + 2, 18)), np.empty(6 * free.size * WIDE)
    frames, places = np.empty((joints + 3) * 12 * WIDE), np.empty((joints + 2) * 3 * WIDE)
    links(full, fixed, align, link, ways, frames)
    screws, which = np.empty((n, 6 if oriented else 3, free.size)), np.empty(WIDE, dtype=np.int64)
    result, mean, slid = np.empty((size, free.size)), np.zeros((sockets, 3)), np.zeros((sockets, 3, free.size))
    for first in range(0, n, WIDE):
        for i in range(WIDE):
            which[i] = min(first + i, n - 1)
        live = min(WIDE, n - first)
        screws_of(
            which, full, free, sliding, stands, link, ways, frames, places, moved, seen, screws, first, live
        )  # fmt: skip
    means_of(seen, screws, groups, mean, slid)
    for g in range(groups.shape[0]):
        slopes_of(seen, screws, g, groups, values, weight, mean, slid, limit, result)
    return result


@njit()
def poses(
    p: Array, free: Index, fixed: Array, align: Array, sliding: Index, stands: Array, oriented: bool
) -> tuple[Array, Array]:  # fmt: skip
    """Return targets, (n, 9): place [mm] and the x and y axes; and their screws in the `free` of p, (n, 3 or 6, k).

    A screw is the shift [mm] of the target and, where `oriented`, its turn [rad], both in the world.
    """
    n, joints = stands.shape[0], sliding.size
    full, seen = _whole(p, p, free[:0]), np.empty((n, 9, 1))
    link, ways, moved = np.empty((joints + 2, 12)), np.empty((joints + 2, 18)), np.empty(6 * free.size * WIDE)
    frames, places = np.empty((joints + 3) * 12 * WIDE), np.empty((joints + 2) * 3 * WIDE)
    links(full, fixed, align, link, ways, frames)
    screws, which = np.empty((n, 6 if oriented else 3, free.size)), np.empty(WIDE, dtype=np.int64)
    for first in range(0, n, WIDE):
        for i in range(WIDE):
            which[i] = min(first + i, n - 1)
        live = min(WIDE, n - first)
        screws_of(
            which, full, free, sliding, stands, link, ways, frames, places, moved, seen, screws, first, live
        )  # fmt: skip
    return seen[:, :, 0].copy(), screws


@part()
def _whole(x: Array, template: Array, free: Index) -> Array:
    """Return all parameters of one candidate, shape (P, 1)."""
    full = np.empty((template.size, 1))
    full[:, 0] = template
    for c in range(free.size):
        full[free[c], 0] = x[c]
    return full


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
                for i in range(lanes):
                    cs[0, i], cs[1, i] = near_cos_sin(gain[i] * (q + zero[i]))
                for i in range(lanes):
                    if not abs(gain[i] * (q + zero[i])) <= FAR:
                        cs[0, i], cs[1, i] = cos_sin(gain[i] * (q + zero[i]))
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


@part()
def total_of(
    seen: Array, i: int, groups: Index, values: Array, weight: Array, sockets: int, limit: float, r: Array
) -> float:
    """Return the sum of squared residuals of lane i; they are written to r."""
    rows_of(seen, i, groups, values, weight, sockets, limit, r)
    total = 0.0
    for k in range(r.size):
        total += r[k] * r[k]
    return total


@part()
def rows_of(
    seen: Array, i: int, groups: Index, values: Array, weight: Array, sockets: int, limit: float, r: Array
) -> None:
    """Write the residuals of lane i to r."""
    mean, turned = np.zeros((sockets, 3)), np.empty(9)
    if sockets > 0:
        _means(seen, i, groups, mean)
    for g in range(groups.shape[0]):
        kind, a, b, row = groups[g, 0], groups[g, 1], groups[g, 2], groups[g, 3]
        _group(seen, i, kind, a, b, values[g], weight[g], mean, turned, r[row : row + 6])
        if limit < math.inf:
            _tamed(r[row : row + _count(kind)], limit)


@part()
def _group(
    seen: Array, i: int, kind: int, a: int, b: int, values: Array, weight: Array, mean: Array, turned: Array, r: Array
) -> None:
    """Write the residuals of one group to the beginning of r."""
    if kind in (POSITION, POSE):
        for c in range(3):
            r[c] = weight[0] * (seen[a, c, i] - values[c])
        if kind == POSE:
            _rotation(seen, a, i, turned)
            for c in range(3):
                p, q = (c + 1) % 3, (c + 2) % 3
                r[3 + c] = 0.5 * weight[1] * (_entry(turned, values[3:], q, p) - _entry(turned, values[3:], p, q))
    elif kind == SOCKET:
        for c in range(3):
            r[c] = weight[0] * (seen[a, c, i] - mean[b, c] - values[c])
    else:
        apart = 0.0
        for c in range(3):
            step = mean[b, c] - mean[a, c]
            apart += step * step
        r[0] = weight[0] * (math.sqrt(apart) - values[0])


@part()
def means_of(seen: Array, screws: Array, groups: Index, mean: Array, moved: Array) -> None:
    """Write the mean place in each socket, (sockets, 3), and its slopes, (sockets, 3, dim)."""
    if mean.shape[0] == 0:
        return
    _means(seen, ALONE, groups, mean)
    count = np.zeros(moved.shape[0])
    for g in range(groups.shape[0]):
        if groups[g, 0] == SOCKET:
            s = groups[g, 2]
            count[s] += 1.0
            for c in range(3):
                for d in range(moved.shape[2]):
                    moved[s, c, d] += screws[groups[g, 1], c, d]
    for s in range(moved.shape[0]):
        for c in range(3):
            for d in range(moved.shape[2]):
                moved[s, c, d] /= count[s]


@part()
def slopes_of(
    seen: Array, screws: Array, g: int, groups: Index, values: Array, weight: Array, mean: Array,
    moved: Array, limit: float, result: Array,
) -> None:  # fmt: skip
    """Write the slopes of group g to `result`, (size, dim), from the `screws` of the targets, (n, 3 or 6, dim)."""
    dim = result.shape[1]
    kind, a, b, row = groups[g, 0], groups[g, 1], groups[g, 2], groups[g, 3]
    if kind in (POSITION, POSE):
        w = weight[g, 0]
        for c in range(3):
            for d in range(dim):
                result[row + c, d] = w * screws[a, c, d]
        if kind == POSE:
            turned = np.empty(9)
            _rotation(seen, a, ALONE, turned)
            _turn_slopes(turned, values[g, 3:], weight[g, 1], screws[a, 3:], result[row + 3 : row + 6])
    elif kind == SOCKET:
        for c in range(3):
            for d in range(dim):
                result[row + c, d] = weight[g, 0] * (screws[a, c, d] - moved[b, c, d])
    else:
        apart = 0.0
        for c in range(3):
            apart += (mean[b, c] - mean[a, c]) * (mean[b, c] - mean[a, c])
        apart = math.sqrt(apart)
        for d in range(dim):
            along = 0.0
            for c in range(3):
                along += (mean[b, c] - mean[a, c]) * (moved[b, c, d] - moved[a, c, d])
            result[row, d] = weight[g, 0] * along / apart
    if limit < math.inf:
        r, turned = np.empty(6), np.empty(9)
        _group(seen, ALONE, kind, a, b, values[g], weight[g], mean, turned, r)
        _tame(r[: _count(kind)], limit, result[row : row + _count(kind)])


@part()
def _count(kind: int) -> int:
    return 6 if kind == POSE else 1 if kind == GAP else 3


@part()
def _means(seen: Array, i: int, groups: Index, mean: Array) -> None:
    """Write the mean place in each socket to `mean`, shape (sockets, 3)."""
    count = np.zeros(mean.shape[0])
    for g in range(groups.shape[0]):
        if groups[g, 0] == SOCKET:
            for c in range(3):
                mean[groups[g, 2], c] += seen[groups[g, 1], c, i]
            count[groups[g, 2]] += 1.0
    for s in range(mean.shape[0]):
        for c in range(3):
            mean[s, c] /= count[s]


@part()
def _rotation(seen: Array, a: int, i: int, turned: Array) -> None:
    """Write the rotation of target a, (9,) by rows: z is x cross y."""
    xx, xy, xz = seen[a, 3, i], seen[a, 4, i], seen[a, 5, i]
    yx, yy, yz = seen[a, 6, i], seen[a, 7, i], seen[a, 8, i]
    turned[0], turned[3], turned[6] = xx, xy, xz
    turned[1], turned[4], turned[7] = yx, yy, yz
    turned[2], turned[5], turned[8] = xy * yz - xz * yy, xz * yx - xx * yz, xx * yy - xy * yx


@part()
def _entry(turned: Array, measured: Array, a: int, b: int) -> float:
    """Return (R M')_ab."""
    at, to = 3 * a, 3 * b
    entry: float = turned[at] * measured[to] + turned[at + 1] * measured[to + 1] + turned[at + 2] * measured[to + 2]
    return entry


@part()
def _turn_slopes(turned: Array, measured: Array, weight: float, turns: Array, j: Array) -> None:
    """Write the slopes of a turn past the measured one: with Q = R M' and dR = [w] R they are (tr(Q) I - Q) w / 2."""
    trace = 0.0
    for c in range(3):
        trace += _entry(turned, measured, c, c)
    for c in range(3):
        for d in range(j.shape[1]):
            j[c, d] = 0.5 * weight * trace * turns[c, d]
        for k in range(3):
            part = 0.5 * weight * _entry(turned, measured, c, k)
            for d in range(j.shape[1]):
                j[c, d] -= part * turns[k, d]


@part()
def _tamed(r: Array, limit: float) -> None:
    """Shorten a group's residuals to the length c sqrt(log(1 + s^2 / c^2))."""
    square = 0.0
    for k in range(r.size):
        square += r[k] * r[k]
    u = square / (limit * limit)
    factor = math.sqrt(math.log1p(u) / u) if u > 1e-12 else 1.0 - 0.25 * u
    for k in range(r.size):
        r[k] *= factor


@part()
def _tame(r: Array, limit: float, j: Array) -> None:
    """Turn slopes of a group's plain residuals r into those of the shortened ones."""
    square = 0.0
    for k in range(r.size):
        square += r[k] * r[k]
    u = square / (limit * limit)
    if u > 1e-5:
        factor = math.sqrt(math.log1p(u) / u)
        slope = (1.0 / (1.0 + u) - math.log1p(u) / u) / (2.0 * u * factor)  # of the factor in u
    else:
        factor, slope = 1.0 - u / 4 + 13 * u * u / 96, -0.25 + 13 * u / 48
    for d in range(j.shape[1]):
        along = 0.0
        for k in range(r.size):
            along += r[k] * j[k, d]
        for k in range(r.size):
            j[k, d] = factor * j[k, d] + r[k] * slope * 2.0 * along / (limit * limit)


ALONE = cast(int, np.int64(0))  # the lane of a candidate alone; a literal would be compiled apart from what varies


@part()
def placement(full: Array, at: int, i: int, fixed: Array, turned: Array, frame: Array) -> None:
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


@part()
def after(first: Array, second: Array, product: Array) -> None:
    """Write frame `first` times frame `second` to `product`, all of shape (12,)."""
    for a in range(3):
        u, v, w = first[3 * a], first[3 * a + 1], first[3 * a + 2]
        for b in range(3):
            product[3 * a + b] = u * second[b] + v * second[3 + b] + w * second[6 + b]
        product[9 + a] = first[9 + a] + (u * second[9] + v * second[10] + w * second[11])


@part()
def turned(frame: Array, align: Array, found: Array) -> None:
    """Write `frame` followed by the rotation `align`, (9,)."""
    for a in range(3):
        u, v, w = frame[3 * a], frame[3 * a + 1], frame[3 * a + 2]
        for b in range(3):
            found[3 * a + b] = u * align[b] + v * align[3 + b] + w * align[6 + b]
        found[9 + a] = frame[9 + a]


WIDE = 16


@part()
def links(full: Array, fixed: Array, align: Array, link: Array, ways: Array, frames: Array) -> None:
    """Write the links L_0 (base) .. L_J+1 (tool), (J + 2, 12), and what their parameters move along, (J + 2, 18).

    Those are told in the frame before the link. The first two of `frames`, (J + 2) x 12 x WIDE, which no posture
    changes, are written as well.
    """
    joints = align.shape[0]
    angles, placed, local = np.empty(6), np.empty(12), np.empty(18)
    for k in range(joints + 2):
        at = 0 if k == 0 else 6 + 8 * (k - 1)
        placement(full, at, ALONE, fixed[k], angles, placed)
        # the unit vectors that the six parameters move along or turn about, in the frame before
        cy, sy = cos_sin(full[at + 4, 0])
        cz, sz = cos_sin(full[at + 5, 0])
        for a in range(18):
            local[a] = 0.0
        local[0] = local[4] = local[8] = local[17] = 1.0
        local[9], local[10], local[11] = cz * cy, sz * cy, -sy
        local[12], local[13] = -sz, cz
        for what in range(6):
            for a in range(3):
                ways[k, 3 * what + a] = (
                    fixed[k, 3 * a] * local[3 * what]
                    + fixed[k, 3 * a + 1] * local[3 * what + 1]
                    + fixed[k, 3 * a + 2] * local[3 * what + 2]
                )
        if 1 <= k <= joints:
            turned(placed, align[k - 1], link[k])
        else:
            for a in range(12):
                link[k, a] = placed[a]
    none = np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    for a in range(12):
        for i in range(WIDE):
            frames[a * WIDE + i], frames[(12 + a) * WIDE + i] = none[a], link[0, a]


@part()
def screws_of(
    which: Index, full: Array, free: Index, sliding: Index, stands: Array, link: Array, ways: Array,
    frames: Array, places: Array, moved: Array, seen: Array, screws: Array, to: int, live: int,
) -> None:  # fmt: skip
    """Write of the first `live` postures `which` what is seen, and their screws to ``screws[to ...]``, (3 or 6, dim).

    A screw is the shift [mm] of the target and, where there is room, its turn. `frames`, `places` and `moved`,
    (J + 2) x 12, (J + 2) x 3 and 6 x dim times WIDE, are room.
    """
    joints, rows, dim = sliding.size, screws.shape[1], free.size
    _walk(which, full, sliding, stands, link, frames, places, seen, live)
    end = (joints + 1) * 3 * WIDE
    for c in range(dim):
        f = free[c]
        k = 0 if f < 6 else (f - 6) // 8 + 1
        what = f if f < 6 else (f - 6) % 8
        at, by = 12 * k * WIDE, 3 * dim * WIDE  # from the shifts to the turns
        out = c * WIDE
        if what < 6:
            x, y, z = ways[k, 3 * what], ways[k, 3 * what + 1], ways[k, 3 * what + 2]
        else:  # z behind the link
            x, y, z = link[k, 2], link[k, 5], link[k, 8]
        if what == 6:
            gain = full[13 + 8 * (k - 1), 0]
            x, y, z = gain * x, gain * y, gain * z
        slides = what < 3 or (what > 5 and sliding[k - 1] == 1)
        if slides:
            _along(frames, at, x, y, z, moved, out, dim)
        else:
            _about(frames, at, x, y, z, places, 3 * k * WIDE, end, moved, out, dim)
        if rows == 6:
            if slides:
                for a in range(3):
                    for i in range(WIDE):
                        moved[by + (a * dim + c) * WIDE + i] = 0.0
            else:
                _along(frames, at, x, y, z, moved, by + out, dim)
        if what == 7:
            zero = full[12 + 8 * (k - 1), 0]
            for a in range(rows):
                for i in range(WIDE):
                    moved[(a * dim + c) * WIDE + i] *= stands[which[i], k - 1] + zero
    for i in range(live):
        for a in range(rows):
            for c in range(dim):
                screws[to + i, a, c] = moved[(a * dim + c) * WIDE + i]


@part()
def _walk(
    which: Index, full: Array, sliding: Index, stands: Array, link: Array, frames: Array, places: Array, seen: Array,
    live: int,
) -> None:  # fmt: skip
    """Write the frames before each link, the places of the placements, and what is seen of the targets."""
    joints = sliding.size
    c, s = np.empty(WIDE), np.empty(WIDE)
    for a in range(3):
        for i in range(WIDE):
            places[a * WIDE + i] = frames[(21 + a) * WIDE + i]
    for k in range(1, joints + 2):
        at, to = 12 * k * WIDE, 12 * (k + 1) * WIDE
        for a in range(3):
            for b in range(3):
                x, y, z = link[k, b], link[k, 3 + b], link[k, 6 + b]
                _along_one(frames, at + 3 * a * WIDE, x, y, z, frames, to + (3 * a + b) * WIDE)
            _along_one(frames, at + 3 * a * WIDE, link[k, 9], link[k, 10], link[k, 11], frames, to + (9 + a) * WIDE)
            for i in range(WIDE):
                frames[to + (9 + a) * WIDE + i] += frames[at + (9 + a) * WIDE + i]
                places[(3 * k + a) * WIDE + i] = frames[to + (9 + a) * WIDE + i]
        if k > joints:
            break
        q, zero, gain = k - 1, full[12 + 8 * (k - 1), 0], full[13 + 8 * (k - 1), 0]
        for i in range(WIDE):
            s[i] = gain * (stands[which[i], q] + zero)
        if sliding[q] == 1:
            for a in range(3):
                for i in range(WIDE):
                    frames[to + (9 + a) * WIDE + i] += frames[to + (3 * a + 2) * WIDE + i] * s[i]
            continue
        _circle(c, s)
        for a in range(3):
            for i in range(WIDE):
                u, v = frames[to + 3 * a * WIDE + i], frames[to + (3 * a + 1) * WIDE + i]
                frames[to + 3 * a * WIDE + i] = u * c[i] + v * s[i]
                frames[to + (3 * a + 1) * WIDE + i] = v * c[i] - u * s[i]
    last = 12 * (joints + 2) * WIDE
    for i in range(live):
        for a in range(3):
            seen[which[i], a, 0] = frames[last + (9 + a) * WIDE + i]
            if seen.shape[1] == 9:
                seen[which[i], 3 + a, 0] = frames[last + 3 * a * WIDE + i]
                seen[which[i], 6 + a, 0] = frames[last + (3 * a + 1) * WIDE + i]


@part()
def _along_one(frames: Array, row: int, x: float, y: float, z: float, to: Array, at: int) -> None:
    """Write a row of frames times (x, y, z)."""
    for i in range(WIDE):
        to[at + i] = frames[row + i] * x + frames[row + WIDE + i] * y + frames[row + 2 * WIDE + i] * z


@part()
def _along(frames: Array, at: int, x: float, y: float, z: float, moved: Array, out: int, dim: int) -> None:
    """Write the direction (x, y, z) of the frames as the world sees it."""
    for a in range(3):
        _along_one(frames, at + 3 * a * WIDE, x, y, z, moved, out + a * dim * WIDE)


@part()
def _about(
    frames: Array, at: int, x: float, y: float, z: float, places: Array, place: int, end: int, moved: Array, out: int,
    dim: int,
) -> None:  # fmt: skip
    """Write that direction times the lever from `place` to the target, which is at `end`."""
    step = dim * WIDE
    for i in range(WIDE):
        ux = frames[at + i] * x + frames[at + WIDE + i] * y + frames[at + 2 * WIDE + i] * z
        uy = frames[at + 3 * WIDE + i] * x + frames[at + 4 * WIDE + i] * y + frames[at + 5 * WIDE + i] * z
        uz = frames[at + 6 * WIDE + i] * x + frames[at + 7 * WIDE + i] * y + frames[at + 8 * WIDE + i] * z
        lx = places[end + i] - places[place + i]
        ly = places[end + WIDE + i] - places[place + WIDE + i]
        lz = places[end + 2 * WIDE + i] - places[place + 2 * WIDE + i]
        moved[out + i] = uy * lz - uz * ly
        moved[out + step + i] = uz * lx - ux * lz
        moved[out + 2 * step + i] = ux * ly - uy * lx


@part()
def _circle(c: Array, s: Array) -> None:
    """Write cosines, and in the place of the angles their sines."""
    far = False
    for i in range(WIDE):
        far = far or not abs(s[i]) <= FAR
    if far:
        for i in range(WIDE):
            c[i], s[i] = cos_sin(s[i])
    else:
        for i in range(WIDE):
            c[i], s[i] = near_cos_sin(s[i])
