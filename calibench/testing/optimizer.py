"""The laws of an optimiser: the budget is a wall, the box is a box, a seed is a run, and its traits are true.

``make()`` returns the optimiser, a new one each time: ``lambda: Mine(population=30)``, or the class itself. It runs on
Rosenbrock's function, which keeps its own books, outside of the gate and of the process: an entry of a file a call.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, final

import numpy as np

from calibench.bench.execution.run import Run, execute
from calibench.bench.gate.face import METHODS
from calibench.optimizers.base import Array, Stop, Traits
from calibench.problems.base import extra_of
from calibench.testing._law import TIME_LIMIT, Checks, checks_of, keep_all, require

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
        self.book = os.open(book, os.O_WRONLY | os.O_APPEND | os.O_CREAT)

    @np.errstate(all="ignore")  # where no bound is finite a point need not be
    def __call__(self, x: Array) -> float:
        self._write(b"e", x)
        r = self._residuals(x)
        return float(r @ r)

    def _residuals(self, x: Array) -> Array:
        return np.concatenate([10.0 * (x[1:] - x[:-1] ** 2), 1.0 - x])

    def _write(self, tag: bytes, x: Array) -> None:
        if np.shape(x) != (self.dimension,):
            raise ValueError(f"takes a point of shape ({self.dimension},), and was given {np.shape(x)}")
        os.write(self.book, tag + np.ascontiguousarray(x, dtype=float).tobytes())


@final
class SumOfSquares(Rosenbrock):
    """The same with its residuals and their Jacobian in the open."""

    @np.errstate(all="ignore")
    def residuals(self, x: Array) -> Array:
        self._write(b"e", x)
        return self._residuals(x)

    @np.errstate(all="ignore")
    def jacobian(self, x: Array) -> Array:
        self._write(b"j", x)
        n = len(x)
        steps = np.zeros((n - 1, n))
        steps[np.arange(n - 1), np.arange(n - 1)] = -20.0 * x[:-1]
        steps[np.arange(n - 1), np.arange(1, n)] = 10.0
        return np.vstack([steps, -np.eye(n)])


def account_of(
    make: Callable[[], Any], budget: int, seed: int = 0, squares: bool | None = None, dimension: int = 12,
    start: Any = None, bound: float | None = None, well: bool = False,
) -> Account:  # fmt: skip
    """Run what `make` returns on Rosenbrock's function, in as many dimensions as it takes; return the books.

    `squares`: it may ask for residuals and Jacobians (None: as its traits say). `bound`: the box is -bound .. bound, in
    place of -2 .. 2.5. `well`: raise unless the run is ok, as one that failed says nothing of a law.
    """
    squares = _traits(make).uses_residuals if squares is None else squares
    optimizer = make()
    dimension = taken(getattr(optimizer, "traits", None), dimension)
    with tempfile.TemporaryDirectory() as folder:
        book = Path(folder) / "book"
        problem = (SumOfSquares if squares else Rosenbrock)(book, dimension, bound)
        first = None if start is None else np.full(dimension, start)
        patients: list[_Patient] = []

        def minimize(objective: Any, rng: np.random.Generator) -> Any:
            patients.append(_Patient(objective))
            return optimizer.minimize(patients[-1], rng)

        heard = SimpleNamespace(
            minimize=minimize, traits=getattr(optimizer, "traits", None), options={},
            name=extra_of(optimizer, "name", type(optimizer).__name__),
            library=extra_of(optimizer, "library", "calibench"), compile=extra_of(optimizer, "compile", lambda: None),
        )  # fmt: skip
        try:
            run = execute(problem, heard, budget=budget, seed=seed, start=first)
        finally:
            os.close(problem.book)
        written = np.frombuffer(book.read_bytes(), dtype=[("tag", "S1"), ("x", "<f8", (dimension,))])
    if any(one.refused >= _PATIENCE for one in patients):  # to a run it is no failure
        raise AssertionError(
            f"an optimiser ends when the objective stops it; found calls without end after the budget of {budget}; "
            "let optimizers.Stop pass, or return when it comes"
        )
    require(
        run.status == "ok" or not well, "a run ends well at any budget",
        f"{run.status} at budget {budget}: {run.row['error_type']} {run.row['error']}",
        "mend what raised; a first step above the budget is stopped by the objective",
    )  # fmt: skip
    return Account(run, written["tag"].tobytes(), written["x"])


def taken(traits: Any, dimension: int) -> int:
    """Return the number of dimensions next to `dimension` in which an optimiser with these traits runs."""
    least, most = (getattr(traits, f"{which}_dimension", None) for which in ("minimum", "maximum"))
    return max(min(dimension, most or dimension), least or 1)


@final
class _Patient:
    """An `Objective` that hands on every call, and raises `Deaf` where it goes on long after the first `Stop`."""

    def __init__(self, gate: Any) -> None:
        self._gate, self.refused = gate, 0

    def __deepcopy__(self, memo: Any) -> _Patient:
        return self  # as the gate: a library that copies what it is given still counts here

    def __getattr__(self, name: str) -> Any:
        known = getattr(self._gate, name)
        return partial(self._ask, known) if name in METHODS else known

    def __call__(self, x: Array) -> float:
        return float(self._ask(self._gate, x))

    def _ask(self, call: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return call(*arguments)
        except Stop:
            self.refused += 1
            if self.refused >= _PATIENCE:
                raise Deaf from None
            raise


BUDGETS = (1, 7, 50)
LONG = 600  # evaluations, after which a method shows what it does late
Make = Callable[[], Any]


def check_optimizer(make: Make, *, time_limit: float = TIME_LIMIT) -> None:
    """Raise `AssertionError`, one line, for the first law that the optimisers of `make` break."""
    keep_all(lambda: optimizer_checks(make), time_limit)


def optimizer_checks(make: Make) -> Checks:
    """Return (name, check) for every law of an optimiser."""
    return checks_of(OPTIMIZER_LAWS, make)


def it_has_minimize_and_traits(make: Make) -> None:
    """An optimiser has ``minimize(objective, rng)``; its traits, where it states some, are `Traits`."""
    require(
        callable(make), "each run has an optimiser of its own", f"an object of {type(make).__name__}",
        f"give what makes one: the class, or lambda: {type(make).__name__}(...)",
    )  # fmt: skip
    optimizer = make()
    can = callable(getattr(optimizer, "minimize", None))
    require(can, "an optimiser has minimize(objective, rng)", type(optimizer).__name__, "write it")
    traits = getattr(optimizer, "traits", Traits())
    require(isinstance(traits, Traits), "traits are Traits", repr(traits), "say traits = optimizers.Traits(...)")


def budget_is_a_wall(make: Make, budgets: tuple[int, ...] = BUDGETS, dimension: int = 12) -> None:
    """Nothing is evaluated above the budget, and what the gate counted is what the problem saw."""
    for budget in budgets:
        account = account_of(make, budget, well=True, dimension=dimension)
        evaluations, jacobians = account.tags.count(b"e"), account.tags.count(b"j")
        charged = evaluations + account.points.shape[1] * jacobians
        require(
            (account.run.evaluations, account.run.row["jacobian_evaluations"]) == (evaluations, jacobians),
            "every evaluation passes the objective",
            f"{evaluations} evaluations and {jacobians} Jacobians, counted {account.run.evaluations}",
            "call nothing but the objective that minimize was given",
        )
        require(
            1 <= charged <= budget, "the budget is a wall", f"{charged} charged of {budget}",
            "ask the objective, and nothing beside it",
        )  # fmt: skip


def only_the_self_terminating_leave_a_rest(make: Make, budgets: tuple[int, ...] = BUDGETS, dimension: int = 12) -> None:
    """Who is not `self_terminating` spends the whole budget, but for the rest that its next step would exceed."""
    traits = _traits(make)
    for budget in budgets:
        account = account_of(make, budget, well=True, dimension=dimension)
        dear = account.points.shape[1] if traits.uses_residuals else 1  # what is refused: a Jacobian, or an evaluation
        spent = account.run.charged > budget - dear
        reason = account.run.stop_reason
        require(
            spent or traits.self_terminating,
            "only the self_terminating leave a rest", f"{account.run.charged} of {budget} spent",
            "go on until the objective stops you, or state self_terminating=True",
        )  # fmt: skip
        right = reason == "converged" or spent if reason != "budget" else True
        require(
            right and (reason == "budget" or account.run.charged < budget), "the reason is that of the books",
            f"{reason} with {account.run.charged} of {budget} spent", "return 'converged', or let the Stop pass",
        )  # fmt: skip


def a_seed_is_a_run(make: Make, budgets: tuple[int, ...] = BUDGETS, dimension: int = 12) -> None:
    """The same seed gives the same points in the same order, to the last bit."""
    for budget in budgets:
        one, other = (account_of(make, budget, well=well, dimension=dimension) for well in (True, False))
        n, same = min(len(one.points), len(other.points)), np.array_equal(one.points, other.points, equal_nan=True)
        parted = np.append(np.flatnonzero((one.points[:n] != other.points[:n]).any(axis=1)), n)[0] + 1
        require(
            same and one.run.points == other.run.points, "a seed is a run",
            f"two runs that part at evaluation {parted}",
            "draw from rng alone, keep nothing between two runs, iterate over nothing unordered",
        )  # fmt: skip


def only_the_stochastic_depend_on_the_seed(make: Make, budget: int = LONG) -> None:
    """Another seed gives another run if the trait `stochastic` says so, and the same one if not."""
    one, other = (account_of(make, budget, seed=seed, dimension=2) for seed in (0, 1))
    same = np.array_equal(one.points, other.points, equal_nan=True)
    stated = _traits(make).stochastic
    require(
        same is not stated, "only the stochastic depend on the seed",
        f"stochastic={stated} and {'the same run' if same else 'another run'} by another seed",
        f"state stochastic={not same}",
    )  # fmt: skip


def nothing_is_asked_outside_the_box(
    make: Make, budgets: tuple[int, ...] = (*BUDGETS, LONG), dimension: int = 12
) -> None:
    """Every point is a number in the box, but for one rounding; or the trait `bounded` is False."""
    if not _traits(make).bounded:
        return
    for budget in budgets:
        points = account_of(make, budget, dimension=dimension).points
        outside = ~((points >= np.nextafter(-2.0, -np.inf)) & (points <= np.nextafter(2.5, np.inf)))  # nan is outside
        require(
            not outside.any(), "nothing is asked outside the box",
            f"{points[outside][0] if outside.any() else 0:.9g} in a box of -2 .. 2.5 at budget {budget}",
            "clip to objective.lower and objective.upper, or state bounded=False",
        )  # fmt: skip


def uses_start_is_true(make: Make, budget: int = 300) -> None:
    """The run depends on the start if the trait `uses_start` says so, and only then."""
    one, other = (account_of(make, budget, dimension=2, start=start) for start in (-1.2, 0.7))
    differ = not np.array_equal(one.points, other.points, equal_nan=True)
    stated = _traits(make).uses_start
    require(
        differ is stated, "uses_start is true",
        f"uses_start={stated} and {'another run' if differ else 'the same run'} from another start",
        f"begin at objective.start or state uses_start={differ}",
    )  # fmt: skip


def minimum_budget_is_enough(make: Make) -> None:
    """With the least budget that its traits state a run ends well and spends no more."""
    traits = _traits(make)
    dimension = taken(traits, 2)
    budget = traits.minimum_budget + traits.minimum_budget_per_dimension * dimension
    account = account_of(make, budget, dimension=dimension)
    run = account.run
    require(
        run.status == "ok" and run.charged <= budget, "the stated minimum_budget is enough",
        f"{run.status} {run.row['error']!r} at {budget}", "state the evaluations of the first step",
    )  # fmt: skip


def an_open_box_is_searched_or_refused(make: Make, budget: int = 50) -> None:
    """In a box without ends every point that is asked for is finite, or the trait `needs_finite_bounds` refuses it."""
    if _traits(make).needs_finite_bounds:
        return
    account = account_of(make, budget, dimension=2, bound=np.inf)
    astray = ~np.isfinite(account.points).all(axis=1)
    require(
        account.run.status == "ok" and not astray.any(), "an open box is searched, or needs_finite_bounds refuses it",
        f"{account.run.status}, {astray.sum()} of {astray.size} points not finite where the bounds are infinite",
        "state needs_finite_bounds=True",
    )  # fmt: skip


OPTIMIZER_LAWS = (
    it_has_minimize_and_traits, budget_is_a_wall, only_the_self_terminating_leave_a_rest, a_seed_is_a_run,
    only_the_stochastic_depend_on_the_seed, nothing_is_asked_outside_the_box, uses_start_is_true,
    minimum_budget_is_enough, an_open_box_is_searched_or_refused,
)  # fmt: skip


def _traits(make: Make) -> Traits:
    traits = getattr(make(), "traits", Traits())
    return traits if isinstance(traits, Traits) else Traits()
