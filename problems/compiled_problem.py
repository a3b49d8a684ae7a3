"""`CompiledProblem`: what the problems with compiled kernels share. A problem holds one and passes calls on to it.

A kernel never sees the caller's array: it gets a copy of the right type and length, or the caller a `ValueError` that
says what is needed. A class of problems takes its arrays by `hold` and its methods by `passed`::

    def __post_init__(self) -> None:
        hold(self, self.parameters, kernels, constants, data=readings.tobytes())

    residuals = passed(CompiledProblem.residuals)
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from hashlib import blake2b
from importlib import import_module
from typing import Any, Concatenate, ParamSpec, TypeVar, final

import numpy as np

from calibench.problems.base import Array, Parameter, frozen

P = ParamSpec("P")
T = TypeVar("T")


def vector_of(problem: Any, x: Array) -> Array:
    """Return x as an array of shape (dim,) of our own, so that one compiled form serves all callers' arrays."""
    own = np.array(x, dtype=np.float64)
    if own.shape != problem.lower.shape:
        raise ValueError(f"{problem.name}: x has shape {own.shape}, ({len(problem.lower)},) is needed")
    return own


def vectors_of(problem: Any, points: Array) -> Array:
    """Return candidates likewise, shape (k, dim)."""
    own = np.array(points, dtype=np.float64, order="C")
    if own.ndim != 2 or own.shape[1] != len(problem.lower):
        raise ValueError(f"{problem.name}: points have shape {own.shape}, (k, {len(problem.lower)}) is needed")
    return own


@final
@dataclass(frozen=True, eq=False)
class CompiledProblem:
    """The arrays and kernels of one problem: ``kernels.cost(x, *constants)`` is the value of x, shape (dim,).

    `name` is the problem's, for error messages. `truth`, shape (dim,), is None where it is not known.
    """

    name: str
    lower: Array
    upper: Array
    start: Array
    truth: Array | None
    kernels: Any
    constants: tuple[Any, ...]

    def cost(self, x: Array) -> float:
        """Return the value of x, shape (dim,): the sum of the squared residuals."""
        value: float = self.kernels.cost(self.vector(x), *self.constants)
        return value

    def batch(self, points: Array) -> Array:
        """Return the values, shape (k,), of candidates of shape (k, dim): the same bits as one call for each."""
        values: Array = self.kernels.batch(self.vectors(points), *self.constants)
        return values

    def residuals(self, x: Array) -> Array:
        """Return the residuals at x, shape (m,): what is modelled minus what was read."""
        residuals: Array = self.kernels.residuals(self.vector(x), *self.constants)
        return residuals

    def jacobian(self, x: Array) -> Array:
        """Return the analytic derivative of the residuals at x, shape (m, dim)."""
        slopes: Array = self.kernels.jacobian(self.vector(x), *self.constants)
        return slopes

    def compile(self) -> None:
        """Compile (or load from the cache) what an optimiser will call, so that no clock sees it."""
        self.compile_values()
        self.residuals(self.start), self.jacobian(self.start)

    def compile_values(self) -> None:
        """Compile likewise what methods call that ask for values alone."""
        self.cost(self.start), self.batch(self.start[None])

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"kernels": self.kernels.__name__}  # a module cannot be pickled

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state | {"kernels": import_module(state["kernels"])})

    vector, vectors = vector_of, vectors_of


def hold(
    problem: Any, coordinates: tuple[Parameter, ...], kernels: Any, constants: tuple[Any, ...], **values: Any
) -> None:
    """Give a new problem its `CompiledProblem`, what x holds, the arrays of its box, and further `values`, as its own.

    Of `data`, bytes, which must be among the values, it gets a digest, `data_id`: the same data, the same id.
    Its calls leave their arguments alone and return floats, so the gate need not look, and a value has the same bits
    alone and in a batch.
    """
    lower, upper, start = (frozen([getattr(c, key) for c in coordinates]) for key in ("lower", "upper", "start"))
    true = [c.true for c in coordinates]
    truth = None if None in true else frozen(true)
    compiled = CompiledProblem(
        problem.name, lower, upper, start=start, truth=truth, kernels=kernels, constants=constants
    )
    box = {"lower": lower, "upper": upper, "start": start, "truth": truth}
    data_id = blake2b(values.pop("data"), digest_size=8).hexdigest()
    values |= {"_compiled": compiled, "coordinates": coordinates, "data_id": data_id, **box}
    for key, value in {**values, "side_effect_free": True, "splits_batches": True}.items():
        object.__setattr__(problem, key, value)


def passed(method: Callable[Concatenate[CompiledProblem, P], T]) -> Callable[Concatenate[Any, P], T]:
    """Return a method of problems that passes its calls on to `method` of the `CompiledProblem` that they hold."""

    @wraps(method)
    def call(problem: Any, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return method(problem._compiled, *args, **kwargs)

    return call


def itself(problem: Any, x: Array) -> Array:
    """Return the physical parameters of x, which are x: the `physical` of problems that search their parameters."""
    return np.array(x, dtype=float)
