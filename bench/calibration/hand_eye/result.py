"""`HandEye`: what `bench calibrate hand_eye=...` found, as plain values for JSON, and as a file for users of ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan
from typing import Any, final

from calibench.bench.calibration.hand_eye.frames import Frame
from calibench.core.plain import finite

SCHEMA_VERSION = 1


@final
@dataclass(frozen=True)
class Left:
    """What is left of poses of the board: three-dimensional rms of place [mm] and rotation [rad] over `poses` rows."""

    poses: int
    position: float = nan
    rotation: float = nan


@final
@dataclass(frozen=True)
class Outlier:
    """An outlying pair, which the fit did not use: its row in the file, and what is left of it [mm], [rad]."""

    row: str
    position: float
    rotation: float


@final
@dataclass(frozen=True)
class HandEye:
    """Both frames of one hand-eye calibration, `camera` and `board`, and how true they are.

    `fitted` is what is left of the fitted pairs; `unseen` of pairs that were not fitted: those that the file holds
    back, or each by a fit to others, as `how` says. `sigma` [mm] and `sigma_rotation` [rad] are the noise on an axis,
    `learned` from what is left, or stated. `scale` is how many times as far as the robot's moves say the camera sees
    the board, with its standard error; the frames take it as 1.
    """

    case: str
    hand_eye: str
    read: str
    pairs: int
    camera: Frame
    board: Frame
    fitted: Left
    unseen: Left
    how: str
    sigma: float
    sigma_rotation: float
    learned: tuple[bool, bool]
    scale: float
    scale_se: float
    outliers: tuple[Outlier, ...] = ()
    notes: tuple[str, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"schema_version": SCHEMA_VERSION, **finite(self)}


def transforms_yaml(found: HandEye) -> str:
    """Return both frames as YAML, in metres: translation, quaternion x y z w, and the command that publishes each."""
    lines = [f"# bench calibrate hand_eye={found.hand_eye}, {found.case}: {found.pairs} pairs; metres", "transforms:"]
    for frame in (found.camera, found.board):
        x, y, z = (f"{value / 1000 + 0.0:.7f}" for value in frame.position)
        qx, qy, qz, qw = (f"{value + 0.0:.8f}" for value in frame.quaternion)
        lines += [
            f"  - parent: {frame.parent}",
            f"    child: {frame.child}",
            f"    translation: {{x: {x}, y: {y}, z: {z}}}",
            f"    rotation: {{x: {qx}, y: {qy}, z: {qz}, w: {qw}}}",
            f"    command: ros2 run tf2_ros static_transform_publisher --x {x} --y {y} --z {z} --qx {qx} --qy {qy}"
            f" --qz {qz} --qw {qw} --frame-id {frame.parent} --child-frame-id {frame.child}",
        ]
    return "\n".join([*lines, ""])
