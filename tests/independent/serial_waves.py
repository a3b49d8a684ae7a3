"""Waves of unknown order on simulated arms: ``python -m tests.independent.serial_waves wave FIRST LAST out.jsonl``.

The arms of `serial`, whose teeth are not stated. `silence`: nothing is hidden. `wave`: an error of one joint that
repeats 12 to 59 times a turn, drawn by the seed, with an overtone of up to 15 %. Seeds and counts stand in
`serial_batches.json`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.machines.arm import Arm
from tests.independent import serial_cases, serial_faults

ORDERS = (12, 60)


def told(kind: str, seed: int) -> dict[str, Any]:
    """Return what was hidden in an arm, and what the search says of it."""
    order = int(np.random.default_rng(seed).integers(*ORDERS)) if kind == "wave" else serial_faults.TEETH
    before = serial_faults.TEETH
    serial_faults.TEETH = serial_cases.TEETH = order
    try:
        drawn = serial_cases.case(seed, **({"family": "teeth"} if kind == "wave" else {"kind": "none"}))  # type: ignore[arg-type]
    finally:
        serial_faults.TEETH = serial_cases.TEETH = before
    stated = {name: value for name, value in drawn.stated.items() if name != "teeth"}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(drawn.urdf)
        report = explain(Arm(str(path)), MeasuredData(drawn.columns, "arm", stated, f"arm{seed}"))
    return {
        "seed": seed, "poses": drawn.poses, "verdict": report.verdict,
        "hidden": [(fault.target, order, fault.visible) for fault in drawn.faults],
        "found": [[rival.effect for rival in finding.set] for finding in report.findings],
        "orders": [2 * np.pi / finding.period if finding.period else 0.0 for finding in report.findings],
    }  # fmt: skip


def main(kind: str, first: str, last: str, out: str) -> None:
    """Search the seeds that are asked for, a line each."""
    with Path(out).open("a") as file:
        for seed in range(int(first), int(last) + 1):
            print(json.dumps(told(kind, seed)), file=file, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
