"""Laws of the gate: the budget is a wall, every call is counted once, scalar and batch leave the same record."""

import copy
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibench.bench.gate.evaluator import Evaluator
from calibench.optimizers.base import BudgetExhausted, Stop, TargetReached, TimeUp


class Sphere:
    """A counted sum of squares with residuals, Jacobian and batch."""

    def __init__(self, n=3):
        self.lower, self.upper, self.start = -np.ones(n), np.ones(n), np.full(n, 0.5)
        self.calls = self.jacobians = 0

    def __call__(self, x):
        self.calls += 1
        return float(x @ x)

    def residuals(self, x):
        self.calls += 1
        return np.array(x)

    def jacobian(self, x):
        self.jacobians += 1
        return np.eye(len(x))

    def batch(self, points):
        self.calls += len(points)
        return (points**2).sum(axis=1)


class Scalar(Sphere):
    batch = None


class Values:
    """Gives back a list of values, one a call."""

    lower, upper, start = np.zeros(1), np.ones(1), np.zeros(1)

    def __init__(self, values):
        self.values = list(values)

    def __call__(self, x):
        return self.values.pop(0)


def test_budget_is_a_wall_for_scalar_callers():
    problem = Sphere()
    gate = Evaluator(problem, budget=5)
    for _ in range(5):
        gate(problem.start)
    for _ in range(3):
        with pytest.raises(BudgetExhausted):
            gate(problem.start)
    assert problem.calls == gate.evaluations == gate.charged == 5
    assert gate.stopped == "budget"


@pytest.mark.parametrize("kind", [Sphere, Scalar])
def test_a_batch_is_cut_at_the_wall(kind):
    problem = kind()
    gate = Evaluator(problem, budget=7)
    points = np.linspace(-1, 1, 30).reshape(10, 3)
    with pytest.raises(BudgetExhausted):
        gate.batch(points)
    assert problem.calls == gate.evaluations == 7
    assert gate.best_value == (points[:7] ** 2).sum(axis=1).min()
    with pytest.raises(BudgetExhausted):
        gate.batch(points)
    assert problem.calls == 7


def test_a_jacobian_is_charged_its_dimension_and_refused_where_it_does_not_fit():
    problem = Sphere(n=4)
    gate = Evaluator(problem, budget=10)
    gate.residuals(problem.start)
    gate.jacobian(problem.start)
    assert (gate.evaluations, gate.jacobian_evaluations, gate.charged, gate.remaining) == (1, 1, 5, 5)
    gate.residuals(problem.start)
    gate.jacobian(problem.start)
    assert gate.remaining == 0
    with pytest.raises(BudgetExhausted):
        gate.residuals(problem.start)
    with pytest.raises(BudgetExhausted):
        gate.jacobian(problem.start)
    assert (problem.calls, problem.jacobians) == (2, 2)


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.one_of(st.floats(-5, 5), st.just(math.inf), st.just(math.nan)), min_size=1, max_size=120),
    st.integers(1, 130),
    st.integers(1, 13),
    st.one_of(st.none(), st.floats(-5, 5)),
)
def test_scalar_and_batch_callers_leave_the_same_record(values, budget, size, target):
    class Batched(Values):
        def batch(self, points):
            return np.array([self(x) for x in points])

    def record(problem, ask):
        gate = Evaluator(problem, budget, target=target, targets=[1.0, 0.0, -1.0])
        try:
            for first in range(0, len(values), size):
                ask(gate, np.zeros((len(values[first : first + size]), 1)))
        except Stop:
            pass
        gate.close()
        return gate

    one = record(Values(values), lambda gate, points: [gate(x) for x in points])
    many = record(Batched(values), lambda gate, points: gate.batch(points))
    if one.stopped != "target":  # a batch that holds the target has been evaluated, and is counted, whole
        assert one.trace == many.trace
        assert (one.evaluations, one.non_finite, one.stopped) == (many.evaluations, many.non_finite, many.stopped)
    assert (one.best_value, one.best_evaluation, one.hits) == (many.best_value, many.best_evaluation, many.hits)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_worst_and_counted(bad):
    gate = Evaluator(Values([bad, 3.0, bad, 2.0]), budget=10)
    assert [gate(np.zeros(1)) for _ in range(4)] == [math.inf, 3.0, math.inf, 2.0]
    assert (gate.non_finite, gate.best_value, gate.evaluations) == (2, 2.0, 4)


@pytest.mark.parametrize(
    ("value", "word"), [(1j, "complex"), (np.ones(2), "array"), ("a", "str"), (None, "NoneType"), ([1.0], "list")]
)
def test_an_answer_that_is_no_number_says_so(value, word):
    with pytest.raises(TypeError, match=word):
        Evaluator(Values([value]), budget=10)(np.zeros(1))


def test_residuals_and_slopes_of_a_wrong_shape_say_so():
    class Odd(Sphere):
        def residuals(self, x):
            return np.zeros((2, 2))

        def jacobian(self, x):
            return np.zeros((len(x), 7))

    with pytest.raises(TypeError, match=r"shape \(2, 2\)"):
        Evaluator(Odd(), budget=10).residuals(np.zeros(3))
    with pytest.raises(ValueError, match=r"shape \(3, 7\)"):
        Evaluator(Odd(), budget=10).jacobian(np.zeros(3))


def test_a_problem_that_fills_the_same_array_again_changes_no_earlier_result():
    """A method that takes differences of residuals would see none, and end at its start as converged."""

    class Buffered(Sphere):
        def __init__(self):
            super().__init__()
            self.r, self.slopes = np.zeros(3), np.zeros((3, 3))

        def residuals(self, x):
            self.r[:] = x - 1.0
            return self.r

        def jacobian(self, x):
            self.slopes[:] = np.diag(x)
            return self.slopes

    gate = Evaluator(Buffered(), budget=100)
    for ask in (gate.residuals, gate.jacobian):
        first = ask(np.full(3, 0.25))
        before = first.copy()
        ask(np.full(3, 0.5))
        assert np.array_equal(first, before)


def test_the_target_ends_the_run_and_hits_are_exact():
    gate = Evaluator(Values([9.0, 5.0, 7.0, 0.5, 0.1]), budget=10, target=1.0, targets=[6.0, 1.0])
    assert [gate(np.zeros(1)) for _ in range(3)] == [9.0, 5.0, 7.0]
    with pytest.raises(TargetReached):
        gate(np.zeros(1))
    assert gate.hits == [2, 4]
    assert gate.stopped == "target"


def test_residuals_that_are_not_finite_come_back_large_and_count_once():
    class Broken(Sphere):
        def residuals(self, x):
            return np.array([np.nan, np.inf, 1.0])

    gate = Evaluator(Broken(), budget=10)
    r = gate.residuals(np.zeros(3))
    assert np.isfinite(r).all()
    assert np.abs(r).max() > 1e99
    assert (gate.non_finite, gate.best_value) == (1, math.inf)


def test_the_trace_has_first_and_last_and_does_not_grow_with_the_budget():
    def falling(count):
        gate = Evaluator(Values(1.0 / np.arange(1, count + 1)), budget=count)
        for _ in range(count):
            gate(np.zeros(1))
        gate.close()
        return gate.trace

    short, long = falling(1000), falling(20_000)
    assert short[0][:3] == (1, 1, 1.0)
    assert long[-1][:3] == (20_000, 20_000, 1 / 20_000)
    assert len(long) < 400
    assert all(a[0] < b[0] and a[2] >= b[2] for a, b in pairwise(long))


def test_a_point_of_the_trace_stands_at_what_it_cost_when_it_was_reached():
    problem = Sphere(n=4)
    gate = Evaluator(problem, budget=100)
    for x in (np.full(4, 0.5), np.full(4, 0.25)):
        gate.residuals(x)
        gate.jacobian(x)
    gate.close()
    assert [point[:3] for point in gate.trace] == [(1, 1, 1.0), (2, 6, 0.25)]
    assert gate.charged == 10


def test_the_best_point_is_a_copy():
    gate = Evaluator(Sphere(), budget=10)
    x = np.full(3, 0.25)
    gate(x)
    x[:] = 9
    assert gate.best_x.tolist() == [0.25] * 3


def test_a_copy_of_the_gate_is_the_gate():
    gate = Evaluator(Sphere(), budget=10)
    assert copy.deepcopy(gate) is gate
    assert copy.copy(gate) is gate


def test_bounds_cannot_be_written_by_an_optimiser():
    gate = Evaluator(Sphere(), budget=10)
    with pytest.raises(ValueError, match="read-only"):
        gate.lower[0] = -9


def test_the_kernel_and_the_problem_give_the_gate_the_same_record():
    from calibench import problems

    class Slow:
        """The same problem without its kernel, and not trusted."""

        def __init__(self, problem):
            self.lower, self.upper, self.start = problem.lower, problem.upper, problem.start
            self.problem = problem

        def __call__(self, x):
            return self.problem(x)

        def batch(self, points):
            return self.problem.batch(points).tolist()

    problem = problems.make("full12", error="J3")
    points = problem.lower + np.random.default_rng(0).random((300, 12)) * (problem.upper - problem.lower)
    records = []
    for case in (problem, Slow(problem)):
        gate = Evaluator(case, budget=400, targets=problem.targets)
        for x in points[:150]:
            gate(x)
        gate.batch(points[150:])
        with pytest.raises(BudgetExhausted):
            gate.batch(points)
        records.append((gate.best_value, gate.best_x.tolist(), gate.evaluations, gate.trace, gate.hits))
    assert records[0] == records[1]


@pytest.mark.parametrize("odd", [list, tuple, lambda x: np.repeat(x, 2)[::2], np.float32])
def test_a_point_that_the_kernel_does_not_take_is_evaluated_all_the_same_and_once(odd):
    from calibench import problems

    problem = problems.make("full12", error="J3")
    gate = Evaluator(problem, budget=10)
    x = odd(problem.start.copy())
    assert gate(x) == problem(np.array(x, dtype=float))
    assert gate.evaluations == 1


def test_an_exception_of_the_objective_comes_through_after_one_call():
    class Broken(Sphere):
        def __call__(self, x):
            self.calls += 1
            raise TypeError("mine")

    problem = Broken()
    gate = Evaluator(problem, budget=10)
    with pytest.raises(TypeError, match="mine"):
        gate(problem.start)
    assert problem.calls == gate.evaluations == 1


def test_a_batch_of_a_plain_class_is_asked_by_one_function_for_all_its_points(monkeypatch):
    made, make = [], Evaluator.single_call

    def counted(gate):
        made.append(gate)
        return make(gate)

    monkeypatch.setattr(Evaluator, "single_call", counted)
    gate = Evaluator(Scalar(), budget=100)
    assert gate.batch(np.ones((40, 3))).tolist() == [3.0] * 40 == [gate(np.ones(3)) for _ in range(40)]
    assert len(made) == 1


def test_a_value_that_is_not_finite_hides_no_improvement_of_its_batch():
    values = [9.0, math.nan, 5.0, math.inf, 7.0, -math.inf, 4.0]

    class Batched(Values):
        def batch(self, points):
            return np.array(self.values)

    gate = Evaluator(Batched(values), budget=10**6)
    for _ in range(3):  # so that the wall, and no mark of the trace, is near
        gate.batch(np.zeros((len(values), 1)))
    assert gate.batch(np.zeros((len(values), 1))).tolist() == [9.0, math.inf, 5.0, math.inf, 7.0, math.inf, 4.0]
    assert (gate.best_value, gate.best_evaluation, gate.non_finite) == (4.0, 7, 12)


def test_a_watcher_sees_each_call_and_whatever_else_has_changed_with_the_next_one():
    published, count = [], [0.0]
    gate = Evaluator(Sphere(), budget=1000)
    gate.refuse_after(math.inf, lambda told, n: published.append((n, told.restarts, told.outside_evaluations)), count)
    call = gate.single_call()
    for n in range(1, 201):
        call(np.full(3, 0.5 + n / 1000))
        assert max(count[0], published[-1][0]) == n
    assert len(published) < 100  # a call that changes nothing else writes one number
    gate.restart()
    call(np.ones(3))
    assert published[-1] == (201, 1, None)
    gate.note_outside(1)
    call(np.ones(3))
    assert published[-1] == (202, 1, 1)
    gate.batch(np.ones((3, 3)))
    call(np.ones(3))
    assert published[-1][0] == 206


def test_a_watched_run_keeps_its_budget_and_its_time():
    gate = Evaluator(Scalar(), budget=150)
    gate.refuse_after(math.inf, lambda _, n: None, [0.0])
    for _ in range(150):
        gate(gate.start)
    with pytest.raises(BudgetExhausted):
        gate(gate.start)
    assert (gate.evaluations, gate.charged) == (150, 150)
    late = Evaluator(Scalar(), budget=1000)
    late.refuse_after(math.inf, lambda _, n: None, [0.0])
    for _ in range(70):
        late(late.start)
    late.deadline = -math.inf
    with pytest.raises(TimeUp):
        late(late.start)
    assert (late.evaluations, late.stopped) == (70, "timeout")
