"""Does the interval of the told error hold it, of rigs, of less than places, and of joints that bend?

Arms as in `serial_rigs`, 40 poses, noise .03 mm; the kinematics is written by hand. What is true is the error at 400
further poses between them, which the file holds back, with as much noise; of touched planes, each one number, 110 poses
are read and 330 held back. A line a case, able to go on:

    python -m tests.independent.serial_told 0 99 out.jsonl
    python -m tests.independent.serial_told 0 99 out.jsonl "three planes"
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import calibench
from tests.bench.arm_by_hand import NAMES, placed, urdf
from tests.calibration.test_elastic import KAPPA, heavy_urdf, held
from tests.calibration.test_loci import FROM_BASE, PLANES, WIRES, touching
from tests.calibration.test_rig import REFLECTORS, rig, without
from tests.independent.serial_rigs import truth_of

COUNT, EVERY, NOISE = 440, 11, 0.03  # poses, of which every eleventh is read, and the others are held back
Columns = dict[str, np.ndarray]


def joints(seed: int) -> np.ndarray:
    """Return the joints of all poses."""
    return np.random.default_rng([seed, 46]).uniform(-2.4, 2.4, (COUNT, 6))


def places(seed: int) -> Columns:
    """Return poses of one target."""
    return without(rig(COUNT, reflectors=REFLECTORS[:1], seed=seed + 2000, truth=truth_of(seed)), "base")


def two_targets(seed: int, drift: float = 0.0) -> Columns:
    """Return poses of two targets; where the tracker has a `drift` there are three of the base beside them."""
    columns = rig(COUNT, drift, REFLECTORS[:2], seed=seed + 2000, truth=truth_of(seed))
    for name in (name for name in columns if name.startswith("base")):
        columns[name][np.arange(COUNT) % (6 * EVERY) != 0] = np.nan  # beside every sixth pose that is read
    return columns if drift else without(columns, "base")


def distances(seed: int) -> Columns:
    """Return distances from three points."""
    q, rng, truth = joints(seed), np.random.default_rng([seed, 47]), truth_of(seed)
    seen = placed(q, truth, base=FROM_BASE)[0]
    far = {f"distance_{name}": np.linalg.norm(seen - at, axis=1) for name, at in WIRES.items()}
    return dict(zip(NAMES, q.T, strict=True)) | {n: one + rng.normal(0, NOISE, len(q)) for n, one in far.items()}


def planes(seed: int) -> Columns:
    """Return poses that touch three planes in turn, read to .01 mrad."""
    truth = truth_of(seed)
    q = np.stack([touching(COUNT // 3 + 1, one, seed, truth) for one in PLANES.values()], axis=1).reshape(-1, 6)[:COUNT]
    return dict(zip(NAMES, q.T, strict=True)) | {"plane": np.resize([*PLANES], COUNT)}


def bending(seed: int) -> Columns:
    """Return poses of an arm whose joints bend under its masses and a payload."""
    q, rng, truth = joints(seed), np.random.default_rng([seed, 48]), truth_of(seed)
    payload = np.where(np.arange(COUNT) % 2, 0.0, 5.0)
    seen = placed(q - KAPPA * held(q, payload), truth)[0]
    seen += rng.normal(0, NOISE, seen.shape)
    return dict(zip(NAMES, q.T, strict=True)) | dict(zip("xyz", seen.T, strict=True)) | {"payload_kg": payload}


KINDS: dict[str, Callable[[int], Columns]] = {
    "one target": places,
    "x and z of it": lambda seed: without(places(seed), "y"),
    "two targets": two_targets,
    "two, base targets and drift": lambda seed: two_targets(seed, 1.0),
    "three distances": distances,
    "three planes": planes,
    "joints that bend": bending,
}


def case(kind: str, seed: int, folder: Path) -> dict[str, float | str]:
    """Return what is told of the first poses, and what is left of the others [mm]."""
    level = "elastic" if kind == "joints that bend" else "geometry"
    (folder / "my.urdf").write_text(heavy_urdf() if level == "elastic" else urdf())
    columns, every = KINDS[kind](seed), 4 if kind == "three planes" else EVERY
    some = {name: one[::every] for name, one in columns.items()}
    split = np.where(np.arange(COUNT) % every, "hold", "train")
    told, true = (
        calibench.calibrate(folder / "my.urdf", one, level=level, resamples=20, limits=False).after
        for one in (some, columns | {"split": split})
    )
    return {"told": told.rms, "low": told.ci95[0], "high": told.ci95[1], "true": true.rms}


def main(first: int, last: int, out: Path, kinds: Sequence[str] = tuple(KINDS)) -> None:
    """Write the cases of `kinds` that `out` lacks, and print how many intervals hold."""
    lines = [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []
    if not lines:
        lines = [{"seeds": [first, last], "kinds": kinds, "poses": COUNT // EVERY, "noise_mm": NOISE}]
        out.write_text(json.dumps(lines[0]) + "\n")
    there = {(one["seed"], one["kind"]) for one in lines[1:]}
    with TemporaryDirectory() as folder, out.open("a") as file:
        for seed, kind in ((s, k) for s in range(first, last + 1) for k in kinds):
            if (seed, kind) not in there:
                lines.append({"seed": seed, "kind": kind} | case(kind, seed, Path(folder)))
                print(json.dumps(lines[-1]), file=file, flush=True)
    print(
        "| read | fits | interval holds | high / low, median | told / true, median |\n| --- | --- | --- | --- | --- |"
    )
    for kind in kinds:
        mine = [one for one in lines[1:] if one["kind"] == kind]
        holds = sum(one["low"] <= one["true"] <= one["high"] for one in mine)
        wide, ratio = (np.median([one[a] / one[b] for one in mine]) for a, b in (("high", "low"), ("told", "true")))
        print(f"| {kind} | {len(mine)} | {holds} | {wide:.2f} | {ratio:.3f} |")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]), *([sys.argv[4:]] if sys.argv[4:] else []))
