"""The calls of a problem by the gate: foreign code can neither change a candidate, nor return anything but numbers,
nor change what it has returned.

A problem with ``side_effect_free = True`` promises all three, so the gate calls it directly, down to its compiled
kernel. Any other gets a copy of each candidate, and its results are copied as floats, so that one that fills the same
array at every call changes no earlier result; a `TypeError` says what is needed.
"""

from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, final

import numpy as np

from calibench.problems.base import Array

_ONE = "one number is needed; several objectives are not handled: give a weighted sum"


@final
@dataclass(frozen=True)
class Calls:
    """The calls of a problem; None where it has no such method.

    ``value(x, fixed)`` is one number; where that raises, ``again(x)`` is asked for the number or the error to tell.
    ``batch`` and ``below`` give shape (k,), ``residuals`` (m,), ``jacobian`` (m, dim), ``gradient`` (dim,), ``joint``
    (1 + dim,): the value and then its gradient. ``ahead(points)`` tells which points are asked for next, one by one.
    """

    value: Any
    fixed: Any
    again: Any
    batch: Any
    below: Any
    residuals: Any
    jacobian: Any
    gradient: Any = None
    joint: Any = None
    ahead: Any = None

    def one(self, x: Array) -> float:
        """Return the value at x, shape (dim,), that the gate would get; raise the exception that it would get."""
        try:
            value: float = self.value(x, self.fixed)
        except Exception:
            value = self.again(x)
        return value


def calls_of(problem: Any) -> Calls:
    """Return the calls of `problem`."""
    ask: Any = problem.__call__
    names = ("batch", "batch_below", "residuals", "jacobian", "gradient", "value_and_gradient")
    batch, below, residuals, jacobian, slopes, both = (getattr(problem, name, None) for name in names)
    joint = both and (lambda x: _joint(both(_copy(x)), len(x)))
    gradient = joint and (lambda x: joint(x)[1:])
    if slopes:
        gradient = lambda x: _slopes(slopes(_copy(x)), "gradient", len(x))  # noqa: E731
    if getattr(problem, "side_effect_free", False):
        kernel = getattr(problem, "kernel", None)  # the compiled kernel itself: 30 ns less a call
        value, fixed = kernel or (lambda x, _: ask(x), None)
        again = ask if kernel else raise_again
        return Calls(
            value=value, fixed=fixed, again=again, batch=batch, below=below, residuals=residuals, jacobian=jacobian,
            gradient=gradient, joint=joint,
        )  # fmt: skip
    array, ndarray, double = np.array, np.ndarray, np.dtype(np.float64)

    def on_a_copy(x: Array, _: Any) -> float:
        value = ask(array(x) if type(x) is ndarray and x.dtype is double else array(x, double))
        return value if type(value) is float else _as_float(value)

    return Calls(
        value=on_a_copy,
        fixed=None,
        again=raise_again,
        batch=batch and (lambda points: _numbers(batch(_copy(points)), len(points))),
        below=below and (lambda points, limits: _numbers(below(_copy(points), _copy(limits)), len(points))),
        residuals=residuals and (lambda x: _vector(residuals(_copy(x)))),
        jacobian=jacobian and (lambda x: _own(jacobian(_copy(x)))),  # the gate, which knows m, checks its shape
        gradient=gradient,
        joint=joint,
    )


_copy = partial(np.array, dtype=np.float64)


def raise_again(_x: Array) -> float:
    """Raise the exception that is being handled."""
    raise


def _numbers(values: Any, count: int) -> Array:
    """Return the values of `count` points as float64 of shape (k,), of the gate's own."""
    own = np.array(_real(values), order="C")
    if own.shape != (count,):
        raise TypeError(f"batch returned shape {own.shape} for {count} points")
    return own


def _vector(values: Any) -> Array:
    own = _own(values)
    if own.ndim != 1:
        raise TypeError(f"residuals returned shape {own.shape}: (m,) is needed, one axis")
    return own


def _joint(pair: Any, dimension: int) -> Array:
    """Return (value, gradient) likewise, as one array of shape (1 + dim,)."""
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise TypeError(f"value_and_gradient returned {type(pair).__name__}: a value and an array are needed")
    return np.append(_as_float(pair[0]), _slopes(pair[1], "value_and_gradient", dimension))


def _slopes(values: Any, name: str, dimension: int) -> Array:
    slopes = _own(values)
    if slopes.shape != (dimension,):
        raise TypeError(f"{name} returned a gradient of shape {slopes.shape}: ({dimension},) is needed, one axis")
    return slopes


def _own(values: Any) -> Array:
    """Return numbers as floats in an array of their own; with their layout, as BLAS sums other layouts otherwise."""
    return np.array(_real(values), order="K")


def _real(values: Any) -> Array:
    array = np.asarray(values)
    if np.iscomplexobj(array):
        raise TypeError("the objective returned complex numbers: real ones are needed")
    return np.asarray(array, dtype=np.float64)


def _as_float(value: Any) -> float:
    """Return what an objective gave as a float; a `TypeError` says what it should have given."""
    if isinstance(value, complex | np.complexfloating):
        raise TypeError(f"the objective returned the complex number {value}: a real number is needed")
    if isinstance(value, np.ndarray) and value.ndim:
        raise TypeError(f"the objective returned an array of shape {value.shape}: {_ONE}")
    if isinstance(value, list | tuple):
        raise TypeError(f"the objective returned a {type(value).__name__} of {len(value)}: {_ONE}")
    with suppress(TypeError, ValueError):
        if not isinstance(value, str | bytes | bytearray):
            return float(value)
    raise TypeError(f"the objective returned {type(value).__name__}: a real number is needed")
