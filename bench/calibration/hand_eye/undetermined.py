"""Refuse poses that are too few or turn too little to tell both frames, and say what to measure instead.

Frames that are not told are not written.

Of rotations about one axis alone, camera and board may be shifted along it together, unseen; without any rotation
nothing tells where the camera is at all (Tsai and Lenz 1989).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calibench.bench.calibration.hand_eye.adjust import Adjusted
from calibench.bench.calibration.hand_eye.frames import slopes_of, spread
from calibench.bench.calibration.readings import poses_of
from calibench.core.words import counted, plain
from calibench.discrepancy import DataError
from calibench.problems.base import Array

LEAST = 3  # poses: two motions about different axes
_TURNS = np.deg2rad(0.5)  # rad: less than this about an axis is how a robot holds still
_WORTH = 0.2  # of the board's distance, or 0.2 rad: a number known no better is not told by the poses
_FEW_TURNS = np.deg2rad(15)  # rad: less about an axis, and the intervals are wide
_BESIDE = 20  # poses from which all others are looked at
_WAY_OUT = "add poses that turn the flange by 30° or more about at least two axes, such as 10 to 20 of them"


def check_poses(flange: Array, stands: Array, stated: bool) -> None:
    """Refuse poses of the flange (n, 4, 4) that cannot tell both frames; `stands` (n, 6) tell the same poses apart.

    With `stated` both noises are known; else a pose more must tell them. Raises `DataError`.
    """
    count = len(np.unique(poses_of(stands)))
    if count < LEAST:
        raise DataError(
            f"{counted(count, 'different pose')} {'is' if count == 1 else 'are'} too few: {LEAST} at the least, and "
            f"some 15 that differ much; {_WAY_OUT}"
        )
    if count == LEAST and not stated:
        raise DataError(
            f"{count} different poses tell both frames, and not the noise, so that no interval is known: state sigma= "
            "[mm] and sigma_rotation= [rad] of the board's pose, or add poses"
        )
    largest, axis, beside, _ = _turned(flange)
    if largest < _TURNS:
        raise DataError(
            f"the flange turns by {plain(float(np.rad2deg(largest)), 2)}° at the most, and shifts alone do not tell "
            f"where the camera is: {_WAY_OUT}"
        )
    if beside < _TURNS:
        raise DataError(
            f"all rotations are about one axis of the flange, ({_listed(axis)}): where camera and board are along it "
            f"is not determined: {_WAY_OUT}"
        )


def missing_turns(flange: Array) -> list[str]:
    """Return in a sentence which turns would narrow the intervals, where poses of the flange (n, 4, 4) turn little."""
    largest, axis, beside, across = _turned(flange)
    if largest < _FEW_TURNS:
        return [
            f"the flange turns by {plain(float(np.rad2deg(largest)), 2)}° at the most, so that the intervals are wide: "
            f"{_WAY_OUT}"
        ]
    if beside < _FEW_TURNS:
        return [
            f"the flange turns by up to {plain(float(np.rad2deg(largest)), 2)}° about its axis ({_listed(axis)}), and "
            f"by {plain(float(np.rad2deg(beside)), 2)}° at the most about others: add poses that turn it by 30° or "
            f"more about its axis ({_listed(across)})"
        ]
    return []


def _turned(flange: Array) -> tuple[float, Array, float, Array]:
    """Return the largest turn between poses [rad], the axis of most turns, the largest beside it, and across it."""
    some = flange[:: max(1, len(flange) // _BESIDE), :3, :3]
    turns = np.stack([Rotation.from_matrix(one.T @ flange[:, :3, :3]).as_rotvec() for one in some])
    turns = turns.reshape(-1, 3)
    axes = np.linalg.svd(turns, full_matrices=False)[2]
    axis, across = axes[0], axes[-1]
    beside = float(np.linalg.norm(turns - np.outer(turns @ axis, axis), axis=1).max())
    return float(np.linalg.norm(turns, axis=1).max()), axis, beside, across


def check_determined(found: Adjusted) -> None:
    """Refuse frames of which a direction is known worse than a fifth of the board's distance, or .2 rad."""
    position = found.fit.model.position
    assert position is not None
    distance = float(np.median(np.linalg.norm(position, axis=1)))
    for child, slopes in zip(("camera", "board"), slopes_of(found), strict=True):
        for part, worth, unit in ((slopes[:3], _WORTH * distance, "mm"), (slopes[3:], _WORTH, "rad")):
            covariance = part @ found.parts.sum(axis=0) @ part.T
            direction = np.linalg.eigh(covariance)[1][:, -1]
            half = float(spread(found, direction[None] @ part)[1][0])
            if not half < worth:
                what = "place along" if unit == "mm" else "turn about"
                raise DataError(
                    f"the {child}'s {what} ({_listed(direction)}) is known to ±{plain(half, 2)} {unit} only (95 %), so "
                    f"these poses do not determine it: {_WAY_OUT}"
                )


def _listed(direction: Array) -> str:
    """Return a direction in two digits, its largest part positive."""
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    return ", ".join(f"{value + 0.0:.2f}" for value in np.round(direction, 2))
