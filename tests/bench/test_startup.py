"""A tiny run loads what it needs, and what all its processes need is loaded once."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from calibench.bench.sweep.request import read_request

ROOT = Path(__file__).resolve().parents[2]
RUN = """
import json, sys
from calibench.bench.cli import main
from calibench.bench.sweep import carry_out, costs
carry_out.CAN_FORK = costs.CAN_FORK = sys.argv.pop(1) == "fork"
try:
    main()
except SystemExit as ended:
    kernels = [k for k, v in vars(sys.modules["calibench.problems.planar.compiled._closed_loop_kernels"]).items()
               if getattr(v, "signatures", None)]
    print(json.dumps([ended.code, sorted(sys.modules), kernels]), file=sys.stderr)
"""
SPARED = {
    "hydra", "omegaconf", "antlr4",
    "matplotlib", "pygmo", "nlopt", "joblib", "rich", "jinja2", "jsonschema", "scipy.stats", "pyarrow.dataset",
    "calibench.discrepancy", "calibench.bench.report", "calibench.bench.papers", "calibench.bench.sweep.tuner",
    "calibench.bench.statistics.choosing",
}  # fmt: skip


def loaded(folder, *words):
    done = subprocess.run(
        [sys.executable, "-c", RUN, *words, f"results={folder}"], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    code, names, kernels = json.loads(done.stderr.splitlines()[-1])
    assert code == 0, done.stderr
    return {*names, *(f"kernel {name}" for name in kernels)}


@pytest.mark.parametrize("again", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["new", "done before"])
def test_a_tiny_run_loads_no_library_that_it_does_not_use(tmp_path, again):
    read_request(["problem=sensor_zero", "optimizer=de"], multirun=False)  # what conf/ says is read once, and kept
    words = ("here", "run", "problem=sensor_zero", "optimizer=de", "budget=60", "seeds=1")
    if again:
        loaded(tmp_path, *words)
    assert not SPARED & loaded(tmp_path, *words)


@pytest.mark.slow
def test_the_compiler_is_loaded_before_the_children_are_forked(tmp_path):
    names = loaded(tmp_path, "fork", "run", "problem=sensor_zero", "optimizer=de", "budget=60", "seeds=1")
    assert "numba.np.arraymath" in names
    assert "scipy.optimize" not in names  # nothing of this run needs it


def test_a_search_for_effects_loads_no_library_that_it_does_not_use():
    code = "import sys, calibench.discrepancy; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert not {"scipy.stats", "scipy.signal", "scipy.interpolate", "pandas", "matplotlib"} & set(done.stdout.split())


def test_a_report_of_shares_does_not_load_scipys_tests():
    code = (
        "import sys; from calibench.bench.statistics.summary import success_interval; "
        "from calibench.bench.report.study import write; success_interval(3, 10); print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert "scipy.stats" not in done.stdout.split()


@pytest.mark.slow
def test_the_kernels_of_our_problems_are_loaded_before_the_children_are_forked(tmp_path):
    names = loaded(tmp_path, "fork", "run", "problem=sensor_zero", "optimizer=lm", "budget=60", "seeds=1")
    assert any(name.startswith("kernel ") for name in names)
    assert "scipy.optimize" in names  # the optimiser's too: a worker that takes another's place begins at once
