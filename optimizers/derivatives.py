"""Gradients: analytic where the objective has a gradient or a Jacobian, else differences that are charged."""

from collections.abc import Callable
from typing import Any, Literal, final

import numpy as np
from numpy.typing import NDArray

from calibench.optimizers.base import Array, Objective

_EPS = float(np.finfo(float).eps)
_FORWARD, _CENTRAL = _EPS**0.5, _EPS ** (1 / 3)  # balance the error of the formula against rounding of the values
_UNDEFINED = 1e199  # residuals that are not finite come back as 1e100, and this is below the square of one


def value_and_gradient(objective: Objective, x: Array) -> tuple[float, Array]:
    """Return f(x) and its gradient, shape (dim,): its own, 2 J^T r, or forward differences that step into the box.

    A gradient or Jacobian is charged `dimension` evaluations and so are the differences. Where that is no longer
    affordable the differences spend what is left, one evaluation at a time.
    """
    if objective.remaining > objective.dimension:
        if objective.has_gradient:
            return objective.value_and_gradient(x)
        if objective.has_residuals and objective.has_jacobian:
            r = objective.residuals(x)
            return float(r @ r), 2.0 * (objective.jacobian(x).T @ r)
    value = objective(x)
    # what steps are relative to, shape (dim,): the box where it is closed, and at least the point
    width = objective.upper - objective.lower
    size = np.maximum(np.abs(x), np.where(np.isfinite(width), width, 1.0))
    return value, differences(objective, x, value, objective.lower, objective.upper, size)


def differences(
    function: Callable[[Array], Any], x: Array, value: float | Array, lower: Array, upper: Array, size: Array,
    kind: Literal["forward", "central"] = "forward", steps: Array | None = None,
) -> NDArray[np.float64]:  # fmt: skip
    """Return the slopes of `function` at x, shape (dim,) for a number, (dim, m) for a vector of m, inside the box.

    `value` is ``function(x)`` and `size`, shape (dim,), what a step is relative to: eps^(1/2) for forward (one call a
    variable, error ~ step), eps^(1/3) for central ones (two calls, error ~ step^2). Beside a bound forward ones step
    back, and central ones use two points of the same side. A variable without room has slope 0.

    `steps`, shape (dim,), are the steps themselves in place of those of `size`; a sign is a side, where there is room.
    """

    def at(i: int, step: float) -> Array:
        moved = x.copy()
        moved[i] = min(max(x[i] + step, lower[i]), upper[i])
        return moved

    slopes = np.zeros((len(x), *np.shape(value)))
    for i in range(len(x)):
        if kind == "forward":
            step = _FORWARD * size[i] if steps is None else float(steps[i])
            if not lower[i] <= x[i] + step <= upper[i]:
                step = -step
                if not lower[i] <= x[i] + step <= upper[i]:  # neither side is wide enough: as far as the wider one goes
                    step = max(upper[i] - x[i], lower[i] - x[i], key=abs)
            ahead = at(i, step)
            taken = ahead[i] - x[i]
            slopes[i] = (function(ahead) - value) / taken if taken else 0.0
            continue
        wanted = _CENTRAL * size[i] if steps is None else abs(float(steps[i]))
        step = min(wanted, 0.25 * (upper[i] - lower[i]))
        if not step > 0:
            continue
        first, second = (1, -1) if lower[i] <= x[i] - step and x[i] + step <= upper[i] else (1, 2)
        if x[i] + step > upper[i] and second == 2:
            first, second = -1, -2
        near, far = at(i, first * step), at(i, second * step)
        h, k = near[i] - x[i], far[i] - x[i]
        if h and k and h != k:  # exact for a parabola through the three points
            rise, fall = function(near) - value, function(far) - value
            slopes[i] = (k * k * rise - h * h * fall) / (h * k * (k - h))
    return slopes


@final
class Memoized:
    """The value and the gradient of an objective, where one point is one pass of each however often it is asked.

    With `analytic`, the gradient is the objective's own; or, where that has residuals and a Jacobian, a value is a pass
    of residuals, and the gradient at the same point reuses it. Otherwise the gradient is differences of `kind`, inside
    the box unless the method is not `bounded`. `count` is the evaluations so far.
    """

    def __init__(
        self, objective: Objective, analytic: bool, kind: Literal["forward", "central"], bounded: bool = True
    ) -> None:
        self.count = 0
        self._objective, self._kind = objective, kind
        self._own = analytic and objective.has_gradient
        self._analytic = analytic and not self._own and objective.has_residuals and objective.has_jacobian
        self._lower = objective.lower if bounded else np.full(objective.dimension, -np.inf)
        self._upper = objective.upper if bounded else np.full(objective.dimension, np.inf)
        self._x: Array | None = None
        self._value = np.inf
        self._r: Array | None = None
        self._J: tuple[Array, Array] | None = None

    def value(self, x: Array) -> float:
        """Return f(x); infinite where it is not defined."""
        if self._x is None or not np.array_equal(x, self._x):
            self.count += 1
            self._r = self._objective.residuals(x) if self._analytic else None
            self._value = self._objective(x) if self._r is None else float(self._r @ self._r)
            self._value = self._value if self._value < _UNDEFINED else np.inf
            self._x = x.copy()
        return self._value

    def gradient(self, x: Array, steps: Array | None = None) -> Array:
        """Return the gradient at x, shape (dim,); a slope into where f is not defined is 0."""
        gate = self._objective
        if self._own and gate.remaining >= gate.dimension:
            return gate.gradient(x)
        value = self.value(x)
        if self._r is not None and gate.remaining >= gate.dimension:
            self._J = x.copy(), gate.jacobian(x)
            return np.asarray(2.0 * (self._J[1].T @ self._r))
        width = gate.upper - gate.lower
        size = np.where(np.isfinite(width), width, np.maximum(np.abs(x), 1.0))
        paid = differences(self._counted, x, value, self._lower, self._upper, size=size, kind=self._kind, steps=steps)
        return np.nan_to_num(paid, posinf=0.0, neginf=0.0)

    def curvature(self, x: Array) -> Array | None:
        """Return Gauss and Newton's 2 J^T J (dim, dim) of residuals, or None; free after the gradient at x."""
        if not self._analytic:
            return None
        if self._J is None or not np.array_equal(x, self._J[0]):
            self._J = x.copy(), self._objective.jacobian(x)
        return np.asarray(2.0 * (self._J[1].T @ self._J[1]))

    def _counted(self, x: Array) -> float:
        self.count += 1
        return self._objective(x)
