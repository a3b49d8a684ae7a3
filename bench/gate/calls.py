"""The calls of a problem by the gate: foreign code can neither change a candidate, nor return anything but numbers,
nor change what it has returned.

A problem with ``side_effect_free = True`` promises all three, so the gate calls it directly, down to its compiled
kernel. Any other gets a copy of each candidate, and its results are copied as floats, so that one that fills the same
array at every call changes no earlier result; a `TypeError` says what is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_ONE = "one number is needed; several objectives are not handled: give a weighted sum"


@final
@dataclass(frozen=True)
class Calls:
    """The calls of a problem; None where it has no such method.

    ``value(x, fixed)`` is one number; where that raises, ``again(x)`` is asked for the number or the error to tell.
    ``batch(points)`` and ``below(points, limits)`` give shape (k,), ``residuals(x)`` (m,), ``jacobian(x)`` (m, dim),
    ``gradient(x)`` (dim,), ``joint(x)`` (1 + dim,): the value and then its gradient.
    ``ahead(points)`` tells which points will be asked for next, one by one, so that a pool of processes may begin.
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
    batch, below, residuals, jacobian = (
        getattr(problem, name, None) for name in ("batch", "batch_below", "residuals", "jacobian")
    )
    both, gradient = (getattr(problem, name, None) for name in ("value_and_gradient", "gradient"))
    joint = both and _joint(both)
    gradient = _slopes(gradient) if gradient else joint and (lambda x: joint(x)[1:])
    if getattr(problem, "side_effect_free", False):
        kernel = getattr(problem, "kernel", None)  # the compiled kernel itself: 30 ns less a call
        value, fixed = kernel or (lambda x, _: ask(x), None)
        again = ask if kernel else raise_again
        return Calls(
            value=value,
            fixed=fixed,
            again=again,
            batch=batch,
            below=below,
            residuals=residuals,
            jacobian=jacobian,
            gradient=gradient,
            joint=joint,
        )
    checked = _number(ask)
    return Calls(
        value=lambda x, _: checked(x),
        fixed=None,
        again=raise_again,
        batch=batch and _numbers(batch),
        below=below and _numbers(below),
        residuals=residuals and _vector(residuals),
        jacobian=jacobian and _matrix(jacobian),
        gradient=gradient,
        joint=joint,
    )


def raise_again(_x: Array) -> float:
    """Raise the exception that is being handled."""
    raise


def _number(function: Any) -> Any:
    """Return `function`, x -> value, so that it cannot change what the optimiser holds, and gives a float."""

    def on_a_copy(x: Array) -> float:
        value = function(np.array(x, dtype=np.float64))
        return value if type(value) is float else _as_float(value)

    return on_a_copy


def _numbers(function: Any) -> Any:
    """Return `function`, points -> values or (points, limits) -> values, likewise: float64 of shape (k,)."""

    def on_copies(points: Array, *limits: Array) -> Array:
        given = (np.array(array, dtype=np.float64) for array in (points, *limits))
        values = np.array(_real(function(*given)), order="C")
        if values.shape != (len(points),):
            raise TypeError(f"batch returned shape {values.shape} for {len(points)} points")
        return values

    return on_copies


def _vector(function: Any) -> Any:
    """Return `function`, x -> residuals, likewise: float64 of shape (m,), an array of the gate's own."""

    def on_a_copy(x: Array) -> Array:
        values = _own(function(np.array(x, dtype=np.float64)))
        if values.ndim != 1:
            raise TypeError(f"residuals returned shape {values.shape}: (m,) is needed, one axis")
        return values

    return on_a_copy


def _matrix(function: Any) -> Any:
    """Return `function`, x -> derivatives of the residuals, likewise; the gate, which knows m, checks its shape."""
    return lambda x: _own(function(np.array(x, dtype=np.float64)))


def _slopes(function: Any) -> Any:
    """Return `function`, x -> gradient, likewise: float64 of shape (dim,), of the gate's own."""

    def on_a_copy(x: Array) -> Array:
        return _checked_slopes(function(np.array(x, dtype=np.float64)), "gradient", len(x))

    return on_a_copy


def _joint(function: Any) -> Any:
    """Return `function`, x -> (value, gradient), likewise, as one array of shape (1 + dim,)."""

    def on_a_copy(x: Array) -> Array:
        pair = function(np.array(x, dtype=np.float64))
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise TypeError(f"value_and_gradient returned {type(pair).__name__}: a value and an array are needed")
        return np.append(_as_float(pair[0]), _checked_slopes(pair[1], "value_and_gradient", len(x)))

    return on_a_copy


def _checked_slopes(values: Any, name: str, dimension: int) -> Array:
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
    try:
        if not isinstance(value, str | bytes | bytearray):
            return float(value)
    except (TypeError, ValueError):
        pass
    raise TypeError(f"the objective returned {type(value).__name__}: a real number is needed")
