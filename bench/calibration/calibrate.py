"""The calibration of an arm from beginning to end: read, start, fit, hold out, choose, write.

The levels (frames, zeros, geometry, gains) are fitted one after the other. The level that predicts held-out poses best
is written; a richer level must be better by more than chance would make it, otherwise the simpler one is taken. A URDF
has no place for gains, so they are written only on request, and reported otherwise.

Where the file holds rows back, the others alone are fitted: they choose the level by cross-validation among themselves,
and are what is written. The errors that are told are then of the rows held back. Otherwise all rows are fitted, and the
errors are cross-validated.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np

from calibench.bench.calibration.carries import foretold, ranges
from calibench.bench.calibration.described import Written, described_by, table_told
from calibench.bench.calibration.files import read_table
from calibench.bench.calibration.fit import LEVELS, Fit, far_out, fitted, norms, order_of
from calibench.bench.calibration.judged import FOLDS, HeldOut, crossed_out, predicted, resampled, rms, rms_interval
from calibench.bench.calibration.model import ArmModel, model_of
from calibench.bench.calibration.readings import Index, Mask, Readings, joints_beside, poses_of, read_readings
from calibench.bench.calibration.report.diff import changes_of, placement, undetermined_of
from calibench.bench.calibration.report.parts import by_joint, by_region, drawn_of, over_joints
from calibench.bench.calibration.report.result import Calibration, Error, Wild
from calibench.bench.calibration.request import CalibrateRequest
from calibench.bench.calibration.start import DOUBTFUL, started
from calibench.core.process import one_thread
from calibench.core.words import plain
from calibench.discrepancy import DataError
from calibench.problems.arm.chains.kinematics import forward, nominal
from calibench.problems.arm.chains.rigid import rpy_of
from calibench.problems.arm.stands import stepped
from calibench.problems.base import Array

_SPOILT = 0.75  # of the squares of what is left: a step that makes more leaves less than half of it
_FAR = 3.0  # times the error that is foretold among the poses that were read: beyond, it is told
_NARROW = 0.25  # of the way between a joint's limits
_MANY = 0.1  # of the poses: more wild ones are no mishaps
WRITTEN = ("frames", "zeros", "geometry")


@one_thread()
def calibrate(request: CalibrateRequest) -> tuple[Calibration, Written, Readings]:
    """Return the calibration, the files of the calibrated arm, and the readings. Raises `ValueError`, in one line."""
    began = perf_counter()
    arm = described_by(request)
    chain = arm.chain
    table = read_table(request.data, request.stated)
    rotation = request.rotation or str(table.stated.get("rotation", ""))
    try:
        readings = read_readings(table, chain, request.observe, request.limits)
        _refuse_unused(request, readings)
        train = np.ones(len(readings), dtype=bool) if readings.hold is None else ~readings.hold
        begin = started(readings.where(train), chain, rotation)
        readings = begin.readings if train.all() else started(readings, chain, rotation).readings
        model = model_of(chain, readings, begin.base, begin.tool, request.distance, request.sigma_distance, arm.table)
        fits = _fits(model.at(train).numbered(), readings)
    except DataError as error:
        told = table_told(arm, table, request)
        raise (DataError(f"{told}. As it stands: {error}") if told else error) from None
    crossed = {level: crossed_out(fits[level], order_of(model.names, level, model.sliding)) for level in LEVELS}
    poses = _poses(model)
    chosen = _chosen(crossed, fits, poses[train]) if request.level == "auto" else request.level
    fit = fits[chosen]
    judged, wild = (crossed, fit.wild) if train.all() else _of_hold(fits, chosen, model, train)
    draws = resampled(fit, request.resamples)
    levels = tuple(_error(level, judged[level], ~wild, poses, request.distance) for level in LEVELS)
    fitted_rows = readings.where(train)
    scaled = any(model.names[k].startswith("gain_") for k in fit.kept)
    alone = _alone(fit, model, np.isfinite(judged[chosen].left) & ~wild) if scaled else None
    doubt = table_told(arm, table, request)
    notes = (
        *([doubt] if doubt else _far_off(levels, chosen, model, readings)), *arm.notes, *readings.notes,
        *_uncounted(judged[chosen], wild), *_scales(alone, arm.chain.told),
        *_notes(levels, chosen, model, fitted_rows), *_range(fit, chosen),
        *_many_wild(wild), *_step(fit, fitted_rows), *_again(poses, train),
    )  # fmt: skip
    before, after = (np.where(wild, np.nan, judged[level].left) for level in ("frames", chosen))
    drawn = drawn_of(readings.joints, chain, _in_base(fit, model), before, after)
    changes = changes_of(fit, draws) + arm.more_changes(fit, draws)
    written = arm.written(fit, changes, _comment(request, levels, chosen, train, alone))
    return (
        Calibration(
            table.name, str(arm.path), chain.told, readings.observed, chain.base, chain.tip, chain.driven,
            len(readings), int(train.sum()), _folds_told(model, readings), chosen, levels, changes,
            undetermined_of(fit, draws), _wild(fit, model, wild, readings), by_region(drawn),
            by_joint(drawn), _frames(fit), (fit.model.sigma[0], fit.model.sigma[1]), tuple(dict.fromkeys(notes)),
            perf_counter() - began, {}, drawn, over_joints(drawn),
        ),
        written,
        readings,
    )  # fmt: skip


def _refuse_unused(request: CalibrateRequest, readings: Readings) -> None:
    """Raise `DataError` for statements on readings of another kind, which nothing would read."""
    if request.distance and readings.observed != "sockets":
        raise DataError(f"distance= is that of two sockets, and {readings.table.name} has none; leave it out")
    if request.rotation and readings.angles is None:
        raise DataError(f"rotation= is the order of rotations, and none of {readings.table.name} is read; leave it out")


def _fits(model: ArmModel, readings: Readings) -> dict[str, Fit]:
    fits: dict[str, Fit] = {}
    for level in LEVELS:
        before = next(reversed(fits.values()), None)
        try:
            fits[level] = fitted(
                model, order_of(model.names, level, model.sliding), None if before is None else before.p
            )
        except ValueError as error:
            raise DataError(f"{error}{joints_beside(readings, model.chain)}") from None
    return fits


def _poses(model: ArmModel) -> Index:
    """Return the number of each row's pose, (n,); a posture of a ball in a socket is one of its own."""
    return np.arange(len(model.joints)) if model.position is None else poses_of(model.joints)


def _of_hold(fits: dict[str, Fit], chosen: str, model: ArmModel, train: Mask) -> tuple[dict[str, HeldOut], Mask]:
    """Return the errors of the rows that the file holds back, by fits to the others; which of all rows are wild, (n,).

    A row that is held back is wild as a fitted one is, but beside the rows that are held back.
    """
    judged = {level: predicted(fits[level], model, ~train) for level in LEVELS}
    wild = np.zeros(len(train), dtype=bool)
    wild[train] = fits[chosen].wild
    for size in (judged[chosen].left, judged[chosen].turned):
        wild[~train] |= False if size is None else far_out(size[~train])
    return judged, wild


def _chosen(judged: dict[str, HeldOut], fits: dict[str, Fit], poses: Index) -> str:
    """Return the level that predicts what was not fitted best: a richer one has to be better by a standard error."""
    chosen, sigma = WRITTEN[0], fits[WRITTEN[-1]].model.sigma
    for level in WRITTEN[1:]:
        known = ~(fits[level].wild | fits[chosen].wild)
        better = _squares(judged[chosen], sigma) - _squares(judged[level], sigma)
        known &= np.isfinite(better)
        there = np.unique(poses[known], return_inverse=True)[1]
        gain = np.asarray(np.bincount(there, better[known]), dtype=float)  # repeats of a pose as one
        if len(gain) > 1 and gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)):
            chosen = level
    return chosen


def _squares(found: HeldOut, sigma: tuple[float, float]) -> Array:
    """Return the square of each pose's error, position and rotation each over its scatter, (n,)."""
    turned = 0.0 if found.turned is None else (found.turned / sigma[1]) ** 2
    return np.asarray((found.left / sigma[0]) ** 2 + turned)


def _error(level: str, found: HeldOut, known: Mask, poses: Index, distance: float) -> Error:
    left = np.where(known, found.left, np.nan)
    turned = np.nan if found.turned is None else rms(np.where(known, found.turned, np.nan))
    apart = rms(found.spans - distance) if len(found.spans) and distance else np.nan
    there = left[np.isfinite(left)]
    interval = rms_interval(left, poses=poses)
    return Error(level, rms(left), interval, float(np.median(there)), float(there.max()), turned, apart)


def _notes(levels: tuple[Error, ...], chosen: str, model: ArmModel, readings: Readings) -> list[str]:
    by = {error.level: error for error in levels}
    said = []
    if model.position is None and not model.distance:
        said.append(
            f"distance= of the two sockets is not stated, so nothing fixes how large the arm is but its "
            f"{model.chain.told}"
        )
    if chosen != "gains" and by["gains"].ci95[1] < by["geometry"].rms:
        said.append(
            f"with a scale for each joint's reading the error would be {plain(by['gains'].rms, 3)} mm instead of "
            f"{plain(by['geometry'].rms, 3)}; a {model.chain.told} has no place for it: the joints bend or "
            "their gears err, and bench discover machine=arm looks for what does"
        )
    if (poses := len(np.unique(poses_of(readings.joints)))) < 40:
        said.append(f"{poses} poses are few: some 40 make the numbers sure, and bench design says which")
    return said


def _uncounted(judged: HeldOut, wild: Mask) -> list[str]:
    """Return the error with the wild readings in it: they may be no mishaps, but what is wrong with the arm."""
    count = int((wild & np.isfinite(judged.left)).sum())
    if not count:
        return []
    many = count > 1
    these, them = (f"the {count} wild readings are", "them") if many else ("the wild reading is", "it")
    cause = (
        "were they misread, or do they lie at one range of a joint, whose error they are" if many else "was it misread"
    )
    return [f"{these} in no error above, with {them} the error after is {plain(rms(judged.left), 3)} mm; {cause}?"]


def _alone(fit: Fit, model: ArmModel, there: Mask) -> float:
    """Return the error [mm] of what is written where nobody scales the joints' readings."""
    p, place = fit.p.copy(), {name: k for k, name in enumerate(model.names)}
    for name, k in place.items():
        if name.startswith("gain_"):
            zero = place.get(name.replace("gain_", "zero_"))
            if zero is not None:
                p[zero] *= p[k]  # the zero as it is written
            p[k] = 1.0
    return rms(norms(model.errors(p))[there])


def _scales(alone: float | None, told: str) -> list[str]:
    """Return how the scales of joints' readings are used."""
    if alone is None:
        return []
    return [
        f"joint scales have no place in a {told}: give it each joint's reading times (1 + its scale), and divide a "
        f"joint's command by (1 + its scale); without them what is written leaves {plain(alone, 3)} mm"
    ]


def _range(fit: Fit, chosen: str) -> list[str]:
    """Return a remark where poses outside the ranges that were read are foretold much worse than those inside."""
    if fit.model.position is None or chosen == "frames":
        return []
    inside, outside = foretold(fit, chosen)
    if not outside > max(_FAR * inside, fit.model.sigma[0]):
        return []
    read, limits = ranges(fit.model)
    whole, part = limits[1] - limits[0], read[1] - read[0]
    narrow = [n for n, w, r in zip(fit.model.chain.driven, whole, part, strict=True) if r < _NARROW * w]
    where = f"; {', '.join(narrow)} moved little" if narrow else ""
    return [
        f"valid where the poses are: among them the arm is foretold to {plain(inside, 2)} mm, over all limits of its "
        f"joints to {plain(outside, 2)} mm{where}; bench design ... plan.limits=urdf names the poses that help"
    ]


def _far_off(levels: tuple[Error, ...], chosen: str, model: ArmModel, readings: Readings) -> list[str]:
    """Return a remark where so much is left that the description cannot be that of the arm."""
    if model.position is None:
        return []
    left = next(error.rms for error in levels if error.level == chosen)
    places = forward(model.chain, nominal(model.chain), model.joints)[:, :3, 3]
    reach = rms(np.linalg.norm(places - places.mean(axis=0), axis=1))
    if left < DOUBTFUL * reach:
        return []
    told = model.chain.told
    return [
        f"{plain(left, 3)} mm are left, and the arm moves its tip by {reach:.0f} mm: so much is no matter of "
        f"calibration; is this the {told} of the arm, and does each column hold its joint?"
        f"{joints_beside(readings, model.chain)}"
    ]


def _many_wild(wild: Mask) -> list[str]:
    if wild.mean() <= _MANY:
        return []
    return [
        f"{int(wild.sum())} of {len(wild)} poses are wild, and that many have a cause: a target that was "
        "loose, another arm position than was written down, or two tables mixed"
    ]


def _step(fit: Fit, readings: Readings) -> list[str]:
    """Return a remark where base or tracker moved so little that it was not seen before the calibration.

    Raises `DataError` where that is most of what is left: then the numbers of the arm have taken up a part of it.
    """
    if readings.position is None:
        return []
    known = np.flatnonzero(~fit.wild)
    found = stepped(fit.model.errors(fit.p)[0][known], readings.position[known])
    if found is None:
        return []
    row, off, share = found
    at = readings.told(int(known[row]))
    told = f"from {at} on, readings lie {plain(off, 2)} mm off, as if base or tracker had moved"
    cure = "calibrate what was read before and after by themselves, or let bench discover machine=arm tell it"
    if share > _SPOILT:
        raise DataError(f"{told}, and that is most of what is left: no number of the arm is sure beside it; {cure}")
    return [f"{told}: {cure}"]


def _again(poses: Index, train: Mask) -> list[str]:
    """Return a remark where poses that are held back were fitted as well: they say little of others."""
    again = int(np.isin(poses[~train], poses[train]).sum())
    return [f"{again} of {int((~train).sum())} rows that are held back repeat a pose that was fitted"] if again else []


def _wild(fit: Fit, model: ArmModel, wild: Mask, readings: Readings) -> tuple[Wild, ...]:
    size = norms(model.errors(fit.p, np.where(wild, 0.0, 1.0)))
    order = sorted(np.flatnonzero(wild), key=lambda i: -size[i])
    return tuple(Wild(readings.told(int(i)), float(size[i])) for i in order)


def _folds_told(model: ArmModel, readings: Readings) -> str:
    if readings.hold is not None:
        return f"the {int(readings.hold.sum())} rows that the file holds back"
    places = len(np.unique(model.place))
    if model.position is None and places > 1:
        return f"places left out in turn, {min(FOLDS, places)} groups of {places}"
    poses = len(np.unique(poses_of(model.joints)))
    if poses < len(readings):
        return f"every fifth of {poses} different ones left out in turn with its repeats, {FOLDS} times"
    return f"every fifth pose left out in turn, {FOLDS} times"


def _frames(fit: Fit) -> dict[str, tuple[float, ...]]:
    """Return base and target with their corrections: x y z [mm], roll pitch yaw [rad]."""
    base = fit.model.chain.mount @ placement(fit, "base")
    tool = fit.model.chain.tool @ placement(fit, "tool")
    if fit.model.position is None:
        return {"target": (*tool[:3, 3].tolist(),)}
    return {"base": (*base[:3, 3], *rpy_of(base)), "target": (*tool[:3, 3], *rpy_of(tool))}


def _in_base(fit: Fit, model: ArmModel) -> Array:
    """Return where the target is in the arm's base at each reading of `model`, (n, 3) [mm]."""
    base = model.chain.mount @ placement(fit, "base")
    return np.asarray((np.linalg.inv(base) @ model.placed(fit.p))[:, :3, 3])


def _comment(
    request: CalibrateRequest, levels: tuple[Error, ...], chosen: str, train: Mask, alone: float | None
) -> str:
    by = {error.level: error for error in levels}
    poses = f"{len(train)} poses" if train.all() else f"{int(train.sum())} of {len(train)} poses"
    return (
        f"calibrated by bench calibrate from {request.data}, {poses}; error of poses not fitted: "
        f"{plain(by['frames'].rms, 3)} mm before, {plain(by[chosen].rms, 3)} mm after (rms)"
        + ("" if alone is None else f" with the joint scales, which stand elsewhere; {plain(alone, 3)} mm without them")
    )
