"""A problem's own gradient: gradient methods ask for it; it is charged as a Jacobian, and priced as measured."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from calibench import bench, optimizers
from calibench.bench.gate.evaluator import BudgetExhausted, Evaluator
from calibench.bench.statistics.summary import priced
from tests.few import one_of_each

METHODS = [
    name
    for name in optimizers.names()
    if optimizers.make(name).traits.uses_gradient and not optimizers.make(name).traits.uses_residuals
]
DIMENSION = 4


class Chain:
    """Rosenbrock's function in pairs, with its gradient; counts its calls."""

    def __init__(self, dimension: int = DIMENSION) -> None:
        self.dimension = dimension
        self.lower, self.upper = np.full(dimension, -2.0), np.full(dimension, 2.5)
        self.start = np.tile([-1.2, 1.0], dimension // 2)
        self.calls: list[str] = []

    def __call__(self, x: np.ndarray) -> float:
        self.calls.append("value")
        return self._value(x)

    def _value(self, x: np.ndarray) -> float:
        return float(np.sum(100 * (x[1::2] - x[::2] ** 2) ** 2 + (1 - x[::2]) ** 2))

    def _slopes(self, x: np.ndarray) -> np.ndarray:
        slopes = np.empty(self.dimension)
        slopes[::2] = -400 * x[::2] * (x[1::2] - x[::2] ** 2) - 2 * (1 - x[::2])
        slopes[1::2] = 200 * (x[1::2] - x[::2] ** 2)
        return slopes


class Sloped(Chain):
    def gradient(self, x: np.ndarray) -> np.ndarray:
        self.calls.append("gradient")
        return self._slopes(x)


class AtOnce(Chain):
    def value_and_gradient(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        self.calls.append("both")
        return self._value(x), self._slopes(x)


class OfResiduals(Sloped):
    def residuals(self, x: np.ndarray) -> np.ndarray:
        self.calls.append("residuals")
        return np.concatenate([10 * (x[1::2] - x[::2] ** 2), 1 - x[::2]])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        raise AssertionError("its gradient is there")


@pytest.mark.parametrize("problem", [Sloped, AtOnce, OfResiduals])
@pytest.mark.parametrize("name", one_of_each(METHODS))
def test_every_gradient_method_asks_for_the_gradient_and_pays_as_for_a_jacobian(name: str, problem: Any) -> None:
    asked = problem()
    method = optimizers.make(name, **({"n": 10} if name == "scipy_shgo" else {}))
    run = bench.execute(asked, method, budget=300)
    assert run.status == "ok", run.row["error"]
    if not method.traits.may_hang:  # what may hang runs in a child: its calls are not seen here
        values, both = asked.calls.count("value"), asked.calls.count("both")
        assert (run.evaluations, run.row["gradient_evaluations"]) == (
            values + run.row["joint_evaluations"],
            asked.calls.count("gradient") + both,
        )
    assert run.row["jacobian_evaluations"] == run.row["gradient_evaluations"] > 0
    assert run.charged == run.evaluations + DIMENSION * run.row["gradient_evaluations"] <= 300


@pytest.mark.parametrize("budget", [1, 4, 5, 6, 11])
def test_a_gradient_beyond_the_budget_is_never_made(budget: int) -> None:
    asked = AtOnce()
    gate = Evaluator(asked, budget)
    for _ in range(budget // (1 + DIMENSION)):
        gate.value_and_gradient(asked.start)
    with pytest.raises(BudgetExhausted):
        gate.value_and_gradient(asked.start)
    assert gate.charged == len(asked.calls) * (1 + DIMENSION) <= budget
    assert gate.stopped == "budget"


def test_a_value_with_its_gradient_is_the_best_like_any_other() -> None:
    asked = AtOnce()
    gate = Evaluator(asked, 100)
    value, slopes = gate.value_and_gradient(asked.start)
    assert (gate.best_value, gate.best_x.tolist()) == (value, asked.start.tolist())
    assert slopes.tolist() == asked._slopes(asked.start).tolist()
    assert (gate.evaluations, gate.joint_evaluations, gate.gradient_evaluations, asked.calls) == (1, 1, 1, ["both"])
    assert gate.gradient(asked.start).tolist() == slopes.tolist()  # alone, by the same call
    assert (gate.charged, gate.joint_evaluations, gate.gradient_evaluations) == (1 + 2 * DIMENSION, 1, 2)


@pytest.mark.parametrize(
    ("way", "given", "said"),
    [
        ("gradient", lambda x: np.zeros((1, 4)), r"gradient returned a gradient of shape (1, 4): (4,) is needed"),
        ("gradient", lambda x: 0.0, "gradient returned a gradient of shape (): (4,) is needed"),
        ("gradient", lambda x: 1j * x, "complex numbers: real ones are needed"),
        ("value_and_gradient", lambda x: x, "value_and_gradient returned ndarray: a value and an array are needed"),
        ("value_and_gradient", lambda x: (x, x), "the objective returned an array of shape (4,): one number"),
        ("value_and_gradient", lambda x: (1.0, x[:2]), "of shape (2,): (4,) is needed"),
    ],
)
def test_a_wrong_gradient_is_a_failed_row_and_one_sentence(way: str, given: Any, said: str) -> None:
    wrong = type("Wrong", (Chain,), {way: lambda self, x: given(x)})()
    run = bench.execute(wrong, optimizers.make("scipy_l_bfgs_b"), budget=50)
    assert run.status == "failed"
    assert said in run.error
    assert "\n" not in run.error


def test_slopes_that_are_not_finite_are_zero() -> None:
    for way in ("gradient", "value_and_gradient"):
        answer = np.array([1.0, np.nan, np.inf, 2.0])
        given = answer if way == "gradient" else (3.0, answer)
        gate = Evaluator(type("Edge", (Chain,), {way: lambda self, x, given=given: given})(), 100)
        assert gate.gradient(gate.start).tolist() == [1.0, 0.0, 0.0, 2.0]


def test_a_watched_run_and_a_replayed_one_are_the_same(tmp_path: Any) -> None:
    from calibench.bench.execution.costly import ReplayFolder

    for kind in (Sloped, AtOnce):
        plain, watched, kept = (
            bench.execute(kind(), optimizers.make("scipy_l_bfgs_b"), budget=200, **options).row
            for options in ({}, {"time_limit": 60.0}, {"replay": ReplayFolder(tmp_path, always=True)})
        )
        again = kind()
        bench.execute(again, optimizers.make("scipy_l_bfgs_b"), budget=200, replay=ReplayFolder(tmp_path, always=True))
        assert again.calls == []  # as if the first had been killed after its last call
        for column in ("best_x", "charged", "gradient_evaluations", "joint_evaluations"):
            assert plain[column] == watched[column] == kept[column]


def test_in_200_dimensions_a_gradient_saves_nine_tenths_of_the_objectives_time() -> None:
    """By counts: a gradient as long as three values, and the values that stand for it as differences."""
    record = {"problem": "chain", "problem_options": "{}", "data_id": "", "value_s": 1.0, "gradient_s": 3.0}
    rows = []
    for kind in (Chain, Sloped):
        run = bench.execute(
            kind(200), optimizers.make("scipy_l_bfgs_b"), budget=50_000, target=1e-6, problem_name="chain"
        )
        assert run.stop_reason == "target"
        rows.append(run.row | {"problem_options": "{}", "data_id": ""})
    differences, own = priced(pd.DataFrame(rows), [record])
    assert own < differences / 10
    assert rows[1]["charged"] == rows[1]["evaluations"] + 200 * rows[1]["gradient_evaluations"]
