"""The public door: calibrate, design, identify and hand_eye, from numbers to values; nothing is read but descriptions.

Readings are a mapping of columns, a pandas DataFrame, or an array with the names of its columns. What a column is in
stands in its name, ``x [m]``, or in `units`; without either it is found by what fits the arm, and a note says so.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calibench.calibration.arm import Arm, read_arm
from calibench.calibration.calibrate import Calibration, Level, calibrate_arm
from calibench.calibration.hand_eye import HandEye, calibrate_hand_eye
from calibench.calibration.hand_eye_start import Flange, Mounting, Read, Setup
from calibench.calibration.model import KNOWN_TO
from calibench.calibration.poses import OFF, By, Design, Limits, design_poses
from calibench.calibration.readings import table_of
from calibench.calibration.start import HowRead


def calibrate(
    urdf_or_table: str | Path | Arm, readings: Any, *, observe: str = "", rotation: str = "", limits: bool = True,
    distance: float = 0.0, sigma_distance: float = KNOWN_TO, level: Level = "auto", resamples: int = 200,
    columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None, names: Sequence[str] = (),
    name: str = "readings", base: str = "", tip: str = "", convention: str = "",
    priors: Mapping[str, tuple[float, float]] | None = None,
    hand_eye: Mounting | None = None, read: Read = "", board_scale: float = 1.0,
) -> Calibration:  # fmt: skip
    """Return the calibration of the arm in a URDF, or in a table of joints (CSV, Excel), by `readings`.

    `readings` have a column a joint, and x, y, z of the target (with a rotation, if one was measured), or `socket` for
    a ball in sockets. `priors` has numbers that are known, {"z_joint_3": (0.8, 0.05)}: off by so much, and its standard
    error [mm, rad]. `columns` renames, {"x": "Weg X"}; `names` are those of an array's columns. With `hand_eye` a
    camera is calibrated in the same fit, by the poses of a board that it sees, as in the function `hand_eye`. The other
    options are those of ``bench calibrate``. Raises `ValueError` in one line.
    """
    camera = None
    if hand_eye is not None:
        orders = {"board": rotation} if rotation else {}
        camera = Setup(hand_eye=hand_eye, read=read, rotation=orders, board_scale=board_scale)
    table = table_of(readings, columns=columns, units=units, names=names, name=name)
    how = HowRead(observe, rotation, limits)
    arm = read_arm(urdf_or_table, convention=convention, base=base, tip=tip, option="", data=table, how=how)
    return calibrate_arm(
        arm, table, how=how, distance=distance, sigma_distance=sigma_distance, level=level, resamples=resamples,
        priors=priors, camera=camera,
    )  # fmt: skip


def design(
    urdf_or_table: str | Path | Arm, count: int, readings: Any = None, *, by: By = "D", sigma: float | None = None,
    sigma_rotation: float | None = None, observe: str = "", rotation: str = "",
    target: Sequence[float] = (0.0, 100.0, 100.0), limits: Limits | None = None,
    box: Sequence[Sequence[float]] | None = None, keep_out: Sequence[Sequence[Sequence[float]]] = (),
    off: float = OFF, seed: int = 0, columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None, names: Sequence[str] = (), base: str = "", tip: str = "",
    convention: str = "",
) -> Design:  # fmt: skip
    """Return the `count` poses that are worth most to measure, beside those of `readings` where there are any.

    `box`, ((x0, x1), (y0, y1), (z0, z1)) [mm] in the base, holds the tip, and the arm keeps out of each box of
    `keep_out`; the other options are those of
    ``bench design machine=arm plan.n=``. Raises `ValueError` in one line.
    """
    how, start = HowRead(observe, rotation), None
    table = None if readings is None else table_of(readings, columns=columns, units=units, names=names)
    arm = read_arm(urdf_or_table, convention=convention, base=base, tip=tip, option="", data=table, how=how)
    if table is not None:
        start = how.start(table, arm.chain)
    return design_poses(
        arm, count, start=start, by=by, sigma=sigma, sigma_rotation=sigma_rotation, rotations=observe == "pose",
        target=target, limits=limits, box=None if box is None else np.asarray(box, dtype=float),
        keep_out=[np.asarray(one, dtype=float) for one in keep_out], off=off, seed=seed,
    )  # fmt: skip


def hand_eye(
    pairs: Any, *, mounting: Mounting = "eye_in_hand", read: Read = "", rotation: str | Mapping[str, str] = "",
    flange: Flange = "flange_in_base", board_scale: float | Literal["free"] = 1.0, sigma: float = 0.0,
    sigma_rotation: float = 0.0,
    columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None, names: Sequence[str] = (),
    name: str = "pairs",
) -> HandEye:  # fmt: skip
    """Return the frames of a camera and of a board by `pairs` of poses, of the flange in the base and of the board.

    Their columns are flange_x ... flange_qw, board_x ... board_qw, or angles rx, ry, rz, in the order `rotation` of
    both or of {"flange": ..., "board": ...}; the options are those of ``bench calibrate hand_eye=``. Raises
    `ValueError` in one line.
    """
    orders = dict.fromkeys(("flange", "board"), rotation) if rotation and isinstance(rotation, str) else rotation
    setup = Setup(
        hand_eye=mounting, read=read, rotation=orders or {}, sigma=sigma, sigma_rotation=sigma_rotation,
        flange=flange, board_scale=1.0 if board_scale == "free" else board_scale,
        free_scale=board_scale == "free",
    )  # fmt: skip
    return calibrate_hand_eye(table_of(pairs, columns=columns, units=units, names=names, name=name), setup)
