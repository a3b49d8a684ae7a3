"""Run one method of SciPy through the gate: units, tolerances, derivatives, restarts.

SciPy owns the loop and lets our exceptions pass. A search that is `scaled` runs in the unit box and on the value
divided by its first size, so that rad and mm side by side become shares of their own range; otherwise SciPy gets
coordinates and values as they are. A coordinate whose bounds are equal is held, and is no variable to SciPy.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import count
from typing import Any, ClassVar, final

import numpy as np

from calibench.optimizers.base import Array, Objective, Reason, Traits, with_restarts
from calibench.optimizers.derivatives import Memoized, value_and_gradient
from calibench.optimizers.scipy.settings import SETTINGS

_LARGEST = 1e100  # stands for an infinite value: models built through inf become NaN
_EPS = float(np.finfo(float).eps)


class _Lost(Exception):
    """The method asks for a point that is no number: there is nothing to evaluate, and its descent is over."""


@final
class Units:
    """The objective in SciPy's coordinates u, shape (n,), for the n variables that are free."""

    def __init__(self, objective: Objective, start: Array, scaled: bool, bounded: bool) -> None:
        lower, upper = objective.lower, objective.upper
        self._objective, self._start, self._bounded = objective, start, bounded
        self.free = lower < upper
        width = np.where(np.isfinite(upper - lower), upper - lower, np.maximum(np.abs(start), 1.0))
        origin = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - width, start - 0.5 * width))
        self._width = (width if scaled else np.ones(len(width)))[self.free]
        self._origin = (origin if scaled else np.zeros(len(width)))[self.free]
        self.lower, self.upper = (self._of(x) for x in (lower, upper))
        self.start = np.clip(self._of(start), self.lower, self.upper)
        self._size = 0.0 if scaled else 1.0
        self._memo = Memoized(objective, analytic=True, kind="forward", bounded=bounded)
        self._slopes: tuple[Array, Array] | None = None  # where a gradient was asked for last, and what it was
        self.exact = objective.has_gradient or (objective.has_residuals and objective.has_jacobian)

    @property
    def remaining(self) -> int:
        """Return what is left of the budget, in the int of SciPy's compiled parts."""
        return min(self._objective.remaining, 2**31 - 2)

    def value(self, u: Array) -> float:
        """Return the value, of a method that asks for nothing else."""
        return self._sized(self._objective(self._point(u)))

    def remembered(self, u: Array) -> float:
        """Return the value, and keep what a gradient at the same point will need."""
        return self._sized(self._memo.value(self._point(u)))

    def gradient(self, u: Array) -> Array:
        """Return the gradient, shape (n,)."""
        slopes = self._scaled(self._memo.gradient(self._point(u)))
        self._slopes = np.array(u), slopes
        return slopes

    def both(self, u: Array) -> tuple[float, Array]:
        """Return the value and the gradient, which one call of the problem may give."""
        value, slopes = value_and_gradient(self._objective, self._point(u))
        return self._sized(value), self._scaled(slopes)

    def batch(self, columns: Array) -> Array:
        """Return the values of points (n, k), as SciPy stands them."""
        points = np.tile(self._start, (columns.shape[1], 1))
        points[:, self.free] = self._origin + columns.T * self._width
        return self._objective.batch(points.clip(self._objective.lower, self._objective.upper))

    def product(self, u: Array, direction: Array) -> Array:
        """Return the Hessian at u times a direction: of 2 J^T J where there is a Jacobian, else of two gradients."""
        curvature = self._memo.curvature(self._point(u))
        if curvature is not None:
            scale = np.outer(self._width, self._width) / self._size
            product: Array = (curvature[np.ix_(self.free, self.free)] * scale) @ direction
            return product
        base = self._slopes[1] if self._slopes and np.array_equal(self._slopes[0], u) else self.gradient(u)
        length = float(np.linalg.norm(direction))
        if not length:
            return np.zeros(len(u))
        step = _EPS ** (1 / 2 if self.exact else 1 / 4) * max(1.0, float(np.abs(u).max())) / length
        ahead = self._scaled(self._memo.gradient(self._point(u + step * direction)))
        change: Array = (ahead - base) / step
        return change

    def hessian(self, u: Array) -> Array:
        """Return the Hessian at u, shape (n, n), a product a column, made symmetric."""
        columns = np.array([self.product(u, unit) for unit in np.eye(len(u))])
        whole: Array = 0.5 * (columns + columns.T)
        return whole

    def _of(self, x: Array) -> Array:
        return (x[self.free] - self._origin) / self._width

    def _point(self, u: Array) -> Array:
        """Return SciPy's point in ours; some miss the box by rounding."""
        norm = u.dot(u)
        if norm != norm:
            raise _Lost
        x = np.array(self._start)
        x[self.free] = self._origin + u * self._width
        return x.clip(self._objective.lower, self._objective.upper) if self._bounded else x

    def _sized(self, value: float) -> float:
        if not self._size:
            self._size = abs(value) if np.isfinite(value) and value else 1.0
        return min(value / self._size, _LARGEST)

    def _scaled(self, slopes: Array) -> Array:
        return np.nan_to_num(slopes[self.free] * self._width / (self._size or 1.0), posinf=0.0, neginf=0.0)


# (the objective in SciPy's coordinates, a generator, which of the restarts this is): run SciPy once
Search = Callable[[Units, np.random.Generator, int], object]


@final
@dataclass(frozen=True)
class SciPy:
    """One method of SciPy with its options, and `search`, which calls SciPy."""

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    method: str
    options: Mapping[str, Any]
    search: Search = field(repr=False, compare=False)

    library: ClassVar[str] = "scipy"

    @property
    def name(self) -> str:
        """Return the name in the registry."""
        return f"scipy_{self.method}"

    @property
    def traits(self) -> Traits:
        """Return the traits that the table holds; with `restarts` it goes on, at random, until it is stopped."""
        known, restarts = SETTINGS[self.method], self.options.get("restarts", False)
        population = self.options.get("popsize", 0)
        return Traits(
            stochastic=known.stochastic or (restarts and known.uses_start),
            uses_gradient=known.gradient,
            bounded=known.bounded,
            self_terminating=known.stops and not restarts,
            uses_start=known.uses_start,
            minimum_budget=self.options.get("n", 1),
            minimum_budget_per_dimension=population or known.first_per_dimension,
            minimum_dimension=known.minimum_dimension,
            maximum_dimension=known.maximum_dimension,
            needs_finite_bounds=known.needs_finite_bounds or restarts,
            batches=known.batches,
        )

    def compile(self) -> None:
        """Import SciPy's part, so that no clock sees it."""
        optimize()

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Run from the start; with `restarts`, or where it ends against its habit, again from random points."""
        known, turns = SETTINGS[self.method], count()

        def descend(start: Array) -> None:
            units = Units(objective, start, self.options.get("scaled", False), known.bounded)
            if not units.free.any():
                objective(start)
                return
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")  # overflow far outside the box, a line search without an end
                try:
                    self.search(units, rng, next(turns))
                except _Lost:
                    pass

        return with_restarts(descend, objective, restarts=not self.traits.self_terminating)


def optimize() -> Any:
    """Return the module `scipy.optimize`; its stubs know no options that are collected in a mapping."""
    import scipy.optimize

    return scipy.optimize
