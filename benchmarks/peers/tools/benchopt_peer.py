"""benchopt: a folder of an objective, a data set and solvers; its command runs, keeps and draws them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from answering import answer

_OBJECTIVE = """
from benchopt import BaseObjective
class Objective(BaseObjective):
    name = "sphere"
    def set_data(self, target): self.target = target
    def evaluate_result(self, x): return {"value": float(((x - self.target) ** 2).sum())}
    def get_one_result(self): return {"x": __import__("numpy").zeros(5)}
    def get_objective(self): return {"target": self.target}
"""
_DATA = """
from benchopt import BaseDataset
class Dataset(BaseDataset):
    name = "own"
    def get_data(self): return {"target": 0.3}
"""
_SOLVER = """
from benchopt import BaseSolver
import numpy as np
class Solver(BaseSolver):
    name = "random"
    sampling_strategy = "run_once"
    parameters = {"start": list(range(RUNS))}
    def set_objective(self, target): self.target = target
    def run(self, _):
        rng = np.random.default_rng(self.start)
        points = [rng.uniform(-5, 5, 5) for _ in range(BUDGET)]
        self.best = min(points, key=lambda x: float(((x - self.target) ** 2).sum()))
    def get_result(self): return {"x": self.best}
"""


def _run(work: Mapping[str, Any], runs: int, *words: str) -> Path:
    place = Path(work["folder"]) / "own"
    for folder in ("datasets", "solvers"):
        (place / folder).mkdir(parents=True)
    (place / "objective.py").write_text(_OBJECTIVE)
    (place / "datasets" / "own.py").write_text(_DATA)
    solver = _SOLVER.replace("RUNS", str(runs)).replace("BUDGET", str(work["budget"]))
    (place / "solvers" / "random.py").write_text(solver)
    command = [sys.executable, "-m", "benchopt", "run", str(place), "-r", "1", "--no-display", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode or not list(place.rglob("*.parquet")):
        raise RuntimeError(f"benchopt run: {' '.join((done.stderr or done.stdout).split()[-25:])}")
    return place


def _sweep(work: Mapping[str, Any]) -> dict[str, Any]:
    """Carry out a tenth of the runs."""
    import pandas as pd

    place = _run(work, work["runs"] // 10, "--no-html", "--no-plot")
    table = pd.concat([pd.read_parquet(path) for path in place.rglob("*.parquet")])
    print(table.describe())
    return {"count": len(table), "note": f"{len(table)} runs, start of the process included"}


def _plot(work: Mapping[str, Any]) -> dict[str, Any]:
    place = _run(work, 5)
    return {"note": f"1 method, 5 seeds, {len(list(place.rglob('*.html')))} pages"}


LINES: dict[str, dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {
    "sweep": {"benchopt": _sweep},
    "plot": {"benchopt": _plot},
}

if __name__ == "__main__":
    answer(LINES)
