"""The least squares answer of a problem with residuals and a Jacobian: pseudo-inverse, Gauss-Newton, weighted or not.

It is a reference for tables, tests and statistics, not an optimiser to be compared: it passes no gate.

How good a fit the noise of the readings allows: the levels that an instance's runs are held to.

The true machine does not explain noisy readings exactly: it leaves the value ``problem(truth)``. An answer of that
value or less explains them as well as the truth does, and no more can be asked of a method: this is *as good as the
noise*. The least value in the box lies below it, as a fit of p parameters to m residuals takes up some p of m parts of
the noise; what lies between the two is chance, and no method is ranked by it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from calibench.problems.base import Array

_ROUNDING = 1e-14
_HIGH = 1e100
_ROUGH = 50  # damped steps where a rough answer is enough; else a hundred for each parameter


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
    least_fall: float | None = None,
) -> Array:
    """Return a minimum of r @ r near `x`: full steps while they go down; then MINPACK's damped ones, once.

    Where a step promises less than rounding can show, full steps are taken until they are negligible.

    A direction whose singular value is below `rank_tolerance` times the largest (columns scaled to length 1; None: the
    rounding of the machine) is held where it is. A fall by less than `least_fall` of the value ends the search, however
    long its step was; None: both must be rounding only.
    """
    r = residuals(x)
    value, damped = _square(r), False
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
        trial = x + step
        there = residuals(trial)
        if not _square(there) < value and not damped:
            trial, damped = _damped(residuals, jacobian, x, least_fall), True
            there, step = residuals(trial), trial - x
        reached = _square(there)
        if not reached < value:
            return x
        x, r, gained, value = trial, there, value - reached, reached
        if least_fall is not None and gained <= least_fall * value:
            return x
        if gained <= 1e-15 * value and _negligible(step * scale, x * scale):
            return x
    return x


def _damped(
    residuals: Callable[[Array], Array], jacobian: Callable[[Array], Array], x: Array, least_fall: float | None
) -> Array:
    """Return where the steps of Levenberg and Marquardt end, from x; a place without a value is far too high."""
    from scipy.optimize import least_squares

    def finite(x: Array) -> Array:
        return np.nan_to_num(residuals(x), nan=_HIGH, posinf=_HIGH, neginf=-_HIGH)

    few = len(residuals(x)) < len(x)  # equations, of which MINPACK wants as many as there are parameters
    rough = least_fall is not None
    found = least_squares(
        finite, x, jacobian, method="trf" if few else "lm", x_scale="jac", ftol=least_fall if rough else _ROUNDING,
        xtol=_ROUNDING, gtol=_ROUNDING, max_nfev=_ROUGH if rough else 100 * (len(x) + 1),
    )  # fmt: skip
    return np.asarray(found.x)


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


_ABOVE = (1e8, 1e6, 1e4, 1e3, 1e2, 1e1, 3.0, 1.5, 1.0)  # levels over that of the noise


def value_of_noise(problem: Any, noise: float, expected: float) -> float:
    """Return the value that the noise of the readings leaves at the truth; without noise the `expected` one.

    `expected` is the mean value that the finest readings of the family would leave: an answer below it is as good as if
    the readings had that noise.
    """
    return float(problem(problem.truth)) if noise > 0 else expected


def levels(level: float, noise: float, exact: tuple[float, ...]) -> tuple[float, ...]:
    """Return the targets of an instance, largest first: with noise down to `level`, as nothing below it is ranked.

    Without noise they are the family's `exact` ones, which end at rounding, and `level` among them.
    """
    if noise > 0:
        return tuple(level * factor for factor in _ABOVE)
    return tuple(sorted({*exact, level}, reverse=True))


def least_in_box(problem: Any) -> float:
    """Return the least value in the box that is found downhill from the truth, by trust regions kept in the box.

    A local minimum: no other is sought. It is a reference and passes no gate.
    """
    from scipy.optimize import least_squares  # here, as listing the problems must not load SciPy

    scale = problem.upper - problem.lower
    found: Array = problem.truth
    for method in ("trf", "dogbox"):
        answer = least_squares(
            problem.residuals, found, problem.jacobian, (problem.lower, problem.upper), method=method, x_scale=scale,
            ftol=1e-15, xtol=1e-15, gtol=1e-15, max_nfev=200,
        )  # fmt: skip
        if problem(answer.x) < problem(found):
            found = np.clip(answer.x, problem.lower, problem.upper)
    return float(problem(found))
