"""One search of `fmincon`, from its start to its exit flag: SciPy proposes iterates, and `Walk` checks each one.

SciPy sees u of `Frame`, f and c divided by the rule of IPOPT (Waechter and Biegler 2006, sec. 3.8). An iterate is a
point whose gradient is asked for: there MATLAB's tests are made. The end is `Finished`, which SciPy lets through.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, final

import numpy as np

from calibench.optimizers.base import Array
from calibench.optimizers.fmincon.constraints import Frame, Iterate, Region, Scales, iterate_at
from calibench.optimizers.fmincon.options import Options, absolute_stop

_EPS = float(np.finfo(float).eps)
_REFUSED = 1e100  # stands for a value that is not defined: models built through inf become NaN
_NO_TEST = 1e-300  # SciPy's tolerance: met only by no change at all
_AFRESH = 3  # sqp begins again from its best point, with a new matrix and new scales, at most so often
PATIENCE = 10  # iterates in a row without progress: SLSQP's line search gives up after ten cuts, and goes on
STUCK = "no further step lowers the objective in double precision"
_INFEASIBLE = "No feasible point found: near the last one constraints are violated by at least {:.3e}."
_UNBOUNDED = "Unbounded: the objective {:.3e} is below ObjectiveLimit {:.1e}, and the constraints are satisfied."
_OUT_OF_ITERATIONS = "Stopped at MaxIterations = {}."

if TYPE_CHECKING:
    from calibench.optimizers.derivatives import Memoized
    from calibench.optimizers.fmincon.direct import Called

    Asked: TypeAlias = "Called | Memoized"  # an objective in the form that a search needs

ExitFlag = Literal[1, 2, 4, 5, 0, -1, -2, -3]
Slopes = tuple[Array, Array]  # of inequalities and of equalities, a row each


def search(asked: Asked, region: Region, options: Options, x0: Array) -> tuple[Finished, Walk | None]:
    """Search from x0, shape (n,), until a test is met; return the end and the way there (None: nothing was asked).

    Raises `RuntimeError` where an OutputFcn raises.
    """
    options, walk, end = options.filled(len(x0)), None, None
    if contradiction := region.contradiction():
        end = Finished(-2, f"No feasible point: {contradiction}.")
    else:
        # before the first iterate: scales come from the derivatives at the start
        frame = Frame.of(region, x0, options.ScaleProblem and options.ScaleVariables)
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
        walk = Walk(asked, region, options, frame, scales, Seen(x, value, True))

        if options.Display == "iter":
            print(f"{'':>55}{'':>14}{'Norm of':>14}{'First-order':>14}")
            heads = f"{'Iter':>5}{'Func-count':>12}{'Fval':>19}{'Feasibility':>15}{'Step length':>14}{'step':>14}"
            print(f"{heads}{'optimality':>14}")
        why = "Every variable is fixed by its bounds"
        try:
            walk.arrive(x, gradient, slopes)
            if frame.free.any():
                why = (sqp if options.Algorithm == "sqp" else interior_point)(walk, frame.u(x))
        except Finished as raised:
            end = raised
        if end is None or end.flag not in (1, -3):  # only these are about the last iterate
            walk.chosen = walk.best()
        best = walk.answer
        if end is None and best.violation > options.ConstraintTolerance:
            end = Finished(-2, f"No feasible point found: constraints are violated by {best.violation:.3e}.")
        elif end is None and best.first_order <= options.OptimalityTolerance:
            end = Finished(1, f"Local minimum found: first-order optimality is {best.first_order:.3e}.")
        elif end is None:
            end = Finished(2, f"Local minimum possible: {why}, and the constraints are satisfied.")
        elif end.flag == 0 and best.violation > options.ConstraintTolerance:
            nearest = region.violation(region.nearest(best.x))
            if not nearest <= options.ConstraintTolerance:
                end = Finished(-2, _INFEASIBLE.format(nearest))
        walk.tell("done")
    if options.Display != "off":
        print(f"\n{end.message}")
    return end, walk


class Seen(NamedTuple):
    """The last point at which the objective was called; `defined`: it and the constraints are finite numbers there."""

    x: Array
    value: float
    defined: bool


@final
@dataclass(eq=False)
class Walk:
    """A search on its way. u are coordinates of `Frame`, x and steps in the user's units, all of shape (n,).

    `path` are its iterates, from the start. `trial` is the first point tried after the last iterate, `direction` from
    the iterate before to its `trial`. `step` is the norm of the last step, `step_length` its part of d. `least` value,
    violation and measure; `idle`: iterates in a row that lowered none. `known` iterates are in the matrix, `bent` if
    curved.
    """

    asked: Asked
    region: Region
    options: Options
    frame: Frame
    scales: Scales
    seen: Seen
    path: list[Iterate] = field(default_factory=list)
    trial: Array | None = None
    direction: Array | None = None
    step: float = 0.0
    step_length: float = 0.0
    least: tuple[float, float, float] = (np.inf, np.inf, np.inf)
    idle: int = 0
    known: int = 0
    bent: bool = False
    chosen: Iterate | None = None

    @property
    def last(self) -> Iterate:
        return self.path[-1]

    @property
    def answer(self) -> Iterate:
        """Return the iterate that was chosen as the answer; until then the last."""
        return self.path[-1] if self.chosen is None else self.chosen

    def best(self) -> Iterate:
        """Return the feasible iterate of least merit f + 2 |lambda|_1 violation; without one, the least infeasible."""
        # by f alone a point outside by less than the tolerance would beat the optimum
        inside = [i for i in self.path if i.violation <= self.options.ConstraintTolerance]
        if not inside:
            return min(self.path, key=lambda i: i.violation)
        last = inside[-1]
        penalty = 2.0 * float(np.abs(last.inequalities).sum() + np.abs(last.equalities).sum())
        return min(inside, key=lambda i: i.value + penalty * i.violation)

    def value(self, u: Array) -> float:
        """Return the scaled objective; where it or a constraint is not defined a value that is always refused."""
        x, at = self.frame.x(u), self.last
        if self.trial is None and not np.array_equal(x, at.x):
            self.trial = x
        if self.options.StopPlace == "before_step" and self.trial is not None:
            limit = self.options.FunctionTolerance
            if end := small(at.violation, self.trial - at.x, float(at.gradient @ (x - at.x)), limit, self.options):
                raise end
        value, defined = self._look(x)
        return min(value / self.scales.f, _REFUSED) if defined else _REFUSED

    def slope(self, u: Array) -> Array:
        """Return the scaled gradient of the objective: u becomes an iterate."""
        x = self.frame.x(u)
        if not np.array_equal(x, self.last.x):
            self.arrive(x)
        return np.asarray(self.last.gradient[self.frame.free] * self.frame.width / self.scales.f)

    def constraint(self, u: Array, which: int) -> Array:
        """Return the scaled inequalities (`which` 0) or equalities (1); where undefined those of the last iterate."""
        x = self.frame.x(u)
        if not self.region.is_defined(x):
            x = self.last.x
        return self.region.values(x)[which] / (self.scales.inside, self.scales.on)[which]

    def constraint_slope(self, u: Array, which: int) -> Array:
        frame, scales, last = self.frame, self.scales, self.last
        x = frame.x(u)
        rows = (last.J_in, last.J_eq) if np.array_equal(x, last.x) else self.region.slopes(x)
        return np.asarray(rows[which][:, frame.free] * frame.width / (scales.inside, scales.on)[which][:, None])

    def _look(self, x: Array) -> tuple[float, bool]:
        """Return the value at x, and whether it and the constraints are defined; the last two points are remembered."""
        if np.array_equal(x, self.last.x):
            return self.last.value, True
        if not np.array_equal(x, self.seen.x):
            most = self.options.MaxFunctionEvaluations
            if most is not None and self.asked.count >= most:
                raise Finished(0, f"Stopped at MaxFunctionEvaluations = {most}.")
            value = self.asked.value(x)
            if value == -np.inf and self.region.violation(x) <= self.options.ConstraintTolerance:
                raise Finished(-3, _UNBOUNDED.format(value, self.options.ObjectiveLimit))
            self.seen = Seen(x, value, bool(np.isfinite(value)) and self.region.is_defined(x))
        return self.seen[1:]

    def arrive(self, x: Array, gradient: Array | None = None, slopes: Slopes | None = None) -> None:
        """Make x the next iterate: find its derivatives where they are not given, show it, test it."""
        options, before, trial = self.options, self.path[-1] if self.path else None, self.trial
        if before is not None:
            self.step = float(np.linalg.norm(x - before.x))
            whole = 0.0 if trial is None else float(np.linalg.norm(trial - before.x))
            self.step_length = self.step / whole if whole else 0.0
        value = min(self.seen.value if np.array_equal(self.seen.x, x) else self._look(x)[0], _REFUSED)
        self.direction = direction = None if trial is None else trial - self.last.x  # of the step that was taken
        if options.StopPlace == "after_step" and before is not None and direction is not None:
            # its gradient stays unknown, so the slope is that of the point before
            violation, slope = self.region.violation(x), float(before.gradient @ direction)
            if end := small(violation, direction, slope, 2.0 * (options.FunctionTolerance or 0.0), options):
                self.path.append(replace(before, x=x, value=value, violation=violation))
                raise end
        steps = None if gradient is not None and slopes else difference_steps(x, self.path, options)
        gradient = self.asked.gradient(x, steps) if gradient is None else gradient
        slopes = slopes or self.region.slopes(x, steps)
        now = iterate_at(self.region, self.frame, self.scales, x, value, gradient, *slopes)
        feasible, (value, violation, first_order) = now.violation <= options.ConstraintTolerance, self.least
        nearer = now.violation < 0.9 * violation or now.first_order < 0.9 * first_order
        self.idle = 0 if nearer or (feasible and now.value < value) else self.idle + 1
        value = min(value, now.value) if feasible else value
        self.least = (value, min(violation, now.violation), min(first_order, now.first_order))
        self.path.append(now)
        self.trial, iteration = None, len(self.path) - 1
        if options.Display == "iter":
            print(
                f"{iteration:5d}{self.asked.count:12d}{now.value:19.6e}{now.violation:15.3e}"
                f"{self.step_length:14.3e}{self.step:14.3e}{now.first_order:14.3e}"
            )
        if self.tell("iter" if before else "init"):
            raise Finished(-1, "Stopped by the OutputFcn.")
        if end := met_at(now, before, direction, iteration, self.idle >= PATIENCE, options):
            raise end

    def arrive_feasible(self, at: Iterate) -> Iterate:
        """Arrive at a feasible point near `at` and return it; raise `Finished` with -2 where none is found."""
        x = self.region.nearest(at.x)
        violation = self.region.violation(x)
        if not violation <= self.options.ConstraintTolerance:
            raise Finished(-2, _INFEASIBLE.format(violation))
        self.arrive(x)
        return self.last

    def tell(self, when: Literal["init", "iter", "done"]) -> bool:
        """Call the OutputFcn; return whether it asks to stop. An error is a `RuntimeError`."""
        if self.options.OutputFcn is None:
            return False
        at, iteration = self.answer, len(self.path) - 1
        values = OptimValues(
            iteration, self.asked.count, fval=at.value, constrviolation=at.violation, stepsize=self.step,
            lssteplength=self.step_length, firstorderopt=at.first_order, gradient=at.gradient.copy(),
            searchdirection=None if self.direction is None else self.direction.copy(),
        )  # fmt: skip
        try:
            return bool(self.options.OutputFcn(at.x.copy(), values, when))
        except Exception as error:
            where = f"at iteration {iteration} ({when})"
            raise RuntimeError(f"OutputFcn raised {type(error).__name__} {where}: {error}") from error


def difference_steps(x: Array, path: Sequence[Iterate], options: Options) -> Array | None:
    """Return the difference steps at x, shape (n,), after the iterates of `path`; None where the box gives them.

    `typical_x` is the documented rule, since February 2003: v sign'(x) max(|x|, TypicalX), sign'(0) = 1. `gradient` is
    the rule before it: -1e-8 / g, with g of the Lagrangian at the iterate before, so that f changes by about 1e-8. Both
    are held between DiffMinChange and DiffMaxChange, the sign kept. `box`, ours, is found where the differences are
    taken.
    """
    if options.FiniteDifferenceStepRule == "box":
        return None
    if options.FiniteDifferenceStepRule == "typical_x":
        forward, size = options.FiniteDifferenceType == "forward", options.FiniteDifferenceStepSize
        default = _EPS**0.5 if forward else _EPS ** (1 / 3)
        typical_x, given, n = 1.0 if options.TypicalX is None else options.TypicalX, [], len(x)
        size = default if size is None else size
        for name, values in (("FiniteDifferenceStepSize", size), ("TypicalX", typical_x)):
            each = np.atleast_1d(np.asarray(values, dtype=float))
            if len(each) not in (1, n):
                raise ValueError(f"{name} has {len(each)} values: one, or one for each of {n} variables, is needed")
            given.append(np.broadcast_to(each, (n,)))
        v, typical = given
        steps: Array = v * np.maximum(np.abs(x), np.abs(typical))
        steps = steps * np.where(x < 0, -1.0, 1.0) if forward else steps
    else:
        if len(path) < 2:  # none is known yet: its steps, 1e-9 / (|x| + 1), are below DiffMinChange
            before: Array = 10.0 * (np.abs(path[-1].x if path else x) + 1.0)
        else:
            last = path[-1]
            pull = last.J_in.T @ last.inequalities + last.J_eq.T @ last.equalities - last.at_lower + last.at_upper
            before = last.gradient + pull
        steps = -1e-8 / (before + _EPS)  # against that gradient, but above 1e-8 / eps = 4.5e7 eps turns the sign
        steps = np.where(steps + _EPS >= 0, 1.0, -1.0) * np.abs(steps)
    least, most = options.change_limits
    lengths: Array = np.minimum(np.maximum(np.abs(steps), least), most)
    return np.where(steps < 0, -lengths, lengths)


def sqp(walk: Walk, start: Array) -> str:
    """Search by SciPy's SLSQP (Kraft 1988) from u = `start`, afresh where it gives up; return why no test ended it."""
    from scipy.optimize import minimize

    options, tolerance, scales = walk.options, walk.options.ConstraintTolerance, walk.scales
    constraints: Any = [  # SLSQP's inequalities are >= 0, MATLAB's <= 0
        {
            "type": kind,
            "fun": lambda u, w=which, s=sign: s * walk.constraint(u, w),
            "jac": lambda u, w=which, s=sign: s * walk.constraint_slope(u, w),
        }
        for kind, which, sign, count in (("ineq", 0, -1.0, len(scales.inside)), ("eq", 1, 1.0, len(scales.on)))
        if count
    ]
    tried_elsewhere = False
    for _ in range(_AFRESH):
        before, walk.idle = walk.best(), 0
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Values in x were outside bounds", category=RuntimeWarning)
            try:
                ended = minimize(
                    walk.value, start, jac=walk.slope, method="SLSQP", bounds=list(zip(*walk.frame.bounds())),
                    constraints=constraints, options={"ftol": _NO_TEST, "maxiter": 10**8},
                )  # fmt: skip
                gone_wrong = bool(ended.status != 0)  # otherwise than by no change of value or point
            except Finished as end:
                if end.message != STUCK:
                    raise
                gone_wrong = False
        best = walk.best()
        if best.violation > tolerance:
            if tried_elsewhere:
                break
            tried_elsewhere = True
            best = walk.arrive_feasible(best)
        elif not gone_wrong or (
            before.violation <= tolerance and before.value - best.value <= 1e-6 * abs(before.value)
        ):
            break
        walk.frame = Frame.of(walk.region, best.x, options.ScaleProblem and options.ScaleVariables)
        walk.scales = Scales.of(walk.frame, best.gradient, best.J_in, best.J_eq, on=options.ScaleProblem)
        start = walk.frame.u(best.x)
    return STUCK


def interior_point(walk: Walk, start: Array, first: bool = True) -> str:
    """Search by SciPy's trust-constr (Byrd, Hribar, Nocedal 1999) from u = `start`; once more from a feasible point."""
    from scipy.optimize import SR1, Bounds, NonlinearConstraint, minimize

    options, (low, high), scales = walk.options, walk.frame.bounds(), walk.scales
    matrix = SR1()
    matrix.initialize(len(start), "hess")
    straight: Any = lambda u, v: np.zeros((len(u), len(u)))  # noqa: E731  (the curvature is in `matrix`)
    constraints = [
        NonlinearConstraint(
            functools.partial(walk.constraint, which=which), -np.inf if which == 0 else 0.0, 0.0,
            jac=functools.partial(walk.constraint_slope, which=which), hess=straight,
        )
        for which, scale in enumerate((scales.inside, scales.on))
        if len(scale)
    ]  # fmt: skip
    settings: Any = {
        "gtol": _NO_TEST, "xtol": max(options.StepTolerance or 0.0, 1e-16),
        "barrier_tol": max(options.OptimalityTolerance**2, 1e-30), "maxiter": options.MaxIterations,
        "sparse_jacobian": False, "initial_barrier_parameter": options.InitBarrierParam or 0.1,
        "initial_tr_radius": options.InitTrustRegionRadius or 1.0,
        "factorization_method": "SVDFactorization" if len(scales.on) >= len(start) else None,
    }  # fmt: skip
    closed = np.isfinite(low).any() or np.isfinite(high).any()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Singular Jacobian matrix", category=UserWarning)
        ended = minimize(
            walk.value, start, jac=walk.slope, hess=lambda u: _curvature(walk, matrix), method="trust-constr",
            bounds=Bounds(low, high, keep_feasible=True) if closed else None, constraints=constraints,
            options=settings,
        )  # fmt: skip
    if ended.status == 0:
        raise Finished(0, _OUT_OF_ITERATIONS.format(options.MaxIterations))
    best = walk.best()
    if first and best.violation > options.ConstraintTolerance:
        feasible = walk.arrive_feasible(best)
        return interior_point(walk, walk.frame.inside(walk.frame.u(feasible.x)), first=False)
    return "the trust region is within StepTolerance"


def _curvature(walk: Walk, matrix: Any) -> Array:
    """Return the Hessian of the Lagrangian, updated by the last step (SR1): SciPy's asks for refused points, too."""
    path, free, width, bend = walk.path, walk.frame.free, walk.frame.width, np.zeros(0)
    n = int(free.sum())
    if len(path) > 1 and walk.known < len(path):
        now, before = path[-1], path[-2]
        change = now.gradient - before.gradient
        change += (now.J_in - before.J_in).T @ now.inequalities + (now.J_eq - before.J_eq).T @ now.equalities
        step, bend = (now.x - before.x)[free] / width, change[free] * width / walk.scales.f
        if bend.any():
            matrix.update(step, bend)
    walk.known, walk.bent = len(path), walk.bent or bool(bend.any())
    straight = len(path) > 1 and not walk.bent  # no curvature so far: then each step goes to the radius
    return np.zeros((n, n)) if straight else np.asarray(matrix.get_matrix())


@dataclass(eq=False)
class Finished(Exception):
    """The search is over: MATLAB's exit flag, and the message."""

    flag: ExitFlag
    message: str


def met_at(
    now: Iterate, before: Iterate | None, direction: Array | None, iteration: int, stuck: bool, options: Options
) -> Finished | None:
    """Return the first of MATLAB's tests that `now` meets; `direction` led there, `stuck`: no progress lately."""
    feasible, sqp = now.violation <= options.ConstraintTolerance, options.Algorithm == "sqp"
    if feasible and now.first_order <= options.OptimalityTolerance:
        return Finished(
            1,
            f"Local minimum found: first-order optimality {now.first_order:.3e} is within OptimalityTolerance "
            f"{options.OptimalityTolerance:.1e}, and the constraints are satisfied.",
        )
    if feasible and now.value < options.ObjectiveLimit:
        return Finished(-3, _UNBOUNDED.format(now.value, options.ObjectiveLimit))
    if direction is not None and options.StopPlace == "next_gradient":
        limit = 2.0 * (options.FunctionTolerance or 0.0)
        if end := small(now.violation, direction, float(now.gradient @ direction), limit, options):
            return end
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
        return Finished(0, _OUT_OF_ITERATIONS.format(options.MaxIterations))
    return None


def small(violation: float, direction: Array, slope: float, limit: float | None, options: Options) -> Finished | None:
    """Return MATLAB's absolute stop if a point of this `violation` is feasible and meets it; `limit` is for |slope|."""
    if not violation <= options.ConstraintTolerance:
        return None
    met = absolute_stop(direction, slope, options.StepTolerance or 0.0, limit or 0.0)
    return None if met is None else Finished(*met)


@final
@dataclass(frozen=True, eq=False)
class OptimValues:
    """The argument of an OutputFcn, under MATLAB's names; `stepsize` is the norm of the last step in x.

    `searchdirection`, shape (n,), is the whole d of the line search that led here; None where none did.
    """

    iteration: int
    funccount: int
    fval: float
    constrviolation: float
    stepsize: float
    lssteplength: float
    firstorderopt: float
    gradient: Array
    searchdirection: Array | None = None
