"""Prepare sealed cases for the rivals, and take our own verdict on each: ``python -m benchmarks.peers.export``.

What a rival gets of a case: whitened residuals of the calibrated model without effects, in sigma, on the rows for
fitting and on the held-out rows; the trace of every candidate of the catalogue in them, projected off the calibration
parameters as the fitting rows see them; and all covariates.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calibench.bench.measured.files import read_measured
from calibench.discrepancy import explain
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import Fit, linearise, readings_of
from calibench.discrepancy.model.effect import Effect, name_of
from calibench.discrepancy.model.measured import PLACE, MeasuredData
from calibench.discrepancy.model.model import Model, signature
from calibench.discrepancy.report import Report
from calibench.problems.base import Array

_NOT_COVARIATES = {"pose_id", "visit_id", "repeat", "valid", "split", PLACE}


def main() -> None:
    """Export every case of a folder."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers.export", description=__doc__)
    parser.add_argument("cases", type=Path, help="folder of measured files")
    parser.add_argument("--to", type=Path, required=True, help="folder for the .npz files and ours.jsonl")
    asked = parser.parse_args()
    asked.to.mkdir(parents=True, exist_ok=True)
    with (asked.to / "ours.jsonl").open("w") as out:
        for path in sorted(asked.cases.glob("*.parquet")):
            data = read_measured(path, "gpm2002")
            began = time.process_time()
            report = explain("gpm2002", data)
            seconds = time.process_time() - began
            held = _held_out(data)
            case = export(report, held)
            np.savez(asked.to / f"{path.stem}.npz", **case)
            after = report.model.predict(held) / report.before.fit.noise.scale
            row = {
                "case": path.stem,
                "method": "this package",
                "mean_square_before": float(np.mean(case["residual_hold"] ** 2)),
                "mean_square_after": float(np.mean(after**2)),
                "named": [f.effect for f in report.findings],
                "verdict": report.verdict,
                "cpu_s": seconds,
            }
            print(json.dumps(row), file=out, flush=True)


def export(report: Report, held: MeasuredData) -> dict[str, Any]:
    """Return the arrays that a rival gets of a case whose held-out rows are `held`."""
    base = report.before.fit
    formulation = base.model.formulation
    candidates = catalogue(formulation).candidates
    candidates = [e for e in candidates if e.positions == 1] + _every(5, [e for e in candidates if e.positions > 1])
    names = sorted(name for name in held.columns if name not in _NOT_COVARIATES and held[name].dtype.kind in "fi")
    known = _arrays(base, candidates, formulation.data, names)
    unseen = _arrays(base, candidates, held, names)
    taken_up = np.linalg.pinv(known["J"]) @ known["columns"]
    case = {key: known[key] for key in ("residual", "features", "output", "pose")}
    case |= {f"{key}_hold": unseen[key] for key in ("residual", "features", "output")}
    return case | {
        "columns": known["columns"] - known["J"] @ taken_up,
        "columns_hold": unseen["columns"] - unseen["J"] @ taken_up,
        "effect": np.array([name_of(e) for e in candidates for _ in e.coefficients]),
    }


def _every(k: int, steps: Sequence[Effect]) -> list[Effect]:
    """Return every k-th place of each step: a finer scan is so collinear that regression over all of it fails."""
    counts: dict[str, int] = {}
    kept = []
    for effect in steps:
        place = counts.get(name_of(effect), 0)
        counts[name_of(effect)] = place + 1
        if place % k == k // 2:
            kept.append(effect)
    return kept


def _arrays(base: Fit, candidates: Sequence[Effect], data: MeasuredData, names: Sequence[str]) -> dict[str, Array]:
    """Return residuals (m,), Jacobian (m, p), candidate columns (m, k) and covariates (m, f) of rows of `data`."""
    formulation = base.model.formulation.on(data)
    model = Model(formulation)
    readings = readings_of(model)
    at = linearise(model, replace(base.noise, extra={}), base.x, readings, readings)
    scale, c = base.noise.scale, at.misclosure.shape[1]
    nothing = [np.zeros(len(e.coefficients)) for e in candidates]
    traces = [signature(e, zero, at.recorded, at.slopes, formulation) for e, zero in zip(candidates, nothing)]
    return {
        "residual": at.whiten(at.misclosure) / scale,
        "J": at.whiten(at.columns) / scale,
        "columns": at.whiten(np.concatenate(traces, axis=2)) / scale,
        "features": np.repeat(np.stack([np.asarray(data[name], dtype=float) for name in names], axis=1), c, axis=0),
        "output": np.tile(np.arange(c), len(data)),
        "pose": np.repeat(np.asarray(data["pose_id"]), c),
    }


def _held_out(data: MeasuredData) -> MeasuredData:
    rows = data.rows(np.asarray(data["split"]) == "hold")
    return rows.rows(np.asarray(rows["valid"], dtype=bool)) if rows.has("valid") else rows


if __name__ == "__main__":
    main()
