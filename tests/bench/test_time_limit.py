"""A run that does not end is ended, and its row holds what it had found; one that ends in time is not changed."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.execution.run import Spec
from calibench.bench.gate import time_limit
from calibench.optimizers.base import Objective, Stop, Traits


class Bowl:
    """A sum of squares in two variables, with a target on the way."""

    lower, upper, start = np.full(2, -1.0), np.full(2, 1.0), np.full(2, 0.5)
    targets = (0.1, 1e-30)

    def __call__(self, x: np.ndarray) -> float:
        return float(x @ x)

    def batch(self, points: np.ndarray) -> np.ndarray:
        return (points**2).sum(axis=1)  # type: ignore[no-any-return]


class Looping:
    """Halve the point `steps` times, then do what `then` does, for ever."""

    def __init__(self, then: Any, steps: int = 10, may_hang: bool = False) -> None:
        self._then, self._steps = then, steps
        self.traits = Traits(may_hang=may_hang)

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Any:
        x = np.array(objective.start)
        for _ in range(self._steps):
            x = x / 2
            objective(x)
        objective.restart()
        objective(np.full(2, np.nan))
        while True:
            self._then(objective, x)


def hang(objective: Objective, x: np.ndarray) -> None:
    for _ in range(3):
        objective(x)  # nothing new: only the count tells
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})  # as deaf as a loop in C
    time.sleep(60)


def keep_calling(objective: Objective, x: np.ndarray) -> None:
    objective(x)


def swallow(objective: Objective, x: np.ndarray) -> None:
    try:
        objective(x)
    except Stop:
        pass


def die(_objective: Objective, _x: np.ndarray) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def assert_knows_what_was_found(run: bench.Run) -> None:
    assert run.best_value == 0.5 * 0.25**10
    assert np.array_equal(run.best_x, np.full(2, 0.5**11))  # type: ignore[arg-type]
    assert run.row["best_evaluation"] == 10
    assert run.row["hits"] == [2, None]
    assert run.row["hits_charged"] == [2, None]
    assert run.row["restarts"] == 1
    assert [n for n, _, _, _ in run.points[:10]] == list(range(1, 11))
    assert run.points[-1] == (run.evaluations, run.charged, run.best_value, 1)


def test_what_loops_without_calling_back_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_limit, "GRACE", 0.2)
    began = time.perf_counter()
    run = bench.execute(Bowl(), Looping(hang), budget=100, time_limit=0.3)
    assert time.perf_counter() - began < 5
    assert (run.status, run.stop_reason, run.row["error_type"]) == ("timeout", "timeout", "")
    assert run.row["error"] == "the time limit has passed, and it did not stop when told"
    assert run.evaluations == 14
    assert_knows_what_was_found(run)


def test_what_loops_while_calling_is_ended() -> None:
    run = bench.execute(Bowl(), Looping(keep_calling), budget=10**9, time_limit=0.3)
    assert (run.status, run.stop_reason) == ("timeout", "timeout")
    assert 11 < run.evaluations < 10**9
    assert run.row["error"] == "the time limit has passed"
    assert run.row["non_finite"] == 1
    assert 0.29 < run.row["wall_s"] < 0.3 + time_limit.GRACE
    assert_knows_what_was_found(run)


def test_what_ignores_the_refusal_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_limit, "GRACE", 0.2)
    run = bench.execute(Bowl(), Looping(swallow), budget=10**9, time_limit=0.3)
    assert (run.status, run.stop_reason) == ("timeout", "timeout")
    assert run.evaluations > 11
    assert_knows_what_was_found(run)


def test_what_may_hang_is_ended_when_it_falls_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibench.bench.gate.time_limit.STALL_LIMIT", 0.3)
    run = bench.execute(Bowl(), Looping(hang, may_hang=True), budget=100)
    assert (run.status, run.stop_reason) == ("timeout", "timeout")
    assert "no evaluation in 0.3 s" in run.row["error"]
    assert_knows_what_was_found(run)


def test_a_process_that_dies_is_a_row() -> None:
    run = bench.execute(Bowl(), Looping(die), budget=100, time_limit=20)
    assert (run.status, run.row["error_type"]) == ("failed", "ProcessDied")
    assert str(-signal.SIGKILL) in run.row["error"]
    assert_knows_what_was_found(run)


@pytest.mark.parametrize("name", ["de", "lm", "nlopt_LD_SLSQP", "pygmo_cmaes"])
def test_a_limit_that_is_not_reached_changes_no_bit(name: str) -> None:
    problem = problems.make("full12", n=30)
    free = bench.execute(problem, optimizers.make(name), budget=900, seed=3)
    limited = bench.execute(problem, optimizers.make(name), budget=900, seed=3, time_limit=100)
    timing = {"wall_s", "cpu_s", "started_at"}
    assert {k: v for k, v in free.row.items() if k not in timing} == {
        k: v for k, v in limited.row.items() if k not in timing
    }
    assert free.points == limited.points


def test_an_exception_in_a_limited_run_is_the_same_row() -> None:
    def fail(_objective: Objective, _x: np.ndarray) -> None:
        raise ZeroDivisionError("by the optimiser")

    free, limited = (bench.execute(Bowl(), Looping(fail), budget=100, time_limit=t) for t in (None, 20))
    assert limited.status == "failed"
    assert [limited.row[k] for k in ("error_type", "error")] == ["ZeroDivisionError", "by the optimiser"]
    assert limited.points == free.points


def test_a_batch_is_counted_when_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    class Slow(Bowl):
        def batch(self, points: np.ndarray) -> np.ndarray:
            if len(points) == 7:
                time.sleep(60)
            return super().batch(points)

    class Batches:
        def minimize(self, objective: Objective, rng: np.random.Generator) -> Any:
            objective.batch(np.linspace([0.9, 0.9], [0.1, 0.1], 5))
            objective.batch(np.zeros((7, 2)))

    monkeypatch.setattr(time_limit, "GRACE", 0.1)
    run = bench.execute(Slow(), Batches(), budget=100, time_limit=0.2)
    assert (run.status, run.evaluations, run.row["best_evaluation"]) == ("timeout", 12, 5)


@pytest.mark.parametrize("limit", [0, -1, float("nan"), float("inf"), True, "60"])
def test_a_limit_that_is_no_time_is_refused(limit: Any) -> None:
    with pytest.raises(ValueError, match="time_limit="):
        bench.execute(Bowl(), optimizers.make("de"), budget=10, time_limit=limit)


def test_the_limit_is_no_part_of_the_id(tmp_path: Path) -> None:
    free, limited = (
        Spec("full12", {"n": 30}, "nlopt_LN_BOBYQA", {}, budget=60, repetition=0, time_limit=t).execute()
        for t in (None, 50.0)
    )
    assert free.run_id == limited.run_id


@pytest.mark.slow
def test_the_method_of_nlopt_that_hangs_is_ended() -> None:
    """On Rosenbrock's function LN_NEWUOA_BOUND loops in C at its end, without a call."""

    class Rosenbrock:
        lower, upper, start = np.full(12, -2.0), np.full(12, 2.5), np.full(12, -1.2)

        def __call__(self, x: np.ndarray) -> float:
            return float(100 * ((x[1:] - x[:-1] ** 2) ** 2).sum() + ((1 - x[:-1]) ** 2).sum())

    began = time.perf_counter()
    run = bench.execute(Rosenbrock(), optimizers.make("nlopt_LN_NEWUOA_BOUND"), budget=20_000, time_limit=2)
    assert time.perf_counter() - began < 10
    assert run.status == "timeout"
    assert 100 < run.evaluations < 20_000


def test_the_command_line_takes_a_limit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from calibench.bench.cli import main

    words = ["run", "problem=full12", "problem.n=30", "budget=10000000", "seeds=1", f"results={tmp_path}"]
    with pytest.raises(SystemExit) as ended:
        main([*words, "optimizer=nlopt_GN_ESCH", "time_limit=0.5"])
    assert ended.value.code == 1
    row = bench.ResultStore(tmp_path / "adhoc").runs().iloc[0]
    assert (row["status"], row["stop_reason"]) == ("timeout", "timeout")
    assert 0 < row["evaluations"] < 10_000_000
    with pytest.raises(SystemExit) as ended:
        main([*words, "optimizer=de", "time_limit=0"])
    assert ended.value.code == 2
    assert "time_limit=0: seconds above 0" in capsys.readouterr().err
