"""A calibration in words: the headline, further sentences, and the cells of its tables."""

from __future__ import annotations

from math import degrees, isfinite

from calibench.bench.calibration.report.result import Calibration, Change, Error
from calibench.core.words import plain

LEVEL_WORDS = {
    "frames": "nothing (base and target only)",
    "zeros": "joint zeros",
    "geometry": "zeros, lengths, angles",
    "gains": "these and joint scales",
}
_NAMED = 4  # numbers that are told by name
_SHORT = {"position": "position", "pose": "position and rotation", "sockets": "a ball in sockets"}


def headline(found: Calibration) -> str:
    """Return the answer in a sentence."""
    before, after = found.before, found.after
    if found.chosen == "frames":
        return (
            f"calibration does not reduce the error of poses that were not fitted: {plain(before.rms, 3)} mm rms as "
            f"the {found.described} is; nothing in it is changed{_but(found)}"
        )
    low, high = after.ci95
    turned = ""
    if isfinite(after.rotation):
        turned = f"; rotation {plain(1e3 * before.rotation, 3)} mrad before, {plain(1e3 * after.rotation, 3)} after"
    return (
        f"{plain(before.rms, 3)} mm before, {plain(after.rms, 3)} mm after (95 %: {plain(low, 3)} to "
        f"{plain(high, 3)} mm), rms of poses that "
        f"were not fitted{turned}"
    )


def _but(found: Calibration) -> str:
    joints = dict.fromkeys(change.joint for change in found.changes)
    return f" but {', '.join(joints)}, which takes up where the target is" if joints else ""


def sentences(found: Calibration) -> list[str]:
    """Return the sentences after the headline."""
    said = [
        f"{found.poses} poses of {len(found.joints)} joints, {_SHORT[found.observed]} read, {found.base} to "
        f"{found.tip}; {found.folds}"
    ]
    if found.fitted < found.poses:
        said.append(
            f"what is written is fitted to the other {found.fitted} alone; the errors are of the rows held back"
        )
    elif found.chosen != "frames":
        said.append(f"what is written is fitted to all {found.poses}; errors are of fits without the poses left out")
    if found.changes:
        said.append(f"{len(found.changes)} numbers of the arm are determined by these data, {_kept(found)}")
    worst = max((p for p in found.by_joint if isfinite(p.after)), key=lambda p: p.after, default=None)
    if worst is not None and worst.after > 1.3 * found.after.rms:
        said.append(f"largest where {worst.where}: {plain(worst.after, 3)} mm (before {plain(worst.before, 3)})")
    return said


def _kept(found: Calibration) -> str:
    few = [one.parameter for one in found.undetermined if one.told_by_more_poses]
    rest = len(found.undetermined) - len(few)
    if not few:
        return f"{rest} are not"
    told = ", ".join(few) if len(few) <= _NAMED else f"{len(few)} numbers"
    return f"{rest} are not, and these poses tell {told} too badly"


def level_rows(found: Calibration) -> list[list[str]]:
    """Return a row for each level that was tried; the one that is written has a mark."""
    return [_level(error, found) for error in found.levels]


def _level(error: Error, found: Calibration) -> list[str]:
    mark = " *" if error.level == found.chosen else ""
    low, high = error.ci95
    cells = [
        f"{LEVEL_WORDS[error.level]}{mark}", f"{error.rms:.3f}", f"{low:.3f} to {high:.3f}", f"{error.median:.3f}",
        f"{error.largest:.3f}",
    ]  # fmt: skip
    if any(isfinite(one.rotation) for one in found.levels):
        cells.append(f"{1e3 * error.rotation:.2f}")
    if any(isfinite(one.spans) for one in found.levels):
        cells.append(f"{error.spans:.3f}")
    return cells


def rows_of_changes(found: Calibration) -> list[list[str]]:
    """Return joint, number, change and its interval: a row for each number that the data determine."""
    return [[change.joint, change.what, by(change), interval(change)] for change in found.changes]


def by(change: Change) -> str:
    """Return the difference of a number from its nominal value.

    >>> by(Change("zero_a", "a", "zero", "rad", 0.0021, 1e-4, (0.0019, 0.0023)))
    '+2.100 mrad (+0.120°)'
    """
    if change.unit == "rad":
        return f"{1e3 * change.change:+.3f} mrad ({degrees(change.change):+.3f}°)"
    if change.unit == "mm":
        return f"{change.change:+.3f} mm"
    return f"{100 * change.change:+.4f} %"


def interval(change: Change) -> str:
    """Return the 95 % interval of a change, in the unit of the change."""
    size = {"rad": 1e3, "mm": 1.0}.get(change.unit, 100.0)
    low, high = change.ci95
    return f"{size * low:+.3f} to {size * high:+.3f}"
