"""Where tracker and target stand, from nothing but readings: the start of every calibration, in closed form.

A target at t on the last link of an arm, whose nominal pose is (R_i, f_i) in the base, is read at p_i. With B the
rotation of the tracker's frame into the base, B p_i + c = R_i t + f_i is linear in B, c and t: 15 numbers. The scale of
B is the unit of the readings. A ball in sockets has R_i t + f_i = s_k. Wild readings are kept out by the least median.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import final

import numpy as np

from calibench.calibration.rigid import Array, Index, Numbers
from calibench.core.words import plain

TWO_TARGETS = "a column target tells which rows read which, 1 or 2"
LEAST = 5  # poses: 15 equations for 15 numbers
_HANDFUL, _HANDFULS = 8, 300
_WORST = 1e10  # condition of normal equations that are solved as they are
_FAR = 6.0  # times the median of what is left: a reading beyond it has no influence on the frames


@final
@dataclass(frozen=True, eq=False)
class Frames:
    """`base` (4, 4) places the arm's base in the tracker's frame, p = base (R t + f); `tool` leads from tip to target.

    `scale` turns the readings' unit into mm. `mirrored`: only a left-handed frame fits. `apart` is the median distance
    [mm] between readings and arm, `reach` the arm's spread [mm]. `near` (n,) marks poses that had a say.
    """

    base: Array
    tool: Array
    scale: float
    mirrored: bool
    apart: float
    reach: float
    near: Numbers


def frames_of_positions(poses: Array, read: Array, scale: float = 0.0) -> Frames:
    """Return the frames from nominal `poses` (n, 4, 4) [mm] and positions `read` (n, 3), times `scale` mm, or 0."""
    n = len(poses)
    if n < LEAST:
        raise ValueError(f"{n} poses are too few to find the frames: {LEAST} at least, and 20 to calibrate, are needed")
    middle = np.median(read, axis=0)
    spread = float(np.median(np.sqrt(((read - middle) ** 2).sum(axis=1)))) or 1.0  # whatever wild readings are
    rows = equations(poses, (read - middle) / spread)
    wanted, near = poses[:, :3, 3], np.ones(n, dtype=bool)
    if n > 2 * LEAST:
        solved, near = _least_median(rows, wanted)
    else:
        solved = np.linalg.lstsq(rows.reshape(-1, 15), wanted.ravel(), rcond=1e-9)[0]
    u, sizes, vt = np.linalg.svd(solved[:9].reshape(3, 3) / spread)
    mirrored = bool(np.linalg.det(u @ vt) < 0 and sizes[2] > 0.2 * sizes[1])
    turn = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt).T
    scale = scale or float(np.sqrt(sizes[0] * sizes[1]))

    # rotation and shift of the base, and the target on the tip, from `turn` on: along an axis about which alone the
    # tip turns nothing tells where the target is, and there it is at the tip
    base, tool, some, places = np.eye(4), np.eye(4), poses[near], scale * read[near]
    middle = some[:, :3, :3].mean(axis=0)
    for _ in range(20):
        rest = places - some[:, :3, 3] @ turn.T
        about = rest - rest.mean(axis=0)
        turned = (turn @ (some[:, :3, :3] - middle)).reshape(-1, 3)
        target = np.linalg.lstsq(turned, about.ravel(), rcond=1e-9)[0]
        base[:3, 3] = rest.mean(axis=0) - turn @ middle @ target
        there = some[:, :3, :3] @ target + some[:, :3, 3]
        before, turn = turn, nearest_rotation((places - places.mean(axis=0)).T @ (there - there.mean(axis=0)))
        if float(np.abs(turn - before).max()) < 1e-6:
            break
    base[:3, :3], tool[:3, 3] = turn, target
    apart = np.sqrt(((scale * read - (base @ poses @ tool)[:, :3, 3]) ** 2).sum(axis=1))
    reach = float(np.sqrt(((wanted - wanted.mean(axis=0)) ** 2).sum(axis=1).mean()))
    return Frames(
        base=base, tool=tool, scale=scale, mirrored=mirrored, apart=float(np.median(apart)), reach=reach, near=near
    )


def tool_rotation(poses: Array, base: Array, turns: Array) -> tuple[Numbers, float]:
    """Return the rotation (3, 3) from tip to target, and the median angle [rad] of single poses from it."""
    single = np.einsum("nji,kj,nkl->nil", poses[:, :3, :3], base[:3, :3], turns)
    keep = np.ones(len(single), dtype=bool)
    for _ in range(3):
        mean = nearest_rotation(single[keep].mean(axis=0))
        angle = angle_between(single, mean)
        keep = angle <= max(_FAR * float(np.median(angle)), 1e-9)
    return mean, float(np.median(angle))


def ball_in_sockets(poses: Array, group: Numbers) -> tuple[Numbers, Numbers, float]:
    """Return the ball (3,) on the last link, the sockets (k, 3) in the base, and what is left, rms [mm]."""
    count = int(group.max()) + 1
    rows = np.zeros((len(poses), 3, 3 + 3 * count))
    rows[:, :, :3] = poses[:, :3, :3]
    for axis in range(3):
        rows[np.arange(len(poses)), axis, 3 + 3 * group + axis] = -1.0
    flat, wanted = rows.reshape(-1, rows.shape[2]), -poses[:, :3, 3].ravel()
    solved = np.linalg.lstsq(flat, wanted, rcond=1e-9)[0]
    rest = (flat @ solved - wanted).reshape(-1, 3)
    return solved[:3], solved[3:].reshape(-1, 3), float(np.sqrt((rest**2).sum(axis=1).mean()))


def nearest_rotation(matrix: Array) -> Array:
    """Return the rotation nearest to each matrix, (..., 3, 3)."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]  # no reflection
    return np.asarray(u @ vt)


def angle_between(turns: Array, mean: Array) -> Array:
    """Return the angle [rad] of each of (n, 3, 3) from `mean` (3, 3)."""
    away = np.linalg.norm(turns - mean, axis=(1, 2)) / np.sqrt(8.0)
    return np.asarray(2 * np.arcsin(np.minimum(away, 1.0)))


def equations(poses: Array, read: Array) -> Array:
    """Return the coefficients of B by rows, c and t, (n, 3, 15), of poses (n, 4, 4) and what was read (n, 3)."""
    rows = np.zeros((len(poses), 3, 15))
    for axis in range(3):
        rows[:, axis, 3 * axis : 3 * axis + 3] = read
        rows[:, axis, 9 + axis] = 1.0
    rows[:, :, 12:] = -poses[:, :3, :3]
    return rows


_SHOWN = 3000  # poses


def _least_median(rows: Array, wanted: Array) -> tuple[Numbers, Numbers]:
    """Return the numbers that leave the least median, refined on the poses near to it, and which these are."""
    some = np.linspace(0, len(rows) - 1, min(len(rows), _SHOWN)).astype(np.int64)  # of many, as many show the median
    shown, there = rows[some], wanted[some]
    picks = handfuls(len(rows), len(some), _HANDFULS, _HANDFUL, 15)
    tried = _solved(shown[picks].reshape(_HANDFULS, -1, 15), there[picks].reshape(_HANDFULS, -1, 1))[:, :, 0]
    best = tried[np.argmin(np.median(((shown @ tried.T - there[:, :, None]) ** 2).sum(axis=1), axis=0))]
    before, near = np.zeros(0, dtype=bool), np.ones(len(rows), dtype=bool)
    for _ in range(5):
        apart = np.sqrt(((rows @ best - wanted) ** 2).sum(axis=1))
        near = apart <= max(_FAR * float(np.median(apart)), 1e-9)
        if np.array_equal(near, before):  # and so is all that follows from it
            break
        before = near
        best = np.linalg.lstsq(rows[near].reshape(-1, 15), wanted[near].ravel(), rcond=1e-9)[0]
    return best, near


@lru_cache(32)
def handfuls(n: int, shown: int, count: int, size: int, seed: int) -> Index:
    """Return so many handfuls of this `size` of those that are `shown` of n, (count, size), the same ones each time."""
    rng = np.random.default_rng(np.random.SeedSequence([n, seed]))
    return np.asarray(np.argsort(rng.random((count, shown)), axis=1)[:, :size])


def _solved(rows: Array, wanted: Array) -> Array:
    """Return the least squares solutions, (k, 15, 1), of handfuls (k, m, 15) that want (k, m, 1), the shortest each."""
    # normal equations, corrected once, take a quarter of the time of singular values
    turned = np.swapaxes(rows, 1, 2)
    square = turned @ rows
    try:
        inverse = np.linalg.inv(square)
    except np.linalg.LinAlgError:  # one of them is singular to the last bit
        return np.asarray(np.linalg.pinv(rows, rcond=1e-9) @ wanted)
    solved = inverse @ (turned @ wanted)
    solved += inverse @ (turned @ (wanted - rows @ solved))
    open_ = ~(np.linalg.norm(square, axis=(1, 2)) * np.linalg.norm(inverse, axis=(1, 2)) < _WORST)
    if open_.any():
        solved[open_] = np.linalg.pinv(rows[open_], rcond=1e-9) @ wanted[open_]
    return np.asarray(solved)


_MANY = 0.05  # of the poses: so many are no wild readings
_AGREE = 0.7  # of them have a say in frames of their own
_AS_NEAR = 4.0  # times what the others leave
_ELSEWHERE = 10.0  # times what the others leave: base and target lie further apart than frames are found to


def moved(poses: Array, read: Array, frames: Frames) -> tuple[Array, str]:
    """Return which poses were read from another stand than `frames`, (n,), and in words what was moved, or ""."""
    far = ~np.asarray(frames.near, dtype=bool)
    none = np.zeros(len(poses), dtype=bool), ""
    if far.sum() <= max(3 * LEAST, _MANY * len(poses)):
        return none
    other = frames_of_positions(poses[far], read[far], 1.0)
    size = max(frames.apart, other.apart)
    if other.mirrored or other.apart > _AS_NEAR * max(frames.apart, 1e-6) or np.mean(other.near) < _AGREE:
        return none
    base = float(np.linalg.norm(frames.base[:3, 3] - other.base[:3, 3]))
    turn = float(np.linalg.norm(frames.base[:3, :3] - other.base[:3, :3])) * other.reach
    if max(base, turn) > _ELSEWHERE * size:
        return far, f"the tracker, or the base, stands {plain(base, 3)} mm elsewhere; use what was read from one stand"
    tool = float(np.linalg.norm(frames.tool[:3, 3] - other.tool[:3, 3]))
    if tool > _ELSEWHERE * size:
        return far, f"the target sits {plain(tool, 3)} mm elsewhere on its link; {TWO_TARGETS}"
    return none
