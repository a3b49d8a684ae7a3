"""How a search of `fmincon` ends: MATLAB's exit flags, the tests that lead to them, and their messages.

A test is a function of an iterate and the options. It returns a `Finished` where it is met, else None; who asks raises
it. SciPy lets that exception through, so that both algorithms end by the same tests and the same messages.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from calibench.optimizers.base import Array
from calibench.optimizers.fmincon.frame import Iterate
from calibench.optimizers.fmincon.options import Options
from calibench.optimizers.fmincon.stop import absolute_stop

ExitFlag = Literal[1, 2, 4, 5, 0, -1, -2, -3]

STUCK = "no further step lowers the objective in double precision"


class Finished(Exception):
    """The search is over: MATLAB's exit flag, and the message."""

    def __init__(self, flag: ExitFlag, message: str) -> None:
        super().__init__(message)
        self.flag, self.message = flag, message


def met_at(
    now: Iterate, before: Iterate | None, direction: Array | None, iteration: int, stuck: bool, options: Options
) -> Finished | None:
    """Return the first of MATLAB's tests that the iterate `now` meets.

    `direction`, shape (n,), is that of the line search from `before` to `now`. `stuck` tells that the last iterates
    brought no progress: SQP then ends, as its line search would go on for ever.
    """
    feasible, sqp = is_feasible(now, options), options.Algorithm == "sqp"
    if feasible and now.first_order <= options.OptimalityTolerance:
        return Finished(
            1,
            f"Local minimum found: first-order optimality {now.first_order:.3e} is within OptimalityTolerance "
            f"{options.OptimalityTolerance:.1e}, and the constraints are satisfied.",
        )
    if feasible and now.value < options.ObjectiveLimit:
        return unbounded(now.value, options)
    if direction is not None and options.StopPlace == "next_gradient":
        small = small_at(now, direction, direction, 2.0 * (options.FunctionTolerance or 0.0), options)
        if small is not None:
            return small
    if before is not None and sqp and options.StopRule == "relative" and feasible:
        # trust-constr's small steps are its radius', and it tests that itself
        change = float(np.max(np.abs(now.x - before.x) / (1.0 + np.abs(now.x))))
        if change <= (options.StepTolerance or 0.0):
            return Finished(
                2, f"Local minimum possible: the relative step {change:.3e} is within StepTolerance, and feasible."
            )
    if sqp and stuck:
        return Finished(2, STUCK)
    if options.MaxIterations is not None and iteration >= options.MaxIterations:
        return out_of_iterations(options)
    return None


def small_at(
    now: Iterate, direction: Array, step: Array, slope_limit: float | None, options: Options
) -> Finished | None:
    """Return MATLAB's absolute stop where `now` is feasible and meets it; |g step| is compared with `slope_limit`."""
    if not is_feasible(now, options):
        return None
    met = absolute_stop(direction, float(now.gradient @ step), options.StepTolerance or 0.0, slope_limit or 0.0)
    return None if met is None else Finished(*met)


def small_after(before: Iterate, direction: Array, violation: float, options: Options) -> Finished | None:
    """Return MATLAB's absolute stop where a line search that began at `before` ends with this `violation`.

    The gradient there is not known yet, so the slope is that of `before`.
    """
    if not violation <= options.ConstraintTolerance:
        return None
    slope, limit = float(before.gradient @ direction), 2.0 * (options.FunctionTolerance or 0.0)
    met = absolute_stop(direction, slope, options.StepTolerance or 0.0, limit)
    return None if met is None else Finished(*met)


def verdict(best: Iterate, why: str, options: Options) -> tuple[ExitFlag, str]:
    """Return flag and message of a search that SciPy ended, or that had nothing to search, with the answer `best`."""
    if best.violation > options.ConstraintTolerance:
        return -2, f"No feasible point found: constraints are violated by {best.violation:.3e}."
    if best.first_order <= options.OptimalityTolerance:
        return 1, f"Local minimum found: first-order optimality is {best.first_order:.3e}."
    return 2, f"Local minimum possible: {why}, and the constraints are satisfied."


def is_feasible(at: Iterate, options: Options) -> bool:
    """Tell whether the constraints are satisfied at an iterate, within ConstraintTolerance."""
    return at.violation <= options.ConstraintTolerance


def infeasible(violation: float) -> Finished:
    """Return the end of a search near which no feasible point was found; `violation` is the least that was."""
    return Finished(
        -2, f"No feasible point found: near the last one constraints are violated by at least {violation:.3e}."
    )


def unbounded(value: float, options: Options) -> Finished:
    """Return the end of a search at a feasible point below ObjectiveLimit."""
    return Finished(
        -3,
        f"Unbounded: the objective {value:.3e} is below ObjectiveLimit {options.ObjectiveLimit:.1e}, "
        "and the constraints are satisfied.",
    )


def out_of_iterations(options: Options) -> Finished:
    """Return the end of a search that has made as many iterates as it may."""
    return Finished(0, f"Stopped at MaxIterations = {options.MaxIterations}.")


def out_of_evaluations(options: Options) -> Finished:
    """Return the end of a search that has called the objective as often as it may."""
    return Finished(0, f"Stopped at MaxFunctionEvaluations = {options.MaxFunctionEvaluations}.")
