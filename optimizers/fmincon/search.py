"""One search of `fmincon`: `run` takes it from start to exit flag, and its state is a value.

`sqp` and `interior_point` are SciPy's two algorithms, `walk` answers their calls, `state` is the state of a search,
`endings` its possible ends, `told` its display.

One search of `fmincon`, from its start to its exit flag: SciPy proposes iterates, and `walk` checks each one.

SciPy sees u of `frame`, and f and c divided so that no component of a gradient at the start is above 100: the
rule of IPOPT (Waechter and Biegler 2006, sec. 3.8). Measured on full12 in mm^4: SLSQP then needs 141 .. 233 passes,
with a first value of one up to 297, and unscaled it stops at its first step ("Inequality constraints incompatible").

The walk of a search of `fmincon`: it answers what SciPy asks, and checks each iterate that SciPy comes to.

SciPy's own tests are set beyond rounding. An iterate is a point whose gradient is asked for: there the multipliers and
the first-order measure are computed, the line printed, OutputFcn called, MATLAB's tests made (`endings`). The end is
an exception that SciPy lets through, `Finished`.

SciPy calls back, so something must change between two calls: `Walk.state`, a value that each call replaces.

Algorithm sqp of `fmincon`: SciPy's SLSQP (Kraft 1988), begun afresh where it gives up.

Algorithm interior-point of `fmincon`: SciPy's trust-constr (Byrd, Hribar, Nocedal 1999), with a matrix of ours.
"""

from __future__ import annotations

import functools
import warnings
from dataclasses import dataclass
from typing import Any, Protocol, final

import numpy as np

from calibench.optimizers.base import Array
from calibench.optimizers.fmincon.constraints import Frame, Iterate, Region, Scales, iterate_at
from calibench.optimizers.fmincon.options import Options, first_gradient, gradient_steps, held, typical_steps
from calibench.optimizers.fmincon.state import (
    STUCK,
    ExitFlag,
    Finished,
    Seen,
    State,
    infeasible,
    is_feasible,
    met_at,
    out_of_evaluations,
    out_of_iterations,
    print_header,
    print_iterate,
    print_message,
    small_after,
    small_at,
    tell,
    unbounded,
    verdict,
)


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
            constraints=_scipy_constraints(walk),
            options=settings,
        )
    if ended.status == 0:
        raise out_of_iterations(options)
    best = walk.best()
    if first and best.violation > options.ConstraintTolerance:
        frame, feasible = walk.state.frame, walk.arrive_feasible(best)
        return interior_point(walk, frame.inside(frame.u(feasible.x)), first=False)
    return "the trust region is within StepTolerance"


def _scipy_constraints(walk: Walk) -> Any:
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
