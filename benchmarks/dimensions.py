"""``python -m benchmarks.dimensions [NAME ...] [--dimensions 1000 2000] [--seconds 20]``: the most that methods bear.

Each method runs in a child of its own on a sphere with residuals, with a budget for its first sample and some steps,
for so many seconds at most, under glibc's checking allocator, which ends a process that wrote beyond what it was given.
A line a method tells how its child ended, its evaluations, its memory and its time. It passes where it did not
fail and took less than a gigabyte; to be slow is no failure. Where it does not, the most dimensions that pass are found
by halving; that number, rounded down, is the trait `maximum_dimension`.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
from typing import Any

import numpy as np

_ALLOCATOR = {"LD_PRELOAD": "libc_malloc_debug.so.0", "MALLOC_CHECK_": "3", "MALLOC_PERTURB_": "165"}
_STEPS = 2, 6  # passes for each dimension beyond the first sample: arrays of some libraries are as long as the budget
_MOST_BYTES = 1 << 30  # of a method's own, above what the process has before it


class Sphere:
    """Residuals x - 0.3 in a box: no method has much to do, each has to begin."""

    def __init__(self, dimension: int) -> None:
        self.lower, self.upper, self.start = np.full(dimension, -1.0), np.full(dimension, 2.0), np.zeros(dimension)

    def residuals(self, x: Any) -> Any:
        """Return one residual a parameter."""
        return x - 0.3

    def jacobian(self, x: Any) -> Any:
        """Return the derivative of the residuals."""
        return np.eye(len(x))

    def __call__(self, x: Any) -> float:
        """Return the sum of squares."""
        return float((x - 0.3) @ (x - 0.3))


def run_one(name: str, dimension: int, limit: float) -> None:
    """Run a method here, and print how it went."""
    from calibench import optimizers
    from calibench.bench.execution.run import execute

    method, problem = optimizers.make(name), Sphere(dimension)
    first = method.traits.minimum_budget + method.traits.minimum_budget_per_dimension * dimension
    before, begun, seconds = _peak(), True, 0.0
    for steps in _STEPS:
        run = execute(problem, method, budget=first + steps * dimension + 2, time_limit=limit)
        begun &= run.status != "failed"
        seconds += run.row["wall_s"]
    mib = max(_peak() - before, 0) >> 20
    told = f"{run.evaluations} evaluations, {mib} MiB, {seconds:.1f} s, {run.stop_reason} {run.error_type}"
    print("ok" if begun and mib << 20 < _MOST_BYTES else "fails", told, run.error[:80])


def _peak() -> int:
    return max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) << 10


def passes(name: str, dimension: int, seconds: float) -> bool:
    """Tell whether a method runs in that many dimensions, in a child; print a line of it."""
    command = [sys.executable, "-m", "benchmarks.dimensions", "--here", str(dimension), "--seconds", str(seconds), name]
    try:
        child = subprocess.run(
            command, env=os.environ | _ALLOCATOR, capture_output=True, text=True, timeout=9 * seconds, check=False
        )
        lines = (child.stdout if child.returncode == 0 else child.stderr).strip().splitlines() or [""]
        told = lines[-1] if child.returncode == 0 else f"fails with code {child.returncode}: {lines[-1][:100]}"
    except subprocess.TimeoutExpired:
        told = f"ok, but for its time: not done in {9 * seconds:g} s"
    print(f"{name:34s}{dimension:6d}  {told}", flush=True)
    return told.startswith("ok")


def main() -> None:
    """Survey the methods that are named, or all."""
    from calibench import optimizers

    parser = argparse.ArgumentParser(prog="benchmarks.dimensions")
    parser.add_argument("names", nargs="*")
    parser.add_argument("--dimensions", type=int, nargs="+", default=[1000, 2000])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--here", type=int)
    asked = parser.parse_args()
    if asked.here:
        run_one(asked.names[0], asked.here, asked.seconds)
        return
    for name in asked.names or optimizers.names():
        most = optimizers.make(name).traits.maximum_dimension
        good, bad = 2, 0
        for dimension in asked.dimensions if most is None else [max(most // 2, 2), most]:
            if not passes(name, dimension, asked.seconds):
                bad = dimension
                break
            good = dimension
        while bad and bad - good > max(good // 50, 1):
            middle = (good + bad) // 2
            good, bad = (middle, bad) if passes(name, middle, asked.seconds) else (good, middle)
        if bad:
            print(f"{name:34s}at most {good}", flush=True)


if __name__ == "__main__":
    main()
