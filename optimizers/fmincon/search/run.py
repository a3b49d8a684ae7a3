"""One search of `fmincon`, from its start to its exit flag: SciPy proposes iterates, and `walk` checks each one.

SciPy sees u of `frame`, and f and c divided so that no component of a gradient at the start is above 100: the
rule of IPOPT (Waechter and Biegler 2006, sec. 3.8). Measured on full12 in mm^4: SLSQP then needs 141 .. 233 passes,
with a first value of one up to 297, and unscaled it stops at its first step ("Inequality constraints incompatible").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.optimizers.base import Array
from calibench.optimizers.fmincon.constraints import Region
from calibench.optimizers.fmincon.frame import Frame, Scales
from calibench.optimizers.fmincon.options import Options
from calibench.optimizers.fmincon.search.endings import ExitFlag, Finished, infeasible, verdict
from calibench.optimizers.fmincon.search.interior_point import interior_point
from calibench.optimizers.fmincon.search.sqp import sqp
from calibench.optimizers.fmincon.search.state import Seen, State
from calibench.optimizers.fmincon.search.told import print_header, print_message, tell
from calibench.optimizers.fmincon.search.walk import Asked, Slopes, Walk, difference_steps


@final
@dataclass(frozen=True, eq=False)
class Outcome:
    """MATLAB's exit flag, the message, and the last state; None where the search ended before it asked anything."""

    flag: ExitFlag
    message: str
    state: State | None


def search(asked: Asked, region: Region, options: Options, x0: Array) -> Outcome:
    """Search from x0, shape (n,), until a test is met.

    Raises `ValueError` where objective or constraints are not defined at x0, `RuntimeError` where an OutputFcn raises.
    """
    options = options.filled(len(x0))
    contradiction = region.contradiction()
    if contradiction:
        outcome = Outcome(-2, f"No feasible point: {contradiction}.", None)
    else:
        outcome = _searched(
            asked, region, options, Frame.of(region, x0, options.ScaleProblem and options.ScaleVariables)
        )
    if outcome.state is not None:
        tell(outcome.state, asked.count, options, "done")
    print_message(outcome.message, options)
    return outcome


def _searched(asked: Asked, region: Region, options: Options, frame: Frame) -> Outcome:
    state, gradient, slopes = _start(asked, region, options, frame)
    walk, x = Walk(asked, region, options, state), state.seen.x
    print_header(options)
    try:
        walk.arrive(x, gradient, slopes)
        why = _descend(walk, frame.u(x))
    except Finished as end:
        return _ended(walk, end)
    best = walk.best()
    return Outcome(*verdict(best, why, options), walk.state.settled(best))


def _start(asked: Asked, region: Region, options: Options, frame: Frame) -> tuple[State, Array, Slopes]:
    """Return the state before the first iterate, which fixes the scales, with the derivatives at `seen.x`."""
    x = frame.x0
    if options.Algorithm == "interior-point" and frame.free.any():
        x = frame.x(frame.inside(frame.u(x)))
    if not region.is_defined(x):
        raise ValueError("the constraints are undefined at the initial point: NaN, infinite or complex")
    value = asked.value(x)
    if not np.isfinite(value):
        raise ValueError(f"the objective is undefined at the initial point: it is {value:g} there")
    steps = difference_steps(x, (), options)
    gradient = asked.gradient(x, steps)
    if not np.isfinite(gradient).all():
        raise ValueError("the gradient of the objective is undefined at the initial point")
    slopes = region.slopes(x, steps)
    scales = Scales.of(frame, gradient, *slopes, on=options.ScaleProblem)
    return State(frame, scales, Seen(x, value, True)), gradient, slopes


def _descend(walk: Walk, start: Array) -> str:
    """Search from u = `start`; return why it ended where no test ended it."""
    if not walk.state.frame.free.any():
        return "Every variable is fixed by its bounds"
    return sqp(walk, start) if walk.options.Algorithm == "sqp" else interior_point(walk, start)


def _ended(walk: Walk, end: Finished) -> Outcome:
    """Return the outcome of a search that a test ended. Only flags 1 and -3 are about the last iterate."""
    state = walk.state if end.flag in (1, -3) else walk.state.settled(walk.best())
    if end.flag == 0 and state.answer.violation > walk.options.ConstraintTolerance:
        nearest = walk.region.violation(walk.region.nearest(state.answer.x))
        if not nearest <= walk.options.ConstraintTolerance:
            end = infeasible(nearest)
    return Outcome(end.flag, end.message, state)
