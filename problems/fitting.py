"""The least squares answer of a problem with residuals and a Jacobian: a reference for tables, tests and statistics.

How good a fit the noise of the readings allows: the true machine leaves the value ``problem(truth)`` of noisy readings.
An answer of that value or less is *as good as the noise*, and no more can be asked of a method; the least value in the
box lies below it by chance, and no method is ranked by what lies between.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from calibench.problems.base import Array, extra_of, frozen

_ROUNDING = 1e-14
_HIGH = 1e100  # instead of a residual without a value
_ROUGH = 50  # damped steps where a rough answer is enough; else a hundred for each parameter
_ABOVE = (1e8, 1e6, 1e4, 1e3, 1e2, 1e1, 3.0, 1.5, 1.0)  # levels over that of the noise


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


def best_of(problem: Any) -> Array:
    """Return the least squares answer from the start, shape (dim,), by Gauss-Newton, box or not."""
    return frozen(fit(problem))


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

    def finite(p: Array) -> Array:
        return np.nan_to_num(residuals(p), nan=_HIGH, posinf=_HIGH, neginf=-_HIGH)

    r = residuals(x)
    value, damped = float(r @ r), False
    for _ in range(100):
        j = jacobian(x)
        scale = np.linalg.norm(j, axis=0)
        scale[scale == 0] = 1.0
        step = -np.linalg.lstsq(j / scale, r, rcond=rank_tolerance)[0] / scale
        change = j @ step
        hidden = float(change @ change) <= 1e-12 * value  # by rounding: whether the value falls
        trial = x + step
        there = residuals(trial)
        reached = float(there @ there)

        if not hidden and not reached < value and not damped:
            from scipy.optimize import least_squares  # here, as listing the problems must not load SciPy

            damped, rough = True, least_fall is not None
            few = len(r) < len(x)  # equations, of which MINPACK wants as many as there are parameters
            trial = least_squares(
                finite, x, jacobian, method="trf" if few else "lm", x_scale="jac",
                ftol=least_fall if rough else _ROUNDING, xtol=_ROUNDING, gtol=_ROUNDING,
                max_nfev=_ROUGH if rough else 100 * (len(x) + 1),
            ).x  # fmt: skip
            there, step = residuals(trial), trial - x
            reached = float(there @ there)

        if not hidden and not reached < value:
            return x
        x, r, gained, value = trial, there, value - reached, reached
        if not hidden and least_fall is not None and gained <= least_fall * value:
            return x
        still = hidden or gained <= 1e-15 * value
        if still and np.abs(step * scale).max() <= 1e-9 * (1 + np.abs(x * scale).max()):
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


def value_of_noise(expected: Callable[[Any], float]) -> cached_property[float | None]:
    """Return a property of problems: the value that the noise of an instance leaves at its truth; None of no instance.

    Without noise it is what is `expected`. An answer of that value explains the readings as well as the truth does.
    """

    def value(problem: Any) -> float | None:
        """Return the value at which an answer is as good as the noise; None of no instance."""
        if problem.drawn is None:
            return None
        return float(problem(problem.truth) if problem.drawn.noise.level > 0 else expected(problem))

    return cached_property(value)


def levels(exact: Callable[[Any], tuple[float, ...]]) -> property:
    """Return a property of problems: the targets, largest first, whose first crossing is recorded.

    They are the `exact` ones, which end at rounding. Those of an instance with noise end where an answer is as good as
    the noise, as nothing below that is ranked; without noise that is one of them.
    """

    def targets(problem: Any) -> tuple[float, ...]:
        """Return levels of the value whose first crossing is recorded, the largest first."""
        if problem.drawn is None:
            return exact(problem)
        level = problem.as_good_as_noise
        if problem.drawn.noise.level > 0:
            return tuple(level * factor for factor in _ABOVE)
        return tuple(sorted({*exact(problem), level}, reverse=True))

    return property(targets)


# of a problem of measured lengths: f* + 1e-1 .. 1e-12 mm^2, as rounding leaves 1e-13
levels_above_minimum = levels(lambda problem: tuple(problem.minimum + 10.0**-k for k in (1, 2, 3, 4, 5, 6, 8, 10, 12)))


def worst_errors(problem: Any, x: Array) -> dict[str, float]:
    """Return parameter_error_mm and parameter_error_rad, the worst error of x, for each unit that its parameters have.

    x holds the parameters themselves, and the truth is known.
    """
    away = np.abs(np.asarray(x, dtype=float) - problem.truth)
    units = np.array([p.unit for p in problem.parameters])
    return {f"parameter_error_{unit}": float(away[units == unit].max()) for unit in ("mm", "rad") if unit in units}


def least_of_instance(problem: Any) -> float | None:
    """Return the least value in the box of an instance, found downhill from the truth, zero without noise.

    Of no instance it is that at the problem's `best`, as measured data never reach zero; None where it has none.
    """
    if problem.drawn is None:
        best = extra_of(problem, "best")
        return None if best is None else float(problem(best))
    return least_in_box(problem) if problem.drawn.noise.level > 0 else 0.0


def least_in_box(problem: Any) -> float:
    """Return the least value in the box that is found downhill from the truth, by trust regions kept in the box."""
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
