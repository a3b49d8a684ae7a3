"""No optimiser gets an evaluation too many, whatever it catches, copies, sets or starts; the row tells."""

from __future__ import annotations

import copy
import itertools
import os
import pickle
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from calibench import bench
from calibench.optimizers.base import Stop

BUDGET = 40


class Counted:
    """A bowl that counts the points it was asked for, whoever asks, in this process."""

    lower, upper, start = np.full(3, -1.0), np.full(3, 1.0), np.full(3, 0.5)

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, x: np.ndarray) -> float:
        self.calls += 1
        return float(x @ x)

    def batch(self, points: np.ndarray) -> np.ndarray:
        self.calls += len(points)
        return (points**2).sum(axis=1)  # type: ignore[no-any-return]

    def residuals(self, x: np.ndarray) -> np.ndarray:
        self.calls += 1
        return x


class Cheat:
    """Spend something, cheat, whatever comes of it, and then call as if there were no budget."""

    def __init__(self, trick: Callable[[Any], object]) -> None:
        self.trick, self.options = trick, {"trick": trick.__name__}

    def minimize(self, objective: Any, rng: np.random.Generator) -> Any:
        for _ in range(5):
            objective(rng.uniform(-1, 1, 3))
        try:
            self.trick(objective)
        except Exception:
            pass
        calls = 0
        for _ in range(3 * BUDGET):
            try:
                objective(rng.uniform(-1, 1, 3))
                calls += 1
            except Stop:
                pass
            except RuntimeError:
                break


def set_budget(o: Any) -> None:
    o.budget = 10**9


def delete_evaluations(o: Any) -> None:
    del o.evaluations


def begin_a_count_of_its_own(o: Any) -> None:
    o.evaluations = 0


def keep_a_cache_in_it(o: Any) -> None:
    o.cache = {}


def wrap_its_call(o: Any) -> None:
    o.__call__ = lambda x: 0.0


def make_it_another_class(o: Any) -> None:
    o.__class__ = Method


def pickle_it(o: Any) -> None:
    other = pickle.loads(pickle.dumps(o))
    for _ in range(3 * BUDGET):
        other(np.zeros(3))


def write_start(o: Any) -> None:
    for array in (o.start, o.lower, o.upper):
        array.flags.writeable = True
        array[:] = 100.0


def write_trace(o: Any) -> None:
    o.trace.append((1, 1, -1.0, 0))


def swallow(function: Callable[..., object], *arguments: Any) -> None:
    try:
        function(*arguments)
    except Exception:
        pass


NOTED = {
    set_budget: "set budget", delete_evaluations: "delete evaluations", begin_a_count_of_its_own: "set evaluations",
    keep_a_cache_in_it: "set cache", wrap_its_call: "set __call__", make_it_another_class: "set __class__",
    pickle_it: "pickle", write_start: "", write_trace: "",  # Python and NumPy refuse by themselves
}  # fmt: skip


@pytest.mark.parametrize("trick", NOTED, ids=lambda trick: trick.__name__)
def test_none_spends_a_call_more_and_each_is_noted(trick: Any) -> None:
    problem = Counted()
    run = bench.execute(problem, Cheat(trick), budget=BUDGET)
    assert problem.calls == run.evaluations == run.charged == BUDGET
    assert (run.row["budget"], run.status, run.stop_reason) == (BUDGET, "ok", "budget")
    assert run.best_value == float(run.best_x @ run.best_x)  # type: ignore[operator]
    assert run.row["tampering"] == NOTED[trick]


class Method:
    """An optimiser of one function."""

    def __init__(self, minimize: Callable[[Any], object]) -> None:
        self.options = {"method": minimize.__name__}
        self._minimize = minimize

    def minimize(self, objective: Any, rng: np.random.Generator) -> Any:
        self._minimize(objective)


class Short(np.ndarray):
    """An array that says it has one row."""

    def __len__(self) -> int:
        return 1

    @property
    def shape(self) -> Any:
        return (1, 3)


def test_a_batch_is_as_long_as_it_is() -> None:
    problem = Counted()
    points = np.zeros((3 * BUDGET, 3)).view(Short)
    run = bench.execute(problem, Method(lambda o: o.batch(points)), budget=BUDGET)
    assert problem.calls == run.evaluations == BUDGET


@pytest.mark.parametrize("points", [np.zeros(3), np.zeros((2, 4)), np.zeros((1, 2, 3)), [[0.0]], 3.0])
def test_points_of_another_shape_cost_nothing_and_say_so(points: Any) -> None:
    problem = Counted()
    run = bench.execute(problem, Method(lambda o: o.batch(points)), budget=BUDGET)
    assert (problem.calls, run.evaluations, run.status) == (0, 0, "failed")
    assert "shape" in run.row["error"]


@pytest.mark.parametrize("x", [np.zeros((5, 3)), np.zeros(2), 0.0])
def test_a_point_of_another_shape_costs_nothing_and_says_so(x: Any) -> None:
    problem = Counted()
    for ask in (lambda o: o(x), lambda o: o.residuals(x)):
        run = bench.execute(problem, Method(ask), budget=BUDGET)
        assert (problem.calls, run.evaluations, run.status) == (0, 0, "failed")
        assert "a point of shape (3,)" in run.row["error"]


class Tickets:
    """Each value is one lower than the last: the best one tells how many calls there were, in whatever process."""

    lower, upper, start, side_effect_free = np.zeros(1), np.ones(1), np.zeros(1), True

    def __init__(self) -> None:
        self._next = itertools.count(1).__next__

    def __call__(self, x: np.ndarray) -> float:
        return -float(self._next())


@pytest.mark.parametrize("limit", [None, 20.0])
def test_threads_lose_no_call(limit: float | None) -> None:
    def work(o: Any) -> None:
        with suppress(Stop):
            while True:
                o(o.start)

    def many(o: Any) -> None:
        sys.setswitchinterval(1e-7)
        threads = [threading.Thread(target=work, args=(o,)) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    before = sys.getswitchinterval()
    try:
        run = bench.execute(Tickets(), Method(many), budget=3_000, time_limit=limit)
    finally:
        sys.setswitchinterval(before)
    assert (run.evaluations, run.best_value) == (3_000, -3_000.0)
    assert [point[0] for point in run.points] == sorted({point[0] for point in run.points})


def test_threads_with_batches_and_jacobians_keep_the_wall() -> None:
    class Linear(Counted):
        def jacobian(self, x: np.ndarray) -> np.ndarray:
            return np.eye(3)

    calls: list[int] = []

    def work(o: Any) -> None:
        try:
            while True:
                calls.append(len(o.batch(np.zeros((7, 3)))))
                calls.append(len(o.jacobian(np.zeros(3))))
                o(np.zeros(3))
                calls.append(1)
        except Stop:
            pass

    def many(o: Any) -> None:
        threads = [threading.Thread(target=work, args=(o,)) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-7)
    try:
        run = bench.execute(Linear(), Method(many), budget=5_000)
    finally:
        sys.setswitchinterval(before)
    assert sum(calls) <= run.charged <= 5_000
    assert [point[0] for point in run.points] == sorted({point[0] for point in run.points})


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.parametrize("limit", [None, 20.0])
def test_a_forked_process_gets_no_evaluation(limit: float | None) -> None:
    def fork(o: Any) -> None:
        o(np.zeros(3))
        ours, theirs = os.pipe()
        child = os.fork()
        if child == 0:
            told = b"nothing"
            try:
                o(np.zeros(3))
            except RuntimeError:
                told = b"refused"
            os.write(theirs, told)
            os._exit(0)
        os.waitpid(child, 0)
        if os.read(ours, 10) != b"refused":
            raise AssertionError("the child was not refused")
        o(np.zeros(3))

    run = bench.execute(Counted(), Method(fork), budget=BUDGET, time_limit=limit)
    assert (run.status, run.evaluations) == ("ok", 2)


def test_nothing_is_evaluated_after_the_end() -> None:
    kept: list[Any] = []
    problem = Counted()
    run = bench.execute(problem, Method(lambda o: (kept.append(o), o(np.zeros(3)))), budget=BUDGET)
    with pytest.raises(Stop):
        kept[0](np.zeros(3))
    assert problem.calls == run.evaluations == 1
    assert kept[0].remaining == BUDGET - 1


def test_a_copy_counts_with_the_original() -> None:
    problem = Counted()

    def copies(o: Any) -> None:
        for _ in range(BUDGET):
            copy.copy(o)(np.zeros(3))
            copy.deepcopy([o])[0](np.zeros(3))

    run = bench.execute(problem, Method(copies), budget=BUDGET)
    assert (problem.calls, run.evaluations, run.row["tampering"]) == (BUDGET, BUDGET, "")


def test_what_was_tried_is_told_of_a_run_that_had_to_be_killed() -> None:
    def cheat_and_die(o: Any) -> None:
        o(np.zeros(3))
        swallow(setattr, o, "budget", 10**9)
        os.kill(os.getpid(), 9)

    run = bench.execute(Counted(), Method(cheat_and_die), budget=BUDGET, time_limit=20)
    assert (run.row["error_type"], run.row["tampering"]) == ("ProcessDied", "set budget")
