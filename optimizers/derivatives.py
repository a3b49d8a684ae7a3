"""Derivatives for methods that want a gradient: analytic where the objective has a Jacobian, else paid differences."""

from __future__ import annotations

import numpy as np

from optimizers.base import Array, Objective

_STEP = float(np.finfo(float).eps) ** 0.5


def value_and_gradient(objective: Objective, x: Array) -> tuple[float, Array]:
    """Return f(x) and its gradient, shape (dim,): 2 J^T r, or forward differences that step into the box.

    A Jacobian is charged `dimension` evaluations and so are the differences. Where a Jacobian is no longer affordable
    the differences spend what is left, one evaluation at a time.
    """
    if objective.has_residuals and objective.has_jacobian and objective.remaining > objective.dimension:
        r = objective.residuals(x)
        return float(r @ r), 2.0 * (objective.jacobian(x).T @ r)
    value = objective(x)
    return value, forward_differences(objective, x, value)


def forward_differences(objective: Objective, x: Array, value: float) -> Array:
    """Return the gradient at x by `dimension` further evaluations, each inside the box."""
    gradient = np.empty(objective.dimension)
    for i in range(objective.dimension):
        width = objective.upper[i] - objective.lower[i]
        step = _STEP * max(abs(x[i]), width if np.isfinite(width) else 1.0)
        ahead = x.copy()
        ahead[i] = x[i] + step if x[i] + step <= objective.upper[i] else x[i] - step
        ahead[i] = min(max(ahead[i], objective.lower[i]), objective.upper[i])
        taken = ahead[i] - x[i]
        gradient[i] = (objective(ahead) - value) / taken if taken else 0.0
    return gradient


class Slope:
    """Answer value and gradient when they are asked for one by one: the gradient uses what the value has paid for."""

    def __init__(self, objective: Objective) -> None:
        self._objective = objective
        self._x: Array | None = None
        self._value = np.inf
        self._residuals: Array | None = None

    def value(self, x: Array) -> float:
        """Return f(x) for one evaluation, and remember it."""
        if self._objective.has_residuals and self._objective.has_jacobian:
            self._residuals = self._objective.residuals(x)
            self._value = float(self._residuals @ self._residuals)
        else:
            self._value = self._objective(x)
        self._x = x.copy()
        return self._value

    def gradient(self, x: Array) -> Array:
        """Return the gradient at x, shape (dim,): `dimension` evaluations, and one more where f(x) is not the last."""
        if self._x is None or not np.array_equal(self._x, x):
            self.value(x)
        if self._residuals is not None and self._objective.remaining >= self._objective.dimension:
            return 2.0 * (self._objective.jacobian(x).T @ self._residuals)
        return forward_differences(self._objective, x, self._value)
