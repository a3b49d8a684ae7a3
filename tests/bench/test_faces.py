"""The face that a method sees of the gate, and the points outside the box that a row counts."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from calibench import bench, optimizers
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.face import COPIES, FIXED, METHODS, NUMBERS, doors_of, face_of
from tests.bench.test_cheating import BUDGET, Counted, Method


def test_a_face_shows_what_the_gate_knows() -> None:
    told: dict[str, Any] = {}

    def look(o: Any) -> None:
        o.batch(np.array([[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]]))
        for name in ("budget", "evaluations", "remaining", "charged", "best_value", "dimension", "trace", "restarts"):
            told[name] = getattr(o, name)
        told["best_x"], told["lower"] = o.best_x.tolist(), o.lower.tolist()

    bench.execute(Counted(), Method(look), budget=BUDGET)
    assert told == {
        "budget": BUDGET, "evaluations": 2, "remaining": BUDGET - 2, "charged": 2, "best_value": 0.0, "dimension": 3,
        "trace": ((1, 1, 0.25, 0), (2, 2, 0.0, 0)), "restarts": 0, "best_x": [0.0] * 3, "lower": [-1.0] * 3,
    }  # fmt: skip


def test_a_face_has_all_that_is_promised_and_cannot_be_set() -> None:
    gate = Evaluator(Counted(), BUDGET, start=np.zeros(3), targets=[1.0, 0.5])
    face: Any = face_of(gate, doors_of(gate))
    face(np.array([0.5, 0.0, 0.0]))
    assert {*NUMBERS, *COPIES, *FIXED, *METHODS} == set(dir(face))
    for name in (*NUMBERS, *COPIES, *FIXED):
        np.testing.assert_array_equal(getattr(face, name), getattr(gate, name))
    assert copy.deepcopy(face) is face
    for name in ("budget", "evaluations", "new"):
        with pytest.raises(AttributeError):
            setattr(face, name, 0)


def outside(o: Any) -> None:
    just = np.nextafter(o.upper, np.inf)  # one ulp is a rounding
    for x in (o.start, just, just + 1e-9, np.full(3, np.nan), np.array([0.0, np.inf, 0.0])):
        o(x)
    o.batch(np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]]))
    o.residuals(np.array([-1.5, 0.0, 0.0]))
    o.batch(np.full((2 * BUDGET, 3), 7.0))


def test_points_outside_the_box_are_told() -> None:
    run = bench.execute(Counted(), Method(outside), budget=BUDGET)
    assert run.row["outside_evaluations"] == 3 + 2 + 1 + (BUDGET - 9)
    inside = bench.execute(Counted(), Method(lambda o: o(o.start)), budget=BUDGET)
    assert inside.row["outside_evaluations"] == 0


def test_points_outside_an_open_box_are_those_that_are_not_finite() -> None:
    class Open(Counted):
        lower, upper = np.full(3, -np.inf), np.full(3, np.inf)

    run = bench.execute(Open(), Method(lambda o: (o(np.full(3, 1e100)), o(np.full(3, np.inf)))), budget=BUDGET)
    assert run.row["outside_evaluations"] == 1


def test_ours_are_looked_at_where_their_trait_says_unbounded() -> None:
    for name in ("de", "lm"):
        run = bench.execute(Counted(), optimizers.make(name), budget=BUDGET)
        counted = run.row["outside_evaluations"] is not None
        assert counted is not optimizers.make(name).traits.bounded


@pytest.mark.parametrize("wrong", [None, 1j, "3", np.zeros(2), TypeError("of the problem's own")])
def test_a_value_of_a_wrong_kind_ends_the_run_and_is_not_asked_again(wrong: Any) -> None:
    class Once:
        lower, upper, start = -np.ones(3), np.ones(3), np.zeros(3)
        calls = 0

        def __call__(self, x: Any) -> Any:
            self.calls += 1
            if self.calls == 3 and isinstance(wrong, TypeError):
                raise wrong
            return wrong if self.calls == 3 else float(x @ x)

    def walk(o: Any) -> None:
        for k in range(6):
            o(np.full(3, 0.1 * k))

    problem = Once()
    run = bench.execute(problem, Method(walk), budget=BUDGET)
    assert (run.status, run.error_type, run.evaluations, problem.calls) == ("failed", "TypeError", 3, 3)
