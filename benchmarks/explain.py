"""A hundred thousand readings explained, a fresh process each.

CPU time and largest memory of `explain` on one sealed file of 25 000 poses read four times, with a tracker's x, y, and
on as many readings of other machines; a file counts as one evaluation. An arm has ten errors.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from benchmarks.rounds import COLUMNS

if TYPE_CHECKING:
    from calibench.discrepancy import Machine, MeasuredData

_SEED, _POSES = 6, 25_000
_CASES = {
    "nothing missing": {"kind": "none", "noise": "gauss"},
    "compliance": {"kind": "one", "family": "compliance", "lam": 1.5, "noise": "gauss"},
    "compliance, heavy tails": {"kind": "one", "family": "compliance", "lam": 1.5, "noise": "t3"},
    "compliance, carried noise": {"kind": "one", "family": "compliance", "lam": 1.5, "noise": "ar1"},
    "two effects": {"kind": "two", "noise": "gauss"},
    "of no catalogue": {"kind": "outside", "noise": "gauss"},
}
_OTHERS = {name: {"machine": name} for name in ("mount", "orthoglide", "table", "simulator")}
_ARMS = {f"an arm, {n} poses, ten errors": {"arm": n} for n in (3000, 12_000)}


def rows() -> pd.DataFrame:
    """Return the rows of each kind of case; `ratio` is to the one that misses nothing."""
    lines, nan = [], float("nan")
    titles = "explain, 100 000 readings", "explain, 100 000 readings of other machines", "explain"
    for title, cases in zip(titles, (_CASES, _OTHERS, _ARMS)):
        told = {name: _measured(wanted) for name, wanted in cases.items()}
        first = next(iter(told.values()))[0]
        lines += [
            (title, f"{name}, {gigabytes:.2f} GB", 1e9 * seconds, nan, nan, seconds / first, 1)
            for name, (seconds, gigabytes) in told.items()
        ]
    return pd.DataFrame(lines, columns=list(COLUMNS))


def _measured(wanted: dict[str, object]) -> tuple[float, float]:
    """Return CPU seconds and gigabytes, told by a process of its own with one thread."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.explain", json.dumps(wanted)],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    seconds, gigabytes = json.loads(done.stdout)
    return float(seconds), float(gigabytes)


def _explain(wanted: dict[str, object]) -> None:
    """Print what one case takes: of the CPU the explanation alone, of the memory the largest of the process."""

    from calibench.discrepancy import explain

    if "machine" in wanted:
        asked = _machine(str(wanted["machine"]))
    else:
        asked = _arm(int(str(wanted["arm"]))) if "arm" in wanted else _sealed(wanted)
    report = explain(*asked)
    print(json.dumps([report.seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6]))


def _sealed(wanted: dict[str, object]) -> tuple[str, MeasuredData]:
    from benchmarks.blind.gpm2002.simulate import case
    from calibench.discrepancy import MeasuredData

    sealed = case(_SEED, xy=True, poses=_POSES, **wanted)  # type: ignore[arg-type]
    return "gpm2002", MeasuredData(sealed.columns, "gpm2002", sealed.metadata, "many")


def _machine(name: str) -> tuple[Machine | str, MeasuredData]:
    """Return 100 000 readings: a shipped night, or a plan, again and again with fresh noise; a line; a spring."""
    from benchmarks.blind.orthoglide import case
    from calibench.bench.measured.sources import sources
    from calibench.discrepancy import MeasuredData, machines
    from calibench.discrepancy.machines.table import Table

    n, rng = 4 * _POSES, np.random.default_rng(_SEED)
    if name in ("mount", "orthoglide"):
        one = sources("demo_flexure", "mount")[0].read({}) if name == "mount" else case(1, "backlash")
        rows = len(next(iter(one.columns.values())))
        again = np.repeat(np.arange(-(-n // rows)), rows)
        columns = {c: np.tile(np.asarray(v), again[-1] + 1) for c, v in one.columns.items()}
        for c in {"t_s", "zero_t_s"} & {*columns}:
            columns[c] = columns[c] + again * 2 * np.ptp(columns[c])
        if name == "orthoglide":
            columns["repeat"] = columns["repeat"] + again * (columns["repeat"].max() + 1)
        for c in {"deviation", "star_ha", "star_dec"} & {*columns}:
            columns[c] = columns[c] + rng.normal(0, 3e-3 if c == "deviation" else 1e-5, len(again))
        return name, MeasuredData(columns, name, dict(one.metadata), "many")
    u, v = rng.uniform(-1, 1, (2, n))
    t, warm = 2.0 * np.arange(n), rng.uniform(10, 30, n)
    if name == "table":
        y = 0.3 + 1.2 * u + 0.04 * v**3 + 0.02 * np.sin(2 * np.pi * t / 9000) + 0.002 * (warm - 20)
        columns = {"u": u, "v": v, "t_s": t, "warm": warm, "y": y + 0.05 * rng.standard_normal(n)}
        return Table(model="line", inputs=("u",), sigma=0.05), MeasuredData(columns, "table", {}, "many")
    box, t = rng.integers(0, 2, n), rng.uniform(0.05, 0.6, n)
    y = spring({"a": u, "b": v, "t": t}, {"k": 92.0, "c": 6.0, "m": 1 + 0.08 * box})["y"]
    columns = {"a": u, "b": v, "t": t, "box": 1.0 * box, "y": y + 1e-3 * rng.standard_normal(n)}
    call = machines.make("simulator", call=f"{__file__}:spring", workers=1)
    return call, MeasuredData(columns, "simulator", {}, "many")


INPUTS = ("a", "b", "t")
PARAMETERS = {"k": (100.0, 50.0, 200.0), "c": (5.0, 1.0, 20.0), "m": 1.0}
OUTPUTS = {"y": 1e-3}


def spring(inputs: dict[str, Any], parameters: dict[str, Any]) -> dict[str, Any]:
    """Return where a damped spring has pulled a mass from a towards b after the time t."""
    x, w, h = inputs["a"].copy(), 0.0 * inputs["a"], inputs["t"] / 60
    for _ in range(60):
        w = w + h * (parameters["k"] * (inputs["b"] - x) - parameters["c"] * w) / parameters["m"]
        x = x + h * w
    return {"y": x}


def _arm(poses: int) -> tuple[Machine, MeasuredData]:
    """Return a UR10 seen by a tracker: each joint has an error of its encoder, some have a wave, play, or a drift."""
    from calibench.calibration.kinematics import forward
    from calibench.calibration.urdf import read_urdf
    from calibench.discrepancy import MeasuredData
    from calibench.discrepancy.machines.arm import Arm
    from calibench.problems.arm.families import shipped

    urdf, rng = str(shipped("ur10.urdf")), np.random.default_rng(_SEED)
    chain, run = read_urdf(urdf).chain(), np.linspace(0, 1, poses)
    q = rng.uniform(-1.8, 1.8, (poses, 6))
    wrong = 2e-4 * np.cos(q + np.arange(6)) * [1, 1, 1, 2, 2, 4]
    wrong[:, 0] += 8e-5 * np.cos(21 * q[:, 0])
    wrong[:, 1] += 8e-5 * np.cos(33 * q[:, 1])
    wrong[:, 2] += 1e-4 * np.sign(np.diff(q[:, 2], prepend=0.0))
    wrong[:, 3] += 4e-4 * run
    place = forward(chain, {}, q + wrong)[:, :3, 3] + rng.normal(0, 0.05, (poses, 3))
    columns = dict(zip(chain.driven, q.T, strict=True)) | dict(zip("xyz", place.T, strict=True))
    split = np.where(np.arange(poses) % 5 == 0, "hold", "train")
    data = MeasuredData({**columns, "t_s": 20.0 * np.arange(poses), "split": split}, "arm", {}, "arm")
    return Arm(urdf), data


if __name__ == "__main__":
    _explain(json.loads(sys.argv[1]))
