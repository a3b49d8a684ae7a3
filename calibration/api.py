"""The public door: calibrate, design, identify and hand_eye, from numbers to values; nothing is read but descriptions.

Readings are a mapping of columns, a pandas DataFrame, or an array with the names of its columns. What a column is in
stands in its name, ``x [m]``, or in `units`; without either it is found by what fits the arm, and a note says so.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal, ParamSpec, TypeVar

import numpy as np

from calibench.calibration.arm import Arm, read_arm
from calibench.calibration.calibrate import Calibration, Level, calibrate_arm
from calibench.calibration.hand_eye import HandEye, calibrate_hand_eye
from calibench.calibration.hand_eye_start import Flange, Mounting, Read, Setup
from calibench.calibration.model import KNOWN_TO
from calibench.calibration.poses import OFF, By, Design, Limits, design_poses
from calibench.calibration.readings import table_of
from calibench.calibration.start import HowRead
from calibench.core.options import Range, declared_options

P = ParamSpec("P")
R = TypeVar("R")
Observe = Literal["", "position", "pose", "sockets"]
_Positive = Annotated[float, Range(0, above=True)]
_PositiveOrNone = Annotated[float | None, Range(0, above=True)]
_NotNegative = Annotated[float, Range(0)]


def _checked(call: Callable[P, R]) -> Callable[P, R]:
    """Return `call`, whose options are taken in the types and ranges that its signature states, or refused by name."""
    declared, signature = declared_options(call), inspect.signature(call)

    @wraps(call)
    def checked(*args: P.args, **kwargs: P.kwargs) -> R:
        given = signature.bind(*args, **kwargs)
        for name, value in given.arguments.items():
            plain = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
            given.arguments[name] = value if declared[name].type is Any else declared[name].taken(name, plain)
        return call(*given.args, **given.kwargs)

    return checked


@_checked
def calibrate(
    urdf_or_table: str | Path | Arm, readings: Any, *, observe: Observe = "", rotation: str = "", limits: bool = True,
    distance: _NotNegative = 0.0, sigma_distance: _Positive = KNOWN_TO, level: Level = "auto",
    resamples: Annotated[int, Range(20)] = 200,
    columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None, names: Sequence[str] = (),
    name: str = "readings", base: str = "", tip: str = "", convention: str = "",
    priors: Mapping[str, tuple[float, float]] | None = None,
    hand_eye: Mounting | None = None, read: Read = "", board_scale: _Positive = 1.0,
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


@_checked
def design(
    urdf_or_table: str | Path | Arm, count: Annotated[int, Range(1)], readings: Any = None, *, by: By = "D",
    sigma: _PositiveOrNone = None, sigma_rotation: _PositiveOrNone = None, observe: Observe = "", rotation: str = "",
    target: tuple[float, float, float] = (0.0, 100.0, 100.0), limits: Limits | None = None,
    box: Any = None, keep_out: Any = (), off: _Positive = OFF, seed: int = 0, columns: Mapping[str, str] | None = None,
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
        target=target, limits=limits, box=None if box is None else np.reshape(np.asarray(box, dtype=float), (3, 2)),
        keep_out=[*np.reshape(np.asarray(keep_out, dtype=float), (-1, 3, 2))], off=off, seed=seed,
    )  # fmt: skip


@_checked
def hand_eye(
    pairs: Any, *, mounting: Mounting = "eye_in_hand", read: Read = "", rotation: str | Mapping[str, str] = "",
    flange: Flange = "flange_in_base", board_scale: Annotated[float | Literal["free"], Range(0, above=True)] = 1.0,
    sigma: _NotNegative = 0.0, sigma_rotation: _NotNegative = 0.0,
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
