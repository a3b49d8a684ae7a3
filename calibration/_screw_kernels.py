"""Frames of an arm as flat arrays, compiled: nine numbers of a rotation by rows, then three of a place.

How the targets of one candidate move with each of its parameters, postures side by side in the SIMD lanes.

Behind joint k a frame of the arm is that behind the joint before, through a link that the candidate decides once, and a
turn (or slide) about z by the joint's own motion:

    R_k = R_{k-1} . L_k . Z(s_k),     L_k = fixed_k . placement_k . align_k

A shift along a direction u moves the target by u, a turn about u through a place p by u x (target - p): all that is
needed are the R_k and the places. `WIDE` postures are gone through at once; arrays of them are flat, `WIDE` numbers in
a row for each entry, so that every distance is known when the loops are compiled.
"""

from __future__ import annotations

from typing import cast

import numpy as np

from calibench.calibration.rigid import Array, Index
from calibench.core.compilation.compiled import part
from calibench.core.compilation.lanes import FAR, cos_sin, near_cos_sin

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
        _directions(full, at, local)
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
        if f >= 12 + 8 * joints:  # a plane's
            for a in range(rows):
                for i in range(WIDE):
                    moved[(a * dim + c) * WIDE + i] = 0.0
            continue
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
                _along_one(
                    frames,
                    at + 3 * a * WIDE,
                    link[k, b],
                    link[k, 3 + b],
                    link[k, 6 + b],
                    frames,
                    to + (3 * a + b) * WIDE,
                )
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


@part()
def _directions(full: Array, at: int, local: Array) -> None:
    """Write the unit vectors that a placement's six parameters move along or turn about, (18,), in the frame before."""
    cy, sy = cos_sin(full[at + 4, 0])
    cz, sz = cos_sin(full[at + 5, 0])
    for a in range(18):
        local[a] = 0.0
    local[0] = local[4] = local[8] = local[17] = 1.0
    local[9], local[10], local[11] = cz * cy, sz * cy, -sy
    local[12], local[13] = -sz, cz
