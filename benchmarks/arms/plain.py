"""What a plain script reaches on the same poses: all placements by least squares, then waves, with a walk of its own.

It shares the reading of files and the URDF's numbers with the package, and no kinematics, no noise and no search. Each
joint may be moved and turned by six small numbers, and target and base besides. Then waves in the angle of a joint are
added, of whole orders a turn: at each step the one that leaves the least on the poses that are fitted.
Said of each step is what it leaves there by five-fold cross-validation; poses kept back are looked at at the end.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.arms.series import URDF, series
from calibench.calibration.urdf import read_urdf
from calibench.problems.base import Array

ORDERS = range(1, 65)
WAVES = 8
_STEPS = 8
_FOLDS = 5
_RANK = 1e-6


def rows(folder: Path, name: str) -> Iterator[str]:
    """Yield the errors [mm] of a series: by geometry, after each wave, and of the poses kept back."""
    data = series(folder, name)
    q = np.stack([np.asarray(data[one], dtype=float) for one in read_urdf(URDF).chain().driven], axis=1)
    seen = np.stack([np.asarray(data[axis], dtype=float) for axis in "xyz"], axis=1)
    kept = np.asarray(data["split"]) == "hold"
    left, moved, about = _calibrated(q, seen, ~kept)
    A = _thinned(moved, ~kept)
    yield f"{name}: geometry {rms(left[kept]):.3f} on {kept.sum()} poses kept back, {rms(left[~kept]):.3f} on others"
    waves = {
        (j, order): about[:, :, j, None] * np.stack([np.cos(order * q[:, j]), np.sin(order * q[:, j])], axis=1)[:, None]
        for j in range(q.shape[1])
        for order in ORDERS
    }
    for _ in range(WAVES):
        best = _best(A[~kept], left[~kept], {key: wave[~kept] for key, wave in waves.items()})
        A = np.concatenate([A, waves.pop(best)], axis=2)
        yield f"  joint {best[0] + 1}, {best[1]} a turn: {_crossed(A[~kept], left[~kept]):.3f} by cross-validation"
    yield f"  {rms(left[kept] - A[kept] @ _solved(A[~kept], left[~kept])):.3f} on the poses kept back"


def rms(errors: Array) -> float:
    """Return the 3D rms of errors (n, 3)."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def _calibrated(q: Array, seen: Array, fitted: Array) -> tuple[Array, Array, Array]:
    """Return what is left (n, 3), its slopes in all placements (n, 3, p), and in the angle of each joint (n, 3, j)."""
    small = np.zeros((q.shape[1] + 1, 6))
    tool = np.zeros(3)
    turn, foot = np.eye(3), np.zeros(3)
    for step in range(_STEPS + 2):
        at, slopes, about = _walked(q, small, tool)
        if step < 2:  # first where the base stands, by the arm as it is
            a, b = at[fitted] - at[fitted].mean(axis=0), seen[fitted] - seen[fitted].mean(axis=0)
            turn = Rotation.align_vectors(b, a)[0].as_matrix()
            foot = seen[fitted].mean(axis=0) - turn @ at[fitted].mean(axis=0)
        # the base moves as a body: three ways and three turns about its foot
        away = at @ turn.T
        body = np.concatenate(
            [np.tile(np.eye(3), (len(q), 1, 1)), np.stack([np.cross(e, away) for e in np.eye(3)], axis=2)], axis=2
        )
        moved = np.concatenate([body, turn @ slopes], axis=2)
        left = seen - away - foot
        if step == _STEPS + 1:
            break
        found = _solved(moved[fitted], left[fitted], _RANK)
        turn, foot = Rotation.from_rotvec(found[3:6]).as_matrix() @ turn, foot + found[:3]
        small[:-1] += found[6:-3].reshape(-1, 6)
        tool += found[-3:]
    return left, moved, turn @ about


def _walked(q: Array, small: Array, tool: Array) -> tuple[Array, Array, Array]:
    """Return the target (n, 3) in the base, and its slopes in small moves of each joint and of the tool, and angles."""
    joints = read_urdf(URDF).chain().joints
    at, turn = np.zeros((len(q), 3)), np.tile(np.eye(3), (len(q), 1, 1))
    frames, driven = [], 0
    for joint in joints:
        at = at + turn @ joint.origin[:3, 3]
        turn = turn @ joint.origin[:3, :3]
        if joint.kind == "fixed":
            continue
        at = at + turn @ small[driven, :3]
        turn = turn @ Rotation.from_rotvec(small[driven, 3:]).as_matrix()
        frames.append((at, turn, turn @ joint.axis))
        turn = turn @ Rotation.from_rotvec(q[:, driven, None] * joint.axis).as_matrix()
        driven += 1
    at = at + turn @ tool
    slopes = [
        np.concatenate([way, np.stack([np.cross(way[:, :, k], at - foot) for k in range(3)], axis=2)], axis=2)
        for foot, way, _ in frames
    ]
    about = np.stack([np.cross(axis, at - foot) for foot, _, axis in frames], axis=2)
    return at, np.concatenate([*slopes, turn], axis=2), about


def _thinned(A: Array, fitted: Array) -> Array:
    """Return as many columns as the fitted poses tell apart, (n, 3, m)."""
    size = np.sqrt((A[fitted] ** 2).sum(axis=(0, 1)))
    size = np.where(size > 0, size, 1.0)
    _, values, ways = np.linalg.svd((A[fitted] / size).reshape(-1, A.shape[2]), full_matrices=False)
    seen = values > _RANK * values[0]
    return np.asarray((A / size) @ (ways[seen].T / values[seen]))


def _solved(A: Array, left: Array, rank: float = 1e-9) -> Array:
    flat = A.reshape(-1, A.shape[2])
    size = np.sqrt((flat**2).sum(axis=0))
    size = np.where(size > 0, size, 1.0)
    return np.asarray(np.linalg.lstsq(flat / size, left.ravel(), rcond=rank)[0] / size)


def _best(A: Array, left: Array, waves: dict[tuple[int, int], Array]) -> tuple[int, int]:
    Q = np.linalg.qr(A.reshape(-1, A.shape[2]))[0]
    y = left.ravel() - Q @ (Q.T @ left.ravel())

    def gained(wave: Array) -> float:
        flat = wave.reshape(len(y), -1)
        U, values, _ = np.linalg.svd(flat - Q @ (Q.T @ flat), full_matrices=False)
        return float(((U[:, values > 1e-3 * np.linalg.norm(flat)].T @ y) ** 2).sum())

    return max(waves, key=lambda key: gained(waves[key]))


def _crossed(A: Array, left: Array) -> float:
    fold = np.random.default_rng(0).permutation(len(left)) % _FOLDS
    errors = np.empty_like(left)
    for k in range(_FOLDS):
        errors[fold == k] = left[fold == k] - A[fold == k] @ _solved(A[fold != k], left[fold != k])
    return rms(errors)
