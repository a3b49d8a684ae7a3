"""The walk of a search of `fmincon`: it answers what SciPy asks, and checks each iterate that SciPy comes to.

SciPy's own tests are set beyond rounding. An iterate is a point whose gradient is asked for: there the multipliers and
the first-order measure are computed, the line printed, OutputFcn called, MATLAB's tests made (`endings`). The end is
an exception that SciPy lets through, `Finished`.

SciPy calls back, so something must change between two calls: `Walk.state`, a value that each call replaces.
"""

from __future__ import annotations

from typing import Protocol, final

import numpy as np

from calibench.optimizers.base import Array
from calibench.optimizers.fmincon.constraints import Region
from calibench.optimizers.fmincon.frame import Iterate, iterate_at
from calibench.optimizers.fmincon.options import Options
from calibench.optimizers.fmincon.search.endings import (
    Finished,
    infeasible,
    met_at,
    out_of_evaluations,
    small_after,
    small_at,
    unbounded,
)
from calibench.optimizers.fmincon.search.state import Seen, State
from calibench.optimizers.fmincon.search.told import print_iterate, tell
from calibench.optimizers.fmincon.steps import first_gradient, gradient_steps, held, typical_steps

_REFUSED = 1e100  # stands for a value that is not defined: models built through inf become NaN

Slopes = tuple[Array, Array]  # of inequalities and of equalities, a row each


class Asked(Protocol):
    """An objective in the form that a search needs; `count` is the evaluations so far."""

    count: int

    def value(self, x: Array, /) -> float: ...
    def gradient(self, x: Array, steps: Array | None = None, /) -> Array: ...


@final
class Walk:
    """A search on its way: `state` is where it is. u are coordinates of `Frame`, x the user's, both of shape (n,).

    Each method may raise `Finished`, and what objective, constraints and OutputFcn raise.
    """

    def __init__(self, asked: Asked, region: Region, options: Options, state: State) -> None:
        self.asked, self.region, self.options, self.state = asked, region, options, state

    # ---- what SciPy asks, in u

    def value(self, u: Array) -> float:
        """Return the scaled objective; where it or a constraint is not defined a value that is always refused."""
        x = self.state.frame.x(u)
        self.state = state = self.state.tried(x)
        if self.options.StopPlace == "before_step" and state.trial is not None:
            at, limit = state.last, self.options.FunctionTolerance
            _finish(small_at(at, state.trial - at.x, x - at.x, limit, self.options))
        value, defined = self._look(x)
        return min(value / state.scales.f, _REFUSED) if defined else _REFUSED

    def slope(self, u: Array) -> Array:
        """Return the scaled gradient of the objective: u becomes an iterate."""
        x = self.state.frame.x(u)
        if not np.array_equal(x, self.state.last.x):
            self.arrive(x)
        frame = self.state.frame
        scaled: Array = self.state.last.gradient[frame.free] * frame.width / self.state.scales.f
        return scaled

    def constraint(self, u: Array, which: int) -> Array:
        """Return the scaled inequalities (`which` 0) or equalities (1); where undefined those of the last iterate."""
        x, scales = self.state.frame.x(u), self.state.scales
        if not self.region.is_defined(x):
            x = self.state.last.x
        return self.region.values(x)[which] / (scales.inside, scales.on)[which]

    def constraint_slope(self, u: Array, which: int) -> Array:
        """Return the derivatives of `constraint`, a row each."""
        frame, scales, last = self.state.frame, self.state.scales, self.state.last
        x = frame.x(u)
        rows = (last.J_in, last.J_eq) if np.array_equal(x, last.x) else self.region.slopes(x)
        scaled: Array = rows[which][:, frame.free] * frame.width / (scales.inside, scales.on)[which][:, None]
        return scaled

    def _look(self, x: Array) -> tuple[float, bool]:
        """Return the value at x, and whether it and the constraints are defined; the last two points are remembered."""
        if np.array_equal(x, self.state.last.x):
            return self.state.last.value, True
        if not np.array_equal(x, self.state.seen.x):
            most = self.options.MaxFunctionEvaluations
            if most is not None and self.asked.count >= most:
                raise out_of_evaluations(self.options)
            value = self.asked.value(x)
            if value == -np.inf and self.region.violation(x) <= self.options.ConstraintTolerance:
                raise unbounded(value, self.options)
            self.state = self.state.looked(Seen(x, value, bool(np.isfinite(value)) and self.region.is_defined(x)))
        return self.state.seen.value, self.state.seen.defined

    # ---- at an iterate

    def arrive(self, x: Array, gradient: Array | None = None, slopes: Slopes | None = None) -> None:
        """Make x the next iterate: find its derivatives where they are not given, show it, test it."""
        options, before = self.options, self.state.last if self.state.path else None
        self.state = self.state.stepped(x)
        value = self.state.seen.value if np.array_equal(self.state.seen.x, x) else self._look(x)[0]
        self.state = self.state.headed()
        value = min(value, _REFUSED)
        if options.StopPlace == "after_step" and before is not None and self.state.direction is not None:
            violation = self.region.violation(x)
            end = small_after(before, self.state.direction, violation, options)
            if end is not None:
                self.state = self.state.stopped_at(x, value, violation)
                raise end
        steps = None if gradient is not None and slopes else difference_steps(x, self.state.path, options)
        gradient = self.asked.gradient(x, steps) if gradient is None else gradient
        slopes = slopes or self.region.slopes(x, steps)
        now = iterate_at(self.region, self.state.frame, self.state.scales, x, value, gradient, *slopes)
        self.state = state = self.state.arrived(now, options.ConstraintTolerance)
        print_iterate(state, self.asked.count, options)
        if tell(state, self.asked.count, options, "iter" if before else "init"):
            raise Finished(-1, "Stopped by the OutputFcn.")
        _finish(met_at(now, before, state.direction, state.iteration, state.is_stuck, options))

    def arrive_feasible(self, at: Iterate) -> Iterate:
        """Arrive at a feasible point near `at` and return it; raise `Finished` with -2 where none is found."""
        x = self.region.nearest(at.x)
        violation = self.region.violation(x)
        if not violation <= self.options.ConstraintTolerance:
            raise infeasible(violation)
        self.arrive(x)
        return self.state.last

    def best(self) -> Iterate:
        """Return the best iterate so far, by `State.best`."""
        return self.state.best(self.options.ConstraintTolerance)


def difference_steps(x: Array, path: tuple[Iterate, ...], options: Options) -> Array | None:
    """Return the difference steps at x, shape (n,), after the iterates of `path`; None where the box gives them."""
    if options.FiniteDifferenceStepRule == "box":
        return None
    if options.FiniteDifferenceStepRule == "typical_x":
        typical = 1.0 if options.TypicalX is None else options.TypicalX
        steps = typical_steps(x, options.FiniteDifferenceStepSize, typical, options.FiniteDifferenceType)
    elif len(path) < 2:
        steps = gradient_steps(first_gradient(path[-1].x if path else x))
    else:
        last = path[-1]
        pull = last.J_in.T @ last.inequalities + last.J_eq.T @ last.equalities - last.at_lower + last.at_upper
        steps = gradient_steps(last.gradient + pull)
    return held(steps, *options.change_limits)


def _finish(end: Finished | None) -> None:
    if end is not None:
        raise end
