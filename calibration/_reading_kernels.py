"""Residuals of readings from the targets' places and turns, compiled: a group of rows a reading.

A group is (kind, first, second, row): what is compared, of which poses, sockets or planes, and its first residual.

    kind      residuals                                                 values
    POSITION  place less measured place (3)                             x y z
    POSE      the same, then how the target is turned past it (3)       x y z, rotation (9)
    DISTANCE  distance of two targets less the measured one (1)         d
    SOCKET    place less the mean place in its socket (3)               x y z beside it
    GAP       distance of two sockets' mean places less the known (1)   d
    PLANE     distance from a plane (1)                                 -
    PAIR      second target as seen from the first: place and turn (6)  x y z, rotation (9)

A turn of R past the measured M is the vector of (R M' - M R') / 2: its length is the sine of the angle, without a
branch. Rows are multiplied with `weight`, (groups, 2): of lengths, and of turns [mm/rad].

A socket's point is unknown and linear in all that is seen of it: its least squares value is the mean, and so it needs
no place in x. A plane's normal is ``planes[k]`` (normal, two directions across, 9 numbers) tilted by two parameters;
the third is its height.

With a finite `limit` c a group of length s counts as c sqrt(log(1 + s^2 / c^2)): as it is where small, and hardly more
where wild (Cauchy's function of the whole reading, so that no direction is preferred).
"""

from __future__ import annotations

import math

import numpy as np

from calibench.calibration._screw_kernels import ALONE
from calibench.calibration.rigid import Array, Index
from calibench.core.compilation.compiled import part

POSITION, POSE, DISTANCE, SOCKET, GAP, PLANE, PAIR = range(7)
ROWS = (3, 6, 1, 3, 1, 1, 6)


@part()
def total_of(
    full: Array, seen: Array, i: int, groups: Index, values: Array, weight: Array, planes: Array, sockets: int,
    limit: float, r: Array,
) -> float:  # fmt: skip
    """Return the sum of squared residuals of lane i; they are written to r."""
    rows_of(full, seen, i, groups, values, weight, planes, sockets, limit, r)
    total = 0.0
    for k in range(r.size):
        total += r[k] * r[k]
    return total


@part()
def rows_of(
    full: Array, seen: Array, i: int, groups: Index, values: Array, weight: Array, planes: Array, sockets: int,
    limit: float, r: Array,
) -> None:  # fmt: skip
    """Write the residuals of lane i to r."""
    mean, turned = np.zeros((sockets, 3)), np.empty(9)
    if sockets > 0:
        _means(seen, i, groups, mean)
    for g in range(groups.shape[0]):
        kind, a, b, row = groups[g, 0], groups[g, 1], groups[g, 2], groups[g, 3]
        _group(full, seen, i, kind, a, b, values[g], weight[g], planes, mean, turned, r[row : row + 6])
        if limit < math.inf:
            _tamed(r[row : row + _count(kind)], limit)


@part()
def _group(
    full: Array, seen: Array, i: int, kind: int, a: int, b: int, values: Array, weight: Array, planes: Array,
    mean: Array, turned: Array, r: Array,
) -> None:  # fmt: skip
    """Write the residuals of one group to the beginning of r."""
    if kind in (POSITION, POSE):
        for c in range(3):
            r[c] = weight[0] * (seen[a, c, i] - values[c])
        if kind == POSE:
            _rotation(seen, a, i, turned)
            _turned_past(turned, values[3:], weight[1], r[3:6])
    elif kind == SOCKET:
        for c in range(3):
            r[c] = weight[0] * (seen[a, c, i] - mean[b, c] - values[c])
    elif kind == PLANE:
        at = full.shape[0] - 3 * planes.shape[0] + 3 * b
        height, length = -full[at + 2, i], 0.0
        for c in range(3):
            normal = planes[b, c] + full[at, i] * planes[b, 3 + c] + full[at + 1, i] * planes[b, 6 + c]
            height += normal * seen[a, c, i]
            length += normal * normal
        r[0] = weight[0] * height / math.sqrt(length)
    elif kind == PAIR:
        _seen_from(seen, a, b, i, turned, r)
        for c in range(3):
            r[c] = weight[0] * (r[c] - values[c])
        _turned_past(turned, values[3:], weight[1], r[3:6])
    else:
        apart = 0.0
        for c in range(3):
            step = seen[b, c, i] - seen[a, c, i] if kind == DISTANCE else mean[b, c] - mean[a, c]
            apart += step * step
        r[0] = weight[0] * (math.sqrt(apart) - values[0])


@part()
def reads_alone(groups: Index) -> bool:
    """Tell whether each reading is of one posture alone."""
    for g in range(groups.shape[0]):
        if not (groups[g, 0] == POSITION or groups[g, 0] == POSE or groups[g, 0] == PLANE):
            return False
    return True


@part()
def means_of(seen: Array, screws: Array, groups: Index, mean: Array, moved: Array) -> None:
    """Write the mean place in each socket, (sockets, 3), and its slopes, (sockets, 3, dim)."""
    if mean.shape[0] > 0:
        _means(seen, ALONE, groups, mean)
        _mean_slopes(screws, groups, moved)


@part()
def slopes_of(
    full: Array, free: Index, seen: Array, screws: Array, at: int, g: int, groups: Index, values: Array,
    weight: Array, planes: Array, mean: Array, moved: Array, limit: float, result: Array,
) -> None:  # fmt: skip
    """Write the slopes of group g to `result`, shape (size, dim), from the `screws` of the targets, (n, 3 or 6, dim).

    Those of the first posture of the group are ``screws[at]``.
    """
    dim = free.size
    kind, a, b, row = groups[g, 0], groups[g, 1], groups[g, 2], groups[g, 3]
    if kind in (POSITION, POSE):
        w = weight[g, 0]
        for c in range(3):
            for d in range(dim):
                result[row + c, d] = w * screws[at, c, d]
        if kind == POSE:
            turned = np.empty(9)
            _rotation(seen, a, ALONE, turned)
            _turn_slopes(turned, values[g, 3:], weight[g, 1], screws[at, 3:], result[row + 3 : row + 6])
    elif kind == SOCKET:
        for c in range(3):
            for d in range(dim):
                result[row + c, d] = weight[g, 0] * (screws[a, c, d] - moved[b, c, d])
    elif kind == PLANE:
        _plane_slopes(full, free, seen, a, b, planes, weight[g, 0], screws[at], result[row : row + 1])
    elif kind == PAIR:
        _pair_slopes(seen, a, b, values[g], weight[g], screws, result[row : row + 6])
    elif kind == DISTANCE:
        _distance_slopes(seen[a, :3, 0], seen[b, :3, 0], weight[g, 0], screws[a], screws[b], result[row])
    else:
        _distance_slopes(mean[a], mean[b], weight[g, 0], moved[a], moved[b], result[row])
    if limit < math.inf:
        r, turned = np.empty(6), np.empty(9)
        _group(full, seen, ALONE, kind, a, b, values[g], weight[g], planes, mean, turned, r)
        _tame(r[: _count(kind)], limit, result[row : row + _count(kind)])


@part()
def _distance_slopes(first: Array, second: Array, weight: float, from_: Array, to: Array, j: Array) -> None:
    """Write the slopes of the distance of two places, (dim,), from those of the places, (3 or more, dim)."""
    apart = 0.0
    for c in range(3):
        apart += (second[c] - first[c]) * (second[c] - first[c])
    apart = math.sqrt(apart)
    for d in range(j.size):
        along = 0.0
        for c in range(3):
            along += (second[c] - first[c]) * (to[c, d] - from_[c, d])
        j[d] = weight * along / apart


@part()
def _count(kind: int) -> int:
    return 6 if kind in (POSE, PAIR) else 3 if kind in (POSITION, SOCKET) else 1


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
def _mean_slopes(screws: Array, groups: Index, moved: Array) -> None:
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
def _turned_past(turned: Array, measured: Array, weight: float, r: Array) -> None:
    for c in range(3):
        a, b = (c + 1) % 3, (c + 2) % 3
        r[c] = 0.5 * weight * (_entry(turned, measured, b, a) - _entry(turned, measured, a, b))


@part()
def _turn_slopes(turned: Array, measured: Array, weight: float, turns: Array, j: Array) -> None:
    """Write the slopes of `_turned_past`: with Q = R M' and dR = [w] R they are (tr(Q) I - Q) w / 2."""
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
def _seen_from(seen: Array, a: int, b: int, i: int, turned: Array, place: Array) -> None:
    """Write rotation, (9,), and place, (3,), of target b as seen from target a."""
    first, second = np.empty(9), np.empty(9)
    _rotation(seen, a, i, first)
    _rotation(seen, b, i, second)
    for c in range(3):
        place[c] = 0.0
        for k in range(3):
            place[c] += first[3 * k + c] * (seen[b, k, i] - seen[a, k, i])
            turned[3 * c + k] = first[c] * second[k] + first[3 + c] * second[3 + k] + first[6 + c] * second[6 + k]


@part()
def _pair_slopes(seen: Array, a: int, b: int, values: Array, weight: Array, screws: Array, j: Array) -> None:
    """Write the slopes of a pair, (6, dim): R_a' of the differences in place and turn."""
    first, turned, place, dim = np.empty(9), np.empty(9), np.empty(3), j.shape[1]
    turns = np.empty((3, dim))
    _seen_from(seen, a, b, ALONE, turned, place)
    _rotation(seen, a, ALONE, first)
    lx, ly, lz = seen[b, 0, 0] - seen[a, 0, 0], seen[b, 1, 0] - seen[a, 1, 0], seen[b, 2, 0] - seen[a, 2, 0]
    for d in range(dim):
        wx, wy, wz = screws[a, 3, d], screws[a, 4, d], screws[a, 5, d]
        sx = screws[b, 0, d] - screws[a, 0, d] - (wy * lz - wz * ly)
        sy = screws[b, 1, d] - screws[a, 1, d] - (wz * lx - wx * lz)
        sz = screws[b, 2, d] - screws[a, 2, d] - (wx * ly - wy * lx)
        tx, ty, tz = screws[b, 3, d] - wx, screws[b, 4, d] - wy, screws[b, 5, d] - wz
        for c in range(3):
            j[c, d] = weight[0] * (first[c] * sx + first[3 + c] * sy + first[6 + c] * sz)
            turns[c, d] = first[c] * tx + first[3 + c] * ty + first[6 + c] * tz
    _turn_slopes(turned, values[3:], weight[1], turns, j[3:])


@part()
def _plane_slopes(
    full: Array, free: Index, seen: Array, a: int, b: int, planes: Array, weight: float, screws: Array, j: Array
) -> None:
    at = full.shape[0] - 3 * planes.shape[0] + 3 * b
    normal, length, height = np.empty(3), 0.0, -full[at + 2, 0]
    for c in range(3):
        normal[c] = planes[b, c] + full[at, 0] * planes[b, 3 + c] + full[at + 1, 0] * planes[b, 6 + c]
        length += normal[c] * normal[c]
        height += normal[c] * seen[a, c, 0]
    size = math.sqrt(length)
    for d in range(j.shape[1]):
        own = free[d] - at
        slope = -1.0 if own == 2 else 0.0
        for c in range(3):
            slope += normal[c] * screws[c, d]
            if own == 0 or own == 1:
                across = planes[b, 3 + 3 * own + c]
                slope += across * (seen[a, c, 0] - height * normal[c] / length)
        j[0, d] = weight * slope / size


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
