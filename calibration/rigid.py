"""Rigid transforms of (..., 4, 4) and rotations: made from turns and shifts, inverted, written out as numbers again.

All but `rpy_of`, `quaternion` and `vector_of` take complex numbers, so that a complex step passes through.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Rotation = Literal["", "rpy", "xyz"]  # the order of three angles; "": found by what fits the arm
Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Numbers = NDArray[Any]  # float64, or complex128 where a complex step passes through


def shift(x: Any, y: Any, z: Any) -> Numbers:
    """Return Trans(x, y, z), shape (4, 4)."""
    made = np.eye(4, dtype=np.result_type(x, y, z, np.float64))
    made[0, 3], made[1, 3], made[2, 3] = x, y, z
    return made


def rpy(roll: Any, pitch: Any, yaw: Any) -> Numbers:
    """Return Rz(yaw) Ry(pitch) Rx(roll) of angles of one shape (...): (..., 4, 4); the angles of a URDF [rad]."""
    cx, sx, cy, sy, cz, sz = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    made = np.zeros((*np.shape(cx), 4, 4), dtype=np.result_type(cx, cy, cz))
    made[..., 0, 0], made[..., 0, 1], made[..., 0, 2] = cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx
    made[..., 1, 0], made[..., 1, 1], made[..., 1, 2] = sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx
    made[..., 2, 0], made[..., 2, 1], made[..., 2, 2] = -sy, cy * sx, cy * cx
    made[..., 3, 3] = 1.0
    return made


def turn(axis: Array, angle: Any) -> Numbers:
    """Return rotations about unit vectors `axis`, (..., 3), by angles of a shape (...) beside it: (..., 4, 4)."""
    angle = np.asarray(angle)
    c, s = np.cos(angle)[..., None, None], np.sin(angle)[..., None, None]
    across = np.zeros((*axis.shape, 3))
    across[..., 0, 1], across[..., 0, 2], across[..., 1, 2] = -axis[..., 2], axis[..., 1], -axis[..., 0]
    across -= np.swapaxes(across, -1, -2)
    along = axis[..., :, None] * axis[..., None, :]
    turned = along + c * (np.eye(3) - along) + s * across
    made = np.zeros((*turned.shape[:-2], 4, 4), dtype=turned.dtype)
    made[..., :3, :3] = turned
    made[..., 3, 3] = 1.0
    return made


def slide(axis: Array, way: Any) -> Numbers:
    """Return translations along `axis`, (3,), by `way` of shape (...): shape (..., 4, 4)."""
    way = np.asarray(way)
    made = np.zeros((*way.shape, 4, 4), dtype=np.result_type(way, np.float64))
    made[...] = np.eye(4)
    made[..., :3, 3] = way[..., None] * axis
    return made


def inverse(pose: Numbers) -> Numbers:
    """Return the inverse of rigid transforms, (..., 4, 4)."""
    made = np.zeros_like(pose)
    turned = np.swapaxes(pose[..., :3, :3], -1, -2)
    made[..., :3, :3] = turned
    made[..., :3, 3] = -(turned @ pose[..., :3, 3, None])[..., 0]
    made[..., 3, 3] = 1.0
    return made


def cross(a: Numbers, b: Numbers) -> Numbers:
    """Return a x b along the last axis, of (..., 3); NumPy's own takes several times as long for few rows."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def rpy_of(pose: Array) -> Array:
    """Return roll, pitch and yaw, (..., 3) [rad], of transforms; at a pitch of a right angle the roll is taken as 0."""
    r = pose[..., :3, :3]
    flat = np.hypot(r[..., 0, 0], r[..., 1, 0])
    lost = flat < 1e-12
    roll = np.where(lost, 0.0, np.arctan2(r[..., 2, 1], r[..., 2, 2]))
    yaw = np.where(lost, np.arctan2(-r[..., 0, 1], r[..., 1, 1]), np.arctan2(r[..., 1, 0], r[..., 0, 0]))
    return np.stack([roll, np.arctan2(-r[..., 2, 0], flat), yaw], axis=-1)


def quaternion(x: Array, y: Array, z: Array, w: Array) -> Array:
    """Return the rotations (..., 4, 4) of quaternions, normed first; NaN where all four are zero."""
    q = np.stack(np.broadcast_arrays(x, y, z, w), axis=-1).astype(float)
    with np.errstate(invalid="ignore"):
        q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    x, y, z, w = np.moveaxis(q, -1, 0)
    made = np.zeros((*x.shape, 4, 4))
    made[..., 0, 0], made[..., 0, 1] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w)
    made[..., 1, 0], made[..., 1, 1] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z)
    made[..., 2, 0], made[..., 2, 1] = 2 * (x * z - y * w), 2 * (y * z + x * w)
    made[..., 0, 2], made[..., 1, 2] = 2 * (x * z + y * w), 2 * (y * z - x * w)
    made[..., 2, 2] = 1 - 2 * (x * x + y * y)
    made[..., 3, 3] = 1.0
    return made


def vector_of(turns: Array) -> Array:
    """Return axis times angle [rad], (n, 3), of rotations by less than a half turn."""
    twice = _odd(turns) * 2
    sine = np.linalg.norm(twice, axis=1) / 2
    angle = np.arctan2(sine, (np.trace(turns, axis1=1, axis2=2) - 1) / 2)
    plain = sine > 1e-12
    return np.asarray(np.where(plain[:, None], twice / 2 * (angle / np.where(plain, sine, 1.0))[:, None], twice / 2))


def rotation_of(vectors: Numbers) -> Numbers:
    """Return the rotations, (n, 3, 3), of axis times angle, (n, 3) [rad]; it accepts complex numbers."""
    angle = np.sqrt(np.sum(vectors * vectors, axis=1) + 1e-300)
    x, y, z = vectors.T
    none = np.zeros_like(x)
    across = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=-1).reshape(-1, 3, 3)
    one = (np.sin(angle) / angle)[:, None, None]
    two = ((1 - np.cos(angle)) / angle**2)[:, None, None]
    return np.asarray(np.eye(3) + one * across + two * (across @ across))


def small_vector_of(turns: Numbers) -> Numbers:
    """Return axis times angle [rad], (n, 3), of rotations by less than .3 rad; it accepts complex numbers."""
    odd = _odd(turns)
    s = np.sum(odd * odd, axis=1)[:, None]
    return np.asarray(odd * (1 + s * (1 / 6 + s * (3 / 40 + s * (15 / 336 + s * 105 / 3456)))))  # arcsin


def beside(vectors: Array, omega: Array) -> Array:
    """Return the change of `vectors`, axis times a small angle, when the body turns by omega about fixed axes."""
    once = cross(vectors, omega)
    return np.asarray(omega - once / 2 + cross(vectors, once) / 12)


def _odd(turns: Numbers) -> Numbers:
    pairs = ((2, 1), (0, 2), (1, 0))
    return np.asarray(np.stack([turns[:, i, j] - turns[:, j, i] for i, j in pairs], axis=-1) / 2)
