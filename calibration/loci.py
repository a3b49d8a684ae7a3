"""Where a reading allows the target to be: at a point, on a line, on a plane, on a sphere.

Three axes leave a point, two a line, one a plane; a distance leaves a sphere about a fixed point, and what touches a
flat table lies in its plane. The residual is the vector from the nearest such place to the target, which is all that a
fit needs: its slope is that of the target, projected across the locus. Fixed points and tables that nobody states are
three numbers each, in the measuring frame: base_x_A, base_y_A, base_z_A of a point A, base_z_T, base_rx_T, base_ry_T of
a table T.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np
from scipy.optimize import least_squares

from calibench.calibration.frames import nearest_rotation
from calibench.calibration.rigid import Array, Index, Mask, rpy, shift

AXES, DISTANCE, PLANE = 0, 1, 2  # kinds of readings, each with a noise of its own
KINDS = ("axes", "distance", "plane")
_FAR = 6.0  # times the median of what is left: a reading beyond has no influence on a start
_ROUNDS = 4
_OUT = 150.0  # mm: where on the last link a target is looked for
_LEAST = 6  # readings of a fixed point or table, at the least
_KEPT = 4  # starts that are followed


@final
@dataclass(frozen=True, eq=False)
class Fixture:
    """A fixed point, or a table, of this `name`, at `frame` (4, 4) [mm] in the measuring frame, its z across a table.

    A `stated` place is kept.
    """

    name: str
    kind: int
    frame: Array
    stated: bool = False

    @property
    def words(self) -> str:
        """Return how messages call it: point A, plane table."""
        return f"{'point' if self.kind == DISTANCE else 'plane'} {self.name}"

    @property
    def numbers(self) -> tuple[str, ...]:
        """Return the names of its numbers, which are small."""
        ways = () if self.stated else ("x", "y", "z") if self.kind == DISTANCE else ("z", "rx", "ry")
        return tuple(f"base_{way}_{self.name}" for way in ways)


@final
@dataclass(frozen=True, eq=False)
class Loci:
    """What n readings allow: `fixture` (n,) is the place in `fixtures`, -1 where axes were read; `length` (n,) [mm]."""

    fixture: Index
    length: Array
    fixtures: tuple[Fixture, ...]

    def at(self, keep: Mask | Index) -> "Loci":
        """Return the loci of some readings."""
        return replace(self, fixture=self.fixture[keep], length=self.length[keep])

    def points(self, count: int) -> "Loci":
        """Return the loci of as many readings of whole places, beside the same fixtures."""
        return replace(self, fixture=np.full(count, -1, dtype=np.int64), length=np.full(count, np.nan))

    @property
    def kind(self) -> Index:
        """Return the kind of each reading, (n,)."""
        return np.array([AXES, *(one.kind for one in self.fixtures)], dtype=np.int64)[self.fixture + 1]

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the numbers of all fixtures."""
        return tuple(name for one in self.fixtures for name in one.numbers)

    def counted(self, read: Array) -> Array:
        """Return how many numbers each reading is, (n,): the axes of `read` (n, 3), or one."""
        return np.where(self.fixture < 0, np.isfinite(read).sum(axis=1), 1).astype(float)

    def words(self, read: Array) -> str:
        """Return in words what was read: x, z, and distances from 2 points."""
        axes = ["xyz"[k] for k in np.flatnonzero(np.isfinite(read).any(axis=0))]
        words = [", ".join(axes)] if axes else []
        for kind, one, several in ((DISTANCE, "a distance", "distances from {}"), (PLANE, "a plane", "{} planes")):
            if count := sum(fixture.kind == kind for fixture in self.fixtures):
                words.append(one if count == 1 else several.format(f"{count} points" if kind == DISTANCE else count))
        return " and ".join(words)

    def frames(self, numbers: Array) -> dict[str, Array]:
        """Return what is fixed, "point A" or "plane T", at its `numbers` (m,): frames (4, 4) in the measuring frame."""
        made, first = {}, 0
        for one in self.fixtures:
            moved = numbers[first : (first := first + len(one.numbers))]
            if len(moved):
                x, y, z, rx, ry = (*moved, 0.0, 0.0) if one.kind == DISTANCE else (0.0, 0.0, *moved)
                frame = one.frame @ shift(x, y, z) @ rpy(rx, ry, 0.0)
            made[one.words] = frame if len(moved) else one.frame
        return made

    def residuals(self, places: Array, read: Array, numbers: Array) -> tuple[Array, Array, Array]:
        """Return vectors (n, 3) from the nearest allowed place to `places` (n, 3), the projections across the locus,

        (n, 3, 3), and the slopes of the vectors in the `numbers` (m,) of the fixtures, (n, 3, m).
        """
        known = np.isfinite(read)
        off = np.where(known, places - read, 0.0)
        across = known[:, :, None] * np.eye(3)
        slopes, first = np.zeros((len(places), 3, len(numbers))), 0
        for k, one in enumerate(self.fixtures):
            there, mine = self.fixture == k, slice(first, first + len(one.numbers))
            first, moved = mine.stop, numbers[mine]
            far = places[there] - one.frame[:3, 3]
            if one.kind == DISTANCE:
                far = far - (moved if len(moved) else 0.0)
                size = np.linalg.norm(far, axis=1)
                normal = far / np.maximum(size, 1e-9)[:, None]
                over, by = size - self.length[there], -normal
            else:
                shift, rx, ry = moved
                leant = one.frame[:3, :3] @ [ry, -rx, 1.0]
                size = float(np.linalg.norm(leant))
                normal = np.broadcast_to(leant / size, far.shape)
                over = far @ (leant / size) - shift
                level = (far - (far @ (leant / size))[:, None] * normal) / size @ one.frame[:3, :2]
                by = np.column_stack([-np.ones(len(far)), -level[:, 1], level[:, 0]])
            off[there], across[there] = over[:, None] * normal, normal[:, :, None] * normal[:, None, :]
            if len(moved):
                slopes[there, :, mine] = normal[:, :, None] * by[:, None, :]
        return off, across, slopes


def place(
    poses: Array, read: Array, loci: Loci, frames: tuple[Array, Array] | None = None, followed: int = _KEPT
) -> tuple[Array, Array, Loci, float]:
    """Return base and tool (4, 4), loci with fixtures at their places, and what is left, median [mm]: of a start by

    nominal `poses` (n, 4, 4) and what was `read`, in mm.

    For a target on the tip each fixture and each axis is linear; three numbers are left, the target's, for which some
    starts are tried, and the best `followed`. `frames` are known base and tool. Raises `ValueError` for too few
    readings of a fixture.
    """
    for k, one in enumerate(loci.fixtures):
        if (count := int((loci.fixture == k).sum())) < _LEAST:
            what = f"distances to {one.name}" if one.kind == DISTANCE else f"points of plane {one.name}"
            raise ValueError(f"{count} {what} are too few: {_LEAST} at the least")
    near = np.ones(len(poses), dtype=bool)
    if frames is not None:
        there = (frames[0] @ poses @ frames[1])[:, :3, 3]
        made = _solve(there, read, loci, near, np.eye(4))
        return *frames, made.loci, made.apart

    def at(target: Array) -> Array:
        return np.asarray(poses[:, :3, :3] @ target + poses[:, :3, 3])

    def rest(target: Array) -> Array:
        return _solve(at(target), read, loci, near).off[near].ravel()

    sides = np.array(np.meshgrid(*[[-_OUT, 0.0, _OUT]] * 3)).reshape(3, -1).T
    starts = sorted(sides, key=lambda side: _solve(at(side), read, loci, near).apart)[:followed]
    best = min(
        (least_squares(rest, start, loss="soft_l1", f_scale=1.0, x_scale=_OUT) for start in starts),
        key=lambda found: found.cost,
    ).x
    for _ in range(_ROUNDS):
        left = np.linalg.norm(_solve(at(best), read, loci, near).off, axis=1)
        before, near = near, left <= max(_FAR * float(np.median(left)), 1e-6)
        if np.array_equal(near, before) or not set(loci.fixture.tolist()) <= set(loci.fixture[near].tolist()):
            near = before
            break
        best = least_squares(rest, best, x_scale=_OUT).x
    made = _solve(at(best), read, loci, near)
    tool = np.eye(4)
    tool[:3, 3] = best
    return made.base, tool, made.loci, made.apart


class _Solved(NamedTuple):
    base: Array
    loci: Loci
    off: Array
    apart: float


def _solve(places: Array, read: Array, loci: Loci, near: Mask, base: Array | None = None) -> _Solved:
    """Return base and fixtures for targets at `places` (n, 3) in the base, and what each reading is off, (n, 3)."""
    axes = (loci.fixture < 0) & np.isfinite(read).any(axis=1)
    spheres = {}  # the point (3,) from which places are as far as was read: p p - d d = 2 c p - (c c)
    for k in (k for k, one in enumerate(loci.fixtures) if one.kind == DISTANCE):
        mine = (loci.fixture == k) & near
        middle = places[mine].mean(axis=0)
        about = places[mine] - middle
        size = float(np.sqrt((about**2).mean())) or 1.0
        rows = np.column_stack([2 * about, np.full(len(about), -size)])
        wanted = (about**2).sum(axis=1) - loci.length[mine] ** 2
        spheres[k] = np.linalg.lstsq(rows, wanted, rcond=1e-9)[0][:3] + middle
    if base is None:
        stated = [k for k in spheres if loci.fixtures[k].stated]
        base = np.eye(4)
        if axes.any():
            base = _base_of_axes(places[axes & near], read[axes & near])
        elif stated:
            # the least turn of all rigid transforms that bring the points nearest to where they are stated
            points = np.array([spheres[k] for k in stated])
            there = np.array([loci.fixtures[k].frame[:3, 3] for k in stated])
            middle, goal = points.mean(axis=0), there.mean(axis=0)
            if len(points) > 1:
                base[:3, :3] = nearest_rotation((there - goal).T @ (points - middle))
            base[:3, 3] = goal - base[:3, :3] @ middle
    turn, shift = base[:3, :3], base[:3, 3]
    seen = places @ turn.T + shift
    fixtures = []
    for k, one in enumerate(loci.fixtures):
        frame = np.eye(4)
        if one.stated:
            frame = one.frame
        elif one.kind == DISTANCE:
            frame[:3, 3] = turn @ spheres[k] + shift
        else:
            mine = seen[(loci.fixture == k) & near]
            frame[:3, 3] = mine.mean(axis=0)
            frame[:3, :3] = np.linalg.svd(mine - frame[:3, 3], full_matrices=False)[2].T
            frame[:3, 0] *= np.linalg.det(frame[:3, :3])
        fixtures.append(replace(one, frame=frame))
    made = replace(loci, fixtures=tuple(fixtures))
    off = made.residuals(seen, read, np.zeros(len(made.names)))[0]
    return _Solved(base, made, off, float(np.median(np.linalg.norm(off, axis=1))))


def _base_of_axes(places: Array, read: Array) -> Array:
    """Return the base (4, 4) by which `places` (n, 3) have the axes that were `read` (n, 3), NaN where none was."""
    base, rows = np.eye(4), {}
    for axis in range(3):
        known = np.isfinite(read[:, axis])
        if known.any():
            middle = places[known].mean(axis=0)
            row = np.linalg.lstsq(places[known] - middle, read[known, axis] - read[known, axis].mean(), rcond=1e-9)[0]
            rows[axis] = row / (float(np.linalg.norm(row)) or 1.0)
    matrix = np.zeros((3, 3))
    for axis, row in rows.items():
        matrix[axis] = row
    u, _, vt = np.linalg.svd(matrix)
    turn = u @ vt
    if np.linalg.det(turn) < 0:
        if len(rows) == 3:
            turn = u @ np.diag([1.0, 1.0, -1.0]) @ vt
        else:  # the way of an axis that was not read is free
            free = next(axis for axis in range(3) if axis not in rows)
            turn[free] = -turn[free]
    base[:3, :3] = turn
    for axis in rows:
        known = np.isfinite(read[:, axis])
        base[axis, 3] = float(np.median(read[known, axis] - places[known] @ turn[axis]))
    return base
