"""``bench calibrate``: an arm's URDF, or its table, and readings in; the calibrated one, its errors and a page out."""

from __future__ import annotations

import json
from math import isfinite

from calibench.bench.calibration.request import read_calibrate, write_calibration
from calibench.bench.calibration.words import headline, level_rows, rows_of_changes, sentences
from calibench.bench.commands.arguments import split_flags
from calibench.bench.commands.console import print_end, print_table
from calibench.core.words import plain
from calibench.core.words import print_plain as print


def run(argv: list[str]) -> int:
    """Calibrate the arm that `argv` names, write what came of it, and print it."""
    flags, words = split_flags(argv, ("--json",))
    if any(word.partition("=")[0] == "hand_eye" for word in words):
        from calibench.bench.commands import hand_eye

        return hand_eye.run(words, "--json" in flags)
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
    wild = [f"{one.row} ({plain(one.error, 3)} mm)" for one in result.wild]
    print_end("wild readings", wild, result.notes, result.files.values())
    return 0
