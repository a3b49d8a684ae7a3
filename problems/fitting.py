"""The least squares answer of a problem with residuals and a Jacobian: pseudo-inverse, Gauss-Newton, weighted or not.

It is a reference for tables, tests and statistics, not an optimiser to be compared: it passes no gate.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from calibench.problems.base import Array


def fit(problem: Any, x: Array | None = None, *, covariance: Array | None = None) -> Array:
    """Return the least squares answer, shape (dim,), from `x` (the start) by Gauss-Newton; `covariance` weights it.

    For linear residuals one step is the pseudo-inverse's answer. It is local and ignores the box.
    """
    first = np.array(problem.start if x is None else x, dtype=float)
    if covariance is None:
        return gauss_newton(problem.residuals, problem.jacobian, first)
    half = np.linalg.cholesky(checked_covariance(covariance, len(problem.residuals(first))))
    return gauss_newton(
        lambda p: np.linalg.solve(half, problem.residuals(p)),
        lambda p: np.linalg.solve(half, problem.jacobian(p)),
        first,
    )


def gauss_newton(
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    x: Array,
    rank_tolerance: float | None = None,
) -> Array:
    """Return a minimum of r @ r near `x`: full steps where they go down, else halved, until none does.

    Where a step promises less than rounding can show, full steps are taken until they are negligible.

    A direction whose singular value is below `rank_tolerance` times the largest (columns scaled to length 1; None: the
    rounding of the machine) is held where it is.
    """
    r = residuals(x)
    value = _square(r)
    for _ in range(100):
        j = jacobian(x)
        scale = np.linalg.norm(j, axis=0)
        scale[scale == 0] = 1.0
        step = -np.linalg.lstsq(j / scale, r, rcond=rank_tolerance)[0] / scale
        if _square(j @ step) <= 1e-12 * value:  # rounding would hide whether the value falls
            x = x + step
            if _negligible(step * scale, x * scale):
                return x
            r = residuals(x)
            value = _square(r)
            continue
        for _ in range(40):
            trial = x + step
            there = residuals(trial)
            reached = _square(there)
            if reached < value:
                break
            step = step / 2
        else:
            return x
        x, r, gained, value = trial, there, value - reached, reached
        if gained <= 1e-15 * value and _negligible(step * scale, x * scale):
            return x
    return x


def checked_covariance(covariance: Array | None, m: int) -> Array:
    """Return the covariance of m residuals, the identity where None; raise `ValueError` where it is none."""
    if covariance is None:
        return np.eye(m)
    matrix = np.asarray(covariance, dtype=float)
    if matrix.shape != (m, m) or not np.allclose(matrix, matrix.T):
        raise ValueError(f"covariance has shape {matrix.shape}: a symmetric ({m}, {m}) is needed, a row for a residual")
    if np.linalg.eigvalsh(matrix)[0] <= 0:
        raise ValueError("covariance: it is not positive definite; are two residuals one reading?")
    return matrix


def _square(r: Array) -> float:
    return float(r @ r)


def _negligible(step: Array, x: Array) -> bool:
    return bool(np.abs(step).max() <= 1e-9 * (1 + np.abs(x).max()))
