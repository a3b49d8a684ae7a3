"""A calibration in words: the headline, further sentences, and the cells of its tables."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees, isfinite
from typing import TYPE_CHECKING

from calibench.calibration.calibrate import Calibration
from calibench.core.words import plain

if TYPE_CHECKING:
    from calibench.calibration.hand_eye import Frame

LEVEL_WORDS = {
    "frames": "nothing (base and target only)", "zeros": "joint zeros", "geometry": "zeros, lengths, angles",
    "gains": "these and joint scales", "elastic": "lengths and compliances",
}  # fmt: skip
_NAMED = 4  # numbers that are told by name
_SHORT = {"position": "position", "pose": "position and rotation", "sockets": "a ball in sockets"}


def headline(answer: Calibration) -> str:
    """Return the answer in a sentence."""
    before, after = answer.before, answer.after
    if answer.chosen == "frames":
        joints = dict.fromkeys(change.joint for change in answer.changes)
        but = f" but {', '.join(joints)}, which takes up where the target is" if joints else ""
        return (
            f"calibration does not reduce the error of poses that were not fitted: {plain(before.rms, 3)} mm rms as "
            f"the {answer.source} is; nothing in it is changed{but}"
        )
    (low, high), turned = after.ci95, ""
    if isfinite(after.rotation):
        turned = f"; rotation {plain(1e3 * before.rotation, 3)} mrad before, {plain(1e3 * after.rotation, 3)} after"
    return (
        f"{plain(before.rms, 3)} mm before, {plain(after.rms, 3)} mm after (95 %: {plain(low, 3)} to "
        f"{plain(high, 3)} mm), rms of poses that were not fitted{turned}"
    )


def sentences(answer: Calibration) -> list[str]:
    """Return the sentences after the headline."""
    loci, read = answer.readings.loci, answer.readings.position
    what = _SHORT[answer.observed] if loci is None or read is None else loci.words(read)
    what = what if answer.camera is None else "the board's pose in the camera"
    lines = [
        f"{answer.poses} poses of {len(answer.joints)} joints, {what} read, {answer.base} to "
        f"{answer.tip}; {answer.folds}"
    ]
    if answer.fitted < answer.poses:
        lines.append(
            f"what is written is fitted to the other {answer.fitted} alone; the errors are of the rows held back"
        )
    elif answer.chosen != "frames":
        lines.append(f"what is written is fitted to all {answer.poses}; errors of poses left out are scaled to it")
    if answer.changes:
        few = [one.parameter for one in answer.undetermined if isfinite(one.known_to)]
        rest = f"{len(answer.undetermined) - len(few)} are not"
        names = ", ".join(few) if len(few) <= _NAMED else f"{len(few)} numbers"
        rest += f", and these poses tell {names} less well than the {answer.source}" if few else ""
        lines.append(f"{len(answer.changes)} numbers of the arm are determined by these data, {rest}")
    worst = max((p for p in answer.by_joint if isfinite(p.after)), key=lambda p: p.after, default=None)
    if worst is not None and worst.after > 1.3 * answer.after.rms:
        lines.append(f"largest where {worst.where}: {plain(worst.after, 3)} mm (before {plain(worst.before, 3)})")
    return lines


def level_rows(answer: Calibration) -> list[list[str]]:
    """Return a row for each level that was tried; the one that is written has a mark."""
    rows = []
    for error in answer.levels:
        mark, (low, high) = " *" if error.level == answer.chosen else "", error.ci95
        rows.append([f"{LEVEL_WORDS[error.level]}{mark}", f"{error.rms:.3f}", f"{low:.3f} to {high:.3f}"])
        rows[-1] += [f"{error.median:.3f}", f"{error.largest:.3f}"]
        if any(isfinite(one.rotation) for one in answer.levels):
            rows[-1].append(f"{1e3 * error.rotation:.2f}")
        if any(isfinite(one.spans) for one in answer.levels):
            rows[-1].append(f"{error.spans:.3f}")
    return rows


def rows_of_changes(answer: Calibration) -> list[list[str]]:
    """Return joint, number, change and its 95 % interval: a row for each number that the data determine."""
    rows = []
    for change in answer.changes:
        by, size = f"{100 * change.change:+.4f} %", {"rad": 1e3, "mm": 1.0}.get(change.unit, 100.0)
        if change.unit == "rad":
            by = f"{1e3 * change.change:+.3f} mrad ({degrees(change.change):+.3f}°)"
        elif change.unit == "mm":
            by = f"{change.change:+.3f} mm"
        elif change.unit:
            by, size = f"{1e6 * change.change:+.2f} μ{change.unit}", 1e6
        low, high = change.ci95
        rows.append([change.joint, change.what, by, f"{size * low:+.3f} to {size * high:+.3f}"])
    return rows


def rows_of_frame(frame: Frame) -> list[list[str]]:
    """Return number, value, standard error and interval of a frame: place, quaternion, turns in the parent."""
    rows = []
    places = zip("xyz", frame.position, frame.position_se, frame.position_ci95, strict=True)
    for name, value, error, (low, high) in places:
        rows.append([f"{name} [mm]", f"{value:.3f}", plain(error, 2), f"{low:.3f} to {high:.3f}"])
    numbers = (frame.quaternion, frame.quaternion_se, frame.quaternion_ci95)
    for name, value, error, (low, high) in zip(("qx", "qy", "qz", "qw"), *numbers, strict=True):
        rows.append([name, f"{value:.6f}", plain(error, 2), f"{low:.6f} to {high:.6f}"])
    for name, error, within in zip("xyz", frame.turn_se, frame.turn_within95, strict=True):
        about = f"turn about {name} of {frame.parent} [°]"
        rows.append([about, "", plain(degrees(error), 2), f"±{plain(degrees(within), 2)}"])
    return rows


def transforms_text(head: str, frames: Sequence[Frame]) -> str:
    """Return frames for ROS, in metres, each with the command that publishes it."""
    lines = [f"# {head}; metres", "transforms:"]
    for frame in frames:
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
