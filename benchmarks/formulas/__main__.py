"""`python -m benchmarks.formulas FIRST COUNT OUT.jsonl [sound]`: rates of formulas, a line a case, to be continued.

The first line states seeds and sizes before anything is drawn. Of a case whose verdict is unknown or partly it says
what the smooth functions and the formula remove of the excess on rows that were held out, and whether the formula is
the true one. `python -m benchmarks.formulas table OUT.jsonl ...` prints the rates.
"""

from __future__ import annotations

import json
import re
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.formulas.machines import MACHINES, case
from calibench import discrepancy
from calibench.discrepancy import MeasuredData, procedure
from calibench.discrepancy.diagnostics.smooth_term import smooth_columns
from calibench.discrepancy.fitting.fit import Fit, predicted
from calibench.discrepancy.noise.whiten import Noise


def _unseen(at: Fit, base: Fit, whole: Any) -> float:
    rows = whole.on(whole.data.rows(np.asarray(whole.data["split"]) == "hold"))
    rows = rows.on(rows.data.with_columns(smooth_columns(rows, base.x[: len(rows.parameters)])))
    return float(np.sqrt(np.mean(predicted(at.model, at.x, rows.data, Noise()) ** 2)))


def measure(machine: str, seed: int, sound: bool) -> dict[str, Any]:
    """Return what became of one case."""
    made = case(machine, seed, sound=sound)
    seen: dict[str, Any] = {}
    real = procedure.with_formula

    def watched(ground: Fit, smooth: Fit, free: Any, whole: Any, seed: int) -> Any:
        began = time.process_time()
        final, formula = real(ground, smooth, free, whole, seed)
        seen.update(smooth=_unseen(smooth, ground, whole), after=_unseen(final, ground, whole),
                    ground=_unseen(ground, ground, whole), formula_s=time.process_time() - began)  # fmt: skip
        return final, formula

    procedure.with_formula = watched
    try:
        data = MeasuredData(made.columns, machine, made.metadata, f"{machine}_{seed}")
        report = discrepancy.explain(machine, data)
    finally:
        procedure.with_formula = real
    told: dict[str, Any] = {
        "machine": machine, "seed": seed, "cause": made.cause, "visible": made.visible, "truth": made.truth,
        "verdict": report.verdict, "findings": [f.effect for f in report.findings], "floor": report.gap.noise_floor,
        "before": report.gap.held_out_before, "seconds": report.seconds, **seen,
    }  # fmt: skip
    if (formula := report.formula) is not None:
        told |= {"text": formula.text, "structure": formula.structure, "beside": formula.smooth_beside,
                 "share": formula.share, "sizes": [(a.value, a.ci95) for a in formula.intervals],
                 "rivals": [r.text for r in formula.rivals]}  # fmt: skip
    return told


def run(first: int, count: int, out: Path, sound: bool) -> None:
    """Measure the cases that a file has not, and add a line for each."""
    out.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []
    with out.open("a") as file:
        if not lines:
            file.write(json.dumps({"seeds": [first, first + count - 1], "machines": MACHINES, "sound": sound}) + "\n")
        done = {(line["machine"], line["seed"]) for line in lines[1:]}
        for seed in range(first, first + count):
            machine = MACHINES[seed % 3]
            if (machine, seed) not in done:
                try:
                    told = measure(machine, seed, sound)
                except Exception as error:
                    told = {"machine": machine, "seed": seed, "error": f"{type(error).__name__}: {error}"}
                file.write(json.dumps(told) + "\n")
                file.flush()


def table(paths: list[Path]) -> str:
    """Return the rates of some files."""
    lines = [json.loads(line) for path in paths for line in path.read_text().splitlines()[1:]]
    errors = [line for line in lines if "error" in line]
    lines = [line for line in lines if "error" not in line]
    count = {v: sum(line["verdict"] == v for line in lines) for v in sorted({line["verdict"] for line in lines})}
    said = [f"{len(lines)} cases, {len(errors)} errors; verdicts {count}"]
    told = [line for line in lines if "text" in line]
    said.append(f"formulas {len(told)}, of them with smooth functions {sum(line['beside'] for line in told)}")
    for name, some in (("unknown", [x for x in lines if x["verdict"] == "unknown"]),
                       ("partly", [x for x in lines if x["verdict"] == "partly"])):  # fmt: skip
        some = [x for x in some if "smooth" in x and x["before"] > 1.1 * x["floor"]]
        for group, own in (("all", some), ("writable", [x for x in some if x["truth"]]),
                           ("other forms", [x for x in some if not x["truth"]])):  # fmt: skip
            if not own:
                continue
            gone = {k: np.array([1 - max(x[k] ** 2 - x["floor"] ** 2, 0) / (x["before"] ** 2 - x["floor"] ** 2)
                                 for x in own]) for k in ("smooth", "after")}  # fmt: skip
            worse = sum(x["after"] > 1.02 * x["smooth"] for x in own)
            said.append(
                f"{name}, {group}: {len(own)}; removed on held-out rows, median: before "
                f"{np.median(gone['smooth']):.2f}, now {np.median(gone['after']):.2f}; worse by 2 %: {worse}"
            )
    for least in (0.0, 2.0):
        own = [x for x in lines if x["truth"] and x["visible"] >= least and x["verdict"] in ("unknown", "partly")]
        right = [x for x in own if tuple(x["truth"]) in {tuple(t) for t in x.get("structure", ())}]
        phased = [x for x in own if _any_phase(x["truth"]) in {_any_phase(t) for t in x.get("structure", ())}]
        parts = [x for x in own if _parts(x["truth"]) in {_parts(t) for t in x.get("structure", ())}]
        if own:
            said.append(f"visible >= {least:g}: {len(own)} writable; structure right {len(phased)}, with the phase of "
                        f"waves right {len(right)}, quantity and columns right {len(parts)}")  # fmt: skip
    said += [f"error {x['machine']} {x['seed']}: {x['error']}" for x in errors]
    return "\n".join(said)


def _any_phase(term: list[str]) -> tuple[str, ...]:
    """Return a term whose waves have any phase: that of an angle hangs on the zero of its encoder, which is unknown."""
    return tuple(re.sub("^(sin|cos|wave) ", "wave ", factor) for factor in term)


def _parts(term: list[str]) -> tuple[str, ...]:
    return (term[0], *(factor.rpartition(" ")[2] for factor in term[1:]))


if __name__ == "__main__":
    if sys.argv[1] == "table":
        print(table([Path(name) for name in sys.argv[2:]]))
    else:
        run(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]), "sound" in sys.argv[4:])
