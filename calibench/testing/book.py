"""Problems that keep their own books, outside of the gate and of the process: an entry of a file for each call."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from calibench.bench.execution.run import Run, execute
from calibench.bench.gate.face import KNOWN
from calibench.optimizers.base import Array, Stop
from calibench.problems.base import extra_of

_PATIENCE = 10_000  # calls after the last one until an optimiser is taken for one that never ends; Ipopt makes hundreds


@final
@dataclass(frozen=True)
class Account:
    """A run and what the problem wrote: `tags`, b"e" an evaluation, b"j" a Jacobian, and the points, (calls, dim)."""

    run: Run
    tags: bytes
    points: Array


@final
class Deaf(BaseException):
    """An optimiser goes on calling after it was told to stop."""


class Rosenbrock:
    """Rosenbrock's function in `dimension` variables; writes each call, a tag and the point, into a file."""

    def __init__(self, book: Path, dimension: int, bound: float | None = None) -> None:
        lower, upper = (-2.0, 2.5) if bound is None else (-bound, bound)
        self.lower, self.upper = np.full(dimension, lower), np.full(dimension, upper)
        self.start = np.full(dimension, -1.2)
        self.dimension = dimension
        self.options = {"dimension": dimension}  # seeds follow from it, and not from where the book lies
        self._book = os.open(book, os.O_WRONLY | os.O_APPEND | os.O_CREAT)

    def __call__(self, x: Array) -> float:
        self._write(b"e", x)
        r = self._residuals(x)
        return float(r @ r)

    def _residuals(self, x: Array) -> Array:
        return np.concatenate([10.0 * (x[1:] - x[:-1] ** 2), 1.0 - x])

    def _write(self, tag: bytes, x: Array) -> None:
        if np.shape(x) != (self.dimension,):
            raise ValueError(f"takes a point of shape ({self.dimension},), and was given {np.shape(x)}")
        os.write(self._book, tag + np.ascontiguousarray(x, dtype=float).tobytes())

    def close(self) -> None:
        """Close the book."""
        os.close(self._book)


@final
class SumOfSquares(Rosenbrock):
    """The same with its residuals and their Jacobian in the open."""

    def residuals(self, x: Array) -> Array:
        """Return the residuals, shape (2 dim - 1,)."""
        self._write(b"e", x)
        return self._residuals(x)

    def jacobian(self, x: Array) -> Array:
        """Return their derivative."""
        self._write(b"j", x)
        n = len(x)
        steps = np.zeros((n - 1, n))
        steps[np.arange(n - 1), np.arange(n - 1)] = -20.0 * x[:-1]
        steps[np.arange(n - 1), np.arange(1, n)] = 10.0
        return np.vstack([steps, -np.eye(n)])


def account_of(
    make: Callable[[], Any], budget: int, seed: int = 0, squares: bool = False, dimension: int = 12, start: Any = None,
    bound: float | None = None,
) -> Account:  # fmt: skip
    """Run what `make` returns on Rosenbrock's function, in as many dimensions as it takes; return the books.

    `squares`: it may ask for residuals and Jacobians. `bound`: the box is -bound .. bound, in place of -2 .. 2.5.
    """
    optimizer = make()
    dimension = taken(getattr(optimizer, "traits", None), dimension)
    with tempfile.TemporaryDirectory() as folder:
        book = Path(folder) / "book"
        problem = (SumOfSquares if squares else Rosenbrock)(book, dimension, bound)
        first = None if start is None else np.full(dimension, start)
        try:
            heard = _Heard(optimizer)
            run = execute(problem, heard, budget=budget, seed=seed, start=first)
        finally:
            problem.close()
        written = np.frombuffer(book.read_bytes(), dtype=[("tag", "S1"), ("x", "<f8", (dimension,))])
    if heard.deaf:  # to a run it is a failure like others
        raise Deaf
    return Account(run, written["tag"].tobytes(), written["x"])


def taken(traits: Any, dimension: int) -> int:
    """Return the number of dimensions next to `dimension` in which an optimiser with these traits runs."""
    least, most = (getattr(traits, f"{which}_dimension", None) for which in ("minimum", "maximum"))
    return max(min(dimension, most or dimension), least or 1)


@final
class _Heard:
    """An optimiser whose calls after the last one are counted, so that one which never ends is ended."""

    def __init__(self, optimizer: Any) -> None:
        self._optimizer = optimizer
        self.traits = getattr(optimizer, "traits", None)
        self.name = extra_of(optimizer, "name", type(optimizer).__name__)
        self.library = extra_of(optimizer, "library", "calibench")
        self.options: dict[str, Any] = {}
        self.deaf = False

    def compile(self) -> None:
        """Compile what the optimiser compiles before the clock starts."""
        if extra_of(self._optimizer, "compile"):
            self._optimizer.compile()

    def minimize(self, objective: Any, rng: np.random.Generator) -> Any:
        """Let the optimiser work on the objective with the calls that `Objective` promises, and no more of them."""
        try:
            return self._optimizer.minimize(_Patient(objective), rng)
        except Deaf:
            self.deaf = True
            raise


@final
class _Patient:
    """An `Objective` that hands on every call, and raises `Deaf` where it goes on long after the first `Stop`."""

    def __init__(self, gate: Any) -> None:
        self._gate = gate
        self._refused = 0
        self.lower, self.upper, self.start, self.dimension = gate.lower, gate.upper, gate.start, gate.dimension
        self.has_residuals, self.has_jacobian = gate.has_residuals, gate.has_jacobian
        self.has_gradient = gate.has_gradient

    def __deepcopy__(self, memo: Any) -> _Patient:
        return self  # as the gate: a library that copies what it is given still counts here

    @property
    def remaining(self) -> int:
        """Return what is left of the budget."""
        return int(self._gate.remaining)

    def __getattr__(self, name: str) -> Any:
        """Return what a run knows of itself besides: ``budget``, ``best_value`` and the others."""
        if name in KNOWN:
            return getattr(self._gate, name)
        raise AttributeError(f"an objective has no {name!r}")

    def __call__(self, x: Array) -> float:
        return float(self._ask(self._gate, x))

    def batch(self, points: Array) -> Array:
        """Return the values of `points`."""
        return np.asarray(self._ask(self._gate.batch, points))

    def batch_below(self, points: Array, limits: Array) -> Array:
        """Return the values below `limits`."""
        return np.asarray(self._ask(self._gate.batch_below, points, limits))

    def residuals(self, x: Array) -> Array:
        """Return the residuals at x."""
        return np.asarray(self._ask(self._gate.residuals, x))

    def jacobian(self, x: Array) -> Array:
        """Return their derivative."""
        return np.asarray(self._ask(self._gate.jacobian, x))

    def gradient(self, x: Array) -> Array:
        """Return the derivative of the value at x."""
        return np.asarray(self._ask(self._gate.gradient, x))

    def value_and_gradient(self, x: Array) -> tuple[float, Array]:
        """Return both at x."""
        value, slopes = self._ask(self._gate.value_and_gradient, x)
        return float(value), np.asarray(slopes)

    def restart(self) -> Array:
        """Return a random point to begin again at."""
        return np.asarray(self._ask(self._gate.restart))

    def _ask(self, call: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return call(*arguments)
        except Stop:
            self._refused += 1
            if self._refused >= _PATIENCE:
                raise Deaf from None
            raise
