"""A run made from Python is the run that the command line makes: BLAS has one thread in both."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import scipy.linalg  # noqa: F401  the libraries whose threads are counted
from threadpoolctl import threadpool_info, threadpool_limits

from calibench.core.process import STATED, one_thread

_RUNS = """
from calibench import bench, optimizers, problems
for name in ("arm_ur10", "delta9"):
    problem = problems.make(name)
    for method in ("trf", "fmincon"):
        run = bench.execute(problem, optimizers.make(method), budget=300)
        print(run.run_id, run.evaluations, run.best_value.hex(), run.best_x.tolist())
"""


def _threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture
def two(monkeypatch):
    """Give BLAS two threads, as nothing that is set in the environment forbids."""
    for name in STATED:
        monkeypatch.delenv(name, raising=False)
    with threadpool_limits(2, user_api="blas"):
        yield


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core has one thread anyway")
def test_a_run_of_an_id_has_one_answer_whatever_the_threads_of_the_process():
    free = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    told = [
        subprocess.run([sys.executable, "-c", _RUNS], capture_output=True, text=True, check=True, env=free | stated)
        for stated in ({}, {"OPENBLAS_NUM_THREADS": "1"})
    ]
    assert told[0].stdout == told[1].stdout


@pytest.mark.usefixtures("two")
def test_the_number_of_threads_comes_back_at_the_outermost_end():
    with one_thread():
        with one_thread():
            assert _threads() == {1}
        assert _threads() == {1}
    assert _threads() == {2}


@pytest.mark.usefixtures("two")
def test_an_error_inside_gives_the_threads_back():
    with pytest.raises(KeyError), one_thread():
        raise KeyError
    assert _threads() == {2}


@pytest.mark.usefixtures("two")
def test_a_stated_number_of_threads_is_obeyed(monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    with one_thread():
        assert _threads() == {2}
