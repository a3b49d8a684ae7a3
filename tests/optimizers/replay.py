"""Runs told bit for bit, here and in a process without compilation: what the laws of our own methods compare.

As a script: read cases as JSON, print what is asked of each as JSON.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from hashlib import blake2b
from pathlib import Path
from typing import Any

from calibench import bench, optimizers, problems

ROOT = Path(__file__).resolve().parents[2]
Case = tuple[str, dict[str, Any], int]  # optimiser, options, budget


class Recorder:
    """The 12-parameter problem, one of them held by a box without width; keeps a digest of all candidates in order."""

    name = "recorder"  # a seed follows from the name, and a module's name differs as a script

    def __init__(self) -> None:
        self._problem = problems.make("full12", error="J2")
        self.lower, self.upper, self.start = self._problem.lower.copy(), self._problem.upper.copy(), self._problem.start
        self.lower[3] = self.upper[3] = self.start[3]
        self.seen = blake2b(digest_size=16)

    def __call__(self, x):
        raise AssertionError("our own methods ask in batches")

    def batch(self, points):
        self.seen.update(points.tobytes())
        return self._problem.batch(points)

    def batch_below(self, points, limits):
        self.seen.update(points.tobytes() + limits.tobytes())
        return self._problem.batch_below(points, limits)


def story(name: str, options: dict[str, Any], budget: int) -> dict[str, Any]:
    """Return what a run asked for and what came of it."""
    problem = Recorder()
    run = bench.execute(problem, optimizers.make(name, **options), budget=budget, seed=3)
    assert run.row["status"] == "ok", run.row["error"]
    return {
        "candidates": problem.seen.hexdigest(),
        "evaluations": run.row["evaluations"],
        "trace": [list(point) for point in run.points],
        "best_x": run.row["best_x"],
    }


def compiled(case: Case) -> tuple[list[str], list[str]]:
    """Return what stands compiled of our methods before and after a run, as ``kernel(types)``."""
    from calibench.optimizers.own import _differential_kernels, _genetic_kernels, _random_kernels, _swarm_kernels

    rooms = (_differential_kernels, _genetic_kernels, _random_kernels, _swarm_kernels)

    def standing() -> list[str]:
        return sorted(
            {f"{n}{s}" for room in rooms for n, k in vars(room).items() for s in getattr(k, "signatures", ())}
        )

    name, options, _ = case
    optimizers.make(name, **options).compile()
    before = standing()
    story(*case)
    return before, standing()


def stories_without_compilation(cases: list[Case]) -> list[dict[str, Any]]:
    """Return the stories of these runs as told by the plain Python functions."""
    return _in_another_process("story", cases, {"NUMBA_DISABLE_JIT": "1"})


def compiled_before_and_after(case: Case) -> tuple[list[str], list[str]]:
    """Return what stands compiled before and after a run, in a process that has compiled nothing yet."""
    return _in_another_process("compiled", [case], {})[0]


def _in_another_process(what: str, cases: list[Case], environment: dict[str, str]) -> list[Any]:
    done = subprocess.run(
        [sys.executable, "-W", "error", __file__, what],
        input=json.dumps(cases),
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


if __name__ == "__main__":
    tell = {"story": lambda case: story(*case), "compiled": compiled}[sys.argv[1]]
    print(json.dumps([tell(case) for case in json.load(sys.stdin)]))
