"""`bench report` of ten thousand runs: CPU time from the shell to the page, a fresh process.

Five problems, ten methods and 200 seeds make 50 cells; one problem with 100 drawn instances, ten methods and ten seeds
make 1000. The papers' study is `study=cong2008 budget=ci seeds=ci`: 28 figures, each as SVG and PNG, and the paper's
tables; the figures are 12 of some 19 s of CPU time, and two processes draw them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.rounds import COLUMNS

_METHODS = "optimizer=de,ga,pso,lm,trf,nlopt_LN_BOBYQA,nlopt_LN_SBPLX,nlopt_LN_NELDERMEAD,nlopt_GN_CRS2_LM,pygmo_cmaes"
_STUDIES = {
    "50 cells of 200 runs": ("problem=sensor_zero,link_length,full11,full12,tracking_zero", "seeds=200"),
    "1000 cells of 10 runs": ("problem=full12", "problem.instance=range(1,101)", "seeds=10"),
}
_PAPERS = ("study=cong2008", "budget=ci", "seeds=ci")
_ROUNDS = 3


def rows() -> pd.DataFrame:
    """Return a row for each shape of study, and one for the papers' study."""
    with tempfile.TemporaryDirectory() as folder:
        table = [_paper_row(folder)]
        for name, words in _STUDIES.items():
            study = name.replace(" ", "_")
            _cpu("run", "-m", *words, _METHODS, "budget=60", "start=random", f"study={study}", f"results={folder}")
            table.append(_row("bench report, 10000 runs", name, Path(folder) / study))
    made = pd.DataFrame(table, columns=list(COLUMNS))
    first = made.groupby("benchmark")["ns_per_evaluation"].transform("first")
    return made.assign(ratio=made["ns_per_evaluation"] / first)


def _paper_row(folder: str) -> tuple[Any, ...]:
    """Return the row of the papers' study, which is run first."""
    _cpu("run", *_PAPERS, "execution=processes", f"results={folder}")
    return _row("bench report, the papers' study", " ".join(_PAPERS), Path(folder) / "cong2008")


def _row(benchmark: str, name: str, place: Path) -> tuple[Any, ...]:
    """Return the row of a study that has been run, its report written `_ROUNDS` times."""
    times = pd.Series([_cpu("report", str(place)) for _ in range(_ROUNDS)]) * 1e9
    size = (place / "report.html").stat().st_size / 1e6
    low, middle, high = times.quantile([0.25, 0.5, 0.75])
    return (benchmark, f"{name}, {size:.2g} MB", middle, low, high, 1.0, _ROUNDS)


def _cpu(*words: str) -> float:
    """Return the CPU seconds of one command and its processes."""
    before = os.times()
    subprocess.run([sys.executable, "-m", "bench", *words], check=True, capture_output=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system
