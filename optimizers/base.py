"""The interface of an optimiser: it proposes points to an objective until the objective stops it, or it is done.

An optimiser calls ``objective(x)`` or ``objective.batch(points)``; the call after the last one allowed raises
`BudgetExhausted`, which whoever runs it catches. So none needs to count, keep the best, or catch anything.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import Range
from calibench.core.registry import Registry

Array = NDArray[np.float64]
Share = Annotated[float, Range(0, 1)]
Count = Annotated[int, Range(1)]
CountOrNull = Annotated[int | None, Range(1)]
Positive = Annotated[float, Range(0, above=True)]
OfBox = Annotated[float, Range(0, 1, above=True, unit="widths of the box")]
Reason = Literal["converged"]


class Stop(Exception):
    """The objective takes no further call. Optimisers let it pass; adapters for C libraries carry it around them."""


class BudgetExhausted(Stop):
    """An evaluation beyond the budget was asked for."""


class TargetReached(Stop):
    """A value at or below the target has been found."""


class TimeUp(Stop):
    """The allowed time has passed."""


class ObjectiveFailed(Stop):
    """The objective has raised an exception, which the run's row tells; nothing more is asked of it."""


class Objective(Protocol):
    """The questions an optimiser may ask: values, residuals, derivatives, the box, and the rest of the budget.

    Shapes: x (dim,), ``batch(points)`` (k,) of points (k, dim), ``residuals(x)`` (m,), ``jacobian(x)`` (m, dim),
    ``gradient(x)`` (dim,). `residuals`, `jacobian` and `gradient` exist where `has_residuals`, `has_jacobian` and
    `has_gradient` say so, and ``value_and_gradient(x)`` with the last. A Jacobian or gradient costs `dimension`.
    ``restart()`` notes that the optimiser begins again and returns a random point to begin at, shape (dim,): the k-th
    one is the same for every method on the same problem, data and repetition. An optimiser with a better point ignores
    it. ``batch_below(points, limits)`` is `batch` for optimisers that only need the values below their `limits`: those
    are exact; any other value is not below its limit, and nothing more is known of it. It costs the same. Every call
    raises `Stop` when no more is left.
    """

    lower: Array
    upper: Array
    start: Array
    dimension: int
    has_residuals: bool
    has_jacobian: bool
    has_gradient: bool

    @property
    def remaining(self) -> int: ...
    def __call__(self, x: Array, /) -> float: ...
    def batch(self, points: Array, /) -> Array: ...
    def batch_below(self, points: Array, limits: Array, /) -> Array: ...
    def residuals(self, x: Array, /) -> Array: ...
    def jacobian(self, x: Array, /) -> Array: ...
    def gradient(self, x: Array, /) -> Array: ...
    def value_and_gradient(self, x: Array, /) -> tuple[float, Array]: ...
    def restart(self) -> Array: ...


@dataclass(frozen=True, slots=True)
class Traits:
    """What a user must know before comparing: columns of ``bench list optimizers``.

    `bounded`: evaluates nothing outside the box. `self_terminating`: may stop by its own test before the budget is
    spent. `uses_start`: its result depends on the start point. `minimum_budget`: evaluations before its first own
    proposal, and `minimum_budget_per_dimension` more for each dimension. `minimum_dimension`, `maximum_dimension`: the
    problems it takes. `needs_finite_bounds`: works in widths of the box, or draws from it, so that every parameter must
    have two ends. `may_hang`: may loop in foreign code for ever without an evaluation, so that whoever runs it must
    watch it from outside. `batches`: asks for many points at once, which can then be evaluated by several processes.
    `package`: what must be importable and has no wheel for each system; "" where nothing is needed.
    """

    stochastic: bool = False
    uses_residuals: bool = False
    uses_gradient: bool = False
    bounded: bool = True
    self_terminating: bool = False
    uses_start: bool = True
    minimum_budget: int = 1
    minimum_budget_per_dimension: int = 0
    minimum_dimension: int = 1
    maximum_dimension: int | None = None
    needs_finite_bounds: bool = False
    may_hang: bool = False
    batches: bool = False
    package: str = ""


class Optimizer(Protocol):
    """A method with its options. `minimize` returns why it stopped by itself; most never do."""

    @property
    def name(self) -> str: ...
    @property
    def traits(self) -> Traits: ...
    def minimize(self, objective: Objective, rng: np.random.Generator, /) -> Reason: ...


registry: Registry[Optimizer] = Registry(kind="optimizer", group="calibench.optimizers")


def with_restarts(descend: Callable[[Array], object], objective: Objective, restarts: bool) -> Reason:
    """Run `descend` from the start and, if `restarts`, again from points the objective draws until it is stopped."""
    descend(objective.start)
    while restarts:
        left = objective.remaining
        again = objective.restart()
        descend(again)
        if objective.remaining == left:  # a method that proposes nothing would begin again for ever
            objective(again)
    return "converged"
