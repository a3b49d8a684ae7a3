"""A user's files may be called as they like: what Python or an installed package has too is theirs; no address."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from calibench import problems
from calibench.bench.store.runs import ResultStore

NAMES = ["queue", "copy", "statistics", "select", "platform", "signal", "numpy", "random", "json", "socket", "pickle"]
MINE = """
import numpy as np

from near_by import SHIFT


class Bowl:
    lower, upper, start = -np.ones(2), np.ones(2), np.zeros(2)

    def __call__(self, x):
        return float(np.sum((x - SHIFT) ** 2))
"""
RUN = ["problem=./mine.py:Bowl", "optimizer=nlopt_LN_BOBYQA", "budget=20"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "near_by.py").write_text("SHIFT = 0.25\n")
    for name in NAMES:
        (tmp_path / f"{name}.py").write_text(f"raise RuntimeError('{name} of the user')\n")
    return tmp_path


def call(*words, module=False):
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    begin = ["-m", "calibench"] if module else [str(Path(sys.executable).with_name("bench"))]
    done = subprocess.run([sys.executable, *begin, *words], capture_output=True, text=True, env=kept, timeout=300)
    return done.returncode, done.stdout + done.stderr


def test_files_that_have_names_of_modules_stand_beside_a_class_and_its_neighbours(here):
    words = ["seeds=2", "start=random", "study=p", "execution=processes", "execution.n_jobs=2"]
    assert call("run", *RUN, *words)[0] == 0
    assert ResultStore("results/p").runs()["status"].tolist() == ["ok", "ok"]
    words = ["problem=mine:Bowl", *RUN[1:], "seeds=1", "study=m", "execution=serial"]
    assert call("run", *words, module=True)[0] == 0
    assert call("status", "results/m")[0] == 0


@pytest.mark.slow
def test_they_stand_beside_a_class_on_a_cluster_and_data_of_searches(here):
    assert call("run", *RUN, "seeds=2", "start=random", "study=d", "execution=dask", "execution.n_jobs=1")[0] == 0
    assert ResultStore("results/d").runs()["status"].tolist() == ["ok", "ok"]
    for name in ("a", "b"):
        (here / f"{name}.csv").write_text("x,y\n1,2\n")
    code, told = call("discover", "machine=gpm2002", "data=*.csv", "execution=processes", "execution.n_jobs=2")
    assert code == 1
    assert "of the user" not in told


def test_a_file_that_is_meant_and_hidden_is_refused_with_the_way_out(here):
    (here / "statistics.py").write_text("def median(values):\n    return 7.0\n")
    for taken in ("from statistics import median\n", "import statistics\n\nX = statistics.median\n"):
        (here / "other.py").write_text(taken + MINE)
        with pytest.raises(ValueError, match=r"other\.py takes median from statistics"):
            problems.make("./other.py:Bowl")
    (here / "other.py").write_text("from statistics import mean\n" + MINE)
    assert problems.make("./other.py:Bowl")(problems.make("./other.py:Bowl").start) == 0.125


def test_a_class_may_stand_in_a_file_of_such_a_name(here):
    (here / "queue.py").write_text(MINE.replace("from near_by import SHIFT", "SHIFT = 0.25"))
    assert problems.make("./queue.py:Bowl").start.tolist() == [0.0, 0.0]
    assert hasattr(sys.modules["queue"], "SimpleQueue")


def test_a_folder_whose_name_looks_like_an_address_is_a_folder(here, run_bench):
    for results in ("lab:1", "s3://x"):
        words = f"run problem=sensor_zero optimizer=lm budget=300 seeds=2 study=s results={results}"
        assert run_bench(words)[0] == 0
        assert (Path(results) / "s" / "runs.parquet").is_file()
        store = ResultStore(f"{results}/s")
        assert (len(store.runs()), store.write_hits().is_file()) == (1, True)
