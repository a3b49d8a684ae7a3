"""Cameras on hands in kinhec's own sequences, ours beside its reference solvers and OpenCV's.

kinhec makes sequences of its tier `small` (its own seed 20260909; eight tracks: noise, motion, clocks, outliers, scale,
the robot's errors, images, mixed) with their truth. Ours gets files as a user has them: pairs, or both streams with
their times where the clocks differ, and board_scale=free where the scale is none that its user knows. The others get
its keyframes, with the offset of the clocks that kinhec estimates, and OpenCV the true one. What sits on the hand is
compared: a camera, or a board.

    python -m benchmarks.peers.sequences OUT.jsonl             # 82 of 562, drawn by seed 44; goes on where it stopped
    python -m benchmarks.peers.sequences OUT.jsonl --all
    python -m benchmarks.peers.sequences OUT.jsonl --table
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.peers import environments
from benchmarks.peers.asking import Staying, ToolError
from calibench.bench.calibration.hand_eye import read_hand_eye
from calibench.calibration.rigid import vector_of

TIER, OF_TIER, DRAWN = "small", 562, 82


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers.sequences", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--all", action="store_true", help="every sequence of the tier")
    parser.add_argument("--table", action="store_true", help="print what is measured so far")
    parser.add_argument("--environments", type=Path, default=Path("results/benchmarks/environments"))
    asked = parser.parse_args()
    if asked.table:
        print(table([json.loads(line) for line in asked.out.read_text().splitlines()][1:]))
        return
    order = np.random.default_rng(44).permutation(OF_TIER)
    chosen = (order if asked.all else order[:DRAWN]).tolist()
    if not asked.out.exists():
        stated = {"tier": TIER, "seed of the tier": 20260909, "order": "permutation of seed 44", "count": len(chosen)}
        asked.out.write_text(json.dumps(stated) + "\n")
    done = {json.loads(line)["index"] for line in asked.out.read_text().splitlines()[1:]}
    asked.environments.mkdir(parents=True, exist_ok=True)
    theirs, opencv = (
        Staying(environments.build(name, asked.environments.resolve())) for name in ("kinhec", "opencv")
    )  # fmt: skip
    with asked.out.open("a") as file:
        for index in chosen:
            if index not in done:
                with TemporaryDirectory() as folder:
                    print(json.dumps(measure(index, Path(folder), theirs, opencv)), file=file, flush=True)
    for tool in (theirs, opencv):
        tool.end()


def measure(index: int, folder: Path, theirs: Staying, opencv: Staying) -> dict[str, Any]:
    """Return one sequence's row: what is true of it, what everybody is off by [mm], and whether our intervals hold."""
    work = {"tier": TIER, "index": index, "folder": str(folder)}
    try:
        row = dict(theirs.ask({"table": "sequences", "line": "kinhec", "work": work}))
    except ToolError as error:
        return {"index": index, "not_made": str(error)}
    true = np.array(row.pop("camera_on_hand"))
    try:
        for name, found in opencv.ask({"table": "sequences", "line": "OpenCV", "work": work})["found"].items():
            off = None if found is None else float(1e3 * np.linalg.norm(np.array(found)[:3, 3] - true[:3, 3]))
            row["theirs"][name] = off
    except ToolError as error:
        row["opencv"] = str(error)
    return {"index": index, **row, **ours(row, true, folder)}


def ours(row: Mapping[str, Any], true: Any, folder: Path) -> dict[str, Any]:
    """Return what ours has of a sequence in `folder`, whose frame on the hand is `true` (4, 4) [m]."""
    data = folder / "pairs.csv" if row["synchronous"] else f"{folder}/robot.csv,{folder}/camera.csv"
    words = [f"hand_eye={row['configuration']}", f"data={data}"]
    began = process_time()
    try:
        found = read_hand_eye([*words, *(["board_scale=free"] if row["scale"] != 1 else [])]).carry_out()
    except ValueError as error:
        return {"refused": str(error).replace(str(folder), ""), "cpu_s": process_time() - began}
    frame = found.camera if row["configuration"] == "eye_in_hand" else found.board
    made = np.array(frame.matrix)
    off, turned = made[:3, 3] - 1e3 * true[:3, 3], vector_of((made[:3, :3] @ true[:3, :3].T)[None])[0]
    half = np.diff(frame.position_ci95)[:, 0] / 2
    return {
        "ours": float(np.linalg.norm(off)), "ours_rad": float(np.linalg.norm(turned)),
        "held": int((np.abs(off) <= half).sum() + (np.abs(turned) <= frame.turn_within95).sum()),
        "half_mm": float(np.linalg.norm(half)), "clock": [found.offset, *found.offset_ci95],
        "outliers": len(found.outliers), "notes": [str(note.code) for note in found.notes],
        "cpu_s": process_time() - began,
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table by track: sequences, refusals, how many intervals hold, and medians of errors [mm]."""
    made = [row for row in rows if "track" in row]
    solvers = sorted({name for row in made for name in row["theirs"]})
    lines = [f"| track | sequences | refused | intervals that hold | ours | {' | '.join(solvers)} |"]
    lines.append("|---" * (5 + len(solvers)) + "|")
    for track in [*dict.fromkeys(row["track"] for row in made), "all"]:
        own = [row for row in made if track in (row["track"], "all")]
        solved = [row for row in own if "ours" in row]
        held = f"{sum(row['held'] for row in solved)} of {6 * len(solved)}"
        cells = [_median([row.get("ours") for row in solved])]
        cells += [_median([row["theirs"].get(name) for row in solved]) for name in solvers]
        lines.append(f"| {track} | {len(own)} | {len(own) - len(solved)} | {held} | {' | '.join(cells)} |")
    refused = [row for row in made if "refused" in row]
    lines += ["", "Refused:"]
    for row in refused:
        best = min((off, name) for name, off in row["theirs"].items() if off is not None)
        lines.append(
            f"- {row['sequence_id']} ({row['level']}), best of others {best[0]:.3g} mm by {best[1]}: {row['refused']}"
        )
    missing = [row["not_made"] for row in rows if "not_made" in row]
    return "\n".join([*lines, "", f"{len(missing)} sequences that kinhec did not make: {', '.join(missing) or 'none'}"])


def _median(values: list[Any]) -> str:
    known = pd.Series(values, dtype=float).dropna()
    return f"{known.median():.3g}" if len(known) else ""


if __name__ == "__main__":
    main()
