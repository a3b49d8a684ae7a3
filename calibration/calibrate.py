"""The calibration of an arm from beginning to end: read, start, fit, hold out, choose, and the answer as a value.

The levels (frames, zeros, geometry, gains) are fitted one after the other. The level that predicts held-out poses best
is the answer; a richer level must be better by more than chance would make it, otherwise the simpler one is taken. A
URDF has no place for gains, so they are written only on request, and reported otherwise.

Where the file holds rows back, the others alone are fitted: they choose the level by cross-validation among themselves,
and are what is written. The errors are then of the rows held back. Otherwise all rows are fitted, and the errors are
cross-validated.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import nan
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, final

import numpy as np

from calibench.calibration.arm import Arm, Files, correction
from calibench.calibration.determined import LEVELS, is_gain, order_of
from calibench.calibration.fit import Fit, far_out, fit_arm, norms
from calibench.calibration.frames import stepped
from calibench.calibration.kinematics import forward, nominal
from calibench.calibration.leave_out import FOLDS, HeldOut, cross_validate, predict, resample, rms, rms_interval
from calibench.calibration.model import KNOWN_TO, ArmModel, model_of
from calibench.calibration.poses import foretold, ranges
from calibench.calibration.readings import Readings, Table, joints_beside, poses_of
from calibench.calibration.result import (
    Change,
    Drawn,
    Error,
    OverJoint,
    Part,
    Undetermined,
    Wild,
    by_joint,
    by_region,
    changes_of,
    changes_of_tip,
    drawn_of,
    over_joints,
    undetermined_of,
)
from calibench.calibration.rigid import Array, Index, Mask, rpy_of
from calibench.calibration.start import DOUBTFUL, HowRead
from calibench.core.notes import Code, DataError, Note, once
from calibench.core.plain import finite
from calibench.core.process import one_thread
from calibench.core.words import plain

SCHEMA_VERSION = 1
Level = Literal["auto", "frames", "zeros", "geometry", "gains"]
_SPOILT = 0.75  # of the squares of what is left: a step that makes more leaves less than half of it
_FAR = 3.0  # times the error that is foretold among the poses that were read: beyond, a note says so
_NARROW = 0.25  # of the way between a joint's limits
_MANY = 0.1  # of the poses: more wild ones are no mishaps
_FEW = 40  # poses: with as many the numbers are sure
WRITTEN = ("frames", "zeros", "geometry")
_TO_JSON = (
    "observed", "base", "tip", "joints", "poses", "fitted", "folds", "chosen", "levels", "changes",
    "undetermined", "wild", "regions", "by_joint", "over_joints", "frames", "scatter", "notes", "files", "seconds",
)  # fmt: skip


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """The answer of one calibration of an `arm`, from `readings`; `fit` is the one that is written.

    `levels` are the errors of poses that were not fitted for each level that was tried; `chosen` is the one that is
    written, fitted to `fitted` of the `poses`: all but those that the file holds back. `without_gains` [mm] is what is
    left of it where nobody scales the joints' readings, NaN where none are scaled. `frames` are base (in the tracker)
    and target (on the tip): x y z [mm], roll pitch yaw [rad].
    """

    case: str
    arm: Arm = field(repr=False)
    readings: Readings = field(repr=False)
    fit: Fit = field(repr=False)
    fitted: int
    folds: str
    chosen: str
    levels: tuple[Error, ...]
    changes: tuple[Change, ...]
    undetermined: tuple[Undetermined, ...]
    wild: tuple[Wild, ...]
    regions: tuple[Part, ...]
    by_joint: tuple[Part, ...]
    over_joints: tuple[OverJoint, ...]
    drawn: Drawn = field(repr=False)
    without_gains: float
    frames: Mapping[str, tuple[float, ...]]
    notes: tuple[Note, ...]
    seconds: float = nan
    files: Mapping[str, str] = field(default_factory=dict)

    @property
    def before(self) -> Error:
        """Return the error of the nominal arm, its frames fitted."""
        return self.levels[0]

    @property
    def after(self) -> Error:
        """Return the error of the arm that is written."""
        return next(error for error in self.levels if error.level == self.chosen)

    @property
    def error_before(self) -> float:
        """Return the rms error of poses that were not fitted [mm], of the nominal arm."""
        return self.before.rms

    @property
    def error_after(self) -> float:
        """Return the rms error of poses that were not fitted [mm], of the calibrated arm."""
        return self.after.rms

    @property
    def parameters(self) -> tuple[Change, ...]:
        """Return the numbers that the readings determine, each with its change, standard error and interval."""
        return self.changes

    @property
    def held(self) -> tuple[Undetermined, ...]:
        """Return the numbers that keep their nominal values, each with the reason."""
        return self.undetermined

    @property
    def source(self) -> str:
        """Return what describes the arm: URDF, or table."""
        return self.arm.chain.source

    @property
    def observed(self) -> str:
        """Return what was read: position, pose, or sockets."""
        return self.readings.observed

    @property
    def base(self) -> str:
        """Return the first link of the arm."""
        return self.arm.chain.base

    @property
    def tip(self) -> str:
        """Return the last link of the arm."""
        return self.arm.chain.tip

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the joints that were read."""
        return self.arm.chain.driven

    @property
    def poses(self) -> int:
        """Return how many poses were read."""
        return len(self.readings)

    @property
    def scatter(self) -> tuple[float, float]:
        """Return the scatter that is left, of a coordinate [mm] and of a rotation [rad]."""
        return self.fit.model.sigma[0], self.fit.model.sigma[1]

    def written(self, data: str = "") -> Files:
        """Return the files of the calibrated arm, with a comment on what they come from: `data`, or the case."""
        poses = f"{self.poses} poses" if self.fitted == self.poses else f"{self.fitted} of {self.poses} poses"
        comment = (
            f"calibrated by bench calibrate from {data or self.case}, {poses}; error of poses not fitted: "
            f"{plain(self.before.rms, 3)} mm before, {plain(self.after.rms, 3)} mm after (rms)"
        )
        if np.isfinite(self.without_gains):
            comment += " with the joint scales, which stand elsewhere; "
            comment += f"{plain(self.without_gains, 3)} mm without them"
        errors = {change.parameter: change.sd for change in self.changes if not is_gain(change.parameter)}
        return self.arm.files(self.fit, comment, errors)

    def write_urdf(self, path: str | Path) -> Path:
        """Write the calibrated arm as a URDF; return where."""
        path = Path(path).expanduser()
        path.write_bytes(self.written()["urdf"][1])
        return path

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "schema_version": SCHEMA_VERSION,
            "case": self.case,
            "urdf" if self.arm.table is None else "dh": str(self.arm.path),
            **{key: finite(getattr(self, key)) for key in _TO_JSON},
            "before": finite(self.before),
            "after": finite(self.after),
        }


@one_thread()
def calibrate_arm(
    arm: Arm, table: Table, *, how: HowRead, distance: float = 0.0, sigma_distance: float = KNOWN_TO,
    level: Level = "auto", resamples: int = 200,
) -> Calibration:  # fmt: skip
    """Return the calibration of `arm` by the readings in `table`. Raises `ValueError`, in one line.

    `how` says how the table is read, `distance` [mm] how far the two sockets of a place are apart, 0 where it is not
    known, `sigma_distance` [mm] how well it is known. `level` is how much of the arm is calibrated; auto takes what
    predicts poses best that were not fitted. Intervals come from `resamples` draws.
    """
    clock, chain = perf_counter(), arm.chain
    try:
        start = how.start(table, chain)
        readings, train = start.readings, start.readings.train
        _refuse_unused(table, readings, how, distance)
        model = model_of(
            chain, readings, start.base, start.tool, distance=distance, sigma_distance=sigma_distance, table=arm.table
        )
        fits = _fits(model.at(train).numbered(), readings)
    except DataError as error:
        raise arm.refusal(error, table, how) from None
    crossed = {one: cross_validate(fits[one], order_of(model.names, one, model.sliding)) for one in LEVELS}
    poses = np.arange(len(model.joints)) if model.position is None else poses_of(model.joints)
    chosen = _best_level(crossed, fits, poses[train]) if level == "auto" else level
    fit, judged, wild = fits[chosen], crossed, fits[chosen].wild
    if not train.all():
        judged, wild = _judge_held(fits, chosen, model, train)
    draws = resample(fit, resamples)
    levels = tuple(_error(one, judged[one], ~wild, poses, distance) for one in LEVELS)
    without_gains = nan
    if any(is_gain(model.names[k]) for k in fit.kept):
        without_gains = _without_gains(fit, model, np.isfinite(judged[chosen].position) & ~wild)
    fitted_rows, mistake = readings.where(train), arm.mistake(table, how)
    notes = once([
        *([mistake] if mistake else _far_off(levels, chosen, model, readings)), *arm.notes, *readings.notes,
        *_uncounted(judged[chosen], wild), *_notes(levels, chosen, model, fitted_rows, without_gains),
        *_range(fit, chosen), *_many_wild(wild), *_step(fit, fitted_rows), *_repeated(poses, train),
    ])  # fmt: skip
    base, tool = chain_frames = model.chain.mount @ correction(fit, "base"), model.chain.tool @ correction(fit, "tool")
    places = (np.linalg.inv(base) @ model.placed(fit.p))[:, :3, 3]
    drawn = drawn_of(
        readings.joints, chain, places, *(np.where(wild, np.nan, judged[one].position) for one in ("frames", chosen))
    )
    size = norms(model.errors(fit.p, np.where(wild, 0.0, 1.0)))
    worst_first = sorted(np.flatnonzero(wild), key=lambda i: -size[i])
    return Calibration(
        case=table.name, arm=arm, readings=readings, fit=fit, fitted=int(train.sum()), folds=_folds(model, readings),
        chosen=chosen, levels=levels, changes=changes_of(fit, draws) + changes_of_tip(arm, fit, draws),
        undetermined=undetermined_of(fit, draws),
        wild=tuple(Wild(readings.label(int(i)), float(size[i])) for i in worst_first), regions=by_region(drawn),
        by_joint=by_joint(drawn), over_joints=over_joints(drawn), drawn=drawn, without_gains=without_gains,
        frames={"target": (*tool[:3, 3].tolist(),)} if model.position is None else {
            name: (*frame[:3, 3], *rpy_of(frame)) for name, frame in zip(("base", "target"), chain_frames, strict=True)
        },
        notes=notes, seconds=perf_counter() - clock,
    )  # fmt: skip


def _refuse_unused(table: Table, readings: Readings, how: HowRead, distance: float) -> None:
    """Raise `DataError` for statements on readings of another kind, which nothing would read."""
    if distance and readings.observed != "sockets":
        raise DataError(f"distance= is that of two sockets, and {table.name} has none; leave it out")
    if how.rotation and readings.angles is None:
        raise DataError(f"rotation= is the order of rotations, and none of {table.name} is read; leave it out")


def _fits(model: ArmModel, readings: Readings) -> dict[str, Fit]:
    fits: dict[str, Fit] = {}
    for level in LEVELS:
        before = next(reversed(fits.values()), None)
        try:
            order = order_of(model.names, level, model.sliding)
            fits[level] = fit_arm(model, order, None if before is None else before.p)
        except ValueError as error:
            raise DataError(f"{error}{joints_beside(readings, model.chain)}") from None
    return fits


def _judge_held(fits: dict[str, Fit], chosen: str, model: ArmModel, train: Mask) -> tuple[dict[str, HeldOut], Mask]:
    """Return the errors of the rows that the file holds back, by fits to the others; which of all rows are wild, (n,).

    A row that is held back is wild as a fitted one is, but beside the rows that are held back.
    """
    judged = {level: predict(fits[level], model, ~train) for level in LEVELS}
    wild = np.zeros(len(train), dtype=bool)
    wild[train] = fits[chosen].wild
    for size in (judged[chosen].position, judged[chosen].rotation):
        wild[~train] |= False if size is None else far_out(size[~train])
    return judged, wild


def _best_level(judged: dict[str, HeldOut], fits: dict[str, Fit], poses: Index) -> str:
    """Return the level that predicts what was not fitted best: a richer one has to be better by a standard error."""
    chosen, sigma = WRITTEN[0], fits[WRITTEN[-1]].model.sigma

    def squares(errors: HeldOut) -> Array:
        """Return the square of each pose's error, position and rotation each over its scatter, (n,)."""
        turned = 0.0 if errors.rotation is None else (errors.rotation / sigma[1]) ** 2
        return np.asarray((errors.position / sigma[0]) ** 2 + turned)

    for level in WRITTEN[1:]:
        known = ~(fits[level].wild | fits[chosen].wild)
        better = squares(judged[chosen]) - squares(judged[level])
        known &= np.isfinite(better)
        there = np.unique(poses[known], return_inverse=True)[1]
        gain = np.asarray(np.bincount(there, better[known]), dtype=float)  # repeats of a pose as one
        if len(gain) > 1 and gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)):
            chosen = level
    return chosen


def _error(level: str, errors: HeldOut, known: Mask, poses: Index, distance: float) -> Error:
    position = np.where(known, errors.position, np.nan)
    there = position[np.isfinite(position)]
    return Error(
        level=level, rms=rms(position), ci95=rms_interval(position, poses=poses), median=float(np.median(there)),
        largest=float(there.max()),
        rotation=nan if errors.rotation is None else rms(np.where(known, errors.rotation, np.nan)),
        spans=rms(errors.spans - distance) if len(errors.spans) and distance else nan,
    )  # fmt: skip


def _without_gains(fit: Fit, model: ArmModel, there: Mask) -> float:
    """Return the error [mm] of what is written where nobody scales the joints' readings."""
    p, place = fit.p.copy(), {name: k for k, name in enumerate(model.names)}
    for name, k in place.items():
        if is_gain(name):
            zero = place.get(name.replace("gain_", "zero_"))
            if zero is not None:
                p[zero] *= p[k]  # the zero as it is written
            p[k] = 1.0
    return rms(norms(model.errors(p))[there])


def _folds(model: ArmModel, readings: Readings) -> str:
    """Return in words of which poses the errors are."""
    if readings.hold is not None:
        return f"the {int(readings.hold.sum())} rows that the file holds back"
    places = len(np.unique(model.place))
    if model.position is None and places > 1:
        return f"places left out in turn, {min(FOLDS, places)} groups of {places}"
    poses = len(np.unique(poses_of(model.joints)))
    if poses < len(readings):
        return f"every fifth of {poses} different ones left out in turn with its repeats, {FOLDS} times"
    return f"every fifth pose left out in turn, {FOLDS} times"


def _notes(
    levels: tuple[Error, ...], chosen: str, model: ArmModel, readings: Readings, without_gains: float
) -> Iterable[Note]:
    by, source = {error.level: error for error in levels}, model.chain.source
    if np.isfinite(without_gains):
        yield Note(
            Code.GAINS_ELSEWHERE,
            f"joint scales have no place in a {source}: give it each joint's reading times (1 + its scale), and divide "
            f"a joint's command by (1 + its scale); without them what is written leaves {plain(without_gains, 3)} mm",
            values={"error_mm": without_gains},
        )
    if model.position is None and not model.distance:
        yield Note(
            Code.DISTANCE_UNKNOWN,
            f"distance= of the two sockets is not stated, so nothing fixes how large the arm is but its {source}",
        )
    if chosen != "gains" and by["gains"].ci95[1] < by["geometry"].rms:
        yield Note(
            Code.GAINS_WOULD_HELP,
            f"with a scale for each joint's reading the error would be {plain(by['gains'].rms, 3)} mm instead of "
            f"{plain(by['geometry'].rms, 3)}; a {source} has no place for it: the joints bend or "
            "their gears err, and bench discover machine=arm looks for what does",
            values={"with_mm": by["gains"].rms, "without_mm": by["geometry"].rms},
        )
    if (poses := len(np.unique(poses_of(readings.joints)))) < _FEW:
        text = f"{poses} poses are few: some {_FEW} make the numbers sure, and bench design says which"
        yield Note(Code.FEW_POSES, text, values={"poses": poses})


def _uncounted(errors: HeldOut, wild: Mask) -> Iterable[Note]:
    """Yield the error with the wild readings in it: they may be no mishaps, but what is wrong with the arm."""
    count = int((wild & np.isfinite(errors.position)).sum())
    if count:
        with_them = rms(errors.position)
        text = f"the wild reading is in no error above, with it the error after is {plain(with_them, 3)} mm; was it "
        text += "misread?"
        if count > 1:
            text = (
                f"the {count} wild readings are in no error above, with them the error after is {plain(with_them, 3)} "
                "mm; were they misread, or do they lie at one range of a joint, whose error they are?"
            )
        yield Note(Code.WILD_UNCOUNTED, text, values={"readings": count, "error_mm": with_them})


def _range(fit: Fit, chosen: str) -> Iterable[Note]:
    """Yield a note where poses outside the ranges that were read are foretold much worse than those inside."""
    if fit.model.position is None or chosen == "frames":
        return
    inside, outside = foretold(fit, chosen)
    if outside > max(_FAR * inside, fit.model.sigma[0]):
        read, limits = ranges(fit.model)
        whole, part = limits[1] - limits[0], read[1] - read[0]
        narrow = [n for n, w, r in zip(fit.model.chain.driven, whole, part, strict=True) if r < _NARROW * w]
        where = f"; {', '.join(narrow)} moved little" if narrow else ""
        yield Note(
            Code.NARROW_RANGE,
            f"valid where the poses are: among them the arm is foretold to {plain(inside, 2)} mm, over all limits of "
            f"its joints to {plain(outside, 2)} mm{where}; bench design ... plan.limits=urdf names the poses that help",
            values={"inside_mm": inside, "outside_mm": outside, "joints": narrow},
        )


def _far_off(levels: tuple[Error, ...], chosen: str, model: ArmModel, readings: Readings) -> Iterable[Note]:
    """Yield a note where so much is left that the description cannot be that of the arm."""
    if model.position is None:
        return
    error = next(error.rms for error in levels if error.level == chosen)
    places = forward(model.chain, nominal(model.chain), model.joints)[:, :3, 3]
    reach = rms(np.linalg.norm(places - places.mean(axis=0), axis=1))
    if error >= DOUBTFUL * reach:
        yield Note(
            Code.FAR_OFF,
            f"{plain(error, 3)} mm are left, and the arm moves its tip by {reach:.0f} mm: so much is no matter of "
            f"calibration; is this the {model.chain.source} of the arm, and does each column hold its joint?"
            f"{joints_beside(readings, model.chain)}",
            values={"error_mm": error, "reach_mm": reach},
        )


def _many_wild(wild: Mask) -> Iterable[Note]:
    if wild.mean() > _MANY:
        text = (
            f"{int(wild.sum())} of {len(wild)} poses are wild, and that many have a cause: a target that was "
            "loose, another arm position than was written down, or two tables mixed"
        )
        yield Note(Code.MANY_WILD, text, values={"readings": int(wild.sum())})


def _step(fit: Fit, readings: Readings) -> Iterable[Note]:
    """Yield a note where base or tracker moved so little that it was not seen before the calibration.

    Raises `DataError` where that is most of what is left: then the numbers of the arm have taken up a part of it.
    """
    if readings.position is None:
        return
    known = np.flatnonzero(~fit.wild)
    step = stepped(fit.model.errors(fit.p)[0][known], readings.position[known])
    if step is None:
        return
    row, off, share = step
    at = readings.label(int(known[row]))
    text = f"from {at} on, readings lie {plain(off, 2)} mm off, as if base or tracker had moved"
    cure = "calibrate what was read before and after by themselves, or let bench discover machine=arm tell it"
    note = Note(Code.STEP, f"{text}: {cure}", rows=(at,), values={"off_mm": off, "share": share})
    if share > _SPOILT:
        raise DataError(
            f"{text}, and that is most of what is left: no number of the arm is sure beside it; {cure}", note
        )
    yield note


def _repeated(poses: Index, train: Mask) -> Iterable[Note]:
    """Yield a note where poses that are held back were fitted as well: they say little of others."""
    again = int(np.isin(poses[~train], poses[train]).sum())
    if again:
        text = f"{again} of {int((~train).sum())} rows that are held back repeat a pose that was fitted"
        yield Note(Code.HELD_OUT_FITTED, text, values={"rows": again})
