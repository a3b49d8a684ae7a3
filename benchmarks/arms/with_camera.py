"""An arm and a camera in one fit: do their intervals hold, and how much nearer are they than the camera alone?

A UR5e with errors of half a millimetre, half a milliradian and zeros of 2.5 mrad, in the numbers that such readings
tell; 40 poses about one posture, a board seen with a noise of .2 mm and .8 mrad. Even seeds have the eye in the hand,
odd ones beside the robot. Alone, a camera is calibrated with the arm as it is described.

    python -m benchmarks.arms.with_camera OUT.jsonl --seeds 4500 4700     # goes on where it was stopped
    python -m benchmarks.arms.with_camera OUT.jsonl --table
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.arms.honest import ROBOTS, about, chain_of, frame, moved, urdf_of
from calibench.calibration.api import calibrate, hand_eye
from calibench.calibration.rigid import vector_of
from calibench.problems.base import Array

POSES, NOISE, SIZE = 40, (0.2, 0.0008), 0.5
HOME, SPREAD = np.array([0.3, -1.2, 1.4, -1.6, -1.5, 0.4]), 0.8
TOLD = {
    1: (0, 3, 6),
    2: (0, 3, 4, 6),
    3: (0, 3, 4, 6),
    4: (0, 1, 3, 6),
    5: (0, 1, 3),
}  # of a joint: x y z rx ry rz zero
NAMES = ("x", "y", "z", "rx", "ry", "rz", "zero")


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.arms.with_camera", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument(
        "--seeds", type=int, nargs=2, default=(4500, 4700), help="the first, and the one after the last"
    )
    parser.add_argument("--table", action="store_true", help="print what is measured so far")
    asked = parser.parse_args()
    if asked.table:
        print(table([json.loads(line) for line in asked.out.read_text().splitlines()][1:]))
        return
    if not asked.out.exists():
        asked.out.write_text(json.dumps({"seeds": asked.seeds, "poses": POSES, "noise": NOISE, "size": SIZE}) + "\n")
    done = {json.loads(line)["seed"] for line in asked.out.read_text().splitlines()[1:]}
    with asked.out.open("a") as file:
        for seed in range(*asked.seeds):
            if seed not in done:
                print(json.dumps(measure(seed)), file=file, flush=True)


def measure(seed: int) -> dict[str, Any]:
    """Return what one arm's camera and board are off by [mm], and how many of their intervals hold."""
    rng, mode = np.random.default_rng(seed), ("eye_in_hand", "eye_to_hand")[seed % 2]
    nominal = chain_of(*ROBOTS["Universal Robots", "UR5e"])
    small = np.zeros((6, 7))
    for joint, some in TOLD.items():
        small[joint, list(some)] = (
            rng.normal(size=len(some)) * SIZE * np.array([1, 1, 1, 1e-3, 1e-3, 1e-3, 5e-3])[list(some)]
        )
    q = HOME + rng.uniform(-SPREAD, SPREAD, (POSES, 6))
    flange, [home] = poses(moved(nominal, small), q), poses(moved(nominal, small), HOME[None])
    mount, away = frame((40, -25, 110), (0.3, -0.5, 0.8)), frame((20, -30, 600), (3.0, 0.2, 0.1))
    still = home @ mount @ (away if mode == "eye_in_hand" else np.linalg.inv(away))
    board = np.linalg.inv(flange @ mount) @ still if mode == "eye_in_hand" else np.linalg.inv(still) @ flange @ mount
    board[:, :3, :3] = about(rng.normal(0, NOISE[1], (POSES, 3))) @ board[:, :3, :3]
    board[:, :3, 3] += rng.normal(0, NOISE[0], (POSES, 3))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(urdf_of(nominal))
        both = calibrate(path, {f"j{k + 1} [rad]": q[:, k] for k in range(6)} | _columns("board", board), hand_eye=mode)
    alone = hand_eye(_columns("flange", poses(nominal, q)) | _columns("board", board), mounting=mode)
    row: dict[str, Any] = {"seed": seed, "before": both.error_before, "after": both.error_after, "level": both.chosen}
    true = dict(zip(("camera", "board"), (mount, still) if mode == "eye_in_hand" else (still, mount), strict=True))
    for child, of in true.items():
        for name, answer in (("both", both), ("alone", alone)):
            found = getattr(answer, child)
            made = np.array(found.matrix)
            off, turned = made[:3, 3] - of[:3, 3], vector_of((made[:3, :3] @ of[:3, :3].T)[None])[0]
            held = (np.abs(off) <= np.diff(found.position_ci95)[:, 0] / 2).sum()
            held += (np.abs(turned) <= found.turn_within95).sum()
            row |= {f"{name}_{child}": float(np.linalg.norm(off)), f"{name}_{child}_held": int(held)}
    numbers = {f"{name}_j{j + 1}": small[j, k] for j in range(6) for k, name in enumerate(NAMES)}
    inside = [one.ci95[0] <= numbers[one.parameter] <= one.ci95[1] for one in both.changes if one.parameter in numbers]
    return row | {"arm_held": int(np.sum(inside)), "arm": len(inside)}


def poses(chain: Any, q: Array) -> Array:
    """Return the flange's poses (n, 4, 4) [mm] at joints q (n, j)."""
    made = np.tile(np.eye(4), (len(q), 1, 1))
    for origin, axis, angles in zip(chain.origins, chain.axes, q.T, strict=True):
        turn = np.tile(np.eye(4), (len(q), 1, 1))
        turn[:, :3, :3] = about(angles[:, None] * axis)
        made = made @ origin @ turn
    return np.asarray(made @ chain.flange)


def _columns(side: str, found: Array) -> dict[str, Array]:
    turns = Rotation.from_matrix(found[:, :3, :3]).as_quat()
    places = {f"{side}_{axis} [mm]": found[:, k, 3] for k, axis in enumerate("xyz")}
    return places | {f"{side}_q{axis}": column for axis, column in zip("xyzw", turns.T, strict=True)}


def table(rows: list[dict[str, Any]]) -> str:
    """Return the medians of errors [mm], and how many intervals hold."""
    lines = ["| frame | in one fit | alone | intervals in one fit | alone |", "|---|---|---|---|---|"]
    for child in ("camera", "board"):
        off = [f"{np.median([row[f'{name}_{child}'] for row in rows]):.3f} mm" for name in ("both", "alone")]
        held = [f"{sum(row[f'{name}_{child}_held'] for row in rows)} of {6 * len(rows)}" for name in ("both", "alone")]
        lines.append(f"| {child} | {' | '.join([*off, *held])} |")
    before, after = (np.median([row[key] for row in rows]) for key in ("before", "after"))
    arm = f"{sum(row['arm_held'] for row in rows)} of {sum(row['arm'] for row in rows)}"
    lines += ["", f"{len(rows)} arms: poses not fitted {before:.2f} mm before, {after:.2f} mm after (medians)"]
    return "\n".join([*lines, f"intervals of the arm's numbers that hold: {arm}"])


if __name__ == "__main__":
    main()
