"""Workers die, sweeps are killed: no finished run is done twice, none is lost, nothing is left running."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
from collections import Counter, deque
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calibench.bench.execution import in_progress
from calibench.bench.execution.request import made_pair, read_asked
from calibench.bench.execution.run import Spec
from calibench.bench.store.runs import ResultStore
from calibench.bench.workers import processes
from calibench.bench.workers.carrier import Job, Packs
from calibench.bench.workers.processes import Processes
from calibench.core import own_state
from tests.processes import alive, descendants, wait_for
from tests.same_rows import rows

CODE = """
import os, time
import numpy as np

class Slow:
    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.3)
    def __init__(self, kind: str = "ok", seconds: float = 0.0005):
        self.kind, self.seconds, self.calls = kind, seconds, 0
        if kind == "counted" and os.environ.get("COUNT"):
            with open(os.environ["COUNT"], "a") as file:
                file.write(f"{os.getpid()}\\n")
    def __call__(self, x):
        self.calls += 1
        time.sleep(self.seconds)
        if self.calls == 9:
            if self.kind == "hang":
                time.sleep(600)
        return float(x @ x)
"""


COUNTED = ["problem=mine.py:Slow", "problem.kind=counted", "optimizer=de,pso", "budget=40", "seeds=20"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the folder of the `COUNTED` sweep, done in one process that nobody has ended."""
    home = tmp_path_factory.mktemp("whole")
    (home / "mine.py").write_text(CODE)
    subprocess.run(sweep(*COUNTED, execution="serial"), check=True, capture_output=True, cwd=home)
    return home / "results/adhoc"


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(CODE)
    return tmp_path


def sweep(*words, execution="processes", n=2, results="results"):
    workers = [] if execution == "serial" else [f"execution.n_jobs={n}"]
    return [
        sys.executable, "-m", "bench", "run", "-m", f"execution={execution}", *workers, f"results={results}", *words,
    ]  # fmt: skip


def done(folder="results/adhoc"):
    store = ResultStore(folder)
    return store.finished() if (store.folder / "manifest.json").exists() else set()


@pytest.mark.slow  # one kill among the quick tests is that of `test_cli`
@pytest.mark.parametrize("how", ["kill", "worker", "term", "interrupt"])
def test_a_sweep_that_is_ended_goes_on_with_no_run_done_twice_and_nothing_left_running(here, whole, how, monkeypatch):
    rng = random.Random(how)  # the moments are stated before they are drawn: 2 within the first half second
    monkeypatch.setenv("COUNT", str(here / "made"))
    command = sweep(*COUNTED)
    seen = pd.DataFrame()
    for _ in range(2):
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        before = len(done())
        while len(done()) == before and process.poll() is None:
            time.sleep(0.01)
        time.sleep(rng.uniform(0, 0.1))
        family = descendants(process.pid)
        if how == "worker":
            for pid in family[:1]:
                os.kill(pid, signal.SIGKILL)
            _, told = process.communicate(timeout=60)
            assert process.returncode == 0, told
        else:
            number = {"kill": signal.SIGKILL, "term": signal.SIGTERM, "interrupt": signal.SIGINT}[how]
            process.send_signal(number)
            process.communicate(timeout=60)
        wait_for(lambda family=family: not alive(family), 10)
        now = ResultStore("results/adhoc").runs().set_index("run_id")
        if len(seen):
            pd.testing.assert_series_equal(now.loc[seen.index, "started_at"], seen["started_at"])
        seen = now
    assert subprocess.run(command, capture_output=True).returncode == 0
    assert len(done()) == 40
    pd.testing.assert_frame_equal(rows("results/adhoc"), rows(whole))
    pd.testing.assert_frame_equal(ResultStore("results/adhoc").traces(), ResultStore(whole).traces())


DIES = """
import os

class Dies:
    def minimize(self, objective, rng):
        objective.batch([objective.start])
        os._exit(3)
"""


@pytest.mark.slow
def test_what_takes_the_place_of_a_lost_worker_loads_no_kernel_again(here):
    (here / "dies.py").write_text(DIES)
    process = subprocess.run(
        sweep("problem=sensor_zero", "optimizer=dies.py:Dies", "start=random", "budget=30", "seeds=4", n=1),
        capture_output=True, text=True, env={**os.environ, "NUMBA_DEBUG_CACHE": "1"},
    )  # fmt: skip
    assert process.returncode == 1, process.stderr
    assert set(ResultStore("results/adhoc").runs()["error_type"]) == {"ProcessDied"}
    loaded = Counter(re.findall(r"\[cache\] data (?:loaded from|saved to) '(.*)'", process.stdout))
    assert any("_scan_kernels" in file for file in loaded)
    assert set(loaded.values()) == {1}


def jobs(count, cell="a"):
    return [Job(f"{cell}{i}", Spec("full12", {}, "de", {}, 10, i), cell) for i in range(count)]


def test_packs_are_of_about_a_second_once_a_cell_is_known():
    packs = Packs(deque(jobs(1000)), workers=2)
    first = packs.take()
    assert len(first.jobs) == 1
    packs.note_time(first.jobs[0], 0.01)
    assert len(packs.take().jobs) == 100
    packs.note_time(first.jobs[0], 1.99)
    assert len(packs.take().jobs) == 1


def test_every_job_is_handed_out_once_whatever_the_sizes():
    rng = np.random.default_rng(0)
    packs = Packs(deque([*jobs(300), *jobs(200, "b")]), workers=3)
    handed = Counter()
    while (pack := packs.take()) is not None:
        for job in pack.jobs:
            handed[job.run_id] += 1
            packs.note_time(job, float(rng.exponential(0.02)))
    assert handed == Counter({job.run_id: 1 for job in [*jobs(300), *jobs(200, "b")]})


def test_the_run_that_a_worker_was_lost_with_goes_alone_and_is_at_fault_the_second_time():
    packs = Packs(deque(jobs(3)), workers=1)
    first = packs.take().jobs
    rest = [*first, *packs.take().jobs]
    assert packs.return_lost(rest, at_fault=False) is None
    again = packs.take()
    assert (again.alone, again.jobs) == (True, tuple(rest[:1]))
    assert packs.return_lost(again.jobs, at_fault=True) == rest[0]
    assert [job.run_id for job in packs.take().jobs] == ["a1"]
    assert packs.return_lost([], at_fault=True) is None


def test_a_run_that_hangs_is_a_failed_row_when_somebody_ends_it(here, monkeypatch):
    monkeypatch.setattr(in_progress, "SILENT", 0.3)
    monkeypatch.setattr(processes, "publishing", lambda publish: in_progress.publishing(publish, 0.1))
    words = {"kind": "hang"}
    store = ResultStore("results/hung")
    store.open()
    specs = [Spec("mine.py:Slow", words, "de", {}, 30, 0), Spec("mine.py:Slow", {}, "de", {}, 30, 1)]
    jobs = [Job(read_asked(made_pair(s.problem, s.problem_options, s.optimizer, {}), 30, s.repetition).run_id, s, "a")
            for s in specs]  # fmt: skip
    packs = Packs(deque(jobs), 1)

    def end_what_hangs():
        wait_for(lambda: any(run.silent_line() for run in in_progress.read_running(store.folder)))
        (run,) = in_progress.read_running(store.folder)
        assert f"kill -9 {run.pid}" in run.silent_line()
        os.kill(run.pid, signal.SIGKILL)

    helper = threading.Thread(target=end_what_hangs)
    helper.start()
    ended = {notice.run_id: notice.status for notice in Processes(store.folder, "hung", 1).carry(packs)}
    helper.join()
    assert ended == {jobs[0].run_id: "failed", jobs[1].run_id: "ok"}
    row = store.runs().set_index("run_id").loc[jobs[0].run_id]
    assert (row["error_type"], row["error"]) == ("ProcessDied", "its process ended with exit code -9 (SIGKILL)")


def test_a_worker_that_can_do_no_more_after_each_run_loses_none(tmp_path, monkeypatch):
    monkeypatch.setattr(own_state, "lasting", lambda: ["resource limits"])
    store = ResultStore(tmp_path / "left")
    store.open()
    specs = [Spec("sensor_zero", {}, "nlopt_GN_ESCH", {}, 10, repetition) for repetition in range(6)]
    packs = Packs(deque(Job(spec.execute().run_id, spec, "a") for spec in specs), 2)
    ended = list(Processes(store.folder, "left", 2).carry(packs))
    assert [notice.status for notice in ended] == ["ok"] * 6
    assert {notice.run_id for notice in ended} == store.finished()


HOSTILE = """
import ctypes, os, sys, time
import numpy as np

def do(kind):
    if kind == "segfault":
        ctypes.string_at(0)
    if kind == "exit":
        os._exit(3)
    if kind == "leave":
        sys.exit(4)
    if kind == "daemon" and os.fork() == 0:
        os.setsid()
        time.sleep(600)

class Bad:
    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.3)
    def __init__(self, where: str = "nowhere", kind: str = "exit"):
        self.where, self.kind = where, kind
        self.at("init")
    def at(self, where):
        if self.where == where:
            do(self.kind)
    def compile(self):
        self.at("compile")
    def __call__(self, x):
        self.at("call")
        return float(x @ x)
    def merit(self, x):
        self.at("merit")
        return {}
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "where", ["init", "compile", *(pytest.param(w, marks=pytest.mark.slow) for w in ("call", "merit"))]
)
def test_what_code_does_outside_the_call_costs_its_own_runs_only(here, where):
    (here / "bad.py").write_text(HOSTILE)
    kinds = "segfault,exit,daemon" if where == "init" else "segfault,exit,leave,daemon"
    command = sweep("problem=bad.py:Bad", f"problem.where={where},nowhere", f"problem.kind={kinds}", "optimizer=de",
                    "budget=30", "seeds=2")  # fmt: skip
    process = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert process.returncode == 1, process.stderr
    assert "Traceback" not in process.stderr
    runs = ResultStore("results/adhoc").runs()
    options = runs["problem_options"].map(json.loads)
    runs["where"], runs["kind"] = options.str["where"], options.str["kind"]
    count = len(kinds.split(","))
    assert len(runs) == 4 * count
    assert set(runs.loc[runs["where"] == "nowhere", "status"]) == {"ok"}
    failed = runs[(runs["where"] == where) & (runs["kind"] != "daemon")]
    assert set(failed["status"]) == {"failed"}
    assert len(failed) == 2 * (count - 1)
    wait_for(lambda: not [pid for pid in sleepers() if alive([pid])], 10)


def sleepers():
    """Return the processes that the daemons of these tests are: children of nobody that came from a sweep."""
    found = []
    for cmdline in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = cmdline.read_bytes()
        except OSError:
            continue
        if b"problem=bad.py:Bad" in words:
            found.append(int(cmdline.parent.name))
    return found
