"""Hand-eye and robot-world calibration: pairs of a robot's and a board's poses give both unknown frames.

It is the calibration of an arm of three sliding and three turning joints whose frames alone are free. The noise is what
is left over its degrees of freedom (Rao 1971), intervals are Student's (Satterthwaite 1946); see Tsai and Lenz 1989.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import nan
from typing import Any, final

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import norm, t

from calibench.calibration.determined import order_of
from calibench.calibration.fit import FOLDS, Fit, cross_validate, fit_arm, fit_from, norms, predict, rms
from calibench.calibration.hand_eye_start import Mounting, Pairs, Setup, arm_poses, read_pairs, start_of_pairs
from calibench.calibration.kinematics import Chain, ChainJoint, forward
from calibench.calibration.model import ArmModel
from calibench.calibration.readings import Table, poses_of
from calibench.calibration.rigid import Array, Mask, inverse, rpy_of
from calibench.core.notes import Code, DataError, Note, once
from calibench.core.plain import finite
from calibench.core.process import one_thread
from calibench.core.words import counted, plain

_JOINTS = ("x", "y", "z", "yaw", "pitch", "roll")
_FLOOR = 1e-9  # mm or rad: the noise of readings without any
_ROUNDS, _SETTLED = 30, 1e-4
_LEAST = 1.0  # degree of freedom: with fewer nothing tells a noise


@final
@dataclass(frozen=True, eq=False)
class Adjustment:
    """Mount and tool (4, 4) [mm], and the covariance of their errors by the part of each noise, `parts` (2, 12, 12).

    An error is a shift [mm] and a turn [rad] behind the frame. `sigma` is the noise of places and rotations on an axis,
    `freedom` its degrees of freedom, infinite where it was stated. `fit` has the frames in its chain.
    """

    fit: Fit
    mount: Array
    tool: Array
    parts: Array
    sigma: tuple[float, float]
    freedom: tuple[float, float]


def model_of_pairs(arm: Array, seen: Array, mount: Array, tool: Array) -> ArmModel:
    """Return the model of poses `seen` (n, 4, 4) of the board in the camera, for the `arm`'s poses (n, 4, 4) [mm]."""
    n, axes = len(arm), np.eye(3)
    joints = tuple(
        ChainJoint(name, "sliding" if k < 3 else "rotary", np.eye(4), axes[k if k < 3 else 5 - k])
        for k, name in enumerate(_JOINTS)
    )
    chain = Chain(joints, np.eye(4), source="table", mount=mount, tool=tool)
    none = np.full(n, -1, dtype=np.int64)
    return ArmModel(
        chain=chain, joints=stands_of(arm), position=seen[:, :3, 3], turns=seen[:, :3, :3], socket=none, place=none,
        every=True,
    )  # fmt: skip


def stands_of(poses: Array) -> Array:
    """Return how the six joints stand at `poses` (n, 4, 4): x y z [mm], yaw, pitch and roll [rad], (n, 6)."""
    angles = rpy_of(poses)[:, ::-1]
    middle = np.arctan2(np.sin(angles).mean(axis=0), np.cos(angles).mean(axis=0))
    return np.column_stack([poses[:, :3, 3], middle + (angles - middle + np.pi) % (2 * np.pi) - np.pi])


def adjust(model: ArmModel, stated: tuple[float, float]) -> Adjustment:
    """Return the fit of mount and tool; `stated` is the noise of a place [mm] and a rotation [rad], 0 to learn it."""
    order = order_of(model.names, "frames")
    fit = fit_arm(model, order)
    everywhere = np.ones(len(model.joints), dtype=bool)
    sigma, freedom = fit.model.sigma, (np.inf, np.inf)
    for _ in range(_ROUNDS):
        # the noise of places and of rotations by the residuals under that of before, and its degrees of freedom
        before, noises, free = sigma, list(stated), [np.inf, np.inf]
        rows, inverted = _rows_of(fit)
        for k, part in enumerate(fit.model.errors(fit.p)):
            if not stated[k] and part is not None:
                spent = float(np.einsum("mi,ij,mj->", rows[k], inverted, rows[k]))
                free[k] = max(3 * float(fit.weights.sum()) - spent, _LEAST)
                noises[k] = max(float(np.sqrt((fit.weights[:, None] * part**2).sum() / free[k])), _FLOOR)
        sigma, freedom = (noises[0], noises[1]), (free[0], free[1])
        fit = replace(fit, model=replace(fit.model, sigma=sigma))
        fit = replace(fit, p=fit_from(fit, everywhere))
        if np.allclose(sigma, before, rtol=_SETTLED, atol=0.0):
            break

    # the corrections go into the frames of the chain, and none stay in its parameters
    chain, of_mount, of_tool = fit.model.chain, fit.p.copy(), fit.p.copy()
    of_mount[-6:] = of_tool[:6] = 0.0
    nothing = np.zeros((1, len(_JOINTS)))
    mount = forward(replace(chain, tool=np.eye(4)), of_mount, nothing)[0]
    tool = forward(replace(chain, mount=np.eye(4)), of_tool, nothing)[0]
    placed = replace(fit.model, chain=chain.placed(mount, tool))
    fit = replace(fit, model=placed, p=placed.start)
    rows, inverted = _rows_of(fit)
    parts = np.stack([inverted @ part.T @ part @ inverted for part in rows])
    return Adjustment(fit=fit, mount=mount, tool=tool, parts=parts, sigma=sigma, freedom=freedom)


def _rows_of(fit: Fit) -> tuple[Array, Array]:
    """Return slopes of places and rotations over their noise (2, 3 n, 12), and the inverse of their information."""
    kept = np.array(sorted(order_of(fit.model.names, "frames")), dtype=np.int64)
    rows = fit.model.jacobian(fit.p, kept, fit.weights)[0] * fit.weights[:, None, None]
    parts = np.stack([rows[:, :3].reshape(-1, len(kept)), rows[:, 3:].reshape(-1, len(kept))])
    both = parts.reshape(-1, len(kept))
    scale = np.linalg.norm(both, axis=0) + _FLOOR
    inverse = np.linalg.pinv((both / scale).T @ (both / scale), rcond=1e-13) / np.outer(scale, scale)
    return parts, np.asarray(inverse)


SCHEMA_VERSION = 1


@final
@dataclass(frozen=True)
class Residual:
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
@dataclass(frozen=True, kw_only=True)
class HandEye:
    """Both frames of one hand-eye calibration, `camera` and `board`, and how true they are.

    `fitted` is what is left of the fitted pairs; `unseen` of pairs that were not fitted: those that the file holds
    back, or each by a fit to others, as `how` says. `sigma` [mm] and `sigma_rotation` [rad] are the noise on an axis,
    `learned` from what is left, or stated. `scale` is how many times as far as the robot's moves say the camera sees
    the board, with its standard error; the frames take it as 1.
    """

    case: str
    hand_eye: Mounting
    read: str
    pairs: int
    camera: Frame
    board: Frame
    fitted: Residual
    unseen: Residual
    how: str
    sigma: float
    sigma_rotation: float
    learned: tuple[bool, bool]
    scale: float
    scale_se: float
    outliers: tuple[Outlier, ...] = ()
    notes: tuple[Note, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"schema_version": SCHEMA_VERSION, **finite(self)}


Numbers = tuple[float, ...]
Intervals = tuple[tuple[float, float], ...]


@final
@dataclass(frozen=True, kw_only=True)
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


def frames_of(adjustment: Adjustment, mounting: str) -> tuple[Frame, Frame]:
    """Return the camera's frame, and the board's: on the flange and in the base, or the other way round."""
    camera, board = ("flange", "base") if mounting == "eye_in_hand" else ("base", "flange")
    frames = []
    for parent, child, pose, slopes in zip(
        (camera, board), ("camera", "board"), (inverse(adjustment.mount), adjustment.tool), slopes_of(adjustment),
        strict=True,
    ):  # fmt: skip
        x, y, z, w = q = np.asarray(Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True))
        turned = 0.5 * np.array([[w, z, -y], [-z, w, x], [y, -x, w], [-x, -y, -z]])  # of a small turn before q
        place, of_place = spread(adjustment, slopes[:3])
        turn, of_turn = spread(adjustment, slopes[3:])
        quaternion, of_quaternion = spread(adjustment, turned @ slopes[3:])
        position_ci95, quaternion_ci95 = (
            tuple((float(v - h), float(v + h)) for v, h in zip(values, half, strict=True))
            for values, half in ((pose[:3, 3], of_place), (q, of_quaternion))
        )
        numbers = {
            "position": pose[:3, 3], "position_se": place, "quaternion": q, "quaternion_se": quaternion,
            "turn_se": turn, "turn_within95": of_turn, "rpy": rpy_of(pose),
        }  # fmt: skip
        frames.append(Frame(
            parent=parent, child=child, position_ci95=position_ci95, quaternion_ci95=quaternion_ci95,
            matrix=tuple(tuple(map(float, row)) for row in pose),
            **{name: tuple(map(float, values)) for name, values in numbers.items()},
        ))  # fmt: skip
    return frames[0], frames[1]


def slopes_of(adjustment: Adjustment) -> Array:
    """Return how errors of mount and tool (12,) move camera and board, (2, 6, 12): shift and turn in their parents."""
    slopes, (x, y, z) = np.zeros((2, 6, 12)), inverse(adjustment.mount)[:3, 3]
    slopes[0, :3, :3] = slopes[0, 3:, 3:6] = -np.eye(3)
    slopes[0, :3, 3:6] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    slopes[1, :3, 6:9] = slopes[1, 3:, 9:] = adjustment.tool[:3, :3]
    return slopes


def spread(adjustment: Adjustment, slopes: Array) -> tuple[Array, Array]:
    """Return standard errors of the numbers with `slopes` (k, 12), and half widths of their 95 % intervals."""
    parts = np.einsum("ki,pij,kj->pk", slopes, adjustment.parts, slopes)
    variance, squares = parts.sum(axis=0), (parts**2 / np.array(adjustment.freedom)[:, None]).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        effective = np.where(squares > 0, variance**2 / squares, np.inf)
    width = np.where(np.isfinite(effective), t.ppf(0.975, np.minimum(effective, 1e9)), norm.ppf(0.975))
    return np.sqrt(variance), width * np.sqrt(variance)


_CHANCE = 1e-3  # of noise alone to be told as a scale
_SPARE = 3.0  # degrees of freedom: with fewer a scale is not told from noise
_SCALE_ROUNDS = 10


@final
@dataclass(frozen=True)
class Scale:
    """How many times as far as the frames say the board is seen, its standard error, and whether noise is unlikely."""

    value: float
    se: float
    unlikely: bool


def scale_of(adjustment: Adjustment, learned: bool) -> Scale | None:
    """Return the scale of the board's places; None where too few pairs tell it. `learned` is the noise of places."""
    fit = adjustment.fit
    position, turned = fit.model.errors(fit.p)
    assert turned is not None
    assert fit.model.position is not None
    kept, (places, rotations) = ~fit.wild, _rows_of(fit)[0]
    seen = (position + fit.model.position)[kept].reshape(-1, 1)
    keep = np.repeat(kept, 3)
    places = np.hstack([adjustment.sigma[0] * places[keep], seen])  # in mm
    rotations = np.hstack([rotations[keep], np.zeros((int(keep.sum()), 1))])
    wanted, turns = -position[kept].ravel(), -turned[kept].ravel() / adjustment.sigma[1]
    size = np.linalg.norm(np.vstack([places / adjustment.sigma[0], rotations]), axis=0) + _FLOOR
    sigma, freedom = adjustment.sigma[0], np.inf
    for _ in range(_SCALE_ROUNDS):
        rows = np.vstack([places / sigma, rotations]) / size
        covariance = np.linalg.pinv(rows.T @ rows, rcond=1e-13)
        solved = covariance @ rows.T @ np.concatenate([wanted / sigma, turns])
        if not learned:
            break
        over = rows[: len(wanted)]
        freedom = len(wanted) - float(np.einsum("mi,ij,mj->", over, covariance, over))
        if freedom < _SPARE:
            return None
        sigma = max(float(np.linalg.norm(wanted - places @ (solved / size)) / np.sqrt(freedom)), _FLOOR)
    value = float(solved[-1] / size[-1])
    se = max(float(np.sqrt(covariance[-1, -1]) / size[-1]), _FLOOR)
    limit = t.ppf(1 - _CHANCE / 2, freedom) if np.isfinite(freedom) else norm.ppf(1 - _CHANCE / 2)
    return Scale(1 + value, se, bool(abs(value) > limit * se))


LEAST = 3  # poses: two motions about different axes
_TURNS = np.deg2rad(0.5)  # rad: less than this about an axis is how a robot holds still
_WORTH = 0.2  # of the board's distance, or 0.2 rad: a number known no better is not told by the poses
_FEW_TURNS = np.deg2rad(15)  # rad: less about an axis, and the intervals are wide
_BESIDE = 20  # poses from which all others are looked at
_WAY_OUT = "add poses that turn the flange by 30° or more about at least two axes, such as 10 to 20 of them"


def check_poses(flange: Array, stands: Array, stated: bool) -> None:
    """Refuse poses of the flange (n, 4, 4) that cannot tell both frames; `stands` (n, 6) tell the same poses apart."""
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


def _turned(flange: Array) -> tuple[float, Array, float, Array]:
    """Return the largest turn between poses [rad], the axis of most turns, the largest beside it, and across it."""
    some = flange[:: max(1, len(flange) // _BESIDE), :3, :3]
    turns = np.concatenate([Rotation.from_matrix(one.T @ flange[:, :3, :3]).as_rotvec() for one in some])
    axes = np.linalg.svd(turns, full_matrices=False)[2]
    axis, across = axes[0], axes[-1]
    beside = float(np.linalg.norm(turns - np.outer(turns @ axis, axis), axis=1).max())
    return float(np.linalg.norm(turns, axis=1).max()), axis, beside, across


def check_determined(adjustment: Adjustment) -> None:
    """Refuse frames of which a direction is known worse than a fifth of the board's distance, or .2 rad."""
    position = adjustment.fit.model.position
    assert position is not None
    distance = float(np.median(np.linalg.norm(position, axis=1)))
    for child, slopes in zip(("camera", "board"), slopes_of(adjustment), strict=True):
        for part, worth, unit in ((slopes[:3], _WORTH * distance, "mm"), (slopes[3:], _WORTH, "rad")):
            covariance = part @ adjustment.parts.sum(axis=0) @ part.T
            direction = np.linalg.eigh(covariance)[1][:, -1]
            half = float(spread(adjustment, direction[None] @ part)[1][0])
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


_LEAST_POSES = 5  # different poses: with fewer none can be left out
_FEW = 10  # poses: with fewer the noise is hardly known
_MANY = 0.1  # of the pairs: more outlying ones are no mishaps


@one_thread()
def calibrate_hand_eye(table: Table, setup: Setup, columns: Mapping[str, str] | None = None) -> HandEye:
    """Return the frames of camera and board by the pairs of poses in `table`. Raises `ValueError`, in one line."""
    try:
        pairs = read_pairs(table, setup, columns or {})
    except ValueError as error:
        text = str(error)
        raise DataError(text if text.startswith(table.name) else f"{table.name}: {text}") from None
    try:
        return _calibrate(pairs, setup)
    except ValueError as error:
        also = f" ({pairs.still})" if pairs.still else ""
        raise DataError(f"{pairs.table.name}: {error}{also}", getattr(error, "note", None)) from None


def _calibrate(pairs: Pairs, setup: Setup) -> HandEye:
    train = np.ones(len(pairs.rows), dtype=bool) if pairs.hold is None else ~pairs.hold
    named = pairs.flange.poses(next(iter(pairs.flange.meanings)))  # one axis is one in any order of angles
    check_poses(named[train], stands_of(named[train]), bool(setup.sigma and setup.sigma_rotation))
    arm, seen, mount, tool, remarks = start_of_pairs(pairs, setup.hand_eye, train)
    model = model_of_pairs(arm, seen, mount, tool)
    adjustment = adjust(model.at(train), (setup.sigma, setup.sigma_rotation))
    check_determined(adjustment)
    fit = adjustment.fit
    poses = len(np.unique(poses_of(fit.model.joints)))
    unseen, how = _unseen(fit, model, train, poses)
    camera, board = frames_of(adjustment, setup.hand_eye)
    position, turned = fit.model.errors(fit.p)
    assert turned is not None
    apart, angles = norms((position, None)), np.linalg.norm(turned, axis=1)
    rows, kept = [pairs.table.label(int(row)) for row in pairs.rows[train]], ~fit.wild
    worst_first = sorted(np.flatnonzero(fit.wild), key=lambda i: -apart[i])
    scale = scale_of(adjustment, not setup.sigma)
    notes = []
    if scale and scale.unlikely:
        stated = setup.board_scale / scale.value
        size = f"{plain(100 * abs(1 / scale.value - 1), 2)} % {'smaller' if scale.value > 1 else 'larger'}"
        text = (
            f"the camera sees the board {plain(scale.value, 5)} times as far as the robot's moves say (standard error "
            f"{plain(scale.se, 2)}): the frames and their intervals are wrong. Measure the board: if its squares or "
            f"markers are {size} than the camera was told, state board_scale={plain(stated, 5)}; if they are not, "
            "calibrate the camera's lens anew"
        )
        notes.append(Note(Code.SCALE, text, values={"scale": scale.value, "se": scale.se, "board_scale": stated}))
    largest, axis, beside, across = _turned(arm_poses(arm, setup.hand_eye)[train][kept])
    if min(largest, beside) < _FEW_TURNS:  # which turns would narrow the intervals
        degrees, others = (plain(float(np.rad2deg(angle)), 2) for angle in (largest, beside))
        text = f"the flange turns by {degrees}° at the most, so that the intervals are wide: {_WAY_OUT}"
        if largest >= _FEW_TURNS:
            text = (
                f"the flange turns by up to {degrees}° about its axis ({_listed(axis)}), and by {others}° at the most "
                f"about others: add poses that turn it by 30° or more about its axis ({_listed(across)})"
            )
        notes.append(Note(Code.FEW_TURNS, text, values={"largest_rad": largest, "beside_rad": beside}))
    notes += [*pairs.notes, *remarks]
    if fit.wild.mean() > _MANY:
        text = (
            f"{int(fit.wild.sum())} of {len(fit.wild)} pairs are outlying, and that many have a cause: a board that "
            "moved, or poses that were read before the robot stood still"
        )
        notes.append(Note(Code.MANY_WILD, text, values={"readings": int(fit.wild.sum())}))
    if poses < _FEW:
        text = f"{counted(poses, 'different pose')} are few, and wide intervals say so: 15 or more are usual"
        notes.append(Note(Code.FEW_POSES, text, values={"poses": poses}))
    return HandEye(
        case=pairs.table.name, hand_eye=setup.hand_eye, read=pairs.read, pairs=len(pairs.rows), camera=camera,
        board=board, fitted=Residual(int(kept.sum()), rms(apart[kept]), rms(angles[kept])), unseen=unseen, how=how,
        sigma=adjustment.sigma[0], sigma_rotation=adjustment.sigma[1],
        learned=(not setup.sigma, not setup.sigma_rotation),
        scale=scale.value if scale else nan, scale_se=scale.se if scale else nan,
        outliers=tuple(Outlier(rows[i], float(apart[i]), float(angles[i])) for i in worst_first),
        notes=once(notes),
    )  # fmt: skip


def _unseen(fit: Fit, model: ArmModel, train: Mask, poses: int) -> tuple[Residual, str]:
    """Return what is left of pairs of `model` that were not fitted, and in words how."""
    if not train.all():
        whole = replace(
            fit.model, joints=model.joints, position=model.position, turns=model.turns, socket=model.socket,
            place=model.place,
        )  # fmt: skip
        errors, known, how = predict(fit, whole, ~train), ~train, f"{int((~train).sum())} rows that the file holds back"
    elif poses < _LEAST_POSES:
        return Residual(0), f"unknown: {_LEAST_POSES} different poses are needed to leave one out"
    else:
        errors, known = cross_validate(fit), ~fit.wild
        how = f"every {'fifth' if poses > FOLDS else 'one'} of {poses} different poses left out in turn"
    assert errors.rotation is not None
    return Residual(int(known.sum()), rms(errors.position[known]), rms(errors.rotation[known])), how
