"""A run ten times as long takes no more memory, and hardly more trace."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

_RUN = """
import json, resource, sys
import bench, optimizers, problems
run = bench.execute(problems.make("full12", error="J3"), optimizers.make(sys.argv[1]), budget=int(sys.argv[2]))
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps([run.status, run.evaluations, len(run.points), peak, run.row["cpu_s"]]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["de", "pso", "ga"])
def test_memory_and_trace_do_not_grow_with_the_budget(name):
    pytest.importorskip("resource")
    short, long = (
        json.loads(subprocess.check_output([sys.executable, "-c", _RUN, name, str(budget)]))
        for budget in (1_000_000, 10_000_000)
    )
    assert short[:2] == ["ok", 1_000_000]
    assert long[:2] == ["ok", 10_000_000]
    assert long[3] < 500  # MB, the interpreter and its libraries included
    assert long[3] < short[3] + 20
    assert long[2] < short[2] + 200  # 16 counts a decade, and an improvement by a tenth
