"""A six-axis arm of about the size of a UR10, as its maker built it: own geometry, statics, day in the hall, tracker.

Homogeneous transforms, one after the other, from the tracker's frame to the tool point. No number comes from the
code under test, and nothing imports it. What is wrong with the arm is in `arm6_faults`, a file with its truth in
`arm6_cases`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AXES = "SLURBT"  # the workshop's letters for the joints, from the floor to the flange
# the maker's table, standard Denavit-Hartenberg: turn, offset [mm] along the joint, length [mm] and twist [rad] across
OFFSET = np.array([127.3, 0.0, 0.0, 163.941, 115.7, 92.2])
LENGTH = np.array([0.0, -612.0, -572.3, 0.0, 0.0, 0.0])
TWIST = np.array([np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0])
TOOL = np.array([60.0, 25.0, 140.0])  # mm, from the flange to the reflector
TRACKER = np.array([2400.0, -600.0, 350.0, 0.4, -0.3, 1.1])  # mm, rad: the foot of the arm as the tracker sees it
MASS = np.array([7.1, 12.7, 4.27, 2.0, 2.0, 0.365])  # kg
CENTRE = 0.45  # of each link's mass, as a part of the way back to the joint before
GRAVITY = 9.81e-3  # N m for 1 kg and 1 mm


def turn(axis: int, angle: Array) -> Array:
    """Return rotations about x (0), y (1) or z (2), (..., 4, 4)."""
    made = np.zeros((*np.shape(angle), 4, 4))
    made[..., 3, 3] = made[..., axis, axis] = 1.0
    i, j = (axis + 1) % 3, (axis + 2) % 3
    made[..., i, i] = made[..., j, j] = np.cos(angle)
    made[..., j, i] = np.sin(angle)
    made[..., i, j] = -made[..., j, i]
    return made


def move(along: Array) -> Array:
    """Return translations by (..., 3), as (..., 4, 4)."""
    made = np.broadcast_to(np.eye(4), (*np.shape(along)[:-1], 4, 4)).copy()
    made[..., :3, 3] = along
    return made


@dataclass(frozen=True)
class Build:
    """One arm as it came off the line, with its foot in the tracker's frame: 6 + 5 x 6 + 3 numbers."""

    foot: Array
    zero: Array
    offset: Array
    length: Array
    twist: Array
    skew: Array
    tool: Array

    def vector(self) -> Array:
        """Return all its numbers, (39,)."""
        parts = (self.foot, self.zero, self.offset, self.length, self.twist, self.skew, self.tool)
        return np.concatenate(parts)

    @staticmethod
    def of(v: Array) -> Build:
        """Return the arm of the numbers that `vector` returned."""
        return Build(*np.split(v, [6, 12, 18, 24, 30, 36]))


def nominal() -> Build:
    """Return the arm of the maker's table."""
    none = np.zeros(6)
    return Build(TRACKER, none, OFFSET, LENGTH, TWIST, none, TOOL)


def built(rng: np.random.Generator) -> Build:
    """Return one arm of the line: .5 mm, .7 mrad and 3 mrad of zero off the table, its foot some mm off the plan."""
    plan = nominal()
    return Build(
        plan.foot + np.r_[rng.normal(0, 5.0, 3), rng.normal(0, 5e-3, 3)],
        rng.normal(0, 3e-3, 6),
        plan.offset + rng.normal(0, 0.5, 6) * (plan.offset != 0),
        plan.length + rng.normal(0, 0.5, 6),
        plan.twist + rng.normal(0, 7e-4, 6),
        rng.normal(0, 7e-4, 6) * np.array([0, 1, 1, 0, 0, 0]),
        plan.tool + rng.normal(0, 1.0, 3),
    )


def frames(build: Build, angle: Array, grown: Array | None = None, tilt: Array | None = None) -> list[Array]:
    """Return the frame of each joint before it turns, and of the reflector, seven of (n, 4, 4).

    `angle` (n, 6) is what the joint turns, zero and all; `grown` (n, 6) by what part length and offset of a link are
    longer, `tilt` (n, 6, 2) how far the axis of a joint leans about its own x and y.
    """
    x, y, z, a, b, c = build.foot
    at = move(np.array([x, y, z])) @ turn(2, np.array(c)) @ turn(1, np.array(b)) @ turn(0, np.array(a))
    at = np.broadcast_to(at, (len(angle), 4, 4))
    found = [at]
    longer = np.ones((len(angle), 6)) if grown is None else 1.0 + grown
    for k in range(6):
        if tilt is not None and tilt[:, k].any():
            at = at @ turn(0, tilt[:, k, 0]) @ turn(1, tilt[:, k, 1])
        step = np.zeros((len(angle), 3))
        step[:, 0], step[:, 2] = build.length[k] * longer[:, k], build.offset[k] * longer[:, k]
        at = at @ turn(2, angle[:, k]) @ move(step) @ turn(0, build.twist[k]) @ turn(1, build.skew[k])
        found.append(at)
    found[-1] = at @ move(build.tool)
    return found


def place(build: Build, angle: Array, grown: Array | None = None, tilt: Array | None = None) -> Array:
    """Return where the reflector is, (n, 3) in the tracker's frame."""
    return np.asarray(frames(build, angle, grown, tilt)[-1][:, :3, 3])


def torques(build: Build, angle: Array, payload: Array, mass: Array = MASS, centre: float = CENTRE) -> Array:
    """Return what gravity asks of each joint [N m], (n, 6); it pulls along -z of the arm's own foot."""
    upright = Build(np.zeros(6), *(getattr(build, n) for n in ("zero", "offset", "length", "twist", "skew", "tool")))
    seen = frames(upright, angle)
    start = [one[:, :3, 3] for one in seen]
    lies = [start[k + 1] + centre * (start[k] - start[k + 1]) for k in range(6)]
    weights = [np.full(len(angle), m) for m in mass] + [payload]
    lies.append(start[6])
    asked = np.zeros((len(angle), 6))
    for joint in range(6):
        axis = seen[joint][:, :3, 2]
        for k in range(joint, 7):
            lever = lies[k] - start[joint]
            asked[:, joint] += weights[k] * GRAVITY * (axis[:, 0] * lever[:, 1] - axis[:, 1] * lever[:, 0])
    return asked


@dataclass(frozen=True)
class Day:
    """One day in the hall: what is commanded and what is met, a row a reading (n,) or (n, 6)."""

    pose: NDArray[np.int64]
    visit: NDArray[np.int64]
    hold: NDArray[np.bool_]
    angle: Array
    came: Array
    travel: Array
    speed: Array
    payload: Array
    clock: Array
    warmth: Array

    @property
    def run(self) -> Array:
        """Return the part of the day that is over, 0 to 1, (n,)."""
        return np.asarray((self.clock - self.clock[0]) / np.ptp(self.clock))


LOW = np.array([-2.6, -2.3, 0.3, -2.6, -2.4, -3.0])  # rad, of the commanded angles
HIGH = np.array([2.6, -0.4, 2.3, 0.6, 2.4, 3.0])


def spent(rng: np.random.Generator, poses: int) -> Day:
    """Return a day on which each of `poses` is visited twice; on half of the days each visit is read twice."""
    commanded = rng.uniform(LOW, HIGH, (poses, 6))
    order = np.concatenate([rng.permutation(poses), rng.permutation(poses)])
    reads = int(rng.integers(1, 3))
    pose, visit = np.repeat(order, reads), np.repeat(np.arange(2 * poses), reads)
    came = rng.choice([-1.0, 1.0], (2 * poses, 6))[visit]
    travel = rng.lognormal(-1.0, 0.8, (2 * poses, 6))[visit]  # rad, of the approach
    moving = rng.random() < 0.5  # half of the workshops read on the fly
    speed = came * rng.uniform(0.02, 0.25, (2 * poses, 6))[visit] * moving
    payload = rng.choice([0.0, 2.5, 5.0], 2 * poses)[visit]
    pause = rng.uniform(15, 40, 2 * poses)[visit] * np.r_[True, np.diff(visit) != 0] + 2.0
    clock = np.cumsum(pause)
    part = clock / clock[-1]
    rise, swing = rng.uniform(2, 7), rng.uniform(0.3, 1.2)
    warmth = (
        293 + rise * (1 - np.exp(-3 * part)) + swing * np.sin(2 * np.pi * (part * rng.uniform(0.8, 3) + rng.random()))
    )
    hold = np.isin(pose, rng.permutation(poses)[: poses // 3])
    angle = commanded[pose] + rng.normal(0, 2e-4, (2 * poses, 6))[visit]  # a servo stops a little beside
    return Day(pose, visit, hold, angle, came, travel, speed, payload, clock, warmth)


@dataclass(frozen=True)
class Calibration:
    """The geometry fitted to one set of readings near `build`: slopes once, then as many steps as it takes."""

    build: Build
    taken: Array  # (3 n, rank): an orthonormal basis of what calibration can explain
    inverse: Array  # (39, 3 n): from what is left to the step in the numbers

    @staticmethod
    def of(build: Build, readings: Array) -> Calibration:
        """Return the calibration of an arm from the slopes of the reflector's place, by differences."""
        v = build.vector()
        step = np.r_[np.full(3, 1e-3), np.full(9, 1e-7), np.full(12, 1e-3), np.full(12, 1e-7), np.full(3, 1e-3)]
        moved = np.stack(
            [
                place(Build.of(v + d), readings + (v + d)[6:12]) - place(Build.of(v - d), readings + (v - d)[6:12])
                for d in np.diag(step)
            ],
            axis=-1,
        ).reshape(-1, len(v))
        left, size, right = np.linalg.svd(moved, full_matrices=False)
        sure = size > 1e-7 * size[0]
        taken = left[:, sure]
        return Calibration(build, taken, (2 * step[:, None]) * right[sure].T @ (taken / size[sure]).T)

    def left_of(self, readings: Array, seen: Array) -> Array:
        """Return what calibration cannot take away of `seen`, (n, 3)."""
        v = self.build.vector()
        for _ in range(4):
            left = seen - place(Build.of(v), readings + v[6:12])
            v = v + self.inverse @ left.ravel()
        left = (seen - place(Build.of(v), readings + v[6:12])).ravel()
        return np.asarray(left - self.taken @ (self.taken.T @ left)).reshape(-1, 3)
