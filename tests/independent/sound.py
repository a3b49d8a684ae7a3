"""Sound machines with clean Gaussian noise, of 300 to 10 000 rows: how often is anything told, outliers among it.

    python -m tests.independent.sound run out.jsonl [0/2]      every batch, or every second set of it, from the first
    python -m tests.independent.sound score out.jsonl ...      alarms of each kind and number of rows, with intervals

The first line of a file states the batches before a set is drawn; what is in the file is not searched again. A five-bar
returns to a place exactly, or within `MOVED`, and its encoders (and where there is one the tracker) tell of it.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from calibench.discrepancy import MeasuredData, Report, explain
from calibench.discrepancy.machines.gpm2002.description import planned
from tests.independent import mount
from tests.independent.arm6_cases import case as arm6
from tests.independent.arm6_score import Rate
from tests.independent.own_arm import SixAxisArm

MOVED = 0.03  # mm
SOUND_NIGHTS = 43  # the base of the mounts; a fifth of their nights has noise of a t law
SIGMA, SIGMA_XY = 5e-5, 0.02  # rad, mm
ROWS = {300: 60, 1000: 40, 3000: 24, 10000: 8}  # rows -> sets of each kind
FIVE_BARS = {  # kind -> tracked, moved, repeats
    "five-bar, tracked, repeats within .03 mm": (True, MOVED, 2),
    "five-bar, tracked, exact repeats": (True, 0.0, 3),
    "five-bar, angles, repeats within .03 mm": (False, MOVED, 2),
    "five-bar, angles, exact repeats": (False, 0.0, 2),
    "five-bar, tracked, no repeats": (True, 0.0, 1),
    "five-bar, angles, no repeats": (False, 0.0, 1),
}
ARM, MOUNT = "six-axis arm, repeats", "mount, noise stated, no repeats"
BATCHES = [
    *((kind, rows, 43_000 + 1000 * k, count) for k, kind in enumerate(FIVE_BARS) for rows, count in ROWS.items()),
    (ARM, 300, 49_000, 30), (ARM, 1000, 49_100, 10), (MOUNT, 0, 49_500, 60),
]  # fmt: skip


def five_bar(rows: int, seed: int, tracked: bool, moved: float, repeats: int) -> MeasuredData:
    """Return readings of a five-bar; the first angles of each leg are those of its elbow's side."""
    rng = np.random.default_rng([seed, rows])
    plan = planned(n=rows // repeats, visits=1, repeats=repeats, tracked=True, seed=seed, radius=90.0)
    columns = {name: np.array(values) for name, values in plan.columns.items()}
    n, q = len(columns["t_s"]), plan.metadata["nominal"]
    was = np.stack([columns["x"], columns["y"]])
    now = was + moved * rng.normal(size=(2, n))
    for i in (1, 2, 3):
        base, la, lb = np.array([q[f"xa{i}"], q[f"ya{i}"]]), q[f"la{i}"], q[f"lb{i}"]

        def angle(at: Any, base: Any = base, la: float = la, lb: float = lb) -> Any:
            away = at - base[:, None]
            reach = np.hypot(*away)
            return np.arctan2(away[1], away[0]) + np.arccos((la**2 + reach**2 - lb**2) / (2 * la * reach))

        columns[f"enc_{i}"] = columns[f"enc_{i}"] + angle(now) - angle(was) + SIGMA * rng.normal(size=n)
    columns["x"], columns["y"] = now + SIGMA_XY * rng.normal(size=(2, n))
    kept = {name: values for name, values in columns.items() if tracked or name not in ("x", "y")}
    return MeasuredData(kept, "gpm2002", {**plan.metadata, "sigma_enc": SIGMA, "sigma_xy": SIGMA_XY}, "sound")


def told(kind: str, rows: int, seed: int) -> Report:
    """Return what is said of one sound set."""
    if kind in FIVE_BARS:
        tracked, moved, repeats = FIVE_BARS[kind]
        return explain("gpm2002", five_bar(rows, seed, tracked, moved, repeats))
    if kind == ARM:
        drawn = (arm6(seed + 10_000 * k, kind="none", poses=rows // 4) for k in range(100))
        found = next(one for one in drawn if one.truth.noise == "gauss")
        return explain(SixAxisArm(found.sigma, found.teeth), MeasuredData(found.columns, "six-axis arm", {}, "sound"))
    night = mount.case(seed, only="", base=SOUND_NIGHTS)
    return explain(
        "mount", MeasuredData(night.columns, "mount", {**night.stated, "sigma_arcsec": night.sigma}, "sound")
    )


def run(out: Path, part: str = "0/1") -> None:
    """Search what is not in `out`."""
    first, every = map(int, part.split("/"))
    known = {(one["kind"], one["rows"], one["seed"]) for one in _lines(out)}
    with out.open("a", encoding="utf-8") as file:
        if not known:
            file.write(json.dumps({"batches": BATCHES}) + "\n")
        # all batches keep step, so that a part of them is a part of each
        whole = [(k / count, kind, rows, base + k) for kind, rows, base, count in BATCHES for k in range(count)]
        for _, kind, rows, seed in sorted(whole)[first::every]:
            if (kind, rows, seed) in known:
                continue
            began, report = process_time(), told(kind, rows, seed)
            answer = {
                "kind": kind, "rows": rows, "seed": seed, "verdict": report.verdict,
                "effects": [f.effect for f in report.findings], "notes": [note.code for note in report.notes],
                "seconds": process_time() - began,
            }  # fmt: skip
            file.write(json.dumps(answer) + "\n")
            file.flush()


def _lines(path: Path) -> list[dict[str, Any]]:
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return [one for one in map(json.loads, text.splitlines()) if "batches" not in one]


def score(paths: Sequence[Path]) -> list[str]:
    """Return alarms of each kind and number of rows, of each number of rows, and of all: any verdict but none."""
    groups: dict[str, list[bool]] = defaultdict(list)
    for one in (one for path in paths for one in _lines(path)):
        alarm = one["verdict"] != "none"
        for group in (f"{one['kind']}, {one['rows']} rows", f"{one['rows']} rows", "all"):
            groups[group].append(alarm)
    return [str(Rate(name, sum(hits), len(hits))) for name, hits in sorted(groups.items())]


if __name__ == "__main__":
    verb, *words = sys.argv[1:]
    if verb == "run":
        run(Path(words[0]), *words[1:])
    else:
        print("\n".join(score([Path(word) for word in words])))
