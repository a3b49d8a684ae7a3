"""``bench calibrate``: an arm's URDF, or its table, and readings in; the calibrated one, its errors and a page out.

``bench calibrate hand_eye=...``: poses of a flange and a board in; the frames of camera and board out. With ``urdf=``
and joints in the place of the flange: all of it in one fit.
"""

from __future__ import annotations

import json
from math import degrees, isfinite
from typing import TYPE_CHECKING

from calibench.bench.calibration.request import read_calibrate, write_calibration
from calibench.bench.calibration.words import headline, level_rows, rows_of_changes, rows_of_frame, sentences
from calibench.bench.commands.console import print_end, print_table
from calibench.bench.words import split_flags
from calibench.core.words import plain, print_plain as print

if TYPE_CHECKING:
    from calibench.calibration.hand_eye import Frame, Outlier, Residual


def run(argv: list[str]) -> int:
    flags, words = split_flags(argv, ("--json",))
    keys = {word.partition("=")[0] for word in words}
    if "hand_eye" in keys and not keys & {"urdf", "dh"}:
        return calibrate_camera(words, "--json" in flags)
    request = read_calibrate(words)
    result = write_calibration(request.carry_out(), request)
    if "--json" in flags:
        print(json.dumps(result.to_dict(), allow_nan=False))
        return 0
    print(f"{result.case}: {headline(result)}")
    for sentence in sentences(result):
        print(f"  {sentence}")
    print("\nerror of poses that were not fitted [mm]")
    heads = ["free", "rms", "95 %", "median", "largest"]
    heads += ["rotation [mrad]"] if any(isfinite(error.rotation) for error in result.levels) else []
    heads += ["sockets apart [mm]"] if any(isfinite(error.spans) for error in result.levels) else []
    print_table(heads, level_rows(result))
    if result.changes:
        print(f"\nwhat changes in the {result.source}")
        print_table(["joint", "what", "by", "95 %"], rows_of_changes(result))
    if result.camera is not None and result.board is not None:
        _print_frames(result.camera, result.board)
    wild = [f"{one.row} ({plain(one.error, 3)} mm)" for one in result.wild]
    print_end("wild readings", wild, result.notes, result.files.values())
    return 0


def calibrate_camera(words: list[str], as_json: bool) -> int:
    from calibench.bench.calibration.hand_eye import read_hand_eye, write_hand_eye  # an arm needs nothing of it

    request = read_hand_eye(words)
    result = write_hand_eye(request.carry_out(), request)
    if as_json:
        print(json.dumps(result.to_dict(), allow_nan=False))
        return 0
    if isfinite(result.unseen.position):
        headline = f"{_size(result.unseen)} rms of poses that were not fitted; {result.how}"
    else:
        headline = f"{_size(result.fitted)} rms of the fitted poses; error of others {result.how}"
    print(f"{result.case}: {headline}")
    print(f"  {result.pairs} pairs, {result.read.replace('_', ' ')} read, {result.hand_eye.replace('_', ' ')}")
    sizes = (f"{plain(result.sigma, 3)} mm", f"{plain(degrees(result.sigma_rotation), 3)}°")
    place, turn = (
        f"{size} ({'learned' if one else 'stated'})" for size, one in zip(sizes, result.learned, strict=True)
    )
    print(f"  noise of the board's pose on each axis: {place}, {turn}")
    if isfinite(result.offset):
        least, most = (f"{1e3 * value:.1f}" for value in result.offset_ci95)
        print(f"  the camera's clock is {1e3 * result.offset:.1f} ms ahead of the robot's (95 %: {least} to {most} ms)")
    if result.free_scale:
        print(
            f"  the board is seen {plain(result.scale, 5)} times as far as it is (standard error "
            f"{plain(result.scale_se, 2)}): board_scale={plain(1 / result.scale, 5)}"
        )
    if result.closed_forms:
        away = ", ".join(f"{form.name} {form.size()}" for form in result.closed_forms)
        print(f"  closed forms of all pairs have the camera away by: {away}")
    _print_frames(result.camera, result.board)
    pairs = [f"{one.row} ({_size(one)})" for one in result.outliers]
    print_end("outlying pairs", pairs, result.notes, result.files.values())
    return 0


def _print_frames(*frames: Frame) -> None:
    for frame in frames:
        print(f"\n{frame.child} in {frame.parent}")
        print_table(["", "value", "standard error", "95 %"], rows_of_frame(frame))


def _size(left: Residual | Outlier) -> str:
    return f"{plain(left.position, 3)} mm and {plain(degrees(left.rotation), 3)}°"
