"""Rates of rigs: three reflectors in one fit against one each, and a drift with and without base targets.

Arms are wrong by .4 mm, .6 mrad and 3 mrad of zeros; 30 and 60 poses, noise .03 mm; the kinematics is written by hand.
The error is that of the written file on 300 fresh poses, rms [mm]. A line a case, able to go on:

    python -m tests.independent.serial_rigs 0 19 out.jsonl
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import calibench
from tests.bench.arm_by_hand import NAMES, urdf
from tests.calibration.test_rig import error, rig, single, without

SIZES, DRIFTS = (30, 60), (0.0, 0.5, 1.0)  # poses; times .54 mm and .24 mrad over the run


def truth_of(seed: int) -> dict[str, float]:
    """Return the errors of one arm by name [mm, rad]."""
    rng = np.random.default_rng([seed, 44])
    sizes = {"x": 0.4, "y": 0.4, "z": 0.4, "rx": 6e-4, "zero": 3e-3}
    return {f"{kind}_{name}": float(rng.normal(0, size)) for kind, size in sizes.items() for name in NAMES[1:]}


def case(seed: int, poses: int, drift: float, folder: Path) -> dict[str, float | list[float]]:
    """Return the errors of one case [mm]."""
    truth = truth_of(seed)
    columns = rig(poses, drift, seed=seed + 1000, truth=truth)
    (folder / "my.urdf").write_text(urdf())

    def of(some: dict[str, np.ndarray]) -> float:
        fit = calibench.calibrate(folder / "my.urdf", some, level="geometry", resamples=20, limits=False)
        return error(fit, folder, truth)

    alone = [of(single(columns, k)) for k in (1, 2, 3)]
    return {"three": of(without(columns, "base")), "alone": alone, "three_base": of(columns)}


def main(first: int, last: int, out: Path) -> None:
    """Write the cases that `out` lacks, and print medians over the seeds."""
    lines = [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []
    if not lines:
        lines = [{"seeds": [first, last], "poses": SIZES, "drifts": DRIFTS, "noise_mm": 0.03}]
        out.write_text(json.dumps(lines[0]) + "\n")
    there = {(one["seed"], one["poses"], one["drift"]) for one in lines[1:]}
    with TemporaryDirectory() as folder, out.open("a") as file:
        for key in ((s, n, d) for s in range(first, last + 1) for n in SIZES for d in DRIFTS):
            if key not in there:
                found = dict(zip(("seed", "poses", "drift"), key, strict=True)) | case(*key, Path(folder))
                lines.append(found)
                print(json.dumps(found), file=file, flush=True)
    print(
        "| poses | drift | three fits (median) | three in one fit | and base targets |\n| --- | --- | --- | --- | --- |"
    )
    for n in SIZES:
        for d in DRIFTS:
            mine = [one for one in lines[1:] if (one["poses"], one["drift"]) == (n, d)]
            each = (
                np.median([one["alone"] for one in mine]),
                *(np.median([one[k] for one in mine]) for k in ("three", "three_base")),
            )
            print(f"| {n} | {0.54 * d:.2f} mm | {' | '.join(f'{v:.3f}' for v in each)} |")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
