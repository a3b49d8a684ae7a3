"""A run ten times as long takes no more memory, and hardly more trace; of a run that is over nothing stays."""

from __future__ import annotations

import gc
import json
import subprocess
import sys
import weakref
from pathlib import Path

import numpy as np
import pytest

from calibench import bench, optimizers

_RUN = r"""
import json, re, sys
from calibench import bench, optimizers, problems
run = bench.execute(problems.make("full12", error="J3"), optimizers.make(sys.argv[1]), budget=int(sys.argv[2]))
peak = int(re.search(r"VmHWM:\s*(\d+)", open("/proc/self/status").read())[1]) / 1024  # rusage has the parent's too
print(json.dumps([run.status, run.evaluations, len(run.points), peak, run.row["cpu_s"]]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["de", "pso", "ga"])
def test_memory_and_trace_do_not_grow_with_the_budget(name):
    if not Path("/proc/self/status").exists():
        pytest.skip("the system tells no process its largest memory")
    short, long = (
        json.loads(subprocess.check_output([sys.executable, "-c", _RUN, name, str(budget)]))
        for budget in (1_000_000, 10_000_000)
    )
    assert short[:2] == ["ok", 1_000_000]
    assert long[:2] == ["ok", 10_000_000]
    assert long[3] < 500  # MB, the interpreter and its libraries included
    assert long[3] < short[3] + 20
    assert long[2] < short[2] + 200  # 16 counts a decade, and an improvement by a tenth


class Bowl:
    def __init__(self):
        self.lower, self.upper, self.start = np.full(2, -1.0), np.full(2, 2.0), np.full(2, 0.5)

    def __call__(self, x):
        return float(x @ x)

    def residuals(self, x):
        return x

    def jacobian(self, x):
        return np.eye(2)


def test_a_library_keeps_nothing_of_a_run_that_is_over():
    """What keeps the last run only is seen at its last method."""
    kept = {}
    for name in optimizers.names():
        problem = Bowl()
        kept[name] = weakref.ref(problem)
        assert bench.execute(problem, optimizers.make(name), budget=60).status == "ok"
    del problem
    gc.collect()
    assert [name for name, alive in kept.items() if alive() is not None] == []
