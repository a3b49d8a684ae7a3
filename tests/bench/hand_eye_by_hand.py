"""Pairs of poses of a flange and a board, and a solution in closed form: plain NumPy, nothing of what it tests."""

from __future__ import annotations

import numpy as np

CAMERA = np.array([40.0, -25.0, 110.0]), (0.3, -0.5, 0.8)  # on the flange, or in the base: mm and a rotation vector
BOARD = np.array([620.0, 150.0, -80.0]), (2.6, 0.4, -0.7)


def about(vector):
    """Return the rotation (3, 3) of a rotation vector (3,) [rad] (Rodrigues)."""
    vector = np.asarray(vector, dtype=float)
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across


def vector_of(turn):
    """Return the rotation vector (3,) [rad] of a rotation (3, 3) of less than half a turn."""
    angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
    if angle < 1e-12:
        return np.zeros(3)
    across = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return angle / (2 * np.sin(angle)) * across


def pose(place, vector):
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = about(vector), place
    return made


def quaternion_of(turn):
    """Return x y z w (4,) of a rotation of less than half a turn."""
    vector = vector_of(turn)
    angle = np.linalg.norm(vector)
    return np.array([*(vector * (np.sin(angle / 2) / angle if angle else 0.5)), np.cos(angle / 2)])


def measured(n, hand_eye="eye_in_hand", noise=(0.0, 0.0), seed=3, spread=0.6, flange=None):
    """Return poses of the flange in the base and of the board in the camera, (n, 4, 4) each [mm].

    `noise` is that of the board's pose on an axis [mm], [rad]; `spread` how far the flange turns on an axis [rad].
    """
    rng = np.random.default_rng(seed)
    camera, board = pose(*CAMERA), pose(*BOARD)
    if flange is None:
        tilts, places = rng.normal(0, spread, (n, 3)), rng.uniform(-150, 150, (n, 3))
        flange = np.array([
            pose([500, 100, 450], (2.9, 0.3, 0.1)) @ pose(p, t) for p, t in zip(places, tilts, strict=True)
        ])  # fmt: skip
    if hand_eye == "eye_in_hand":
        seen = np.linalg.inv(camera) @ np.linalg.inv(flange) @ board
    else:
        seen = np.linalg.inv(camera) @ flange @ board
    for one in seen:
        one[:3, :3] = about(rng.normal(0, noise[1], 3)) @ one[:3, :3]
        one[:3, 3] += rng.normal(0, noise[0], 3)
    return np.asarray(flange), seen


QUATERNION, VECTOR = ("qx", "qy", "qz", "qw"), ("rx [rad]", "ry [rad]", "rz [rad]")


def columns_of(poses, name, unit="mm", turns=QUATERNION):
    """Return heads and numbers (n, k) of poses: places in `unit`, rotations as quaternion or vector [rad]."""
    places = poses[:, :3, 3] / {"mm": 1.0, "m": 1000.0}[unit]
    by = quaternion_of if turns == QUATERNION else vector_of
    rotations = np.array([by(one[:3, :3]) for one in poses])
    heads = [*(f"{name}_{axis} [{unit}]" for axis in "xyz"), *(f"{name}_{turn}" for turn in turns)]
    return heads, np.column_stack([places, rotations])


def write(path, *parts):
    """Write parts (heads, numbers) beside one another into a CSV file."""
    heads = [head for part, _ in parts for head in part]
    rows = np.column_stack([numbers for _, numbers in parts])
    path.write_text("\n".join([",".join(heads), *(",".join(f"{v:.12g}" for v in row) for row in rows)]) + "\n")
    return path
