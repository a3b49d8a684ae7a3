"""What the tables of reports and of reading are measured on: written once by each tool itself, and kept.

Reports are of 10 000 runs, reading is of 100 000; where a format's own suite sets the size, the nearest whole number of
its sweeps. MLflow's runs are written into its data base by SQL, as its own client takes hundredths of a second a run.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.asking import ToolError, once, surroundings
from benchmarks.peers.environments import Environment
from benchmarks.peers.tools.arms3 import NAMES

_METHODS = "optimizer=de,ga,pso,lm,trf,nlopt_LN_BOBYQA,nlopt_LN_SBPLX,nlopt_LN_NELDERMEAD,nlopt_GN_CRS2_LM,pygmo_cmaes"
_OURS = {
    "report": ("problem=sensor_zero,link_length,full11,full12,tracking_zero", _METHODS, "seeds=200"),
    "reading": ("problem=sensor_zero", "optimizer=de", "seeds=100000"),
}
_ALGORITHMS = {"report": 6, "reading": 56}  # of 1800 runs: 10 800 and 100 800


def prepared(table: str, lines: Mapping[str, Environment], folder: Path) -> dict[str, Any]:
    """Return what lines of this table are given: the folders of their own runs, made where they are not there."""
    if table == "arms":
        return {"arms": str(_made(folder / "arms", _arms))}
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


_ODD = {  # what gazebo, xacro and hand leave in files: before and after
    "unbound_prefix": ("</robot>", "<gazebo><sensor:camera/></gazebo></robot>"),
    "xacro_left": ("</robot>", "<xacro:arm prefix=''/></robot>"),
    "default_namespace": ("<robot ", "<robot xmlns='http://www.ros.org' "),
    "plugin_placeholder": ("</robot>", "<gazebo><plugin filename='${lib}'/></gazebo></robot>"),
    "fixed_without_axis": (
        "</robot>",
        "<link name='pan'/><joint name='bad' type='fixed'><axis xyz='0 0 0'/><parent link='base'/><child link='pan'/>"
        "</joint></robot>",
    ),
    "exchanged_limits": (
        "</robot>",
        "<link name='pan'/><joint name='bad' type='revolute'><axis xyz='0 0 1'/><parent link='base'/>"
        "<child link='pan'/><limit lower='1' upper='-1' effort='1' velocity='1'/></joint></robot>",
    ),
}


def _arms(place: Path) -> None:
    """Write three of the gate's arms: 120 poses, errors of .4 mm and mrad, zeros 2 mrad, noise .03 mm; seed 45."""
    from benchmarks.arms import honest

    for name in NAMES:
        chain = honest.chain_of(*next(entry for (_, called), entry in honest.ROBOTS.items() if called == name))
        rng = np.random.default_rng([45, NAMES.index(name)])
        small = rng.normal(size=(len(chain.axes), 7)) * 0.4 * np.array([1, 1, 1, 1e-3, 1e-3, 1e-3, 5e-3])
        tool = np.array([60.0, 20.0, 110.0])
        text = honest.urdf_of(replace(chain, flange=chain.flange @ honest.frame(tool)))
        (place / f"{name}.urdf").write_text(text)
        for what, poses, noise in (("seen", 120, 0.03), ("fresh", 300, 0.0)):
            q = rng.uniform(-chain.limits, chain.limits, (poses, len(chain.axes)))
            seen = honest.walk(honest.moved(chain, small), q, tool + np.array([2.0, -1.0, 3.0]))[0]
            rows = np.hstack([q, (seen + rng.normal(0, noise, seen.shape)) / 1000])
            heads = ",".join([*(f"j{k} [rad]" for k in range(1, len(chain.axes) + 1)), "x [m]", "y [m]", "z [m]"])
            np.savetxt(place / f"{name}_{what}.csv", rows, fmt="%.12g", delimiter=",", header=heads, comments="")
        if name == NAMES[0]:
            for odd, (before, after) in _ODD.items():
                (place / f"odd_{odd}.urdf").write_text(text.replace(before, after))
