"""The standing process: it makes all of a run with a time limit, and one that hangs or dies costs that run alone."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import threading
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from calibench.bench import ResultStore
from calibench.bench.cli import main
from calibench.bench.execution import standing
from calibench.bench.execution.run import Run, Spec
from calibench.bench.gate import time_limit
from calibench.core import own_state
from calibench.core.process_state import KINDS
from tests.same_rows import rows

CODE = """
import ctypes, decimal, faulthandler, os, subprocess, threading, time
import numpy as np

def hang():
    time.sleep(600)

def loop():
    ctypes.PyDLL(None).sleep(600)  # in C, with Python's lock held

def die():
    faulthandler.disable()
    ctypes.string_at(0)

def leave():
    os._exit(3)

def interrupt():
    raise KeyboardInterrupt("by the user's code")

def refuse():
    raise ValueError("this machine has no such joint")

def set_state():
    decimal.getcontext().prec = 3
    os.chdir("/")
    np.seterr(all="ignore")

def begin_thread():
    threading.Thread(target=time.sleep, args=(600,), daemon=True).start()

def begin_process():
    subprocess.Popen(["sleep", "600"])

class Rig:
    def __init__(self, where: str = "", what: str = "", n: int = 2):
        self.where, self.what, self.calls = where, what, 0
        self.lower, self.upper, self.start = -np.ones(n), np.ones(n), np.full(n, 0.3)
        self.seen = float(decimal.getcontext().prec), float(len(os.getcwd()))
        self.at("init")
    def at(self, where):
        if where == self.where:
            globals()[self.what]()
    def compile(self):
        self.at("compile")
    def __call__(self, x):
        self.calls += 1
        if self.calls == 9:
            self.at("call")
        return float(x @ x)
    def merit(self, x):
        self.at("merit")
        return {"pid": float(os.getpid()), "precision": self.seen[0], "folder": self.seen[1]}
"""
PLACES = ("init", "compile", "call", "merit")


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(time_limit, "GRACE", 0.2)
    file = tmp_path / f"{tmp_path.name}.py"  # results could not tell two of one name apart
    file.write_text(CODE)
    return f"{file}:Rig"


def make(rig: str, where: str = "", what: str = "", limit: float | None = 60.0, n: int = 2) -> Run:
    given = {"where": where, "what": what, "n": n}
    return Spec(rig, given, "nlopt_LN_NELDERMEAD", {}, 30, 0, time_limit=limit).execute()


def figure(run: Run, name: str) -> float:
    merit = run.row["merit"]
    assert merit is not None
    return float(json.loads(merit)[name])


def comparable(run: Run) -> dict[str, Any]:
    return {key: value for key, value in run.row.items() if key not in {"wall_s", "cpu_s", "started_at", "merit"}}


@pytest.mark.parametrize(("where", "what"), [*((where, "hang") for where in PLACES), ("call", "loop")])
def test_what_hangs_anywhere_is_ended_by_its_time_limit(rig: str, where: str, what: str) -> None:
    whole = make(rig)  # what is loaded takes no time
    run = make(rig, where, what, limit=0.4)
    said = {"init": "in building the problem", "compile": "before the first", "merit": "in judging the answer: "}
    assert run.row["error"].startswith(said.get(where, "the time limit has passed"))
    assert "the time limit has passed" in run.row["error"]
    assert (run.status, run.row["error_type"]) == (("failed", "TimeoutError") if where == "merit" else ("timeout", ""))
    assert run.evaluations == {"call": 9, "merit": whole.evaluations}.get(where, 0)
    assert what == "loop" or run.run_id == make(rig, where, what, limit=0.1).run_id
    assert where in run.row["problem_options"]
    if where == "call":
        assert run.best_x is not None
        assert figure(run, "precision") == 28  # its answer is judged all the same


@pytest.mark.parametrize(("where", "what"), [*((where, "die") for where in PLACES), ("call", "leave")])
def test_what_dies_anywhere_is_one_failed_row(rig: str, where: str, what: str) -> None:
    run, whole = make(rig, where, what), make(rig)
    assert (run.status, run.row["error_type"]) == ("failed", "ProcessDied")
    assert ("SIGSEGV" if what == "die" else "exit code 3") in run.row["error"]
    assert run.evaluations == {"call": 9, "merit": whole.evaluations}.get(where, 0)
    assert whole.status == "ok"


def test_a_file_that_hangs_as_it_is_imported_is_ended(rig: str, tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(CODE + "\nhang()\n")
    run = make(f"{tmp_path}/slow.py:Rig", limit=0.5)
    assert (run.status, run.evaluations, run.row["problem"]) == ("timeout", 0, "slow.py:Rig")
    assert run.run_id
    assert "slow" not in sys.modules


def test_what_user_code_raises_as_it_is_built_reaches_the_caller(rig: str) -> None:
    with pytest.raises(ValueError, match="no such joint"):
        make(rig, "init", "refuse")
    for where in PLACES:
        with pytest.raises(KeyboardInterrupt, match="by the user's code"):
            make(rig, where, "interrupt")
    assert make(rig).status == "ok"


def test_runs_are_made_by_one_process_and_their_state_is_put_back(rig: str) -> None:
    first, second = make(rig), make(rig, "call", "set_state")
    third = make(rig)
    pids = {figure(run, "pid") for run in (first, second, third)}
    assert len(pids) == 1
    assert os.getpid() not in pids
    assert second.row["process_changes"] == ["np.seterr", "working folder", "decimal context"]
    assert comparable(third) == comparable(first)
    assert [figure(third, name) for name in ("precision", "folder")] == [28, len(os.getcwd())]


@pytest.mark.parametrize("what", ["begin_thread", "begin_process"])
def test_what_cannot_be_put_back_ends_the_process_after_that_run(rig: str, what: str) -> None:
    first, second, third = make(rig), make(rig, "call", what), make(rig)
    assert figure(first, "pid") == figure(second, "pid") != figure(third, "pid")
    with pytest.raises(ProcessLookupError):
        os.kill(int(figure(first, "pid")), 0)


def test_a_change_of_this_process_is_one_of_the_next_run(rig: str, tmp_path: Path, monkeypatch: Any) -> None:
    before = make(rig)
    (tmp_path / "further").mkdir()
    monkeypatch.chdir("further")
    after = make(rig)
    assert figure(after, "folder") == figure(before, "folder") + len("/further")
    assert figure(after, "pid") != figure(before, "pid")


def test_memory_is_there_for_few_parameters_and_many(rig: str) -> None:
    few, many = make(rig, n=3), make(rig, n=2500)
    assert (few.status, few.row["dimension"], many.status, many.row["dimension"]) == ("ok", 3, "ok", 2500)
    again, cut = make(rig, n=3), make(rig, "call", "leave", n=2500)
    assert figure(again, "pid") == figure(many, "pid")
    assert comparable(again) == comparable(few)
    assert cut.best_x is not None
    assert len(cut.best_x) == 2500


def test_what_lasts_here_is_where_the_standing_process_begins(rig: str) -> None:
    number = next(i for i, kind in enumerate(KINDS) if kind.name == "recursion limit")
    before = own_state._LASTING[:]  # what other tests have left
    own_state._LASTING[:] = [(number, -1)]  # no process can have it
    try:
        assert own_state.lasting() == ["recursion limit"]
        assert len({figure(make(rig), "pid") for _ in range(3)}) == 1
    finally:
        own_state._LASTING[:] = before


def test_each_thread_has_a_process_of_its_own(rig: str) -> None:
    runs: list[Run] = [make(rig)]
    thread = threading.Thread(target=lambda: runs.extend(make(rig) for _ in range(2)))
    thread.start()
    thread.join()
    runs.append(make(rig))
    pids = [figure(run, "pid") for run in runs]
    assert pids[0] == pids[3] != pids[1] == pids[2]
    assert thread not in standing._STANDING


def test_options_that_cannot_be_sent_are_run_all_the_same(rig: str) -> None:
    class Word(str):
        """What another process does not know."""

    run = make(rig, Word("merit"), "die")
    assert (run.status, run.row["error_type"]) == ("failed", "ProcessDied")


@pytest.mark.parametrize("execution", [["processes", "execution.n_jobs=2"]], ids=str)
def test_a_limit_changes_no_bit_of_a_sweep(rig: str, tmp_path: Path, execution: list[str]) -> None:
    found = []
    for limit in ([], ["time_limit=60"]):
        folder = tmp_path / f"results{len(found)}"
        words = ["optimizer=nlopt_LN_BOBYQA,pygmo_cmaes,scipy_nelder_mead,de", "budget=60", "seeds=2"]
        words += [f"problem={rig},full12", "prob.full12.n=20", f"execution={execution[0]}", *execution[1:]]
        with pytest.raises(SystemExit) as ended:
            main(["run", "-m", *words, *limit, f"results={folder}"])
        assert not ended.value.code
        found.append(ResultStore(folder / "adhoc"))
    free, limited = (rows(store).drop(columns=["merit", "merit.pid"]) for store in found)
    pd.testing.assert_frame_equal(free, limited)
    pd.testing.assert_frame_equal(found[0].traces(), found[1].traces())


@pytest.mark.parametrize("how", ["ends", "is killed"])
def test_it_ends_with_the_process_that_began_it(rig: str, how: str) -> None:
    make(rig)
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()

    def work() -> None:
        theirs.send(figure(make(rig), "pid"))
        if how == "is killed":
            os.kill(os.getpid(), signal.SIGKILL)

    process = context.Process(target=work)
    process.start()
    process.join()
    pid = int(ours.recv())
    assert pid != figure(make(rig), "pid")
    assert process.exitcode == (0 if how == "ends" else -signal.SIGKILL)
    _assert_is_gone(pid)


def _assert_is_gone(pid: int) -> None:
    for _ in range(1000):  # the system's signal takes a moment
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            return
        if state in "ZX":
            return
        threading.Event().wait(0.01)
    pytest.fail(f"process {pid} is still there")
