"""``bench calibrate hand_eye=...``: poses of a flange and a board in; the frames of camera and board out."""

from __future__ import annotations

import json
from math import degrees, isfinite

from calibench.bench.calibration.hand_eye import read_hand_eye, write_hand_eye
from calibench.bench.commands.console import print_end, print_table
from calibench.calibration.hand_eye import Frame, Residual
from calibench.core.words import plain
from calibench.core.words import print_plain as print


def run(words: list[str], as_json: bool) -> int:
    """Calibrate the camera that `words` name, write what came of it, and print it."""
    request = read_hand_eye(words)
    result = write_hand_eye(request.carry_out(), request)
    if as_json:
        print(json.dumps(result.to_dict(), allow_nan=False))
        return 0
    if isfinite(result.unseen.position):
        headline = f"{_left(result.unseen)} rms of poses that were not fitted; {result.how}"
    else:
        headline = f"{_left(result.fitted)} rms of the fitted poses; error of others {result.how}"
    print(f"{result.case}: {headline}")
    print(f"  {result.pairs} pairs, {result.read.replace('_', ' ')} read, {result.hand_eye.replace('_', ' ')}")
    sizes = (f"{plain(result.sigma, 3)} mm", f"{plain(degrees(result.sigma_rotation), 3)}°")
    place, turn = (
        f"{size} ({'learned' if one else 'stated'})" for size, one in zip(sizes, result.learned, strict=True)
    )
    print(f"  noise of the board's pose on each axis: {place}, {turn}")
    for frame in (result.camera, result.board):
        print(f"\n{frame.child} in {frame.parent}")
        print_table(["", "value", "standard error", "95 %"], _rows(frame))
    pairs = [f"{one.row} ({_size(one.position, one.rotation)})" for one in result.outliers]
    print_end("outlying pairs", pairs, result.notes, result.files.values())
    return 0


def _left(left: Residual) -> str:
    return _size(left.position, left.rotation)


def _size(position: float, rotation: float) -> str:
    return f"{plain(position, 3)} mm and {plain(degrees(rotation), 3)}°"


def _rows(frame: Frame) -> list[list[str]]:
    """Return a row for each number: place [mm], turns about the parent's axes [°], quaternion."""
    rows = []
    for name, value, error, (low, high) in zip(
        "xyz", frame.position, frame.position_se, frame.position_ci95, strict=True
    ):
        rows.append([f"{name} [mm]", f"{value:.3f}", plain(error, 2), f"{low:.3f} to {high:.3f}"])
    for name, value, error, (low, high) in zip(
        ("qx", "qy", "qz", "qw"), frame.quaternion, frame.quaternion_se, frame.quaternion_ci95, strict=True
    ):
        rows.append([name, f"{value:.6f}", plain(error, 2), f"{low:.6f} to {high:.6f}"])
    for name, error, within in zip("xyz", frame.turn_se, frame.turn_within95, strict=True):
        rows.append(
            [f"turn about {name} of {frame.parent} [°]", "", plain(degrees(error), 2), f"±{plain(degrees(within), 2)}"]
        )
    return rows
