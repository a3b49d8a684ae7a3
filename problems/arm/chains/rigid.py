"""Rigid transforms of (..., 4, 4): made from turns and shifts, inverted, and written out again as angles.

All but `rpy_of` and `quaternion` take complex numbers, so that a complex step passes through.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calibench.problems.base import Array

Rotation = Literal[
    "", "rpy", "xyz"
]  # how three columns tell a turn: roll, pitch and yaw, or a vector; "": as the file says
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
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
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
    made[..., 0, 0], made[..., 0, 1], made[..., 0, 2] = (
        1 - 2 * (y * y + z * z),
        2 * (x * y - z * w),
        2 * (x * z + y * w),
    )
    made[..., 1, 0], made[..., 1, 1], made[..., 1, 2] = (
        2 * (x * y + z * w),
        1 - 2 * (x * x + z * z),
        2 * (y * z - x * w),
    )
    made[..., 2, 0], made[..., 2, 1], made[..., 2, 2] = (
        2 * (x * z - y * w),
        2 * (y * z + x * w),
        1 - 2 * (x * x + y * y),
    )
    made[..., 3, 3] = 1.0
    return made
