"""A run ten times as long takes no more memory, and hardly more trace."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

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
