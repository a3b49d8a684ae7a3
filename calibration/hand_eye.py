"""Hand-eye and robot-world calibration: pairs of a robot's and a board's poses give both unknown frames.

Intervals are Student's (Satterthwaite 1946); see Tsai and Lenz 1989. `hand_eye_start` says what the start is, and
`hand_eye_fit` what is fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import nan
from typing import Any, final

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import ndtri, stdtrit

from calibench.calibration import hand_eye_start as begin
from calibench.calibration.closed_forms import ClosedForm, closed_forms
from calibench.calibration.fit import FOLDS, rms
from calibench.calibration.hand_eye_fit import Adjustment, Sight, adjust, again, errors_of, stands_of
from calibench.calibration.readings import Table, poses_of
from calibench.calibration.rigid import Array, Mask, inverse, rpy_of
from calibench.core.notes import Code, DataError, Note, once
from calibench.core.plain import finite
from calibench.core.process import one_thread
from calibench.core.words import counted, plain

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
    the board, with its standard error; the frames take it as 1, unless it is free. `offset` [s] is how far the camera's
    clock is ahead of the robot's, where each has its own. `closed_forms` are what those of other tools have.
    """

    case: str
    hand_eye: begin.Mounting
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
    free_scale: bool = False
    offset: float = nan
    offset_se: float = nan
    offset_ci95: tuple[float, float] = (nan, nan)
    closed_forms: tuple[ClosedForm, ...] = ()
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


def frame_of(parent: str, child: str, pose: Array, spread: Callable[[Array], tuple[Array, Array]]) -> Frame:
    """Return the frame at `pose` (4, 4) [mm]: `spread` has standard errors and half widths of its numbers.

    It takes how these numbers follow a shift and a turn (m, 6) of the pose, in its parent.
    """
    x, y, z, w = q = np.asarray(Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True))
    shift, turn = np.split(np.eye(6), 2)
    (place, of_place), (angle, of_angle) = spread(shift), spread(turn)
    turned = 0.5 * np.array([[w, z, -y], [-z, w, x], [y, -x, w], [-x, -y, -z]])  # of a small turn before q
    quaternion, of_quaternion = spread(turned @ turn)
    position_ci95, quaternion_ci95 = (
        tuple((float(v - h), float(v + h)) for v, h in zip(values, half, strict=True))
        for values, half in ((pose[:3, 3], of_place), (q, of_quaternion))
    )
    numbers = {
        "position": pose[:3, 3], "position_se": place, "quaternion": q, "quaternion_se": quaternion,
        "turn_se": angle, "turn_within95": of_angle, "rpy": rpy_of(pose),
    }  # fmt: skip
    return Frame(
        parent=parent, child=child, position_ci95=position_ci95, quaternion_ci95=quaternion_ci95,
        matrix=tuple(tuple(map(float, row)) for row in pose),
        **{name: tuple(map(float, values)) for name, values in numbers.items()},
    )  # fmt: skip


def frames_of(adjustment: Adjustment, mounting: str) -> tuple[Frame, Frame]:
    """Return the camera's frame, and the board's: on the flange and in the base, or the other way round."""
    of_camera, of_board = ("flange", "base") if mounting == "eye_in_hand" else ("base", "flange")
    by_camera, by_board = slopes_of(adjustment)
    mount = np.asarray(inverse(adjustment.mount))
    camera = frame_of(of_camera, "camera", mount, lambda numbers: spread(adjustment, numbers @ by_camera))
    board = frame_of(of_board, "board", adjustment.tool, lambda numbers: spread(adjustment, numbers @ by_board))
    return camera, board


def slopes_of(adjustment: Adjustment) -> Array:
    """Return how errors of mount and tool (12,) move camera and board, (2, 6, 12): shift and turn in their parents."""
    slopes, (x, y, z) = np.zeros((2, 6, 12)), inverse(adjustment.mount)[:3, 3]
    slopes[0, :3, :3] = slopes[0, 3:, 3:6] = -np.eye(3)
    slopes[0, :3, 3:6] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    slopes[1, :3, 6:9] = slopes[1, 3:, 9:] = adjustment.tool[:3, :3]
    return slopes


def spread(adjustment: Adjustment, slopes: Array) -> tuple[Array, Array]:
    """Return standard errors of the numbers with `slopes` (m, k), and half widths of their 95 % intervals."""
    se, freedom = errors_of(adjustment, slopes)
    return se, se * _student(0.975, freedom)


def _student(chance: float, freedom: Array) -> Array:
    return np.where(np.isfinite(freedom), stdtrit(np.minimum(freedom, 1e9), chance), ndtri(chance))


_CHANCE = 1e-3  # of noise alone to be told as a scale
_SPARE = 3.0  # degrees of freedom: with fewer a scale is not told from noise
_OTHER = 0.2  # a scale further from 1 is another camera or another board, and the frames are worth nothing


def scale_of(adjustment: Adjustment, stated: tuple[float, float] = (0.0, 0.0)) -> tuple[float, float, bool]:
    """Return how many times as far as it is the board is seen, with its standard error, and if noise hardly does that.

    It is fitted beside the frames; NaN where too few pairs tell it.
    """
    one = adjustment
    if "scale" not in one.free:
        free = (*one.free, "scale")
        one = adjust(one.sight, one.mount, one.tool, stated, near=~one.wild, free=free, offset=one.offset)
    slope = np.eye(12 + len(one.free))[[12 + one.free.index("scale")]]
    se, freedom = (float(value[0]) for value in errors_of(one, slope))
    if freedom < _SPARE:
        return nan, nan, False
    limit = max(se, 1e-9) * float(_student(1 - _CHANCE / 2, np.array(freedom)))
    return one.scale, max(se, 1e-9), bool(abs(one.scale - 1) > limit)


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
    distance = float(np.median(np.linalg.norm(adjustment.sight.seen[:, :3, 3], axis=1)))
    for child, slopes in zip(("camera", "board"), slopes_of(adjustment), strict=True):
        for part, worth, unit in ((slopes[:3], _WORTH * distance, "mm"), (slopes[3:], _WORTH, "rad")):
            covariance = part @ adjustment.parts.sum(axis=0)[:12, :12] @ part.T
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
_MOST = 0.6  # of the pairs: with more that are far nothing tells which are right
_SO_ALIKE = 0.9  # correlation of neighbours that no drift between still poses has
_MANY = 0.1  # of the pairs: more outlying ones are no mishaps


@one_thread()
def calibrate_hand_eye(table: Table, setup: begin.Setup, columns: Mapping[str, str] | None = None) -> HandEye:
    """Return the frames of camera and board by the pairs of poses in `table`. Raises `ValueError`, in one line."""
    try:
        pairs = begin.read_pairs(table, setup, columns or {})
    except ValueError as error:
        text = str(error)
        raise DataError(text if text.startswith(table.name) else f"{table.name}: {text}") from None
    try:
        return _calibrate(pairs, setup)
    except ValueError as error:
        also = f" ({pairs.still})" if pairs.still else ""
        raise DataError(f"{pairs.table.name}: {error}{also}", getattr(error, "note", None)) from None


def _calibrate(read: begin.Pairs, setup: begin.Setup) -> HandEye:
    pairs, offset = begin.in_step(read, setup.hand_eye)
    train = np.ones(len(pairs.rows), dtype=bool) if pairs.hold is None else ~pairs.hold
    named = pairs.flange.poses(next(iter(pairs.flange.meanings)))  # one axis is one in any order of angles
    stated = (setup.sigma, setup.sigma_rotation)
    check_poses(named[train], stands_of(named[train]), all(stated))
    start = begin.start_of_pairs(pairs, setup.hand_eye, train, free_scale=setup.free_scale)
    arm, seen, mount, tool, near, remarks = start
    track = None
    if pairs.time is not None:  # in the meaning that has the arm's poses
        at, tracks = pairs.time - offset, [begin.track_of(read, meaning) for meaning in read.flange.meanings]
        track = min(tracks, key=lambda one: float(np.abs(begin.arm_poses(one.at(at), setup.hand_eye) - arm).max()))
    sight = Sight(arm, seen, pairs.time, track, setup.hand_eye == "eye_in_hand")
    free = (("offset",) if track else ()) + (("scale",) if setup.free_scale else ())
    adjustment = adjust(sight.at(train), mount, tool, stated, near=near, free=free, offset=offset)
    if adjustment.wild.mean() > _MOST:
        raise DataError(
            f"{int(adjustment.wild.sum())} of {len(near)} pairs do not go with the others: with more than "
            f"{plain(100 * _MOST)} % nothing says which are right. Do both poses of a row belong together?"
        )
    check_determined(adjustment)
    poses = len(np.unique(poses_of(stands_of(adjustment.sight.arm))))
    unseen, how = _unseen(adjustment, sight, train, poses)
    camera, board = frames_of(adjustment, setup.hand_eye)
    apart, angles = (np.linalg.norm(one, axis=1) for one in (adjustment.position, adjustment.turned))
    rows, kept = [pairs.table.label(int(row)) for row in pairs.rows[train]], ~adjustment.wild
    worst_first = sorted(np.flatnonzero(adjustment.wild), key=lambda i: -apart[i])
    scale, scale_se, unlikely = scale_of(adjustment, stated)
    notes = []
    if unlikely and not setup.free_scale:
        cure = setup.board_scale / scale
        size = f"{plain(100 * abs(1 / scale - 1), 2)} % {'smaller' if scale > 1 else 'larger'}"
        text = (
            f"the camera sees the board {plain(scale, 5)} times as far as the robot's moves say (standard error "
            f"{plain(scale_se, 2)}): the frames and their intervals are wrong. Measure the board: if its squares or "
            f"markers are {size} than the camera was told, state board_scale={plain(cure, 5)}; if they are not, "
            "calibrate the camera's lens anew"
        )
        if abs(scale - 1) > _OTHER:
            raise DataError(text)
        notes.append(Note(Code.SCALE, text, values={"scale": scale, "se": scale_se, "board_scale": cure}))
    largest, axis, beside, across = _turned(begin.arm_poses(arm, setup.hand_eye)[train][kept])
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
    notes += _of_noise(adjustment)
    forms = closed_forms(adjustment)
    notes += _of_forms(forms, camera, adjustment)
    if adjustment.wild.mean() > _MANY:
        text = (
            f"{int(adjustment.wild.sum())} of {len(adjustment.wild)} pairs are outlying, and that many have a cause: "
            "a board that moved, or poses that were read before the robot stood still"
        )
        notes.append(Note(Code.MANY_WILD, text, values={"readings": int(adjustment.wild.sum())}))
    if poses < _FEW:
        text = f"{counted(poses, 'different pose')} are few, and wide intervals say so: 15 or more are usual"
        notes.append(Note(Code.FEW_POSES, text, values={"poses": poses}))
    clock: dict[str, Any] = {}
    if track:
        slope = np.eye(12 + len(free))[[12 + free.index("offset")]]
        se, half = (float(one[0]) for one in spread(adjustment, slope))
        value = adjustment.offset
        clock = {"offset": value, "offset_se": se, "offset_ci95": (value - half, value + half)}
    return HandEye(
        case=pairs.table.name, hand_eye=setup.hand_eye, read=pairs.read, pairs=len(pairs.rows), camera=camera,
        board=board, fitted=Residual(int(kept.sum()), rms(apart[kept]), rms(angles[kept])), unseen=unseen, how=how,
        sigma=adjustment.sigma[0], sigma_rotation=adjustment.sigma[1],
        learned=(not setup.sigma, not setup.sigma_rotation),
        scale=scale, scale_se=scale_se, free_scale=setup.free_scale, **clock, closed_forms=forms,
        outliers=tuple(Outlier(rows[i], float(apart[i]), float(angles[i])) for i in worst_first),
        notes=once(notes),
    )  # fmt: skip


def _of_noise(adjustment: Adjustment) -> Iterator[Note]:
    """Yield what the noise is like: of neighbours that agree, and by direction."""
    likeness = float(adjustment.alike.max())
    if likeness > 0:
        text = (
            f"what is left of a pair follows what is left of the pair before (correlation {plain(likeness, 2)}; noise "
            "alone has none), and intervals are wider for it. A lag between robot and camera, a board or a base that "
            "drifts, or an arm that is not calibrated does that, and may shift the frames further: "
        )
        if adjustment.sight.track is not None:
            text += "the clocks are fitted already, so stand still for each pair"
        elif likeness > _SO_ALIKE:
            text += (
                "so strongly a lag does it at most, and wider intervals do not mend it. Write robot and camera each "
                "into a file with a column time, and give data=robot.csv,camera.csv; or stand still for each pair"
            )
        else:
            text += "give both streams with time stamps, or stand still for each pair"
        yield Note(Code.ALIKE, text, values={"correlation": likeness})
    if len(adjustment.noise) > 2:
        noise, groups = adjustment.noise, adjustment.groups
        parts = []
        if groups[0] != groups[1]:
            along, across = (plain(float(noise[groups[k]]), 2) for k in (0, 1))
            parts.append(f"{along} mm along the line of sight and {across} mm across")
        if groups[3] != groups[4]:
            about, across = (plain(float(np.rad2deg(noise[groups[k]])), 2) for k in (3, 4))
            parts.append(f"{about}° about the board's normal and {across}° about its other axes")
        yield Note(Code.NOISE_BY_AXIS, f"the board's pose has a noise of {', and of '.join(parts)}")


def _of_forms(forms: Sequence[ClosedForm], camera: Frame, found: Adjustment) -> Iterator[Note]:
    """Yield where closed forms lie outside of the interval of the `camera`, and why, unless noise alone does that."""
    half, half_turn = np.diff(camera.position_ci95)[:, 0] / 2, np.array(camera.turn_within95)
    far: list[ClosedForm] = []  # of all pairs, and of the near ones
    near: list[ClosedForm] = []
    for form in forms:
        for those, shift, turn in ((far, form.shift, form.turn), (near, form.shift_near, form.turn_near)):
            if (np.abs(shift) > half).any() or (np.abs(turn) > half_turn).any():
                those.append(form)
    if not far:
        return
    noise = f"{plain(max(form.noise for form in far), 2)} mm"
    if any(not form.by_noise for form in near):
        why = f"the noise of these pairs has them {noise} apart, so something else than noise is in the pairs: "
        why += "their neighbours in order of rows agree, as with a lag or a drift" if found.alike.max() > 0 else (
            "a lag, a lens or a board that is not as stated, or an arm that is not calibrated"
        )  # fmt: skip
        why += ", which moves each method another way. Trust none of them before that is found"
    elif any(not replace(form, shift_near=form.shift, turn_near=form.turn).by_noise for form in far):
        off = plain(max(float(np.linalg.norm(form.shift_near)) for form in far), 2)
        why = f"outlying pairs are in them, and not in this fit; without them they are {off} mm off"
    elif len(found.noise) > 2:
        why = (
            f"they weigh all directions alike, and the noise differs by direction, which alone has them {noise} apart; "
            "this fit weighs each by its noise"
        )
    else:
        return
    values = {form.name: float(np.linalg.norm(form.shift)) for form in far}
    text = (
        f"closed forms of other tools have the camera outside of the interval, up to {plain(max(values.values()), 2)} "
        f"mm off: {why}"
    )
    yield Note(Code.FORMS_DIFFER, text, values=values)


def _unseen(found: Adjustment, sight: Sight, train: Mask, poses: int) -> tuple[Residual, str]:
    """Return what is left of pairs of `sight` that were not fitted, and in words how."""
    if not train.all():
        position, turned = found.errors(sight.at(~train))
        known, how = np.ones(len(position), dtype=bool), f"{int((~train).sum())} rows that the file holds back"
    elif poses < _LEAST_POSES:
        return Residual(0), f"unknown: {_LEAST_POSES} different poses are needed to leave one out"
    else:
        fold, known = poses_of(stands_of(found.sight.arm)) % FOLDS, ~found.wild
        position, turned = np.full_like(found.position, np.nan), np.full_like(found.turned, np.nan)
        for k in range(int(fold.max()) + 1):
            there = np.asarray(fold == k)
            position[there], turned[there] = again(found, ~there).errors(found.sight.at(there))
        how = f"every {'fifth' if poses > FOLDS else 'one'} of {poses} different poses left out in turn"
    sizes = (rms(np.linalg.norm(one[known], axis=1)) for one in (position, turned))
    return Residual(int(known.sum()), *sizes), how
