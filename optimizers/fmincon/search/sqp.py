"""Algorithm sqp of `fmincon`: SciPy's SLSQP (Kraft 1988), begun afresh where it gives up."""

from __future__ import annotations

import warnings
from typing import Any

from calibench.optimizers.base import Array
from calibench.optimizers.fmincon.frame import Frame, Scales
from calibench.optimizers.fmincon.search.endings import STUCK, Finished, is_feasible
from calibench.optimizers.fmincon.search.walk import Walk

_NO_TEST = 1e-300  # SciPy's tolerance: met only by no change at all
_AFRESH = 3  # it begins again from its best point, with a new matrix and new scales, at most so often


def sqp(walk: Walk, start: Array) -> str:
    """Search from u = `start`, which the walk has arrived at; return why it ended where no test ended it."""
    options, (low, high) = walk.options, walk.state.frame.bounds()
    constraints = _constraints(walk)
    tried_elsewhere = False
    for _ in range(_AFRESH):
        before = walk.best()
        walk.state = walk.state.afresh()
        gone_wrong = _slsqp(walk, start, low, high, constraints)
        best = walk.best()
        if best.violation > options.ConstraintTolerance:
            if tried_elsewhere:
                break
            tried_elsewhere = True
            best = walk.arrive_feasible(best)
        elif not gone_wrong or (is_feasible(before, options) and before.value - best.value <= 1e-6 * abs(before.value)):
            break
        frame = Frame.of(walk.region, best.x, options.ScaleProblem and options.ScaleVariables)
        scales = Scales.of(frame, best.gradient, best.J_in, best.J_eq, on=options.ScaleProblem)
        walk.state = walk.state.reframed(frame, scales)
        start, (low, high) = frame.u(best.x), frame.bounds()
    return STUCK


def _constraints(walk: Walk) -> list[dict[str, Any]]:
    """Return the constraints as SLSQP takes them: its inequalities are >= 0, MATLAB's <= 0."""
    scales = walk.state.scales
    return [
        {
            "type": kind,
            "fun": lambda u, w=which, s=sign: s * walk.constraint(u, w),
            "jac": lambda u, w=which, s=sign: s * walk.constraint_slope(u, w),
        }
        for kind, which, sign, count in (("ineq", 0, -1.0, len(scales.inside)), ("eq", 1, 1.0, len(scales.on)))
        if count
    ]


def _slsqp(walk: Walk, start: Array, low: Array, high: Array, constraints: list[dict[str, Any]]) -> bool:
    """Run SLSQP once; return whether it ended otherwise than by no change of value or point."""
    from scipy.optimize import minimize

    given: Any = constraints
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Values in x were outside bounds", category=RuntimeWarning)
        try:
            ended = minimize(
                walk.value,
                start,
                jac=walk.slope,
                method="SLSQP",
                bounds=list(zip(low, high)),
                constraints=given,
                options={"ftol": _NO_TEST, "maxiter": 10**8},
            )
        except Finished as end:
            if end.message != STUCK:
                raise
            return False
    return bool(ended.status != 0)
