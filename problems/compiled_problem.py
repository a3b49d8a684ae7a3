"""`CompiledProblem`: what the problems with compiled kernels share. A problem holds one and passes calls on to it.

It holds the box, the start and the truth as arrays that nobody can write to, the module of the kernels (`cost`,
`batch`, `residuals`, `jacobian`), and the constants that go with each candidate. A kernel never sees the caller's
array: it gets a copy of the right type and length, or the caller a `ValueError` that says what is needed.

A caller's candidates as a problem takes them: copies of the right type and length, or a `ValueError`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from calibench.problems.base import Array, Parameter, frozen


@final
@dataclass(frozen=True, eq=False)
class CompiledProblem:
    """The arrays and kernels of one problem: ``kernels.cost(x, *constants)`` is the value of x, shape (dim,).

    `name` is the problem's, as error messages tell it. `truth`, shape (dim,), is None where it is not known.
    """

    name: str
    lower: Array
    upper: Array
    start: Array
    truth: Array | None
    kernels: Any
    constants: tuple[Any, ...]

    @staticmethod
    def of(name: str, coordinates: tuple[Parameter, ...], kernels: Any, constants: tuple[Any, ...]) -> CompiledProblem:
        """Return the problem whose x holds `coordinates`."""
        true = [c.true for c in coordinates]
        return CompiledProblem(
            name=name,
            lower=frozen([c.lower for c in coordinates]),
            upper=frozen([c.upper for c in coordinates]),
            start=frozen([c.start for c in coordinates]),
            truth=None if None in true else frozen(true),
            kernels=kernels,
            constants=constants,
        )

    def cost(self, x: Array) -> float:
        """Return the value of x, shape (dim,)."""
        value: float = self.kernels.cost(self.vector(x), *self.constants)
        return value

    def batch(self, points: Array) -> Array:
        """Return the values, shape (k,), of candidates of shape (k, dim): the same bits as one call for each."""
        values: Array = self.kernels.batch(self.vectors(points), *self.constants)
        return values

    def residuals(self, x: Array) -> Array:
        """Return the residuals at x, shape (m,)."""
        residuals: Array = self.kernels.residuals(self.vector(x), *self.constants)
        return residuals

    def jacobian(self, x: Array) -> Array:
        """Return the analytic derivative of the residuals at x, shape (m, dim)."""
        slopes: Array = self.kernels.jacobian(self.vector(x), *self.constants)
        return slopes

    def compile(self) -> None:
        """Compile (or load from the cache) the four kernels, so that no clock sees it."""
        self.compile_values()
        self.residuals(self.start), self.jacobian(self.start)

    def compile_values(self) -> None:
        """Compile likewise what methods call that ask for values alone."""
        self.cost(self.start), self.batch(self.start[None])

    def vector(self, x: Array) -> Array:
        """Return x as the kernels take it: a copy, so that one compiled form serves all callers' arrays."""
        return vector(self.name, x, len(self.lower))

    def vectors(self, points: Array) -> Array:
        """Return candidates as the kernels take them, shape (k, dim), likewise."""
        return vectors(self.name, points, len(self.lower))


def vector(name: str, x: Array, dim: int) -> Array:
    """Return x as an array of shape (dim,) of our own; `name` is the problem's, as the message tells it."""
    own = np.array(x, dtype=np.float64)
    if own.shape != (dim,):
        raise ValueError(f"{name}: x has shape {own.shape}, ({dim},) is needed")
    return own


def vectors(name: str, points: Array, dim: int) -> Array:
    """Return candidates likewise, shape (k, dim)."""
    own = np.array(points, dtype=np.float64, order="C")
    if own.ndim != 2 or own.shape[1] != dim:
        raise ValueError(f"{name}: points have shape {own.shape}, (k, {dim}) is needed")
    return own
