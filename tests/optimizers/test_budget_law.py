"""The law that makes comparisons fair, over the whole registry: a budget is a wall, a box is a box, a seed is a run.

The objective keeps its own books, outside of the gate and of the process: a line of a file for each call.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibench import bench, optimizers
from calibench.optimizers.base import Traits

BUDGETS = [1, 7, 50, pytest.param(1000, marks=pytest.mark.slow)]
NAMES = optimizers.names()


class Rosenbrock:
    """Rosenbrock's function in `dimension` variables; appends each call, a tag and the point, to a file."""

    def __init__(self, book: Path, dimension: int) -> None:
        self.lower, self.upper = np.full(dimension, -2.0), np.full(dimension, 2.5)
        self.start = np.full(dimension, -1.2)
        self.dimension = dimension
        self._book = os.open(book, os.O_WRONLY | os.O_APPEND | os.O_CREAT)

    def __call__(self, x: np.ndarray) -> float:
        self._write(b"e", x)
        r = self._residuals(x)
        return float(r @ r)

    def _residuals(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([10.0 * (x[1:] - x[:-1] ** 2), 1.0 - x])

    def _write(self, tag: bytes, x: np.ndarray) -> None:
        os.write(self._book, tag + np.ascontiguousarray(x, dtype=float).tobytes())

    def close(self) -> None:
        os.close(self._book)


class SumOfSquares(Rosenbrock):
    """The same with its residuals and their Jacobian in the open."""

    def residuals(self, x: np.ndarray) -> np.ndarray:
        self._write(b"e", x)
        return self._residuals(x)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        self._write(b"j", x)
        n = len(x)
        steps = np.zeros((n - 1, n))
        steps[np.arange(n - 1), np.arange(n - 1)] = -20.0 * x[:-1]
        steps[np.arange(n - 1), np.arange(1, n)] = 10.0
        return np.vstack([steps, -np.eye(n)])


def traits_of(name: str, **options: Any) -> Traits:
    return optimizers.make(name, **options).traits


def run(
    folder: Path, name: str, budget: int, *, seed: int = 0, squares: bool = False, dimension: int = 12, **options: Any
) -> tuple[bench.Run, bytes, np.ndarray]:
    """Return the run, the tags of its calls, and their points, shape (calls, dim)."""
    dimension = min(dimension, traits_of(name).maximum_dimension or dimension)
    book = folder / "book"
    book.unlink(missing_ok=True)
    problem = (SumOfSquares if squares else Rosenbrock)(book, dimension)
    try:
        done = bench.execute(problem, optimizers.make(name, **options), budget=budget, seed=seed)
    finally:
        problem.close()
    entries = np.frombuffer(book.read_bytes(), dtype=[("tag", "S1"), ("x", "<f8", (dimension,))])
    return done, entries["tag"].tobytes(), entries["x"]


def assert_lawful(done: bench.Run, tags: bytes, points: np.ndarray, budget: int, traits: Traits) -> None:
    evaluations, jacobians = tags.count(b"e"), tags.count(b"j")
    assert done.status == "ok", done.row["error"]
    assert done.evaluations == evaluations
    assert done.row["jacobian_evaluations"] == jacobians
    assert done.charged == evaluations + points.shape[1] * jacobians
    assert 1 <= done.charged <= budget
    dear = points.shape[1] if traits.uses_residuals else 1  # what is refused: a Jacobian, or an evaluation
    spent = done.charged > budget - dear
    assert done.stop_reason == "budget" or done.charged < budget
    assert done.stop_reason == "converged" or spent
    assert spent or traits.self_terminating
    if traits.bounded:
        assert (points >= np.nextafter(-2.0, -np.inf)).all()
        assert (points <= np.nextafter(2.5, np.inf)).all()


def assert_same(a: bench.Run, b: bench.Run) -> None:
    assert a.best_value == b.best_value
    assert a.points == b.points
    assert np.array_equal(a.best_x, b.best_x)  # type: ignore[arg-type]


@pytest.mark.parametrize("budget", BUDGETS)
@pytest.mark.parametrize("name", NAMES)
def test_budget_is_a_wall_and_a_seed_is_a_run(name: str, budget: int, tmp_path: Path) -> None:
    traits = traits_of(name)
    done, tags, points = run(tmp_path, name, budget, squares=traits.uses_residuals)
    assert_lawful(done, tags, points, budget, traits)
    assert_same(done, run(tmp_path, name, budget, squares=traits.uses_residuals)[0])


@pytest.mark.parametrize("budget", BUDGETS)
@pytest.mark.parametrize("name", [n for n in NAMES if traits_of(n).uses_gradient and not traits_of(n).uses_residuals])
def test_a_jacobian_is_charged_its_dimension(name: str, budget: int, tmp_path: Path) -> None:
    done, tags, points = run(tmp_path, name, budget, squares=True)
    assert_lawful(done, tags, points, budget, traits_of(name))
    assert b"j" in tags or budget < 1 + traits_of(name).minimum_budget + points.shape[1]


RESTARTED = [n for n in NAMES if "restarts" in optimizers.registry.options(n)]


def test_whatever_stops_by_itself_takes_restarts() -> None:
    """The wall below then says that it spends the budget. MMA and CCSAQ descend for ever unless they are restarted."""
    stops = {n for n in NAMES if traits_of(n).self_terminating}
    assert set(RESTARTED) == stops | {"nlopt_LD_MMA", "nlopt_LD_CCSAQ"}


@pytest.mark.parametrize("budget", [50, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", RESTARTED)
def test_restarts_spend_the_whole_budget(name: str, budget: int, tmp_path: Path) -> None:
    traits = traits_of(name, restarts=True)
    assert not traits.self_terminating
    done, tags, points = run(tmp_path, name, budget, squares=traits.uses_residuals, dimension=2, restarts=True)
    assert_lawful(done, tags, points, budget, traits)


@pytest.mark.parametrize("name", NAMES)
def test_only_the_stochastic_depend_on_the_seed(name: str, tmp_path: Path) -> None:
    """In two dimensions, where the first descent of a method that then draws at random ends soon."""
    traits = traits_of(name)
    first, second = (run(tmp_path, name, 600, seed=s, squares=traits.uses_residuals, dimension=2)[2] for s in (0, 1))
    assert np.array_equal(first, second) is not traits.stochastic
