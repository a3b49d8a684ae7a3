"""How good a fit the noise of the readings allows: the levels that an instance's runs are held to.

The true machine does not explain noisy readings exactly: it leaves the value ``problem(truth)``. An answer of that
value or less explains them as well as the truth does, and no more can be asked of a method: this is *as good as the
noise*. The least value in the box lies below it, as a fit of p parameters to m residuals takes up some p of m parts of
the noise; what lies between the two is chance, and no method is ranked by it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from calibench.problems.base import Array

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
