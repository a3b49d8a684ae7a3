"""Frames of an arm as flat arrays, compiled: nine numbers of a rotation by rows, then three of a place."""

from __future__ import annotations

from typing import cast

import numpy as np

from calibench.core.compilation.compiled import part
from calibench.core.compilation.lanes import cos_sin
from calibench.problems.base import Array

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
