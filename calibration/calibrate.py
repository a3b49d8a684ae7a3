"""The calibration of an arm from beginning to end: read, start, fit, hold out, choose, and the answer as a value.

The levels (frames, zeros, geometry, gains) are fitted one after the other, and `choose` takes the one that predicts
poses best that were left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import nan
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal, final

import numpy as np

from calibench.calibration import fit as fitting
from calibench.calibration.arm import Arm, Files, placement
from calibench.calibration.choose import choose
from calibench.calibration.columns import PAYLOAD
from calibench.calibration.determined import LEVELS, information_of, is_length, order_of
from calibench.calibration.fit import Fit, HeldOut
from calibench.calibration.frames import TWO_TARGETS
from calibench.calibration.kinematics import forward, nominal
from calibench.calibration.loci import PLANE
from calibench.calibration.model import KNOWN_TO, ArmModel, model_of
from calibench.calibration.moved import Motion, motion_from, motion_of_wild
from calibench.calibration.normal import normal_blocks, root_of
from calibench.calibration.poses import foretold, ranges
from calibench.calibration.readings import Readings, Table, first_of_each, joints_beside, poses_of
from calibench.calibration.rigid import Array, Index, Mask, rpy_of
from calibench.calibration.start import DOUBTFUL, HowRead, mistake_in
from calibench.calibration.walk import torques
from calibench.core.notes import Code, DataError, Note, once
from calibench.core.plain import finite
from calibench.core.process import one_thread
from calibench.core.words import plain

if TYPE_CHECKING:
    from calibench.calibration.hand_eye import Frame
    from calibench.calibration.hand_eye_start import Setup

SCHEMA_VERSION = 1
Level = Literal["auto", "frames", "zeros", "geometry", "gains", "elastic"]
_FRAMES = ("base_", "tool_")
WRITTEN = ("frames", "zeros", "geometry")
_SPOILT = 0.75  # of the squares of what is left: a step that makes more leaves less than half of it
_FAR = 3.0  # times the error that is foretold among the poses that were read: beyond, a note says so
_NARROW = 0.25  # of the way between a joint's limits
_MANY = 0.1  # of the poses: more wild ones are no mishaps
_FEW = 40  # poses: with as many the numbers are sure
_STILL = 1e-9  # mm or rad: no pose tells a number of the target that moves by less from draw to draw
_TELLS = 0.05  # of a column, below which another's share in it is not told
_FEWEST = 5  # fewest poses of a part that is reported
_RANGES, _DRAWN = 4, 12  # ranges of a joint that are reported, and drawn
_WORDS = {
    "x": "shift along x", "y": "shift along y", "z": "shift along z", "rx": "turn about x", "ry": "turn about y",
    "rz": "turn about z", "zero": "zero", "gain": "scale of its reading", "elastic": "compliance",
    **{number: number for number in ("theta", "d", "a", "alpha", "beta")},
}  # fmt: skip
_TO_JSON = (
    "observed", "base", "tip", "joints", "poses", "fitted", "folds", "chosen", "tolerance", "levels", "changes",
    "undetermined", "wild", "regions", "by_joint", "over_joints", "frames", "scatter", "notes", "files", "seconds",
    "camera", "board",
)  # fmt: skip


@final
@dataclass(frozen=True)
class Error:
    """The error of poses that were not fitted: rms with its 95 % interval, median and largest [mm]; rotation [rad].

    `spans` [mm] is the rms by which two sockets of a place that was not fitted are not at their stated distance.
    """

    level: str
    rms: float
    ci95: tuple[float, float]
    median: float
    largest: float
    rotation: float = nan
    spans: float = nan


@final
@dataclass(frozen=True)
class Change:
    """One number of the arm that the data determine: how far it is off its nominal value, sd and 95 % interval."""

    parameter: str
    joint: str
    what: str
    unit: str
    change: float
    sd: float
    ci95: tuple[float, float]


@final
@dataclass(frozen=True)
class Undetermined:
    """A number that the readings do not tell: the numbers that act like it, or how well it is known by them [mm, mrad].

    Where `known_to` is finite other poses would tell it, and it is off its nominal value by a `change` [mm, rad] that
    lies within the maker's tolerance. Others keep their nominal value.
    """

    parameter: str
    reason: str
    like: tuple[str, ...] = ()
    known_to: float = nan
    change: float = 0.0


@final
@dataclass(frozen=True)
class Part:
    """The error of a part of the poses, before and after [mm]: of a region, or of a range of one joint."""

    where: str
    poses: int
    before: float
    after: float


@final
@dataclass(frozen=True)
class OverJoint:
    """The error where a joint stands about `at`, between `low` and `high` [`unit`]: rms before and after [mm]."""

    joint: str
    unit: str
    at: float
    low: float
    high: float
    before: float
    after: float
    poses: int


@final
@dataclass(frozen=True)
class Wild:
    """A wild reading, which the fit did not use: where it stands in the file, and its error [mm]."""

    row: str
    error: float


@final
@dataclass(frozen=True, eq=False)
class Drawn:
    """What the drawings need: joints (n, j) [deg | mm], positions (n, 3), errors (n,) [mm], NaN where wild."""

    joints: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    position: Array
    before: Array
    after: Array


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Calibration:
    """The answer of one calibration of an `arm`, from `readings`; `fit` is the one that is written.

    `source` is what describes the arm (URDF, or table), `observed` what was read: position, pose, or sockets. `levels`
    are the errors of poses that were not fitted for each level that was tried, `before` and `after` those of the
    nominal arm and of the one that is written (`error_before`, `error_after`: rms [mm]): `chosen`, fitted to `fitted`
    of the `poses`, all but those that the file holds back, with the maker's lengths and angles taken for true to the
    `tolerance` [mm, mrad]. `without_gains` [mm] is what is left of it where nobody
    scales the joints' readings, NaN where none are scaled. `scatter` is what is left of a coordinate [mm] and of a
    rotation [rad]. `frames` are base (in the tracker) and target (on the tip): x y z [mm], roll pitch yaw [rad]; fixed
    points and planes are in the base, a plane with its normal; where a camera was calibrated with the arm, `camera` and
    `board` are instead.
    """

    case: str
    arm: Arm
    readings: Readings
    fit: Fit
    source: str
    observed: str
    base: str
    tip: str
    joints: tuple[str, ...]
    poses: int
    fitted: int
    folds: str
    chosen: str
    tolerance: float
    levels: tuple[Error, ...]
    before: Error
    after: Error
    error_before: float
    error_after: float
    changes: tuple[Change, ...]
    undetermined: tuple[Undetermined, ...]
    wild: tuple[Wild, ...]
    regions: tuple[Part, ...]
    by_joint: tuple[Part, ...]
    over_joints: tuple[OverJoint, ...]
    drawn: Drawn
    without_gains: float
    scatter: tuple[float, float]
    frames: Mapping[str, tuple[float, ...]]
    notes: tuple[Note, ...]
    seconds: float = nan
    files: Mapping[str, str] = field(default_factory=dict)
    camera: Frame | None = None
    board: Frame | None = None

    def __repr__(self) -> str:
        errors = f"{self.error_before:.3g} -> {self.error_after:.3g} mm on poses that were not fitted"
        return f"<calibration {self.case}: {len(self.changes)} numbers of {self.chosen} changed, error {errors}>"

    @property
    def parameters(self) -> tuple[Change, ...]:
        """Return the numbers that the readings determine, each with its change, standard error and interval."""
        return self.changes

    @property
    def held(self) -> tuple[Undetermined, ...]:
        """Return the numbers that the readings do not tell, each with the reason."""
        return self.undetermined

    def written(self, data: str = "") -> Files:
        """Return the files of the calibrated arm, with a comment on what they come from: `data`, or the case."""
        poses = f"{self.poses} poses" if self.fitted == self.poses else f"{self.fitted} of {self.poses} poses"
        comment = (
            f"calibrated by bench calibrate from {data or self.case}, {poses}; error of poses not fitted: "
            f"{plain(self.before.rms, 3)} mm before, {plain(self.after.rms, 3)} mm after (rms)"
        )
        if np.isfinite(self.without_gains):
            what = "compliances" if self.chosen == "elastic" else "joint scales"
            comment += f" with the {what}, which stand elsewhere; {plain(self.without_gains, 3)} mm without them"
        errors = {
            change.parameter: change.sd
            for change in self.changes
            if not change.parameter.startswith(("gain_", "elastic_"))
        }
        return self.arm.files(self.fit, comment, errors)

    def write_urdf(self, path: str | Path) -> Path:
        """Write the calibrated arm as a URDF; return where."""
        path = Path(path).expanduser()
        path.write_bytes(self.written()["urdf"][1])
        return path

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        names = [self.fit.model.names[k] for k in self.fit.kept]
        of, sliding = {"gain": "", "elastic": "rad/(N m)"}, self.fit.model.sliding
        units = [of.get(n.partition("_")[0], "mm" if is_length(n, sliding) else "rad") for n in names]
        covariance = {"names": names, "units": units, "matrix": self.fit.covariance.tolist()}
        return {
            "schema_version": SCHEMA_VERSION, "case": self.case,
            "urdf" if self.arm.table is None else "dh": str(self.arm.path),
            **{key: finite(getattr(self, key)) for key in _TO_JSON}, "before": finite(self.before),
            "after": finite(self.after), "covariance": covariance,
        }  # fmt: skip


@one_thread()
def calibrate_arm(
    arm: Arm, table: Table, *, how: HowRead, distance: float = 0.0, sigma_distance: float = KNOWN_TO,
    level: Level = "auto", resamples: int = 200, priors: Mapping[str, tuple[float, float]] | None = None,
    camera: Setup | None = None,
) -> Calibration:  # fmt: skip
    """Return the calibration of `arm` by the readings in `table`. Raises `ValueError`, in one line.

    `how` says how the table is read, `distance` [mm] how far the two sockets of a place are apart, 0 where it is not
    known, `sigma_distance` [mm] how well it is known. `level` is how much of the arm is calibrated; auto takes what
    predicts poses best that were not fitted. Intervals come from `resamples` draws. `priors` has what is known of
    numbers of the arm: by how much each is off its nominal value, and the standard error of that [mm, rad]. With a
    `camera` a board's pose in it is what is read, and both their frames are told.
    """
    clock, chain, named = perf_counter(), arm.chain, {*table.columns}
    fits: dict[str, Fit] = {}
    try:
        if camera is not None:
            from calibench.calibration import arm_camera  # an arm without one needs nothing of it

            table, how = arm_camera.as_readings(table, chain, camera), HowRead("pose", limits=how.limits)
        start = how.start(table, chain)
        readings, train = start.readings, start.readings.train
        if distance and readings.observed != "sockets":
            raise DataError(f"distance= is that of two sockets, and {table.name} has none; leave it out")
        if how.rotation and readings.angles is None:
            raise DataError(f"rotation= is the order of rotations, and none of {table.name} is read; leave it out")
        model = model_of(
            chain, readings, start.base, start.tool, distance=distance, sigma_distance=sigma_distance, table=arm.table,
            priors=priors, sees=camera is not None and camera.hand_eye == "eye_in_hand",
        )  # fmt: skip
        tried: tuple[str, ...] = LEVELS
        if level == "elastic":
            other, tried = readings.other, (*LEVELS, level)
            torque = torques(
                chain, readings.joints, start.tool[:3, 3],
                np.nan_to_num(other[PAYLOAD]) if PAYLOAD in other else np.zeros(len(readings)),
                {n: other[f"torque_{n}"] for n in chain.driven if f"torque_{n}" in other}, chain.source,
            )  # fmt: skip
            model = replace(model, torque=torque)
        part, p = model.at(train), model.start
        orders = {one: order_of(model.names, one, model.sliding) for one in tried}
        for one in tried:
            fits[one] = fitting.fit_arm(part, orders[one], p)
            p = fits[one].p if one != "gains" else fits["geometry"].p
        why = fits["geometry"].undetermined
        if not why and fits["frames"].undetermined and arm.mistake(table, how):  # which other numbers would take up
            why = fits["frames"].undetermined
        if why:
            for note in _motions(fits["geometry"], readings.where(train)):
                raise DataError(note.text, note)
            raise DataError(f"{why}{mistake_in(readings, chain)}{joints_beside(readings, model.chain)}")
    except DataError as error:
        raise arm.refusal(error, table, how) from None

    common = fits[level if level in ("gains", "elastic") else "geometry"]
    chosen, fits, judged, count = choose(fits, WRITTEN if level == "auto" else (level,), common)
    fit, wild = fits[chosen], fits[chosen].wild
    poses = np.arange(len(model.joints)) if model.position is None else poses_of(model.joints)
    places, different = len(np.unique(model.place)), len(np.unique(poses_of(model.joints)))
    folds = f"each left out once, in {count} groups"
    if readings.hold is not None:
        folds = f"the {int(readings.hold.sum())} rows that the file holds back"
    elif model.position is None and places > 1:
        folds = f"each of {places} places left out once, in {count} groups"
    elif len(first_of_each(readings)) < len(readings):
        folds = f"each of {different} different ones left out once with its repeats, in {count} groups"
    if not train.all():  # a row that is held back is wild as a fitted one is, but beside those that are held back
        judged = {one: fitting.judge(model, np.where(train, -1, 0), [fits[one].p]) for one in tried}
        wild = np.zeros(len(train), dtype=bool)
        wild[train] = fit.wild
        for sizes in (judged[chosen].position, judged[chosen].rotation):
            wild[~train] |= False if sizes is None else fitting.far_out(sizes[~train])
    numbers = float(np.minimum(model.counted, 3).mean())
    levels = {one: _error(one, judged[one], ~wild, poses, distance, numbers) for one in tried}
    draws, without_gains = fitting.resample(fit, resamples), _without_gains(fit, model, judged[chosen], wild)

    mistake = arm.mistake(table, how)
    notes: list[Note] = [mistake] if mistake else [*_far_off(levels[chosen].rms, model, readings)]
    notes += [*arm.notes, *(note for note in readings.notes if camera is None or set(note.columns) <= named)]
    notes += _notes(levels, fit, chosen, model, readings.where(train), without_gains, judged=judged, wild=wild)
    again = int(np.isin(poses[~train], poses[train]).sum())
    if again:  # they say little of others
        text = f"{again} of {int((~train).sum())} rows that are held back repeat a pose that was fitted"
        notes.append(Note(Code.HELD_OUT_FITTED, text, values={"rows": again}))

    base = model.chain.mount @ placement(fit.p[:6])
    kinds = {joint.name: joint.kind for joint in chain.joints}
    turns = np.array([kinds.get(name, "rotary") == "rotary" for name in chain.driven])
    drawn = Drawn(
        joints=np.where(turns, np.rad2deg(readings.joints), readings.joints), names=chain.driven,
        units=tuple("°" if turn else "mm" for turn in turns),
        position=(np.linalg.inv(base) @ model.placed(fit.p))[:, :3, 3],
        before=np.where(wild, np.nan, judged["frames"].position), after=np.where(wild, np.nan, judged[chosen].position),
    )  # fmt: skip
    regions, by_joint = _parts_of(drawn)
    frames = None if camera is None else arm_camera.frames_of_fit(arm, fit, draws, camera.hand_eye)
    size = fitting.norms(model.errors(fit.p, np.where(wild, 0.0, 1.0)))
    worst_first = sorted(np.flatnonzero(wild), key=lambda i: -size[i])
    counts = [len(readings), int(train.sum())]
    if readings.targets or readings.loci is not None:  # each pose is as many readings
        counts = [len(np.unique(joints, axis=0)) for joints in (readings.joints, readings.joints[train])]
    return Calibration(
        case=table.name, arm=arm, readings=readings, fit=fit, source=chain.source, observed=readings.observed,
        base=chain.base, tip=chain.tip, joints=chain.driven,
        poses=counts[0], fitted=counts[1], folds=folds, chosen=chosen,
        tolerance=fit.model.tolerance, levels=tuple(levels.values()), before=levels["frames"],
        after=levels[chosen], error_before=levels["frames"].rms, error_after=levels[chosen].rms,
        changes=_changes_of(arm, fit, draws), undetermined=_undetermined_of(fit, fits["geometry"]),
        wild=tuple(Wild(readings.label(int(i)), float(size[i])) for i in worst_first), regions=regions,
        by_joint=by_joint, over_joints=over_joints(drawn), drawn=drawn, without_gains=without_gains,
        scatter=(fit.model.sigma[0], fit.model.sigma[1]),
        frames=_frames_of(model, fit.p, readings) if frames is None else {},
        camera=frames and frames[0], board=frames and frames[1], notes=once(notes), seconds=perf_counter() - clock,
    )  # fmt: skip


def _frames_of(model: ArmModel, p: Array, readings: Readings) -> dict[str, tuple[float, ...]]:
    """Return the base in the tracker's frame, and the target on the tip with the places of further ones beside it."""
    base, tool = model.chain.mount @ placement(p[:6]), model.chain.tool @ placement(p[-6:])
    if model.position is None:
        return {"target": (*tool[:3, 3].tolist(),)}
    frames = {name: (*frame[:3, 3], *rpy_of(frame)) for name, frame in (("base", base), ("target", tool))}
    _, places, _, of_fixtures = model.parts(p)
    if model.loci is not None:
        for name, frame in model.loci.frames(of_fixtures).items():
            there = np.linalg.inv(base) @ frame
            frames[name] = (*there[:3, 3].tolist(), *(there[:3, 2].tolist() if name.startswith("plane") else ()))
        if not np.isfinite(model.position).any() and not any(one.stated for one in model.loci.fixtures):
            del frames["base"]  # nothing was read in a frame of its own
    for name, place in zip(readings.targets[1:], places[1:], strict=False):
        frames[f"target {name}"] = (*(tool[:3, :3] @ place + tool[:3, 3]).tolist(),)
    return frames


def _error(level: str, errors: HeldOut, known: Mask, poses: Index, distance: float, numbers: float) -> Error:
    position = np.where(known, errors.position, np.nan)
    there = position[np.isfinite(position)]
    return Error(
        level=level, rms=fitting.rms(position),
        ci95=fitting.rms_interval(position, poses, errors.alone, errors.shared, numbers),
        median=float(np.median(there)), largest=float(there.max()),
        rotation=nan if errors.rotation is None else fitting.rms(np.where(known, errors.rotation, np.nan)),
        spans=fitting.rms(errors.spans - distance) if len(errors.spans) and distance else nan,
    )  # fmt: skip


def _without_gains(fit: Fit, model: ArmModel, errors: HeldOut, wild: Mask) -> float:
    """Return the error [mm] of what is written where nobody scales the joints' readings; NaN where none are scaled."""
    p, place = fit.p.copy(), {name: k for k, name in enumerate(model.names)}
    gains, elastic = ([name for name in place if name.startswith(one)] for one in ("gain_", "elastic_"))
    if not {place[name] for name in (*gains, *elastic)} & set(fit.kept.tolist()):
        return nan
    p[[place[name] for name in elastic]] = 0.0
    for name in gains:
        if (zero := place.get(name.replace("gain_", "zero_"))) is not None:
            p[zero] *= p[place[name]]  # the zero as it is written
        p[place[name]] = 1.0
    return fitting.rms(fitting.norms(model.errors(p))[np.isfinite(errors.position) & ~wild])


def _far_off(error: float, model: ArmModel, readings: Readings) -> Iterable[Note]:
    """Yield a note where so much is left that the description cannot be that of the arm."""
    if model.position is None:
        return
    places = forward(model.chain, nominal(model.chain), model.joints)[:, :3, 3]
    reach = fitting.rms(np.linalg.norm(places - places.mean(axis=0), axis=1))
    if error >= DOUBTFUL * reach:
        yield Note(
            Code.FAR_OFF,
            f"{plain(error, 3)} mm are left, and the arm moves its tip by {reach:.0f} mm: so much is no matter of "
            f"calibration; is this the {model.chain.source} of the arm, and does each column hold its joint?"
            f"{joints_beside(readings, model.chain)}",
            values={"error_mm": error, "reach_mm": reach},
        )


def _notes(
    levels: Mapping[str, Error], fit: Fit, chosen: str, model: ArmModel, readings: Readings, without_gains: float,
    judged: Mapping[str, HeldOut], wild: Mask,
) -> Iterable[Note]:  # fmt: skip
    source = model.chain.source
    count, again = int((wild & np.isfinite(judged[chosen].position)).sum()), _repeated(model, wild)
    if count:  # they may be no mishaps, but what is wrong with the arm
        with_them = fitting.rms(judged[chosen].position)
        subject, them, cure = "wild reading is", "it", "was it misread?"
        if count > 1:
            subject, them = f"{count} wild readings are", "them"
            cure = "were they misread, or do they lie at one range of a joint, whose error they are?"
        if again:
            cure = f"{again} repeat the place of another row to the last digit, as a code for no value does, or an "
            cure += "instrument that keeps its last one: leave such cells empty"
        text = f"the {subject} in no error above, with {them} the error after is {plain(with_them, 3)} mm; {cure}"
        yield Note(Code.WILD_UNCOUNTED, text, values={"readings": count, "error_mm": with_them})
    if np.isfinite(without_gains):
        what, how = "joint scales", "times (1 + its scale), and divide a joint's command by (1 + its scale)"
        if chosen == "elastic":
            what, how = "compliances", "less compliance times torque, and add that to a joint's command"
        yield Note(
            Code.GAINS_ELSEWHERE,
            f"{what} have no place in a {source}: give it each joint's reading {how}; without them what is written "
            f"leaves {plain(without_gains, 3)} mm",
            values={"error_mm": without_gains},
        )
    if model.position is None and not model.distance:
        yield Note(
            Code.DISTANCE_UNKNOWN,
            f"distance= of the two sockets is not stated, so nothing fixes how large the arm is but its {source}",
        )
    if model.loci is not None and model.position is not None:
        text = f"{model.loci.words(model.position)} read: errors are along what was read, and tell nothing across it"
        if (model.loci.kind == PLANE).all():
            text += f"; planes do not tell how large the arm is, which its {source} says"
        yield Note(Code.PARTS_OF_PLACES, text)
    if chosen not in ("gains", "elastic") and levels["gains"].ci95[1] < levels["geometry"].rms:
        yield Note(
            Code.GAINS_WOULD_HELP,
            f"with a scale for each joint's reading the error would be {plain(levels['gains'].rms, 3)} mm instead of "
            f"{plain(levels['geometry'].rms, 3)}; a {source} has no place for it: the joints bend or "
            "their gears err, and bench discover machine=arm looks for what does",
            values={"with_mm": levels["gains"].rms, "without_mm": levels["geometry"].rms},
        )
    if (poses := len(np.unique(poses_of(readings.joints)))) < _FEW:
        text = f"{poses} poses are few: some {_FEW} make the numbers sure, and bench design says which"
        yield Note(Code.FEW_POSES, text, values={"poses": poses})
    if fit.model.position is not None and chosen != "frames":
        inside, outside = foretold(fit)
        if outside > max(_FAR * inside, fit.model.sigma[0]):
            read, limits = ranges(fit.model)
            whole, part = limits[1] - limits[0], read[1] - read[0]
            narrow = [n for n, w, r in zip(fit.model.chain.driven, whole, part, strict=True) if r < _NARROW * w]
            where = f"; {', '.join(narrow)} moved little" if narrow else ""
            yield Note(
                Code.NARROW_RANGE,
                f"valid where the poses are: among them the arm is foretold to {plain(inside, 2)} mm, over all limits "
                f"of its joints to {plain(outside, 2)} mm{where}; bench design ... plan.limits=urdf names the poses "
                "that help",
                values={"inside_mm": inside, "outside_mm": outside, "joints": narrow},
            )
    if wild.mean() > _MANY and not again:
        text = f"{int(wild.sum())} of {len(wild)} readings are wild, and that many have a cause: a target that was "
        text += "loose, another arm position than was written down, or two tables mixed"
        yield Note(Code.MANY_WILD, text, values={"readings": int(wild.sum())})
    yield from _motions(fit, readings)


def _repeated(model: ArmModel, wild: Mask) -> int:
    """Return how many of the `wild` readings (n,) have the very place of another row; 0 where that is not half."""
    if model.position is None:
        return 0
    _, row, count = np.unique(model.position, axis=0, return_inverse=True, return_counts=True)
    again = int((count[row.ravel()] > 1)[wild].sum())
    return again if 2 * again >= wild.sum() else 0


def _motions(fit: Fit, readings: Readings) -> Iterable[Note]:
    """Yield a note where base, tracker, target or a joint moved so little that it was not seen before the fit."""
    repeated = _repeated(fit.model, fit.wild)
    if not repeated and (motion := motion_of_wild(fit.model, fit.p, fit.kept, fit.wild)):
        first, last = (readings.label(int(motion.rows[k])) for k in (0, -1))
        text = f"the {len(motion.rows)} wild readings, {first} to {last}, fit the arm {plain(motion.off, 2)} mm off"
        yield Note(Code.STEP, f"{text}, {_as_if(motion)}", rows=(first, last), values={"off_mm": motion.off})
    if motion := motion_from(fit.model, fit.p, fit.kept, fit.wild):
        at = readings.label(int(motion.rows[0]))
        text = f"from {at} on, readings lie {plain(motion.off, 2)} mm off, {_as_if(motion)}"
        note = Note(Code.STEP, text, rows=(at,), values={"off_mm": motion.off, "share": motion.share})
        if motion.share > _SPOILT:
            raise DataError(f"{text}; that is most of what is left, and no number of the arm is sure beside it", note)
        yield note


def _as_if(motion: Motion) -> str:
    if motion.what == "target":
        return f"as if the target had been moved on its link: {TWO_TARGETS}"
    what = "base or tracker" if motion.what == "base" else f"the zero of {motion.what}"
    cure = "calibrate what was read before and after by themselves, or let bench discover machine=arm tell it"
    return f"as if {what} had moved: {cure}"


def _changes_of(arm: Arm, fit: Fit, draws: Array) -> tuple[Change, ...]:
    """Return the changes of the kept parameters of the joints, with the interval that the `draws` (b, k) give."""
    changes, model, badly = [], fit.model, _known_to(fit)
    for k, place in enumerate(fit.kept):
        name = model.names[place]
        kind, _, joint = name.partition("_")
        if kind not in ("base", "tool") and place not in badly:
            nominal = 1.0 if kind == "gain" else 0.0
            low, high = np.quantile(draws[:, k], [0.025, 0.975]) - nominal
            unit = {"gain": "", "elastic": "rad/(N m)"}.get(kind, "mm" if is_length(name, model.sliding) else "rad")
            sd, change = float(draws[:, k].std(ddof=1)), float(fit.p[place] - nominal)
            changes.append(Change(name, joint, _WORDS[kind], unit, change, sd, (float(low), float(high))))

    if (last := arm.last) is None:
        return tuple(changes)
    tools = np.tile(fit.p[len(fit.p) - 6 :], (len(draws) + 1, 1))
    for k, place in enumerate(fit.kept):
        if place >= len(fit.p) - 6:
            tools[1:, place - len(fit.p) + 6] = draws[:, k]
    poses = [model.chain.tool @ placement(tool) for tool in tools]
    targets = np.array([[*pose[:3, 3], *rpy_of(pose)] for pose in poses])
    for k, kind in enumerate(("x", "y", "z", "rx", "ry", "rz")[: 3 if model.turns is None else 6]):
        at, beside = float(targets[0, k]), targets[1:, k] - targets[0, k]
        if k >= 3:
            beside = (beside + np.pi) % (2 * np.pi) - np.pi
        if (sd := float(beside.std(ddof=1))) >= _STILL:
            low, high = at + np.quantile(beside, [0.025, 0.975])
            name, unit = f"{kind}_{last.name}", "mm" if k < 3 else "rad"
            changes.append(Change(name, last.name, _WORDS[kind], unit, at, sd, (float(low), float(high))))
    return tuple(changes)


def _undetermined_of(fit: Fit, geometry: Fit) -> tuple[Undetermined, ...]:
    """Return the numbers of the arm that the readings do not tell, by `fit` and by the one that frees all geometry."""
    names, model, kept = geometry.model.names, geometry.model, geometry.kept.tolist()
    order = order_of(names, "geometry", model.sliding)
    rest = [k for k in order if k not in kept and not names[k].startswith(_FRAMES)]
    both = np.array([*kept, *rest], dtype=np.int64)
    rows = root_of(normal_blocks(model, geometry.p, both, geometry.weights).gram[0])
    ours, others = np.split(rows, [len(kept)], axis=1)
    scale = np.linalg.norm(ours, axis=0) + 1e-12
    shares = np.linalg.lstsq(ours / scale, others, rcond=1e-10)[0]
    undetermined = {}
    for j, place in enumerate(rest):
        size = float(np.linalg.norm(others[:, j]))
        most = np.argsort(-np.abs(shares[:, j]))[:3]
        like = tuple(names[kept[i]] for i in most if abs(shares[i, j]) > _TELLS * size) if size > 1e-9 else ()
        undetermined[place] = Undetermined(
            names[place], f"looks like {' with '.join(like)}" if like else "moves no reading", like
        )
    for place, (known_to, within) in _known_to(fit).items():
        unit = "mm" if is_length(names[place], model.sliding) else "mrad"
        size = 1.0 if unit == "mm" else 1e3
        moved = float(fit.p[place] - fit.model.start[place])
        reason = f"these poses tell it to {plain(size * known_to, 2)} {unit}, its {model.chain.source} to "
        reason += f"{plain(size * within, 2)}: it stays near that, changed by {plain(size * moved, 2)}"
        undetermined[place] = Undetermined(names[place], reason, known_to=size * known_to, change=moved)
    held = "with it free, poses that were not fitted are not predicted better"
    for place in set(kept) - set(fit.kept.tolist()):
        if not names[place].startswith((*_FRAMES, "gain_", "elastic_")):
            undetermined[place] = Undetermined(names[place], held)
    return tuple(undetermined[k] for k in order if k in undetermined)


def _known_to(fit: Fit) -> dict[int, tuple[float, float]]:
    """Return what the readings alone tell badly: place -> standard errors by them and by the maker, the smaller."""
    before, both = information_of(fit.model)[fit.kept], 1.0 / np.diag(fit.covariance)
    alone = np.maximum(both - before, 1e-6 * before)
    sizes = zip(fit.kept.tolist(), alone**-0.5, np.where(before > 0, before, np.inf) ** -0.5, strict=True)
    stated = {k for k in fit.kept if fit.model.names[k] in fit.model.priors}  # of them the user knows it, no file
    return {k: (float(of), float(within)) for k, of, within in sizes if of > within > 0 and k not in stated}


def _parts_of(drawn: Drawn) -> tuple[tuple[Part, ...], tuple[Part, ...]]:
    """Return the error by region, and by the range of each joint."""
    split = []
    sides = [np.hypot(drawn.position[:, 0], drawn.position[:, 1]), drawn.position[:, 2]]
    edges = [np.quantile(side, [0 / 3, 1 / 3, 2 / 3, 3 / 3]) for side in sides]
    for thirds in np.ndindex(3, 3):
        there, words = np.ones(len(drawn.position), dtype=bool), []
        for k, side, edge, name in zip(thirds, sides, edges, ("out", "up"), strict=True):
            there &= (side >= edge[k]) & ((side < edge[k + 1]) | (k == 2))
            words.append(f"{edge[k]:.0f} to {edge[k + 1]:.0f} mm {name}")
        split.append((", ".join(words), there))
    regions = len(split)
    for name, unit, values in zip(drawn.names, drawn.units, drawn.joints.T, strict=True):
        ends = np.unique(np.quantile(values, np.linspace(0, 1, _RANGES + 1)))
        for low, high in pairwise(ends):
            there = (values >= low) & ((values < high) | (high == ends[-1]))
            split.append((f"{name} {low:.0f} to {high:.0f} {unit}", there))
    known = np.isfinite(drawn.before) & np.isfinite(drawn.after)
    split = [(words, there & known) for words, there in split]
    parts = [Part(words, int(t.sum()), fitting.rms(drawn.before[t]), fitting.rms(drawn.after[t])) for words, t in split]
    of_regions, of_joints = (
        tuple(p for p in some if p.poses >= _FEWEST) for some in (parts[:regions], parts[regions:])
    )
    return of_regions, of_joints


def over_joints(drawn: Drawn) -> tuple[OverJoint, ...]:
    """Return the error over the place of each joint, in ranges of as many poses: what is drawn of it."""
    known = np.isfinite(drawn.before) & np.isfinite(drawn.after)
    before, after = drawn.before[known], drawn.after[known]
    parts = []
    for name, unit, values in zip(drawn.names, drawn.units, drawn.joints[known].T):
        for part in np.array_split(np.argsort(values, kind="stable"), min(_DRAWN, max(1, len(values) // _FEWEST))):
            if len(part):
                at, errors = values[part], (fitting.rms(before[part]), fitting.rms(after[part]))
                place = (float(at.mean()), float(at.min()), float(at.max()))
                parts.append(OverJoint(name, unit, *place, *errors, len(part)))
    return tuple(parts)
