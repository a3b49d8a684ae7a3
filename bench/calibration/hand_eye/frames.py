"""A frame as users need it: place, quaternion, roll pitch yaw and matrix, each number with its error and interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import norm, t

from calibench.bench.calibration.hand_eye.adjust import Adjusted
from calibench.problems.arm.chains.rigid import inverse, rpy_of
from calibench.problems.base import Array

Numbers = tuple[float, ...]
Intervals = tuple[tuple[float, float], ...]


@final
@dataclass(frozen=True)
class Frame:
    """The frame `child` in the frame `parent`, with standard errors (`_se`) and 95 % intervals (`_ci95`).

    `position` is x y z [mm], `quaternion` x y z w, `rpy` roll, pitch and yaw of a URDF [rad], `matrix` (4, 4) [mm].
    `turn_se` [rad] are the standard errors of the rotation about x y z of the parent, and `turn_within95` the angles
    about each that hold 95 %.
    """

    parent: str
    child: str
    position: Numbers
    position_se: Numbers
    position_ci95: Intervals
    quaternion: Numbers
    quaternion_se: Numbers
    quaternion_ci95: Intervals
    turn_se: Numbers
    turn_within95: Numbers
    rpy: Numbers
    matrix: tuple[Numbers, ...]


def frames_of(found: Adjusted, mounting: str) -> tuple[Frame, Frame]:
    """Return the camera's frame, and the board's: on the flange and in the base, or the other way round."""
    camera, board = ("flange", "base") if mounting == "eye_in_hand" else ("base", "flange")
    slopes = slopes_of(found)
    return (
        _frame(camera, "camera", inverse(found.mount), found, slopes[0]),
        _frame(board, "board", found.tool, found, slopes[1]),
    )


def slopes_of(found: Adjusted) -> Array:
    """Return how errors of mount and tool (12,) move camera and board, (2, 6, 12): shift and turn in their parents.

    The camera's frame is the inverse of the mount, so an error behind the mount is one of the other sign before it.
    """
    slopes = np.zeros((2, 6, 12))
    x, y, z = inverse(found.mount)[:3, 3]
    slopes[0, :3, :3] = slopes[0, 3:, 3:6] = -np.eye(3)
    slopes[0, :3, 3:6] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    slopes[1, :3, 6:9] = slopes[1, 3:, 9:] = found.tool[:3, :3]
    return slopes


def spread(found: Adjusted, slopes: Array) -> tuple[Array, Array]:
    """Return standard errors of the numbers with `slopes` (k, 12), and the half widths of their 95 % intervals, (k,).

    Of an effective number of degrees of freedom by Satterthwaite: both noises have a part in a variance.
    """
    parts = np.einsum("ki,pij,kj->pk", slopes, found.parts, slopes)
    variance = parts.sum(axis=0)
    freedom = np.array(found.freedom)[:, None]
    squares = (parts**2 / freedom).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        effective = np.where(squares > 0, variance**2 / squares, np.inf)
    width = np.where(np.isfinite(effective), t.ppf(0.975, np.minimum(effective, 1e9)), norm.ppf(0.975))
    error = np.sqrt(variance)
    return error, width * error


def _frame(parent: str, child: str, pose: Array, found: Adjusted, slopes: Array) -> Frame:
    x, y, z, w = q = np.asarray(Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True))
    turned = 0.5 * np.array([[w, z, -y], [-z, w, x], [y, -x, w], [-x, -y, -z]])  # of a small turn before q
    place, of_place = spread(found, slopes[:3])
    turn, of_turn = spread(found, slopes[3:])
    quaternion, of_quaternion = spread(found, turned @ slopes[3:])
    return Frame(
        parent, child, _told(pose[:3, 3]), _told(place), _within(pose[:3, 3], of_place), _told(q), _told(quaternion),
        _within(q, of_quaternion), _told(turn), _told(of_turn), _told(rpy_of(pose)), tuple(_told(row) for row in pose),
    )  # fmt: skip


def _told(values: Array) -> Numbers:
    return tuple(float(value) for value in values)


def _within(values: Array, half: Array) -> Intervals:
    return tuple((float(v - h), float(v + h)) for v, h in zip(values, half, strict=True))
