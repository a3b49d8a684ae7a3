"""The two ways onto a cluster, on a real Slurm: an array of shards, and Dask workers that srun starts."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from one_machine import CannotStart, start, stop

from calibench.bench.store.runs import ResultStore
from tests.same_rows import rows

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[2]
WORDS = ["problem=mine.py:Slow", "optimizer=nlopt_GN_ESCH", "budget=100", "seeds=30"]
CODE = """
import time
import numpy as np

class Slow:
    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.3)
    def __call__(self, x):
        time.sleep(0.004)
        return float(x @ x)
"""
ARRAY = """#!/bin/sh
#SBATCH --array=1-3
#SBATCH --cpus-per-task=1
#SBATCH --output={folder}/%A_%a.out
exec {python} -m bench run {words} shard=$SLURM_ARRAY_TASK_ID/3 results=shard$SLURM_ARRAY_TASK_ID
"""


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    """The environment in which a Slurm of this machine is found."""
    folder = tmp_path_factory.mktemp("slurm")
    for above in (folder, folder.parent):
        above.chmod(0o755)
    try:
        environment = start(folder)
    except CannotStart as why:
        pytest.skip(f"no Slurm here: {why}")
    before = os.environ.copy()
    os.environ["SLURM_CONF"] = environment["SLURM_CONF"]
    yield folder
    stop(folder)
    os.environ.clear()
    os.environ.update(before)
    wait_for(lambda: not mentioned(str(folder)), 20)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    (tmp_path / "mine.py").write_text(CODE)
    return tmp_path


def says(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def bench(*words):
    return subprocess.run([sys.executable, "-m", "bench", *words], capture_output=True, text=True)


def done(folder):
    store = ResultStore(folder)
    return len(store.finished()) if (store.folder / "manifest.json").exists() else 0


def mentioned(text):
    """Return the processes that have `text` in their command line or environment."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            said = (process / "cmdline").read_bytes() + (process / "environ").read_bytes()
        except OSError:
            continue
        if text.encode() in said and process.name != str(os.getpid()):
            found.append(process.name)
    return found


def wait_for(condition, seconds=120):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.1)


def is_serial(folder):
    assert bench("run", *WORDS, "results=serial").returncode == 0
    pd.testing.assert_frame_equal(rows(folder), rows("serial/adhoc"))
    pd.testing.assert_frame_equal(ResultStore(folder).traces(), ResultStore("serial/adhoc").traces())


def test_an_array_of_shards_with_one_task_cancelled_and_done_again_is_the_serial_sweep(here, slurm):
    Path("array.sh").write_text(ARRAY.format(folder=here, python=sys.executable, words=" ".join(WORDS)))
    job = says("sbatch", "--parsable", "array.sh")
    wait_for(lambda: done("shard2/adhoc") >= 1)
    says("scancel", f"{job}_2")
    wait_for(lambda: not says("squeue", "-h", "-j", job))
    begun = ResultStore("shard2/adhoc").runs().set_index("run_id")["started_at"]
    planned = ResultStore("shard2/adhoc").manifest()["planned"]
    assert 1 <= len(begun) < len(planned)
    again = says("sbatch", "--parsable", "--array=2", "array.sh")
    wait_for(lambda: not says("squeue", "-h", "-j", again))
    assert bench("merge", *(f"shard{i}/adhoc" for i in (1, 2, 3)), "--to", "all/adhoc").returncode == 0
    now = ResultStore("all/adhoc").runs().set_index("run_id")["started_at"]
    pd.testing.assert_series_equal(now[begun.index], begun)
    is_serial("all/adhoc")


def test_a_sweep_runs_on_dask_workers_that_srun_starts(here, slurm):
    found = here / "scheduler.json"
    dask = [sys.executable, "-m"]
    scheduler = subprocess.Popen(
        [*dask, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
         "--scheduler-file", str(found)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        wait_for(found.exists)
        address = json.loads(found.read_text())["address"]
        workers = subprocess.Popen(
            ["srun", "--ntasks=2", *dask, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny",
             "--no-dashboard", "--local-directory", str(here)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        ended = bench("run", *WORDS, "execution=dask", f"execution.address={address}")
        assert ended.returncode == 0, ended.stderr
        workers.terminate()
        workers.wait(60)
    finally:
        scheduler.kill()
        scheduler.wait()
    is_serial("results/adhoc")
    wait_for(lambda: not says("squeue", "-h"))
