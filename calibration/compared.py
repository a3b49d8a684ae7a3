"""What was measured of an arm's target: places, poses, distances, a ball in sockets, planes touched, pairs of poses.

`Compared` holds the joints of n postures and what is compared there, a group of residuals a reading; one function a
kind makes them, and `together` puts kinds into one fit. Lengths are mm; a turn counts as `arm` mm a radian.

A chain as the kernels take it: constant frames, with each joint's own turned so that its axis is z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from calibench.calibration.kinematics import Chain
from calibench.calibration.rigid import Array, Index, inverse

POSITION, POSE, DISTANCE, SOCKET, GAP, PLANE, PAIR = range(7)
ROWS = np.array((3, 6, 1, 3, 1, 1, 6))
ARM = 100.0  # mm: of a turn; a tracker that reads .02 mm reads some .01 degree


@final
@dataclass(frozen=True, eq=False)
class Compared:
    """Joints q, (n, columns) [rad, mm], and groups (kind, first, second), (g, 3), with values (g, 12), weights (g, 2).

    `planes`, (planes, 9), are normals and two directions across them. Shapes of values: `_reading_kernels`.
    """

    q: Array
    groups: Index
    values: Array
    weight: Array
    planes: Array

    @property
    def sockets(self) -> int:
        """Return how many sockets there are."""
        seated = self.groups[self.groups[:, 0] == SOCKET, 2]
        return int(seated.max()) + 1 if seated.size else 0

    @property
    def rows(self) -> Index:
        """Return the first residual of each group."""
        sizes = ROWS[self.groups[:, 0]]
        return np.asarray(np.cumsum(sizes) - sizes, dtype=np.int64)

    @property
    def size(self) -> int:
        """Return how many residuals there are."""
        return int(ROWS[self.groups[:, 0]].sum())

    @property
    def oriented(self) -> bool:
        """Tell whether a turn of the target is compared."""
        return bool(np.isin(self.groups[:, 0], (POSE, PAIR)).any())

    def packed(self) -> tuple[Index, Array, Array, Array]:
        """Return groups with their rows (g, 4), values, weights and planes, as the kernels take them."""
        groups = np.column_stack([self.groups, self.rows]).astype(np.int64)
        return groups, np.ascontiguousarray(self.values), np.ascontiguousarray(self.weight), self.planes


def positions(q: Array, place: Array, weight: float = 1.0) -> Compared:
    """Return readings of the target's place, (n, 3) [mm]."""
    return _each(POSITION, q, np.asarray(place, dtype=float), (weight, 0.0))


def poses(q: Array, pose: Array, arm: float = ARM, weight: float = 1.0) -> Compared:
    """Return readings of the target's pose, (n, 4, 4) [mm]."""
    return _each(POSE, q, _flat(pose), (weight, weight * arm))


def distances(q: Array, first: Index, second: Index, distance: Array, weight: float = 1.0) -> Compared:
    """Return readings of the distance [mm] between the targets of postures `first` and `second`, (m,) each."""
    groups = np.column_stack([np.full(len(first), DISTANCE), first, second])
    return _made(q, groups, np.asarray(distance, dtype=float)[:, None], (weight, 0.0))


def sockets(
    q: Array,
    socket: Index,
    gaps: tuple[tuple[int, int, float], ...] = (),
    gap_weight: float = 1.0,
    beside: Array | None = None,
) -> Compared:
    """Return postures with the ball in a socket, (n,) 0, 1, ...: one unknown point a socket.

    `beside`, (n, 3) [mm], is how far from that point the ball is known to sit, in the world; None where it sits in it.

    `gaps` are known distances [mm] between two sockets, each weighing `gap_weight` times one residual of the ball.
    Raises `ValueError` where a socket was never used.
    """
    socket = np.asarray(socket, dtype=np.int64)
    used = set(socket.tolist())
    missing = next((s for s in range(max(used) + 1) if s not in used), None)
    if missing is not None:
        raise ValueError(f"socket {missing} has no posture; number the sockets 0, 1, ... without a gap")
    n = len(socket)
    groups = np.column_stack([np.full(n, SOCKET), np.arange(n), socket])
    away = np.zeros((n, 3)) if beside is None else np.array(beside, dtype=float)
    for s in used:
        away[socket == s] -= away[socket == s].mean(axis=0)  # the mean itself is the socket's point
    seated = _made(q, groups, away, (1.0, 0.0))
    if not gaps:
        return seated
    for a, b, _ in gaps:
        if a not in used or b not in used or a == b:
            raise ValueError(f"the distance between sockets {a} and {b} is told; only {sorted(used)} are used")
    known = _made(q, np.array([(GAP, a, b) for a, b, _ in gaps]), np.array([[d] for *_, d in gaps]), (gap_weight, 0.0))
    return together(seated, known, same=True)


def planes(q: Array, plane: Index, normals: Array) -> Compared:
    """Return postures whose probe touches a plane, (n,) 0, 1, ..., of about these `normals`, (planes, 3).

    Each plane brings three unknowns: two tilts and its height.
    """
    normals = np.asarray(normals, dtype=float)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    least = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    across = np.cross(normals, least)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    frames = np.hstack([normals, across, np.cross(normals, across)])
    groups = np.column_stack([np.full(len(plane), PLANE), np.arange(len(plane)), np.asarray(plane)])
    return _made(q, groups, np.zeros((len(plane), 1)), (1.0, 0.0), frames)


def pairs(q: Array, first: Index, second: Index, pose: Array, arm: float = ARM) -> Compared:
    """Return pairs of postures: what the target of the second is as seen from the first.

    `pose`, (n, 4, 4), are poses of the target in any frame that stood still: a camera's, a tracker's. Only motions
    between two postures are compared, so the frame itself is not needed.
    """
    seen = inverse(pose[first]) @ pose[second]
    groups = np.column_stack([np.full(len(first), PAIR), first, second])
    return _made(q, groups, _flat(seen), (1.0, arm))


def together(*parts: Compared, same: bool = False) -> Compared:
    """Return several kinds of readings as one. With `same` they are of the same postures and sockets."""
    if same:
        first = parts[0]
        return Compared(
            first.q,
            np.concatenate([p.groups for p in parts]),
            np.concatenate([p.values for p in parts]),
            np.concatenate([p.weight for p in parts]),
            np.concatenate([p.planes for p in parts]),
        )
    groups, postures, sockets_, planes_ = [], 0, 0, 0
    for p in parts:
        g = p.groups.copy()
        of_posture = g[:, 0] != GAP
        g[of_posture, 1] += postures
        both = np.isin(g[:, 0], (DISTANCE, PAIR))
        g[both, 2] += postures
        g[g[:, 0] == SOCKET, 2] += sockets_
        g[~of_posture, 1:] += sockets_
        g[g[:, 0] == PLANE, 2] += planes_
        groups.append(g)
        postures, sockets_, planes_ = postures + len(p.q), sockets_ + p.sockets, planes_ + len(p.planes)
    return Compared(
        np.concatenate([p.q for p in parts]),
        np.concatenate(groups),
        np.concatenate([p.values for p in parts]),
        np.concatenate([p.weight for p in parts]),
        np.concatenate([p.planes for p in parts]),
    )


def _each(kind: int, q: Array, values: Array, weight: tuple[float, float]) -> Compared:
    n = len(q)
    return _made(q, np.column_stack([np.full(n, kind), np.arange(n), np.zeros(n)]), values, weight)


def _made(
    q: Array, groups: Array, values: Array, weight: tuple[float, float], planes_: Array | None = None
) -> Compared:
    filled = np.zeros((len(groups), 12))
    filled[:, : values.shape[1]] = values
    flat = np.zeros((0, 9)) if planes_ is None else planes_
    return Compared(np.asarray(q, float), groups.astype(np.int64), filled, np.tile(weight, (len(groups), 1)), flat)


def _flat(pose: Array) -> Array:
    """Return place and rotation by rows, (n, 12), of poses (n, 4, 4)."""
    return np.concatenate([pose[:, :3, 3], pose[:, :3, :3].reshape(-1, 9)], axis=1)


def packed_chain(chain: Chain) -> tuple[Array, Array, Index]:
    """Return `fixed` (J + 2, 12), `align` (J, 9) and `sliding` (J,): what `_kernels` needs of a chain."""
    turned = [_towards(joint.axis) for joint in chain.joints]
    fixed = [chain.mount, chain.joints[0].origin]
    for k, joint in enumerate(chain.joints[1:]):
        fixed.append(turned[k].T @ joint.origin)
    fixed.append(turned[-1].T @ chain.tail @ chain.tool)
    flat = [np.concatenate([f[:3, :3].ravel(), f[:3, 3]]) for f in fixed]
    align = [t[:3, :3].ravel() for t in turned]
    sliding = np.array([joint.kind == "sliding" for joint in chain.joints], dtype=np.int64)
    return np.ascontiguousarray(flat), np.ascontiguousarray(align), sliding


def constants(chain: Chain, readings: Compared, template: Array, free: Index, limit: float) -> tuple[Any, ...]:
    """Return the arguments of the kernels after x."""
    fixed, align, sliding = packed_chain(chain)
    stands = np.ascontiguousarray(chain.positions(readings.q))
    compared = readings.packed()
    ends = (readings.sockets, float(limit), readings.size)
    return (template, free, fixed, align, sliding, stands, readings.oriented, *compared, *ends)


def _towards(axis: Array) -> Array:
    """Return a rotation (4, 4) that turns z into `axis`; nothing where it is z."""
    made = np.eye(4)
    if axis[2] == 1.0:
        return made
    least = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(least, axis)
    x /= np.linalg.norm(x)
    made[:3, :3] = np.column_stack([x, np.cross(axis, x), axis])
    return made
