"""Formulas beside those of other tools, on the same cases.

`python -m benchmarks.formulas.against export FIRST COUNT FOLDER` writes each case whose cause the grammar can write and
that no name explains: what was met, and the error of the right quantity that each reading implies, with its weight, so
that the others are told what errs. `PYTHON benchmarks/formulas/rivals.py TOOL FOLDER` runs a tool in an environment of
its own. `python -m benchmarks.formulas.against table FOLDER` calibrates again beside what each predicts, to first
order, and prints what is removed of the excess on held-out rows.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.formulas.__main__ import _unseen
from benchmarks.formulas.machines import MACHINES, case
from calibench import discrepancy
from calibench.discrepancy import MeasuredData, procedure
from calibench.discrepancy.diagnostics.smooth_term import smooth_columns
from calibench.discrepancy.fitting.fit import Fit, linearise, readings_of
from calibench.discrepancy.formula.search import _Search
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise

TOOLS = ("sysidentpy", "pysindy", "adcd")


def export(first: int, count: int, folder: Path) -> None:
    """Write the cases of some seeds, a file each."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "seeds.json").write_text(json.dumps({"seeds": [first, first + count - 1]}))
    for seed in range(first, first + count):
        machine = MACHINES[seed % 3]
        made, held = case(machine, seed), {}
        if not made.truth or made.visible < 1 or (folder / f"{seed}.npz").exists():
            continue
        real = procedure.with_formula

        def watched(
            ground: Fit, smooth: Fit, free: Any, whole: Any, at: int, held: Any = held, real: Any = real
        ) -> Any:
            final, formula = real(ground, smooth, free, whole, at)
            held.update(ground=ground, smooth=smooth, final=final, whole=whole)
            return final, formula

        procedure.with_formula = watched
        try:
            report = discrepancy.explain(machine, MeasuredData(made.columns, machine, made.metadata, str(seed)))
        finally:
            procedure.with_formula = real
        if report.verdict == "unknown" and made.truth[0] in held["ground"].at.slopes:
            np.savez(folder / f"{seed}.npz", **_written(held, made.truth[0], report))


def _written(held: dict[str, Any], quantity: str, report: Any) -> dict[str, Any]:
    ground, whole = held["ground"], held["whole"]
    names = list(_Search(ground, whole).columns)
    numbers = {k: _unseen(held[k], ground, whole) for k in ("ground", "smooth", "final")}
    found: dict[str, Any] = {"names": names, "floor": report.gap.noise_floor, "quantity": quantity, **numbers}
    hold = np.asarray(whole.data["split"]) == "hold"
    for part, rows in (("train", ~hold), ("hold", hold)):
        there = whole.on(whole.data.rows(rows))
        there = there.on(there.data.with_columns(smooth_columns(there, ground.x)))
        readings = readings_of(Model(there, ground.model.effects))
        at = linearise(Model(there, ground.model.effects), Noise(), ground.x, readings, readings)
        n, c = at.misclosure.shape
        r, S = at.whiten(at.misclosure).reshape(n, c), at.whiten(at.slopes[quantity]).reshape(n, c)
        weight = (S**2).sum(axis=1)
        q = at.recorded
        found |= {
            f"{part}_r": r, f"{part}_S": S, f"{part}_J": at.whiten(at.columns).reshape(n, c, -1),
            f"{part}_e": -(S * r).sum(axis=1) / np.maximum(weight, 1e-300), f"{part}_w": weight,
            f"{part}_X": np.stack([np.asarray(q[k] if k in q else there.data[k], float).real for k in names], axis=-1),
        }  # fmt: skip
    return found


def table(folder: Path) -> str:
    """Return the rates of ours and of each tool that answered."""
    gone: dict[str, list[float]] = {}
    worse: dict[str, int] = {}
    seconds: dict[str, list[float]] = {}
    for path in sorted(folder.glob("*.npz")):
        if "_" in path.stem:
            continue
        d = np.load(path)
        floor, before = float(d["floor"]), float(d["ground"])
        left = {"smooth functions": float(d["smooth"]), "formula (ours)": float(d["final"])}
        for tool in TOOLS:
            answer = folder / f"{path.stem}_{tool}.npz"
            if answer.exists():
                told = np.load(answer)
                left[tool] = _left(d, told["train"], told["hold"]) if "train" in told else before
                seconds.setdefault(tool, []).append(float(told["seconds"]))
        for name, after in left.items():
            part = 1 - max(after**2 - floor**2, 0) / max(before**2 - floor**2, 1e-12)
            gone.setdefault(name, []).append(part)
            worse[name] = worse.get(name, 0) + (after > 1.02 * float(d["smooth"]))
    lines = ["| tool | cases | removed, median | removed, lower quarter | worse than smooth by 2 % | s a case |",
             "| --- | --- | --- | --- | --- | --- |"]  # fmt: skip
    for name, parts in gone.items():
        took = f"{np.median(seconds[name]):.1f}" if name in seconds else ""
        lines.append(f"| {name} | {len(parts)} | {np.median(parts):.2f} | {np.quantile(parts, 0.25):.2f} "
                     f"| {worse[name]} | {took} |")  # fmt: skip
    return "\n".join(lines)


def _left(d: Any, train: Any, hold: Any) -> float:
    """Return the rms on held-out rows beside predicted errors, the parameters fitted again to first order."""
    r = d["train_r"] + d["train_S"] * np.nan_to_num(train)[:, None]
    J = d["train_J"].reshape(r.size, -1)
    size = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    step = np.linalg.lstsq(J / size, -r.ravel(), rcond=1e-11)[0] / size
    out = d["hold_r"] + d["hold_S"] * np.nan_to_num(hold)[:, None]
    return float(np.sqrt(np.mean((out.ravel() + d["hold_J"].reshape(out.size, -1) @ step) ** 2)))


if __name__ == "__main__":
    if sys.argv[1] == "export":
        export(int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
    else:
        print(table(Path(sys.argv[2])))
