"""Rigid transforms of (..., 4, 4): made from turns and shifts, inverted, and written out again as angles.

All but `rpy_of` and `quaternion` take complex numbers, so that a complex step passes through.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.problems.base import Array

Numbers = NDArray[Any]  # float64, or complex128 where a complex step passes through


def shift(x: Any, y: Any, z: Any) -> Numbers:
    """Return Trans(x, y, z), shape (4, 4)."""
    made = np.eye(4, dtype=np.result_type(x, y, z, np.float64))
    made[0, 3], made[1, 3], made[2, 3] = x, y, z
    return made


def rpy(roll: Any, pitch: Any, yaw: Any) -> Numbers:
    """Return Rz(yaw) Ry(pitch) Rx(roll), shape (4, 4): the angles of a URDF [rad]."""
    return turn(np.array([0.0, 0, 1]), yaw) @ turn(np.array([0.0, 1, 0]), pitch) @ turn(np.array([1.0, 0, 0]), roll)


def turn(axis: Array, angle: Any) -> Numbers:
    """Return rotations about the unit vector `axis`, (3,), by angles of shape (...): shape (..., 4, 4)."""
    angle = np.asarray(angle)
    c, s = np.cos(angle), np.sin(angle)
    made = np.zeros((*angle.shape, 4, 4), dtype=np.result_type(angle, np.float64))
    x, y, z = axis
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    along = np.outer(axis, axis)
    made[..., :3, :3] = along + c[..., None, None] * (np.eye(3) - along) + s[..., None, None] * across
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
