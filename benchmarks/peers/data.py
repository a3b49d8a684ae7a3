"""What the tables of reports and of reading are measured on: written once by each tool itself, and kept.

Reports are of 10 000 runs, reading is of 100 000; where a format's own suite sets the size, the nearest whole number of
its sweeps. MLflow's runs are written into its data base by SQL, as its own client takes hundredths of a second a run.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.peers.asking import ToolError, once, surroundings
from benchmarks.peers.environments import Environment

_METHODS = "optimizer=de,ga,pso,lm,trf,nlopt_LN_BOBYQA,nlopt_LN_SBPLX,nlopt_LN_NELDERMEAD,nlopt_GN_CRS2_LM,pygmo_cmaes"
_OURS = {
    "report": ("problem=sensor_zero,link_length,full11,full12,tracking_zero", _METHODS, "seeds=200"),
    "reading": ("problem=sensor_zero", "optimizer=de", "seeds=100000"),
}
_ALGORITHMS = {"report": 6, "reading": 56}  # of 1800 runs: 10 800 and 100 800


def prepared(table: str, lines: Mapping[str, Environment], folder: Path) -> dict[str, Any]:
    """Return what lines of this table are given: the folders of their own runs, made where they are not there."""
    if table not in _OURS:
        return {}
    study = _made(folder / f"{table}_ours", lambda place: _our_study(table, place)) / "adhoc"
    work = {"study": str(study), "runs": 10_000 if table == "report" else 100_000}
    for tool in {tool.tool: tool for tool in lines.values() if not tool.error}.values():
        if tool.tool != "ours":
            try:
                made = str(_made(folder / f"{table}_{tool.tool}", lambda place, tool=tool: _theirs(table, tool, place)))
            except ToolError as error:  # its line fails then, and tells this
                made = f"its data could not be made: {error}"
            work[f"data_{tool.tool}"] = made
    return work


def _made(place: Path, make: Any) -> Path:
    """Return the folder, made by `make` in whole or not at all."""
    if not place.exists():
        part = place.with_name(f"{place.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        make(part)
        part.rename(place)
    return place


def _our_study(table: str, place: Path) -> None:
    words = ("run", "-m", *_OURS[table], "budget=60", "start=random", f"results={place}", "execution=processes")
    root = str(Path(__file__).resolve().parents[2])
    subprocess.run(
        [sys.executable, "-m", "bench", *words], check=True, stdout=subprocess.DEVNULL, cwd=root, env=surroundings()
    )


def _theirs(table: str, tool: Environment, place: Path) -> None:
    work = {"folder": str(place), "algorithms": _ALGORITHMS[table], "runs": 100_000, "budget": 60}
    once(tool, {"table": "prepare", "line": tool.tool, "work": work})
