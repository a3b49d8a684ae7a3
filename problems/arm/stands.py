"""Whether all poses were read from one stand: a tracker that was moved halfway makes two calibrations out of one table.

Frames are found by the poses that agree (`frames`). Where many do not, and these agree among themselves with the base
or the target elsewhere, something was moved, and no base fits them all: they are told apart before anything is fitted.
"""

from __future__ import annotations

import numpy as np

from calibench.core.words import plain
from calibench.problems.arm.frames import LEAST, Frames, frames_of_positions
from calibench.problems.base import Array

_MANY = 0.05  # of the poses: so many are no wild readings
_AGREE = 0.7  # of them have a say in frames of their own
_AS_NEAR = 4.0  # times what the others leave
_EDGE = 8  # poses before and after a step, at the least
_PLAIN = 0.5  # of what a calibration leaves, in squares: a step that explains as much is told
_ELSEWHERE = 10.0  # times what the others leave: base and target lie further apart than frames are found to


def moved(poses: Array, read: Array, found: Frames) -> tuple[Array, str]:
    """Return which poses were read from another stand than `found`, (n,), and in words what was moved: "" if nothing.

    `poses` (n, 4, 4) are those of the nominal arm, `read` (n, 3) the positions; both mm.
    """
    far = ~np.asarray(found.near, dtype=bool)
    none = np.zeros(len(poses), dtype=bool), ""
    if far.sum() <= max(3 * LEAST, _MANY * len(poses)):
        return none
    other = frames_of_positions(poses[far], read[far], 1.0)
    size = max(found.left, other.left)
    if other.mirrored or other.left > _AS_NEAR * max(found.left, 1e-6) or np.mean(other.near) < _AGREE:
        return none
    base = float(np.linalg.norm(found.base[:3, 3] - other.base[:3, 3]))
    turn = float(np.linalg.norm(found.base[:3, :3] - other.base[:3, :3])) * other.reach
    if max(base, turn) > _ELSEWHERE * size:
        return far, f"the tracker, or the base, stands {plain(base, 3)} mm elsewhere"
    tool = float(np.linalg.norm(found.tool[:3, 3] - other.tool[:3, 3]))
    if tool > _ELSEWHERE * size:
        return far, f"the target sits {plain(tool, 3)} mm elsewhere on the tool"
    return none


def stepped(left: Array, seen: Array) -> tuple[int, float, float] | None:
    """Return the row from which on base or tracker lies elsewhere, by how much its poses do (rms) [mm], and the share.

    The last is that of the squares of what is left which the step explains.

    `left` (n, 3) [mm] is what a calibration leaves of the places `seen` (n, 3) [mm], in the order in which they were
    read. A motion of a body before each row and another one after it are tried; None where none explains `_PLAIN`.
    """
    n = len(left)
    if n < 2 * _EDGE + 1:
        return None
    about = (seen - seen.mean(axis=0)) / max(float(np.ptp(seen)), 1e-9)
    rows = np.zeros((n, 3, 6))
    rows[:, range(3), range(3)] = 1.0
    for k, axis in enumerate(np.eye(3)):
        rows[:, :, 3 + k] = np.cross(axis, about)
    square = np.cumsum(rows.swapaxes(1, 2) @ rows, axis=0)
    pull = np.cumsum(np.einsum("nci,nc->ni", rows, left), axis=0)
    best, found = 0.0, None
    for k in range(_EDGE, n - _EDGE):
        before = np.linalg.pinv(square[k - 1]) @ pull[k - 1]
        after = np.linalg.pinv(square[-1] - square[k - 1]) @ (pull[-1] - pull[k - 1])
        share = float(before @ pull[k - 1] + after @ (pull[-1] - pull[k - 1])) / float((left**2).sum())
        if share > max(best, _PLAIN):
            best, found = share, (k, float(np.sqrt(((rows @ (after - before)) ** 2).sum(axis=1).mean())), share)
    return found
