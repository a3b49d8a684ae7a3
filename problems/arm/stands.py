"""Whether all poses were read from one stand: a tracker that was moved halfway makes two calibrations out of one table.

Frames are found by the poses that agree (`frames`). Where many do not, and these agree among themselves with the base
or the target elsewhere, something was moved, and no base fits them all: they are told apart before anything is fitted.
"""

from __future__ import annotations

import numpy as np

from calibench.core.counted import plain
from calibench.problems.arm.frames import LEAST, Frames, frames_of_positions
from calibench.problems.base import Array

_MANY = 0.05  # of the poses: so many are no wild readings
_AGREE = 0.7  # of them have a say in frames of their own
_AS_NEAR = 4.0  # times what the others leave
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
