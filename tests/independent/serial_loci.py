"""What less than places brings: axes, distances and touched planes against a tracker, on arms that are wrong alike.

Arms as in `serial_rigs`; 100 readings each, noise .03 mm; the kinematics is written by hand. The error is that of the
written file on 300 fresh poses, rms [mm], the target's frames being fitted. A line a case, able to go on:

    python -m tests.independent.serial_loci 0 14 out.jsonl
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import calibench
from tests.bench.arm_by_hand import NAMES, placed, urdf
from tests.calibration.test_loci import FROM_BASE, PLANES, WIRES, touching
from tests.calibration.test_rig import error
from tests.independent.serial_rigs import truth_of

COUNT, NOISE = 100, 0.03
KINDS = ("x, y, z", "x, z", "z", "3 distances", "1 distance", "3 planes", "1 plane")


def columns_of(kind: str, truth: dict[str, float], seed: int) -> dict[str, np.ndarray]:
    """Return the joints and what was read of one kind."""
    rng = np.random.default_rng([seed, 45])
    if "plane" in kind:
        planes = dict([*PLANES.items()][: int(kind[0])])
        q = np.vstack([touching(COUNT // len(planes) + 1, one, seed, truth) for one in planes.values()])
        names = np.repeat([*planes], COUNT // len(planes) + 1)
        return dict(zip(NAMES, q.T, strict=True)) | {"plane": names}
    q = rng.uniform(-2.4, 2.4, (COUNT, 6))
    seen = placed(q, truth, base=FROM_BASE)[0]
    joints = dict(zip(NAMES, q.T, strict=True))
    if "distance" in kind:
        some = [*WIRES.items()][: int(kind[0])]
        far = {f"distance_{name}": np.linalg.norm(seen - at, axis=1) for name, at in some}
        return joints | {name: one + rng.normal(0, NOISE, COUNT) for name, one in far.items()}
    return joints | {a: seen[:, "xyz".index(a)] + rng.normal(0, NOISE, COUNT) for a in kind.split(", ")}


def main(first: int, last: int, out: Path) -> None:
    """Write the cases that `out` lacks, and print medians over the seeds."""
    lines = [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []
    if not lines:
        lines = [{"seeds": [first, last], "kinds": KINDS, "readings": COUNT, "noise_mm": NOISE}]
        out.write_text(json.dumps(lines[0]) + "\n")
    there = {(one["seed"], one["kind"]) for one in lines[1:]}
    with TemporaryDirectory() as folder, out.open("a") as file:
        path = Path(folder) / "my.urdf"
        path.write_text(urdf())
        for seed, kind in ((s, k) for s in range(first, last + 1) for k in KINDS):
            if (seed, kind) not in there:
                truth = truth_of(seed)
                fit = calibench.calibrate(path, columns_of(kind, truth, seed), resamples=20, limits=False)
                found = {"seed": seed, "kind": kind, "error": error(fit, path.parent, truth), "told": fit.error_after}
                lines.append(found)
                print(json.dumps(found), file=file, flush=True)
    print("| read | error, median | largest |\n| --- | --- | --- |")
    for kind in KINDS:
        mine = [one["error"] for one in lines[1:] if one["kind"] == kind]
        print(f"| {kind} | {np.median(mine):.3f} | {max(mine):.3f} |")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
