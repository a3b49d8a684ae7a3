"""The user's function as a search of `fmincon` asks it: counted, checked, with its own gradient or differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

import numpy as np

from calibench.optimizers.base import Array
from calibench.optimizers.derivatives import differences
from calibench.optimizers.fmincon.constraints import step_sizes
from calibench.optimizers.fmincon.options import Options


@final
class Called:
    """The user's function: one point is one call, however often it is asked about. `count` is the calls so far."""

    def __init__(self, fun: Callable[[Array], Any], options: Options, lower: Array, upper: Array) -> None:
        self.count = 0
        self._fun, self._lower, self._upper = fun, lower, upper
        self._own, self._kind = options.SpecifyObjectiveGradient, options.FiniteDifferenceType
        self._last: tuple[Array, float, Array | None] | None = None

    def value(self, x: Array) -> float:
        """Return f(x); NaN where it is complex."""
        return self._ask(x)[0]

    def gradient(self, x: Array, steps: Array | None = None) -> Array:
        """Return the gradient at x, shape (n,); `steps` are those of `differences`."""
        value, gradient = self._ask(x)
        if gradient is not None:
            return gradient
        size = step_sizes(x, self._lower, self._upper)
        return differences(lambda at: self._call(at)[0], x, value, self._lower, self._upper, size, self._kind, steps)

    def _ask(self, x: Array) -> tuple[float, Array | None]:
        if self._last is None or not np.array_equal(x, self._last[0]):
            self._last = (x.copy(), *self._call(x))
        return self._last[1:]

    def _call(self, x: Array) -> tuple[float, Array | None]:
        self.count += 1
        answer = self._fun(x.copy())
        if not self._own:
            return _number(answer), None
        if not isinstance(answer, tuple | list) or len(answer) < 2:
            raise ValueError(
                f"fun returned {type(answer).__name__}: (f, gradient) is needed, as SpecifyObjectiveGradient"
            )
        gradient = np.asarray(answer[1], dtype=float)
        if gradient.shape != x.shape:
            raise ValueError(f"fun returned a gradient of shape {gradient.shape}: {x.shape} is needed")
        return _number(answer[0]), gradient


def _number(value: Any) -> float:
    """Return what fun gave as a float; NaN for a complex number, so that the point is refused."""
    try:
        given = np.asarray(value)
        if given.size == 1 and given.dtype.kind == "c":
            number = complex(given.reshape(()))
            return number.real if number.imag == 0 else float("nan")
        return float(given.reshape(()))
    except (TypeError, ValueError):
        kind = f"an array of shape {np.shape(value)}" if isinstance(value, np.ndarray) else type(value).__name__
        raise ValueError(f"fun returned {kind}: one real number is needed") from None
