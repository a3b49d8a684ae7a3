"""A tiny run loads what it needs, and what all its processes need is loaded once."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy  # noqa: F401  loaded before the command line, as in a notebook
import pytest

from calibench.bench.cli import main
from calibench.bench.store.runs import ResultStore
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
    planar = sys.modules.get("calibench.problems.planar._closed_loop_kernels")
    kernels = [k for k, v in (vars(planar) if planar else {}).items()
               if getattr(v, "signatures", None)]
    print(json.dumps([ended.code, sorted(sys.modules), kernels]), file=sys.stderr)
"""
AS_NUMPY_IS_LOADED = """
import os, sys
class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            print("threads:", os.environ.get("OPENBLAS_NUM_THREADS"))
            print("memory:", os.environ.get("ARROW_DEFAULT_MEMORY_POOL"))
sys.meta_path.insert(0, Watch())
from calibench.bench.cli import main
main()
"""
SPARED = {
    "hydra", "omegaconf", "antlr4", "pandas", "pyarrow.pandas_compat", "pyarrow.compute",
    "scipy.linalg", "scipy.optimize", "numba.np.arraymath",  # the last is numba's compiler: the kernels are kept
    "matplotlib", "pygmo", "nlopt", "rich", "jinja2", "jsonschema", "scipy.stats", "pyarrow.dataset",
    "calibench.discrepancy", "calibench.bench.report", "calibench.bench.papers", "calibench.bench.sweep.tuner",
    "calibench.bench.statistics.choosing",
    "calibench.problems.orthoglide", "calibench.problems.delta", "calibench.problems.suites.nist",
    "calibench.problems.identifiability", "calibench.optimizers.pygmo", "calibench.optimizers.nlopt",
    "calibench.problems.arm.build", "calibench.optimizers.fmincon.direct", "xml.etree.ElementTree",
}  # fmt: skip


OWN = """
class Mine:
    lower, upper, start = [0.0, 0.0], [1.0, 1.0], [0.5, 0.5]

    def __call__(self, x):
        return float(x @ x)
"""


def loaded(folder, *words):
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # as `bench` sets it, before anything loads NumPy
    done = subprocess.run(
        [sys.executable, "-c", RUN, *words, f"results={folder}"], cwd=ROOT, capture_output=True, text=True, timeout=120,
        env=environment,
    )  # fmt: skip
    code, names, kernels = json.loads(done.stderr.splitlines()[-1])
    assert code == 0, done.stderr
    return {*names, *(f"kernel {name}" for name in kernels)}


def test_a_calibration_knows_no_machine_of_another_kind(tmp_path):
    """Its columns are declared beside it, so nothing asks the machines that are searched."""
    arms = ROOT / "problems" / "data" / "arms"
    urdf, data = f"urdf={arms / 'ur10.urdf'}", f"data={arms / 'ur10_b.csv'}"
    script = RUN.replace('carry_out.CAN_FORK = costs.CAN_FORK = sys.argv.pop(1) == "fork"\n', "")
    script = script.replace("from calibench.bench.sweep import carry_out, costs\n", "")
    done = subprocess.run(
        [sys.executable, "-c", script, "calibrate", urdf, data, "resamples=20", "page=false", "level=frames",
         f"results={tmp_path}"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    code, names, _ = json.loads(done.stderr.splitlines()[-1])
    assert code == 0, done.stderr
    ours = {name for name in names if name.startswith("calibench.")}
    assert len(ours) <= 90  # with the aliases of packages
    assert not [name for name in ours if "planar" in name or "orthoglide" in name or "discrepancy" in name]
    assert "scipy.stats" not in names  # a third of a second


def test_a_search_loads_no_verb_and_no_format_that_it_does_not_use():
    code = "import calibench.bench.commands.discover, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert not {"calibench.bench.calibration", "scipy.io", "matplotlib.pyplot"} & {*done.stdout.split()}


def test_matplotlib_and_pandas_are_loaded_beside_a_search(tmp_path):
    words = ["discover", "machine=gpm2002", "data=demo_backlash"]
    names = loaded(tmp_path, "here", *words)
    assert not {"pandas", "matplotlib"} & names
    [drawn] = tmp_path.glob("discover/*/figures/gap.svg")
    assert (drawn.parents[1] / "report.html").exists()


@pytest.fixture(scope="module")
def kernels_are_kept(tmp_path_factory):
    """Compile what the runs here need: a process that compiles loads the compiler."""
    words = ("run", "-m", "problem=sensor_zero", "optimizer=de,lm", "budget=60", "seeds=1")
    loaded(tmp_path_factory.mktemp("before"), "here", *words)


@pytest.mark.usefixtures("kernels_are_kept")
@pytest.mark.parametrize("again", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["new", "done before"])
def test_a_tiny_run_loads_no_library_that_it_does_not_use(tmp_path, again):
    read_request(["problem=sensor_zero", "optimizer=de"], multirun=False)  # what conf/ says is read once, and kept
    words = ("here", "run", "problem=sensor_zero", "optimizer=de", "budget=60", "seeds=1")
    if again:
        loaded(tmp_path, *words)
    names = loaded(tmp_path, *words)
    assert not SPARED & names
    assert len([name for name in names if name.startswith("calibench.")]) <= 125


@pytest.mark.slow
@pytest.mark.usefixtures("kernels_are_kept")
def test_a_run_of_least_squares_loads_no_pandas_and_no_compiler(tmp_path):
    names = loaded(tmp_path, "here", "run", "problem=sensor_zero", "optimizer=lm", "budget=60", "seeds=1")
    assert "scipy.optimize" in names
    assert not {"pandas", "numba.np.arraymath"} & names


@pytest.mark.slow
@pytest.mark.usefixtures("kernels_are_kept")
def test_a_sweep_that_is_asked_for_again_is_told_without_pandas(tmp_path):
    words = ("here", "run", "-m", "problem=sensor_zero", "optimizer=de,lm", "budget=60", "seeds=2")
    for _ in range(2):
        assert "pandas" not in loaded(tmp_path, *words)


@pytest.mark.slow
def test_the_compiler_is_loaded_before_children_are_forked_that_may_compile(tmp_path):
    """What a user's own code compiles nobody knows beforehand."""
    own = tmp_path / "own.py"
    own.write_text(OWN)
    names = loaded(tmp_path, "fork", "run", f"problem={own}:Mine", "optimizer=de", "budget=60", "seeds=1")
    assert "numba.np.arraymath" in names


@pytest.mark.slow
def test_a_search_for_effects_loads_no_library_that_it_does_not_use():
    code = "import sys, calibench.discrepancy; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert not {"scipy.stats", "scipy.signal", "scipy.interpolate", "pandas", "matplotlib"} & set(done.stdout.split())


@pytest.mark.slow
def test_the_kernels_of_our_problems_are_loaded_before_the_children_are_forked(tmp_path):
    names = loaded(tmp_path, "fork", "run", "problem=sensor_zero", "optimizer=lm", "budget=60", "seeds=1")
    assert any(name.startswith("kernel ") for name in names)
    assert "scipy.optimize" in names  # the optimiser's too: a worker that takes another's place begins at once


def test_linear_algebra_has_one_thread_before_numpy_is_loaded():
    """More of them wait for each other on a busy machine: a calibration took four times as long.

    Arrow's memory is the system's by then: its own pool kept 50 MB of a sweep of 20 000 runs.
    """
    alone = {k: v for k, v in os.environ.items() if not k.endswith(("_NUM_THREADS", "_MEMORY_POOL"))}
    done = subprocess.run(
        [sys.executable, "-c", AS_NUMPY_IS_LOADED, "calibrate", "urdf=none.urdf", "data=none.csv"],
        cwd=ROOT, env=alone, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    said = [line for line in done.stdout.splitlines() if line.startswith(("threads:", "memory:"))]
    assert said == ["threads: 1", "memory: system"], done.stderr


def test_the_command_line_called_after_numpy_leaves_the_threads_to_each_run(monkeypatch, capsys):
    """A variable that is set then changes nothing here, and would keep a run from holding one thread itself."""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with pytest.raises(SystemExit):
        main(["list", "machines"])
    assert "gpm2002" in capsys.readouterr().out
    assert "OPENBLAS_NUM_THREADS" not in os.environ


WATCH = """
import gc

class Watched:
    lower, upper, start = [0.0], [1.0], [0.5]

    def __call__(self, x):
        return 1.0 if gc.isenabled() else 0.0
"""


REFUSED = """
import gc
from calibench.bench.cli import main
try:
    main(["run", "problem=nothing_like_it"])
except SystemExit:
    print(gc.isenabled())
"""


@pytest.mark.slow
def test_garbage_is_collected_while_runs_run_and_after_a_request_that_is_refused(tmp_path):
    (tmp_path / "watched.py").write_text(WATCH)
    words = ["run", "problem=./watched.py:Watched", "optimizer=de", "budget=20", "seeds=1", f"results={tmp_path}"]
    there = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-m", "calibench", *words], cwd=tmp_path, env=there, timeout=120)
    assert done.returncode == 0
    assert set(ResultStore(tmp_path / "adhoc").runs()["best_value"]) == {1.0}
    told = subprocess.run([sys.executable, "-c", REFUSED], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert told.stdout.split()[-1] == "True"
