"""An evaluation by our kernels: against C compiled on the spot, against NumPy, alone and in a batch.

`C` lets the compiler contract products and sums; `C, strict` does not. Ours contracts at stated places only, so that a
candidate has the same bits alone and in any lane of a batch.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.rounds import Contestant, interleave
from calibench import problems
from calibench.problems.base import Array
from calibench.problems.planar.closed_loop import Planar

_N = 150
_CALLS = 100
_FLAGS = ("-O3", "-march=native", "-mprefer-vector-width=512", "-fno-math-errno", "-shared", "-fPIC")


def rows() -> pd.DataFrame:
    """Return a row for each kernel and rival."""
    tables = []
    for error in ("J3", "J2", "J1"):
        problem = problems.make("full12", error=error)
        points = _points(problem, _N)
        rivals = _in_c(problem, points) if error == "J3" else {}
        ours = {"ours, batch": partial(_batch, problem, points), "NumPy": partial(_numpy, problem, points)}
        np.testing.assert_allclose(_in_numpy(problem, points), problem.batch(points), rtol=1e-9)
        tables.append(interleave(f"full12 {error}, {_N} candidates, 50 readings", rivals | ours, rounds=31))
    tables.append(_single("full12 J3, one at a time", problems.make("full12", error="J3")))
    for name in ("orthoglide6", "tracking_zero", "arm_ur10"):
        tables.append(_single(f"{name}, one at a time", problems.make(name)))
    return pd.concat(tables, ignore_index=True)


def _single(title: str, problem: Any) -> pd.DataFrame:
    """Time value, residuals and Jacobian of single points, and a batch, all called from Python."""
    problem.compile()
    x = _points(problem, 1)[0].copy()
    calls = {"value": problem, "residuals": problem.residuals, "Jacobian": problem.jacobian}
    points = _points(problem, _N)
    return interleave(
        title,
        {name: partial(_repeatedly, call, x) for name, call in calls.items()}
        | {f"one of a batch of {_N}": partial(_batch, problem, points)},
    )


def _points(problem: Any, count: int) -> Array:
    unit = np.random.default_rng(0).random((count, len(problem.lower)))
    return np.asarray(problem.lower + unit * (problem.upper - problem.lower))


def _batch(problem: Any, points: Array) -> int:
    problem.batch(points)
    return len(points)


def _repeatedly(call: Any, x: Array) -> int:
    for _ in range(_CALLS):
        call(x)
    return _CALLS


def _in_c(problem: Planar, points: Array) -> dict[str, Contestant]:
    """Return the C reference with and without contraction; nothing without a compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return {}
    found: dict[str, Contestant] = {}
    readings = problem.readings
    samples = np.stack([f(readings[:, i]) for i in range(3) for f in (np.cos, np.sin)], axis=1).copy()
    template, free, values = problem._template.copy(), problem._free.astype(ctypes.c_long), np.empty(len(points))
    for name, contract in (("C", "fast"), ("C, strict", "off")):
        with tempfile.TemporaryDirectory() as folder:
            library = Path(folder) / "reference.so"
            source = Path(__file__).with_name("reference.c")
            subprocess.run([compiler, *_FLAGS, f"-ffp-contract={contract}", source, "-o", library], check=True)
            function = ctypes.CDLL(str(library)).batch
        arrays = [ctypes.c_void_p(a.ctypes.data) for a in (points, samples, template, free, values)]
        at, rest = arrays[:2], arrays[2:]
        sizes = [ctypes.c_long(size) for size in (*points.shape, len(samples))]
        arguments = (at[0], sizes[0], sizes[1], at[1], sizes[2], *rest)
        kept = (points, samples, template, free, values)
        found[name] = partial(_call, function, arguments, kept)
        found[name]()
        np.testing.assert_allclose(values, problem.batch(points), rtol=1e-10)
    return found


def _call(function: Any, arguments: tuple[Any, ...], kept: tuple[Array, ...]) -> int:
    function(*arguments)
    return len(kept[0])


def _numpy(problem: Planar, points: Array) -> int:
    return len(_in_numpy(problem, points))


def _in_numpy(problem: Planar, points: Array) -> Array:
    """Evaluate all candidates at once by eqs. (30)-(39), each step an array operation over candidates and readings."""
    q = np.repeat(problem._template[:, None], len(points), axis=1)
    q[problem._free] = points.T
    theta = problem.readings.T[:, None, :]
    la, lb, z = (q[i : i + 3, :, None] for i in (6, 9, 12))
    if problem.error == "J3":
        c, s = np.cos(theta), np.sin(theta)
        bx, by = q[0:6:2, :, None] + la * c - z * s, q[1:6:2, :, None] + la * s + z * c
    else:
        bx, by = q[0:6:2, :, None] + la * np.cos(theta + z), q[1:6:2, :, None] + la * np.sin(theta + z)
    ux, uy, vx, vy = bx[1] - bx[0], by[1] - by[0], bx[2] - bx[0], by[2] - by[0]
    f = 0.5 * (ux**2 + uy**2 + lb[0] ** 2 - lb[1] ** 2)
    h = 0.5 * (vx**2 + vy**2 + lb[0] ** 2 - lb[2] ** 2)
    d = ux * vy - uy * vx
    g = ((f * vy - h * uy) ** 2 + (h * ux - f * vx) ** 2) / d**2 - lb[0] ** 2
    if problem.error == "J1":
        return sum((((np.sqrt(np.maximum(g + r**2, 0.0)) - r) ** 2).sum(axis=1) for r in lb), np.zeros(len(points)))
    return np.asarray(3.0 * (g**2).sum(axis=1))
