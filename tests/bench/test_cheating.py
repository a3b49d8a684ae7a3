"""Optimisers that cheat: none gets an evaluation more than it was given, and the row names what each tried."""

from __future__ import annotations

import copy
import gc
import inspect
import itertools
import os
import pickle
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from calibench import bench
from calibench.bench.gate import evaluator
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


def set_evaluations(o: Any) -> None:
    o.evaluations = 0


def set_best_value(o: Any) -> None:
    o.best_value = -1.0


def delete_evaluations(o: Any) -> None:
    del o.evaluations


def set_by_object(o: Any) -> None:
    object.__setattr__(o, "budget", 10**9)


def delete_by_object(o: Any) -> None:
    object.__delattr__(o, "budget")


def write_dict(o: Any) -> None:
    vars(o)["budget"] = 10**9
    o.__dict__["evaluations"] = 0


def become_another(o: Any) -> None:
    class Free:
        remaining = 10**9

    o.__class__ = Free


def become_another_by_object(o: Any) -> None:
    object.__setattr__(o, "__class__", evaluator.Evaluator)


def begin_anew(o: Any) -> None:
    o.__init__(Counted(), 10**9)


def begin_anew_by_class(o: Any) -> None:
    type(o).__init__(o, Counted(), 10**9)


def restore_state(o: Any) -> None:
    o.__setstate__({"evaluations": 0})


def restore_gate(o: Any) -> None:
    o.restore({"evaluations": 0})


def watch_gate(o: Any) -> None:
    o.refuse_after(1e18, lambda gate, n: setattr(gate, "evaluations", 0))


def pickled(o: Any) -> None:
    other = pickle.loads(pickle.dumps(o))
    for _ in range(3 * BUDGET):
        other(np.zeros(3))


def private_names(o: Any) -> None:
    o._next_event = 10**9


def read_private_names(o: Any) -> None:
    for _ in range(3 * BUDGET):
        o._function(np.zeros(3), None)


def method_self(o: Any) -> None:
    o.batch.__self__.budget = 10**9


def replace_method(o: Any) -> None:
    o.__call__ = lambda x: 0.0


def replace_on_class(o: Any) -> None:
    type(o).remaining = 10**9


def replace_on_class_by_type(o: Any) -> None:
    type.__setattr__(type(o), "remaining", 10**9)


def delete_on_class(o: Any) -> None:
    del type(o).budget


def write_start(o: Any) -> None:
    for array in (o.start, o.lower, o.upper):
        array.flags.writeable = True
        array[:] = 100.0


def write_trace(o: Any) -> None:
    o.trace.append((1, 1, -1.0, 0))


def patch_gate(o: Any) -> None:
    evaluator.Evaluator._exhausted = lambda self: None  # type: ignore[method-assign]


def patch_schedule(o: Any) -> None:
    evaluator.Evaluator._admit = lambda self: 1  # type: ignore[method-assign]


def patch_names(o: Any) -> None:
    evaluator.BudgetExhausted = StopIteration  # type: ignore[misc]
    evaluator.min = lambda *_: 10**9  # type: ignore[attr-defined]


def find_by_gc(o: Any) -> None:
    for found in gc.get_objects():
        if type(found).__name__ == "Evaluator":
            found.budget = 10**9


def follow_gc(o: Any) -> None:
    gc.get_referents(o.batch)[0].__self__.budget = 10**9


def climb_frames(o: Any) -> None:
    frame = sys._getframe()
    while frame is not None:
        if "gate" in frame.f_locals:
            frame.f_locals["gate"].budget = 10**9
        frame = frame.f_back  # type: ignore[assignment]


def climb_by_inspect(o: Any) -> None:
    for record in inspect.stack():
        if "gate" in record.frame.f_locals:
            record.frame.f_locals["gate"].budget = 10**9


def read_traceback(o: Any) -> None:
    try:
        o("nonsense")
    except Exception as error:
        frame = error.__traceback__.tb_next.tb_frame  # type: ignore[union-attr]
        frame.f_locals["self"].budget = 10**9


def walk_traceback(o: Any) -> None:
    try:
        o("nonsense")
    except Exception as error:
        for frame, _ in traceback.walk_tb(error.__traceback__):
            if "self" in frame.f_locals:
                frame.f_locals["self"].budget = 10**9


def from_a_thread(o: Any) -> None:
    thread = threading.Thread(target=swallow, args=(climb_frames, o))
    thread.start()
    thread.join()
    swallow(lambda: [f.f_locals["gate"] for f in sys._current_frames().values()])


def trace_calls(o: Any) -> None:
    sys.settrace(lambda frame, event, argument: None)


def shadow_count(o: Any) -> None:
    o.cache = {}


def swallow(function: Callable[..., object], *arguments: Any) -> None:
    try:
        function(*arguments)
    except Exception:
        pass


NAMED = {
    set_budget: "set budget", set_evaluations: "set evaluations", set_best_value: "set best_value",
    delete_evaluations: "delete evaluations", set_by_object: "set by object.__setattr__",
    delete_by_object: "delete by object.__delattr__",
    write_dict: "set budget", become_another: "set __class__", become_another_by_object: "set by object.__setattr__",
    begin_anew: "call __init__", begin_anew_by_class: "call __init__", restore_state: "call __setstate__",
    restore_gate: "ask for restore", watch_gate: "ask for refuse_after", pickled: "call __reduce_ex__",
    private_names: "set _next_event", read_private_names: "ask for _function", replace_method: "set __call__",
    replace_on_class: "set remaining of the class", replace_on_class_by_type: "replace remaining",
    delete_on_class: "delete budget of the class", patch_gate: "replace _exhausted", patch_schedule: "replace _admit",
    patch_names: "replace BudgetExhausted", find_by_gc: "use gc.get_objects", follow_gc: "use gc.get_referents",
    climb_frames: "use sys._getframe", climb_by_inspect: "use sys._getframe", read_traceback: "use tb_frame",
    walk_traceback: "use tb_frame", from_a_thread: "use sys._current_frames", trace_calls: "use sys.settrace",
    shadow_count: "set cache",
    method_self: "", write_start: "", write_trace: "",  # Python and NumPy refuse by themselves
}  # fmt: skip


@pytest.mark.parametrize("trick", NAMED, ids=lambda trick: trick.__name__)
def test_none_spends_a_call_more_and_each_is_named(trick: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_exhausted", "_admit"):
        monkeypatch.setattr(evaluator.Evaluator, name, vars(evaluator.Evaluator)[name])  # put back after the test
    monkeypatch.setattr(evaluator, "BudgetExhausted", evaluator.BudgetExhausted)
    monkeypatch.setattr(evaluator, "min", min, raising=False)
    problem = Counted()
    run = bench.execute(problem, Cheat(trick), budget=BUDGET)
    assert problem.calls == run.evaluations == run.charged == BUDGET
    assert (run.row["budget"], run.status, run.stop_reason) == (BUDGET, "ok", "budget")
    assert run.best_value == float(run.best_x @ run.best_x)  # type: ignore[operator]
    assert NAMED[trick] in run.row["tampering"].split("; ")


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
    assert (run.status, run.evaluations, run.row["tampering"]) == ("ok", 2, "called from a forked process")


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


def test_honest_code_may_look_at_frames_and_its_problem_too() -> None:
    class Looks(Counted):
        def __call__(self, x: np.ndarray) -> float:
            assert sys._getframe().f_code.co_name == "__call__"
            return super().__call__(x)

    def honest(o: Any) -> None:
        import logging

        logging.getLogger("calibench.test").debug("a line")
        try:
            raise KeyError
        except KeyError:
            assert "KeyError" in traceback.format_exc()
        o(o.start)

    run = bench.execute(Looks(), Method(honest), budget=BUDGET)
    assert (run.status, run.row["tampering"]) == ("ok", "")
