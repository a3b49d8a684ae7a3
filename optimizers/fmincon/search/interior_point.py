"""Algorithm interior-point of `fmincon`: SciPy's trust-constr (Byrd, Hribar, Nocedal 1999), with a matrix of ours."""

from __future__ import annotations

import functools
import warnings
from typing import Any

import numpy as np

from calibench.optimizers.base import Array
from calibench.optimizers.fmincon.search.endings import out_of_iterations
from calibench.optimizers.fmincon.search.walk import Walk

_NO_TEST = 1e-300  # SciPy's tolerance: met only by no change at all


def interior_point(walk: Walk, start: Array, first: bool = True) -> str:
    """Search from u = `start`, which the walk has arrived at; return why it ended where no test ended it.

    Where the answer is not feasible it begins once more (`first`), from a feasible point.
    """
    from scipy.optimize import SR1, Bounds, minimize

    options, (low, high) = walk.options, walk.state.frame.bounds()
    matrix = SR1()
    matrix.initialize(len(start), "hess")
    closed = np.isfinite(low).any() or np.isfinite(high).any()
    settings: Any = {
        "gtol": _NO_TEST,
        "xtol": max(options.StepTolerance or 0.0, 1e-16),
        "barrier_tol": max(options.OptimalityTolerance**2, 1e-30),
        "maxiter": options.MaxIterations,
        "sparse_jacobian": False,
        "initial_barrier_parameter": options.InitBarrierParam or 0.1,
        "initial_tr_radius": options.InitTrustRegionRadius or 1.0,
        "factorization_method": "SVDFactorization" if len(walk.state.scales.on) >= len(start) else None,
    }
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Singular Jacobian matrix", category=UserWarning)
        ended = minimize(
            walk.value,
            start,
            jac=walk.slope,
            hess=lambda u: _curvature(walk, matrix),
            method="trust-constr",
            bounds=Bounds(low, high, keep_feasible=True) if closed else None,
            constraints=_constraints(walk),
            options=settings,
        )
    if ended.status == 0:
        raise out_of_iterations(options)
    best = walk.best()
    if first and best.violation > options.ConstraintTolerance:
        frame, feasible = walk.state.frame, walk.arrive_feasible(best)
        return interior_point(walk, frame.inside(frame.u(feasible.x)), first=False)
    return "the trust region is within StepTolerance"


def _constraints(walk: Walk) -> Any:
    """Return the constraints as trust-constr takes them; their curvature is in the matrix of the whole Lagrangian."""
    from scipy.optimize import NonlinearConstraint

    bent: Any = lambda u, v: np.zeros((len(u), len(u)))  # noqa: E731
    return [
        NonlinearConstraint(
            functools.partial(walk.constraint, which=which),
            -np.inf if which == 0 else 0.0,
            0.0,
            jac=functools.partial(walk.constraint_slope, which=which),
            hess=bent,
        )
        for which, scale in enumerate((walk.state.scales.inside, walk.state.scales.on))
        if len(scale)
    ]


def _curvature(walk: Walk, matrix: Any) -> Array:
    """Return the Hessian of the Lagrangian at the last iterate, updated by the step to it (SR1, as it may be
    indefinite). Ours, as SciPy's asks for the gradient at every trial point, those refused included.
    """
    state, path = walk.state, walk.state.path
    n, bend = int(state.frame.free.sum()), np.zeros(0)
    if len(path) > 1 and state.known < len(path):
        now, before, free, width = path[-1], path[-2], state.frame.free, state.frame.width
        change = now.gradient - before.gradient
        change += (now.J_in - before.J_in).T @ now.inequalities + (now.J_eq - before.J_eq).T @ now.equalities
        step, bend = (now.x - before.x)[free] / width, change[free] * width / state.scales.f
        if bend.any():
            matrix.update(step, bend)
    walk.state = state = state.bent_by(bool(bend.any()))
    straight = len(path) > 1 and not state.bent  # no curvature so far: then each step goes to the radius
    return np.zeros((n, n)) if straight else np.asarray(matrix.get_matrix())
