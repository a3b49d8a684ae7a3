"""Whatever a run does to its process, it is one row that says what, and no other run is lost: on every back end.

One sweep a back end without a time limit, one with: all tests look at these.
"""

import subprocess
import sys

import pandas as pd
import pytest

from calibench.bench.store.runs import ResultStore
from tests.same_rows import rows

CODE = """
import ctypes, itertools, os, resource, subprocess, time
import numpy as np

class Mine:
    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, -0.3)
    def __init__(self, kind: str = "ok"):
        self.kind = kind
    def __call__(self, x):
        if x[0] > 0:  # and not at a count of calls: of a run that is tried again some calls are replayed
            getattr(self, self.kind)()
        return float(x @ x)
    def ok(self):
        np.empty(1 << 24)  # 128 MB: it suffers from what another run has done to its process
    def quick(self):
        pass
    def segfault(self):
        ctypes.string_at(0)
    def exit(self):
        os._exit(0)
    def abort(self):
        os.abort()
    def memory(self):
        resource.setrlimit(resource.RLIMIT_AS, (1 << 28, 1 << 28))
        np.ones(1 << 30)
    def killed(self):  # by another process
        subprocess.Popen(["/bin/sh", "-c", f"kill -9 {os.getpid()}"])
        time.sleep(600)
    def loop(self):
        sum(itertools.repeat(0))  # in C, with Python's lock held: no signal is heard
"""
KINDS = ("memory", "ok", "segfault", "exit", "abort", "killed")  # so that ok comes to a process that memory was in
EXECUTIONS = {
    "serial": ["execution=serial"],
    "processes": ["execution=processes", "execution.n_jobs=2"],
    "dask": ["execution=dask", "execution.n_jobs=2"],
}
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("serial", "dask")]


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Return what gives the folder of a sweep of so many seconds a run on a back end, done once, and what it said."""
    home = tmp_path_factory.mktemp("home")
    (home / "mine.py").write_text(CODE)
    done = {}

    def sweep(execution, kinds, *words):
        if (execution, kinds) not in done:
            results = f"results{len(done)}"
            ended = subprocess.run(
                [sys.executable, "-m", "bench", "run", "-m", "problem=mine.py:Mine", f"problem.kind={','.join(kinds)}",
                 "optimizer=nlopt_GN_ESCH", "budget=30", "seeds=2", f"results={results}", *EXECUTIONS[execution],
                 *words], cwd=home, capture_output=True, text=True,
            )  # fmt: skip
            done[execution, kinds] = home / results / "adhoc", ended
        return done[execution, kinds]

    return sweep


def runs_of(folder):
    runs = ResultStore(folder).runs()
    runs["kind"] = runs["problem_options"].str.extract(r'"kind":"(\w+)"')
    return runs


@pytest.mark.parametrize("execution", ["processes", *SLOW])
def test_a_run_that_takes_its_process_down_is_a_failed_row_and_no_other_is_lost(swept, execution):
    folder, ended = swept(execution, KINDS)
    assert ended.returncode == 1, ended.stderr
    assert ended.stderr.count("Traceback") == 0
    assert "distributed" not in ended.stderr
    runs = runs_of(folder)
    assert runs.groupby(["kind", "status"]).size().to_dict() == {
        (kind, "ok" if kind == "ok" else "failed"): 2 for kind in KINDS
    }
    says = runs.groupby("kind")["error"].agg(lambda errors: set(errors.fillna("")))
    died = "the process of this run ended with exit code"
    assert says["segfault"] == {f"{died} -11 (SIGSEGV)"}
    assert says["exit"] == {f"{died} 0"}
    assert says["abort"] == {f"{died} -6 (SIGABRT)"}
    assert says["killed"] == {f"{died} -9 (SIGKILL)"}
    assert set(runs.loc[runs["kind"] == "memory", "error_type"]) <= {"MemoryError", "_ArrayMemoryError"}
    failed = runs[runs["status"] == "failed"]
    assert failed["evaluations"].between(2, 30).all()  # the start is sound, and half of the points are not
    left = [path.name for path in folder.iterdir() if path.name[0] != "."]
    assert sorted(left) == ["manifest.json", "runs.parquet", "traces.parquet"]


@pytest.mark.slow
@pytest.mark.parametrize("execution", EXECUTIONS)
def test_an_endless_loop_in_c_is_ended_by_its_time_limit(swept, execution):
    folder, ended = swept(execution, ("loop", "quick"), "time_limit=3")
    assert ended.returncode == 1, ended.stderr
    runs = runs_of(folder)
    assert runs.groupby(["kind", "status"]).size().to_dict() == {("loop", "timeout"): 2, ("quick", "ok"): 2}


@pytest.mark.slow
@pytest.mark.parametrize("execution", ["processes", "dask"])
def test_the_rows_are_those_of_a_serial_sweep_also_of_the_runs_that_were_lost(swept, execution):
    serial, other = (ResultStore(swept(name, KINDS)[0]) for name in ("serial", execution))
    pd.testing.assert_frame_equal(*(rows(store) for store in (serial, other)))
    pd.testing.assert_frame_equal(serial.traces(), other.traces())
