"""`bench report` of ten thousand runs, first and again with nothing new: CPU time of a fresh process.

50 cells are five problems and ten methods, 1000 are 100 drawn instances of one problem and ten methods; two processes
draw.
"""

from __future__ import annotations

import os
import shutil
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
        table = _paper_rows(folder)
        for name, words in _STUDIES.items():
            study = name.replace(" ", "_")
            _cpu("run", "-m", *words, _METHODS, "budget=60", "start=random", f"study={study}", f"results={folder}")
            table += _rows("bench report, 10000 runs", name, Path(folder) / study)
    made = pd.DataFrame(table, columns=list(COLUMNS))
    first = made.groupby("benchmark")["ns_per_evaluation"].transform("first")
    return made.assign(ratio=made["ns_per_evaluation"] / first)


def _paper_rows(folder: str) -> list[tuple[Any, ...]]:
    """Return the rows of the papers' study, which is run first."""
    _cpu("run", *_PAPERS, "execution=processes", f"results={folder}")
    return _rows("bench report, the papers' study", " ".join(_PAPERS), Path(folder) / "cong2008")


def _rows(benchmark: str, name: str, place: Path) -> list[tuple[Any, ...]]:
    """Return the rows of a study that has been run: in each round a copy is reported first, and again."""
    times = []
    for _ in range(_ROUNDS):
        copy = shutil.copytree(place, place.with_name(f"{place.name}_again"))
        times.append([_cpu("report", str(copy)), _cpu("report", str(copy))])
        size = (copy / "report.html").stat().st_size / 1e6
        shutil.rmtree(copy)
    low, middle, high = (1e9 * pd.DataFrame(times)).quantile([0.25, 0.5, 0.75]).to_numpy()
    names = (f"{name}, {size:.2g} MB", f"{name}, nothing new")
    return [(benchmark, names[k], middle[k], low[k], high[k], 1.0, _ROUNDS) for k in (0, 1)]


def _cpu(*words: str) -> float:
    """Return the CPU seconds of one command and its processes."""
    before = os.times()
    subprocess.run([sys.executable, "-m", "bench", *words], check=True, capture_output=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system
