"""How far a run is can be read while it runs, from this process and from others, and costs the run nothing."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibench import bench, optimizers
from calibench.bench.commands import study
from calibench.bench.execution import in_progress, in_progress as told
from calibench.bench.execution.in_progress import (
    Progress,
    Running,
    at_work,
    publishing,
    read_running,
    remove_gone,
    running_of,
    to_files,
)
from calibench.bench.gate.processes import forked
from calibench.bench.statistics.progress import sweep_progress
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.carry_out import told_after


class Slow:
    """A bowl that takes its time."""

    name = "slow"
    lower, upper, start = np.full(2, -1.0), np.full(2, 1.0), np.full(2, 0.5)
    options: dict[str, Any] = {}  # noqa: RUF012

    def __init__(self, sleep: float) -> None:
        self.sleep = sleep

    def residuals(self, x: np.ndarray) -> np.ndarray:
        time.sleep(self.sleep)
        return x

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        return np.eye(2)

    def __call__(self, x: np.ndarray) -> float:
        return float(self.residuals(x) @ x)


def once(**changed: Any) -> Progress:
    """Return a progress as this process would tell it."""
    now = time.time()
    known = Progress(
        run_id="3f2a0123456789ab", problem="full12", optimizer="de", repetition=0, pid=os.getpid(),
        host=os.uname().nodename, born=told.born(os.getpid()), began_at=now - 100, updated_at=now, evaluations=1234,
        spent=1234, budget=20_000, best_value=3.21e-5, rate=12.34, eta_s=1520.8, silent_s=0.1, ended=False,
    )  # fmt: skip
    return known | changed  # type: ignore[return-value]


@pytest.mark.parametrize("how", [{}, {"time_limit": 60}, {"inner": 2}], ids=str)
def test_a_run_tells_how_far_it_is(how: dict[str, Any]) -> None:
    heard: list[Progress] = []
    with publishing(heard.append, every=0.05):
        run = bench.execute(Slow(0.005), optimizers.make("de", population=5), 100, seed=4, **how)
    *going, last = heard
    assert len(going) >= 3
    assert [p["ended"] for p in heard] == [False] * len(going) + [True]
    assert {(p["run_id"], p["problem"], p["optimizer"], p["repetition"], p["budget"]) for p in heard} == {
        (run.run_id, "slow", "de", 4, 100)
    }
    spent = [p["spent"] for p in heard]
    assert spent == sorted(spent)
    assert spent[0] < spent[-1] == 100
    assert last["best_value"] == run.best_value
    assert all(p["best_value"] is None or p["best_value"] >= run.best_value for p in going)
    assert going[-1]["best_value"] is not None
    assert 20 < going[-1]["rate"] < 500
    assert (going[-1]["pid"] == os.getpid()) is ("time_limit" not in how)


def test_what_is_charged_counts_derivatives() -> None:
    heard: list[Progress] = []
    with publishing(heard.append, every=0.02):
        run = bench.execute(Slow(0.02), optimizers.make("nlopt_LD_SLSQP"), 60)
    assert run.row["jacobian_evaluations"] > 0
    assert heard[-1]["spent"] == run.charged > heard[-1]["evaluations"] == run.evaluations


def test_short_runs_and_runs_outside_say_nothing() -> None:
    heard: list[Progress] = []
    bench.execute(Slow(0.001), optimizers.make("de", population=5), 50)
    with publishing(heard.append, every=1.0):
        for seed in range(5):
            bench.execute(Slow(0), optimizers.make("de", population=5), 50, seed=seed)
    with publishing(heard.append, every=0.02):
        pass
    bench.execute(Slow(0.001), optimizers.make("de", population=5), 50)
    assert heard == []


def test_silence_is_measured_from_the_last_evaluation() -> None:
    class Sleeper:
        def minimize(self, objective: Any, rng: np.random.Generator) -> None:
            for _ in range(3):
                objective(objective.start)
            time.sleep(0.4)

    heard: list[Progress] = []
    with publishing(heard.append, every=0.05):
        bench.execute(Slow(0), Sleeper(), 50)
    silent = [p["silent_s"] for p in heard if p["evaluations"] == 3]  # the last look may have been before the third
    assert 0.2 < max(silent) < 5
    assert silent == sorted(silent)


def test_no_run_fails_by_what_is_told_of_it(tmp_path: Path) -> None:
    def broken(_: Progress) -> None:
        raise OSError("no space")

    (tmp_path / "running").write_text("a file where the folder should be")
    for publish in (broken, to_files(tmp_path)):
        with publishing(publish, every=0.02):
            assert bench.execute(Slow(0.005), optimizers.make("de", population=5), 30).status == "ok"


def test_other_processes_read_a_folder_of_runs(tmp_path: Path) -> None:
    def work(_: Any) -> None:
        with publishing(to_files(tmp_path), every=0.02):
            bench.execute(Slow(0.01), optimizers.make("de", population=5), 10**6)

    assert read_running(tmp_path) == []
    with forked(work) as (child, _):
        end = time.monotonic() + 30
        while not ((found := read_running(tmp_path)) and found[0].spent) and time.monotonic() < end:
            time.sleep(0.01)
        [run] = found
        assert (run.optimizer, run.problem, run.pid, run.budget) == ("de", "slow", child.pid, 10**6)
        assert run.spent > 0  # what is written before the first evaluation has none
        assert child.pid is not None
        os.kill(child.pid, signal.SIGKILL)
        child.join()
    assert read_running(tmp_path) == []
    assert len(list((tmp_path / "running").glob("*.json"))) == 1  # who reads a folder leaves it as it is
    remove_gone(tmp_path)
    assert not (tmp_path / "running").exists()


def test_a_file_is_gone_with_its_run(tmp_path: Path) -> None:
    with publishing(to_files(tmp_path), every=0.02):
        bench.execute(Slow(0.005), optimizers.make("de", population=5), 30)
    assert list((tmp_path / "running").iterdir()) == []


def write(folder: Path, progress: Any, name: str = "a") -> None:
    (folder / "running").mkdir(exist_ok=True)
    (folder / "running" / f"{name}.json").write_text(progress if isinstance(progress, str) else json.dumps(progress))


def test_what_is_no_run_in_progress_is_passed_over(tmp_path: Path) -> None:
    for i, odd in enumerate(("", "[]", "{", "null", '{"run_id": 3}', json.dumps(once() | {"pid": "x"}))):
        write(tmp_path, odd, str(i))
    assert read_running(tmp_path) == []
    write(tmp_path, once(born="1"), "another process of that number")
    assert read_running(tmp_path) == []
    write(tmp_path, once(host="elsewhere", pid=1, born="1"), "another machine")
    assert [run.host for run in read_running(tmp_path)] == ["elsewhere"]
    write(tmp_path, once(), "ours")
    remove_gone(tmp_path)
    assert len(read_running(tmp_path)) == 2


def test_a_run_is_told_in_one_line() -> None:
    run = running_of(once())
    said = "run 3f2a de on full12: 1 234 of 20 000 evaluations, best 3.2e-05, 12.3/s, 25 min left"
    assert run.line() == said
    assert run.silent_line() is None
    early = running_of(once(best_value=None, eta_s=None, rate=0.0, spent=0))
    assert early.line() == "run 3f2a de on full12: 0 of 20 000 evaluations, no value yet, 0/s"


def test_a_silent_run_is_named_with_what_ends_it() -> None:
    run = running_of(once(silent_s=660.0, pid=4711))
    assert run.line().endswith("12.3/s, silent for 11 min")
    said = run.silent_line()
    assert said is not None
    assert said.startswith("run 3f2a de on full12 has made no evaluation for 11 min; `kill -9 4711` ends it")
    assert "time_limit=SECONDS" in said
    assert "\n" not in said
    assert "`kill -9 4711` on elsewhere" in (replace(run, host="elsewhere").silent_line() or "")


def test_a_run_whose_process_says_nothing_any_more_grows_silent() -> None:
    """A loop in C that holds Python's lock stops the thread that tells, too."""
    run = running_of(once(updated_at=time.time() - 700))
    assert run.silent_s > 699
    assert run.silent_line() is not None
    assert isinstance(run, Running)
    assert in_progress.SILENT == 600


def test_what_takes_long_before_the_first_run_is_said_and_nothing_else():
    said = threading.Event()
    with told_after(0.01, said.set) as begin:
        begin()
        begin()
        assert said.wait(60)
    said.clear()
    with told_after(60, said.set) as begin:
        begin()
    with told_after(0.0, said.set):
        time.sleep(0.05)  # however long: nothing has begun
    assert not said.is_set()
    assert not [thread for thread in threading.enumerate() if isinstance(thread, threading.Timer)]  # none is forked


def test_a_killed_sweep_is_told_from_one_that_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "_EVERY", 0.05)
    store = ResultStore(tmp_path / "s")
    store.open()
    store.plan({"1" * 16: "p x de"}, "bench run problem=p optimizer=de")

    def work(ours: Any) -> None:
        with at_work(store.folder):
            store.write(bench.execute(Slow(0), optimizers.make("de", population=5), 30))
            ours.send(None)
            time.sleep(600)

    with forked(work) as (child, told_by):
        told_by.recv()
        assert sweep_progress(store).pace > 0
        assert not [line for line in study.lines_of(store, sweep_progress(store)) if "nobody" in line]
        assert child.pid is not None
        os.kill(child.pid, signal.SIGKILL)
        os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)  # it is dead, and stands in the system's table
        after = sweep_progress(store)
        assert (after.hosts, after.pace, after.eta_s) == (frozenset(), 0.0, None)
        assert study.status([str(store.folder), "--watch"]) == 0
    said = "nobody is at work on it here; the same command goes on: bench run problem=p optimizer=de"
    assert capsys.readouterr().out.splitlines()[1] == said
    elsewhere = json.dumps({"host": "node7", "pid": 1, "born": "1"})
    (store.folder / "running" / "1@node7.sweep").write_text(elsewhere)
    assert (
        "here; whether node7 still is cannot be seen from here; the same"
        in study.lines_of(store, sweep_progress(store))[1]
    )
    remove_gone(store.folder)
    assert [path.name for path in (store.folder / "running").iterdir()] == ["1@node7.sweep"]
