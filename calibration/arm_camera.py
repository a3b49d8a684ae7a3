"""An arm and its camera in one fit: a board's poses in the camera as readings of the arm, and both frames of its fit.

A board on the flange that a camera beside the robot sees is a target like any other. A camera on the flange that sees
a board lying still is one too, read from its own end: its pose in the board's frame, with residuals in the camera's
(`ArmModel.sees`), as noise is the camera's. Units and orders are found as for a hand-eye calibration, by the nominal
arm's poses.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import ndtri

from calibench.calibration.arm import Arm, placement
from calibench.calibration.columns import POSITION, QUATERNION, by_their_names, match_columns
from calibench.calibration.determined import information_of
from calibench.calibration.fit import Fit
from calibench.calibration.hand_eye import Frame, frame_of
from calibench.calibration.hand_eye_start import Mounting, Pairs, Setup, read_pairs, side_of, start_of_pairs
from calibench.calibration.kinematics import Chain, forward, nominal
from calibench.calibration.readings import Table, readable
from calibench.calibration.rigid import Array, inverse, vector_of
from calibench.core.notes import DataError, Note, once
from calibench.core.words import as_units


def as_readings(table: Table, chain: Chain, setup: Setup) -> Table:
    """Return the joints of `table` with the pose of the target that the camera tells, in mm and quaternions.

    Raises `DataError`, in one line.
    """
    sides = {name: side_of(name)[0] for name in table.columns}
    if not {"board", "camera"} & set(sides.values()):
        raise DataError(
            f"{table.name}: no pose of the board is found among {', '.join(table.columns)}: board_x, board_y, board_z "
            "and board_qx ... board_qw or board_rx ... board_rz are needed (or camera_ for the camera in the board)"
        )
    of_arm = [name for name in readable(table) if not sides[name]]
    matched = match_columns(of_arm, chain.driven, source=chain.source)
    columns = matched.joints.values()
    turned, units, notes = by_their_names(table.columns, columns, table.units)
    table = replace(table, columns={**table.columns, **turned}, units={**table.units, **units})
    joints = np.column_stack([np.asarray(table.columns[name], dtype=float) for name in columns])
    try:
        pairs, seen, remarks = _pairs(table, chain, joints, setup)
    except DataError as error:
        turning = {joint.name for joint in chain.joints if joint.kind == "rotary"}
        degrees = [name in turning for name in chain.driven]
        try:
            _pairs(table, chain, np.where(degrees, np.deg2rad(joints), joints), setup)
        except DataError:
            raise error from None
        angles = [name for name, turns in zip(columns, degrees, strict=True) if turns]
        text = f"{table.name}: the board's poses fit the arm with its joints in degrees: {as_units(angles, 'deg')}"
        raise DataError(text) from None
    if setup.hand_eye == "eye_in_hand":
        seen = np.asarray(inverse(seen))
    target = "camera" if setup.hand_eye == "eye_in_hand" else "board"
    read = {f"{target}_{axis}": seen[:, k, 3] for k, axis in enumerate(POSITION)}
    turns = Rotation.from_matrix(seen[:, :3, :3]).as_quat()
    read |= {f"{target}_{axis}": turns[:, k] for k, axis in enumerate(QUATERNION)}
    places = {*matched.position.values(), *matched.rotation.values()}
    kept = {name: np.asarray(table.columns[name])[pairs.rows] for name in of_arm if name not in places}
    return replace(
        table, columns={**kept, **read}, units={**table.units, **dict.fromkeys([*read][:3], "mm")},
        file=table.file[pairs.rows], row=table.row[pairs.rows], notes=once([*pairs.notes, *notes, *remarks]),
    )  # fmt: skip


def _pairs(table: Table, chain: Chain, joints: Array, setup: Setup) -> tuple[Pairs, Array, tuple[Note, ...]]:
    """Return pairs of the nominal arm's poses and the board's, the board in the camera (n, 4, 4) [mm], and remarks."""
    whole = np.isfinite(joints).all(axis=1)
    flange = np.full((len(joints), 7), np.nan)
    if whole.any():
        poses = forward(chain, nominal(chain), joints[whole])
        flange[whole] = np.column_stack([poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat()])
    named = dict(zip((f"flange_{axis}" for axis in (*POSITION, *QUATERNION)), flange.T, strict=True))
    camera = {
        name: column for name, column in table.columns.items()
        if side_of(name)[0] in ("board", "camera") or name in ("split", "valid")
    }  # fmt: skip
    units: Mapping[str, str] = {**table.units, **dict.fromkeys([*named][:3], "mm")}
    pairs = read_pairs(replace(table, columns={**named, **camera}, units=units), setup, {})
    train = np.ones(len(pairs.rows), dtype=bool) if pairs.hold is None else ~pairs.hold
    _, seen, *_, remarks = start_of_pairs(pairs, setup.hand_eye, train, sides=("board",))
    return pairs, seen, remarks


def frames_of_fit(arm: Arm, fit: Fit, draws: Array, mounting: Mounting) -> tuple[Frame, Frame]:
    """Return the camera's frame and the board's by `fit`, with the intervals of its `draws` (b, k).

    Residuals are smaller than the noise by what went into numbers, and so are draws of them.
    """
    drawn = np.tile(fit.p, (len(draws) + 1, 1))
    drawn[1:, fit.kept] = draws
    chain, last = fit.model.chain, arm.last
    tip = chain.tip if last is None else last.parent  # the link to the target is the mount itself
    before = np.eye(4) if last is None else last.origin
    bases = np.stack([inverse(chain.mount @ placement(p[:6])) for p in drawn])
    tools = np.stack([before @ chain.tool @ placement(p[-6:]) for p in drawn])
    ends = ((tip, tools), (chain.base, bases))
    # the part of the residuals that went into numbers, those counting less that were known before
    known = float(information_of(fit.model)[fit.kept] @ np.diag(fit.covariance))
    spent = (len(fit.kept) - known) / max(float(fit.weights @ fit.model.counted), 1.0)
    frames = []
    for child, (parent, poses) in zip(
        ("camera", "board"), ends if mounting == "eye_in_hand" else ends[::-1], strict=True
    ):
        off = np.column_stack([poses[1:, :3, 3] - poses[0, :3, 3], vector_of(poses[1:, :3, :3] @ poses[0, :3, :3].T)])
        frames.append(frame_of(parent, child, poses[0], partial(_spread, np.cov(off.T) / (1 - spent))))
    return frames[0], frames[1]


def _spread(covariance: Array, slopes: Array) -> tuple[Array, Array]:
    se = np.sqrt(np.einsum("mi,ij,mj->m", slopes, covariance, slopes))
    return se, ndtri(0.975) * se
