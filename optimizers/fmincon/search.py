"""One search of `fmincon`: SciPy proposes, this watches every iterate and says when it is over.

SciPy's own tests are set beyond rounding. An iterate is a point whose gradient is asked for: there the multipliers and
the first-order measure are computed, MATLAB's tests made, the line printed, OutputFcn called. The end is an exception
that SciPy lets through, `Finished`, so that both algorithms end by the same words.

SciPy sees u of `frame`, and f and c divided so that no component of a gradient at the start is above 100: the
rule of IPOPT (Waechter and Biegler 2006, sec. 3.8). Measured on full12 in mm^4: SLSQP then needs 141 .. 233 passes,
with a first value of one up to 297, and unscaled it stops at its first step ("Inequality constraints incompatible").
"""

from __future__ import annotations

import functools
import warnings
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, final

import numpy as np

from calibench.optimizers.base import Array
from calibench.optimizers.fmincon.constraints import Region
from calibench.optimizers.fmincon.frame import Frame, Iterate, Scales, iterate_at
from calibench.optimizers.fmincon.options import Options
from calibench.optimizers.fmincon.steps import first_gradient, gradient_steps, held, typical_steps
from calibench.optimizers.fmincon.stop import absolute_stop

ExitFlag = Literal[1, 2, 4, 5, 0, -1, -2, -3]

_REFUSED = 1e100  # stands for a value that is not defined: models built through inf become NaN
_NO_TEST = 1e-300  # SciPy's tolerances: met only by no change at all
_AFRESH = 3  # SLSQP begins again from its best point, with a new matrix and new scales, at most so often
_PATIENCE = 10  # iterates of SLSQP in a row without progress: its line search gives up after ten cuts, and goes on
_INSIDE = 1e-2  # an interior point begins at least this far, in u, from its bounds


class Finished(Exception):
    """The search is over: MATLAB's exit flag, and the words."""

    def __init__(self, flag: ExitFlag, message: str) -> None:
        super().__init__(message)
        self.flag, self.message = flag, message


class Asked(Protocol):
    """An objective as a search wants it; `count` is the evaluations so far."""

    count: int

    def value(self, x: Array, /) -> float: ...
    def gradient(self, x: Array, steps: Array | None = None, /) -> Array: ...


@final
@dataclass(frozen=True, eq=False)
class OptimValues:
    """What an OutputFcn is told, under MATLAB's names; `stepsize` is the norm of the last step in x.

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


@final
class Search:
    """One search from x0: `run` returns the exit flag and the words; `answer` is the iterate they are about.

    Raises `ValueError` where objective or constraints are not defined at x0, `RuntimeError` where an OutputFcn raises.
    """

    def __init__(self, asked: Asked, region: Region, options: Options, x0: Array) -> None:
        self._asked, self._region, self._options = asked, region, options.filled(len(x0))
        self._frame = Frame.of(region, x0, options.ScaleProblem and options.ScaleVariables)
        self._trial: Array | None = None  # the first point tried after the last iterate
        self._direction: Array | None = None  # d of the step to the last iterate
        self._seen: tuple[Array, float, bool] | None = None
        self._updated, self._bent = 0, False  # iterates that the interior point's matrix knows; whether any bent it
        self._least, self._idle = (np.inf, np.inf, np.inf), 0
        self.iteration = -1
        self.step = self.step_length = 0.0
        self.path: list[Iterate] = []

    def run(self) -> tuple[ExitFlag, str]:
        """Search until a test is met."""
        flag, message = self._run()
        if self.path:
            self._tell("done")
        if self._options.Display != "off":
            print(f"\n{message}")
        return flag, message

    def _run(self) -> tuple[ExitFlag, str]:
        contradiction = self._region.contradiction()
        if contradiction:
            return -2, f"No feasible point: {contradiction}."
        try:
            start = self._begin()
            if not self._frame.free.any():
                return self._verdict("Every variable is fixed by its bounds")
            if self._options.Algorithm == "sqp":
                self._sqp(start)
            return self._verdict(self._interior(start) if self._options.Algorithm == "interior-point" else _STUCK)
        except Finished as end:
            if end.flag not in (1, -3):
                self.answer = self._best()
            if end.flag == 0 and self.answer.violation > self._options.ConstraintTolerance:
                nearest = self._region.violation(self._region.nearest(self.answer.x))
                if not nearest <= self._options.ConstraintTolerance:
                    return -2, _INFEASIBLE.format(nearest)
            return end.flag, end.message

    def _begin(self) -> Array:
        """Arrive at the start, which fixes the scales, and return its u."""
        x = self._frame.x0
        if self._options.Algorithm == "interior-point" and self._frame.free.any():
            x = self._frame.x(self._inside(self._frame.u(x)))
        if not self._region.is_defined(x):
            raise ValueError("the constraints are undefined at the initial point: NaN, infinite or complex")
        value = self._asked.value(x)
        if not np.isfinite(value):
            raise ValueError(f"the objective is undefined at the initial point: it is {value:g} there")
        steps = self._steps(x)
        gradient = self._asked.gradient(x, steps)
        if not np.isfinite(gradient).all():
            raise ValueError("the gradient of the objective is undefined at the initial point")
        self._seen = (x, value, True)
        slopes = self._region.slopes(x, steps)
        self._scales = Scales.of(self._frame, gradient, *slopes, on=self._options.ScaleProblem)
        self._header()
        self._arrive(x, gradient, slopes)
        return self._frame.u(x)

    def _inside(self, u: Array) -> Array:
        """Return u moved off its bounds, where an interior point can begin."""
        low, high = self._frame.bounds()
        room = np.minimum(_INSIDE, 0.25 * (high - low))
        return np.minimum(np.maximum(u, low + room), high - room)

    # ---- what SciPy asks, in u

    def _value(self, u: Array) -> float:
        x = self._frame.x(u)
        if self._trial is None and not np.array_equal(x, self.path[-1].x):
            self._trial = x
        if self._options.StopPlace == "before_step" and self._trial is not None:
            self._stop_if_small(self._trial - self.path[-1].x, x - self.path[-1].x, self._options.FunctionTolerance)
        value, defined = self._look(x)
        return min(value / self._scales.f, _REFUSED) if defined else _REFUSED

    def _slope(self, u: Array) -> Array:
        x = self._frame.x(u)
        if not np.array_equal(x, self.path[-1].x):
            self._arrive(x)
        scaled: Array = self.path[-1].gradient[self._frame.free] * self._frame.width / self._scales.f
        return scaled

    def _constraint(self, u: Array, which: int) -> Array:
        """Return the scaled inequalities (`which` 0) or equalities (1); where undefined those of the last iterate."""
        x = self._frame.x(u)
        if not self._region.is_defined(x):
            x = self.path[-1].x
        return self._region.values(x)[which] / (self._scales.inside, self._scales.on)[which]

    def _constraint_slope(self, u: Array, which: int) -> Array:
        x, last = self._frame.x(u), self.path[-1]
        rows = (last.J_in, last.J_eq) if np.array_equal(x, last.x) else self._region.slopes(x)
        scale = (self._scales.inside, self._scales.on)[which]
        scaled: Array = rows[which][:, self._frame.free] * self._frame.width / scale[:, None]
        return scaled

    def _look(self, x: Array) -> tuple[float, bool]:
        """Return the value at x, and whether it and the constraints are defined; the last two points are remembered."""
        if np.array_equal(x, self.path[-1].x):
            return self.path[-1].value, True
        if self._seen is None or not np.array_equal(x, self._seen[0]):
            most = self._options.MaxFunctionEvaluations
            if most is not None and self._asked.count >= most:
                raise Finished(0, f"Stopped at MaxFunctionEvaluations = {most}.")
            value = self._asked.value(x)
            if value == -np.inf and self._region.violation(x) <= self._options.ConstraintTolerance:
                raise Finished(-3, _UNBOUNDED.format(value, self._options.ObjectiveLimit))
            self._seen = (x, value, bool(np.isfinite(value)) and self._region.is_defined(x))
        return self._seen[1:]

    # ---- at an iterate

    def _arrive(self, x: Array, gradient: Array | None = None, slopes: tuple[Array, Array] | None = None) -> None:
        """Make x the next iterate: find its derivatives where they are not given, show it, test it."""
        before = self.path[-1] if self.path else None
        if before is not None:
            self.step = float(np.linalg.norm(x - before.x))
            whole = 0.0 if self._trial is None else float(np.linalg.norm(self._trial - before.x))
            self.step_length = self.step / whole if whole else 0.0
        value = self._seen[1] if self._seen and np.array_equal(self._seen[0], x) else self._look(x)[0]
        direction = self._direction = None if before is None or self._trial is None else self._trial - before.x
        if direction is not None and self._options.StopPlace == "after_step":
            self._stop_after(x, value, direction)
        steps = None if gradient is not None and slopes else self._steps(x)
        gradient = self._asked.gradient(x, steps) if gradient is None else gradient
        slopes = slopes or self._region.slopes(x, steps)
        iterate = iterate_at(self._region, self._frame, self._scales, x, min(value, _REFUSED), gradient, *slopes)
        self.path.append(iterate)
        self.answer, self._trial = iterate, None
        self.iteration += 1
        self._show(iterate)
        if self._tell("iter" if before else "init"):
            raise Finished(-1, "Stopped by the OutputFcn.")
        self._test(iterate, before, direction)

    def _steps(self, x: Array) -> Array | None:
        """Return the difference steps at x; None where they are relative to the box."""
        options, last = self._options, self.path[-1] if self.path else None
        if options.FiniteDifferenceStepRule == "box":
            return None
        if options.FiniteDifferenceStepRule == "typical_x":
            typical = 1.0 if options.TypicalX is None else options.TypicalX
            steps = typical_steps(x, options.FiniteDifferenceStepSize, typical, options.FiniteDifferenceType)
        elif last is None or self.iteration < 1:
            steps = gradient_steps(first_gradient(x if last is None else last.x))
        else:
            pull = last.J_in.T @ last.inequalities + last.J_eq.T @ last.equalities - last.at_lower + last.at_upper
            steps = gradient_steps(last.gradient + pull)
        return held(steps, *options.change_limits)

    def _stop_if_small(self, direction: Array, step: Array, slope_limit: float | None) -> None:
        """Raise `Finished` where the last iterate is feasible and MATLAB's absolute stop is met there."""
        now, options = self.path[-1], self._options
        if now.violation <= options.ConstraintTolerance:
            met = absolute_stop(direction, float(now.gradient @ step), options.StepTolerance or 0.0, slope_limit or 0.0)
            if met is not None:
                raise Finished(*met)

    def _stop_after(self, x: Array, value: float, direction: Array) -> None:
        """Raise `Finished` where the absolute stop is met as the line search ends at x; its gradient stays unknown."""
        options, before = self._options, self.path[-1]
        violation = self._region.violation(x)
        if not violation <= options.ConstraintTolerance:
            return
        slope, limit = float(before.gradient @ direction), 2.0 * (options.FunctionTolerance or 0.0)
        met = absolute_stop(direction, slope, options.StepTolerance or 0.0, limit)
        if met is not None:
            self.path.append(replace(before, x=x, value=min(value, _REFUSED), violation=violation))
            self.iteration += 1
            raise Finished(*met)

    def _test(self, now: Iterate, before: Iterate | None, direction: Array | None) -> None:
        """Raise `Finished` where one of MATLAB's tests is met."""
        options, feasible = self._options, now.violation <= self._options.ConstraintTolerance
        if feasible and now.first_order <= options.OptimalityTolerance:
            raise Finished(
                1,
                f"Local minimum found: first-order optimality {now.first_order:.3e} is within OptimalityTolerance "
                f"{options.OptimalityTolerance:.1e}, and the constraints are satisfied.",
            )
        if feasible and now.value < options.ObjectiveLimit:
            raise Finished(-3, _UNBOUNDED.format(now.value, options.ObjectiveLimit))
        if direction is not None and options.StopPlace == "next_gradient":
            self._stop_if_small(direction, direction, 2.0 * (options.FunctionTolerance or 0.0))
        if before is not None and options.Algorithm == "sqp" and options.StopRule == "relative" and feasible:
            # trust-constr's small steps are its radius', and it tests that itself
            change = float(np.max(np.abs(now.x - before.x) / (1.0 + np.abs(now.x))))
            if change <= (options.StepTolerance or 0.0):
                raise Finished(
                    2, f"Local minimum possible: the relative step {change:.3e} is within StepTolerance, and feasible."
                )
        if options.Algorithm == "sqp" and self._is_stuck(now, feasible):
            raise Finished(2, _STUCK)
        if options.MaxIterations is not None and self.iteration >= options.MaxIterations:
            raise Finished(0, f"Stopped at MaxIterations = {options.MaxIterations}.")

    def _is_stuck(self, now: Iterate, feasible: bool) -> bool:
        """Tell whether the last `_PATIENCE` iterates brought no lower value, violation or first-order measure."""
        least = self._least
        progress = (
            (feasible and now.value < least[0]) or now.violation < 0.9 * least[1] or now.first_order < 0.9 * least[2]
        )
        self._idle = 0 if progress else self._idle + 1
        self._least = (
            min(least[0], now.value) if feasible else least[0],
            min(least[1], now.violation),
            min(least[2], now.first_order),
        )
        return self._idle >= _PATIENCE

    def _tell(self, state: Literal["init", "iter", "done"]) -> bool:
        if self._options.OutputFcn is None:
            return False
        at = self.answer
        values = OptimValues(
            self.iteration, self._asked.count, at.value, at.violation, self.step, self.step_length, at.first_order,
            at.gradient.copy(), None if self._direction is None else self._direction.copy(),
        )  # fmt: skip
        try:
            return bool(self._options.OutputFcn(at.x.copy(), values, state))
        except Exception as error:
            raise RuntimeError(
                f"OutputFcn raised {type(error).__name__} at iteration {self.iteration} ({state}): {error}"
            ) from error

    # ---- the two algorithms

    def _sqp(self, start: Array) -> None:
        low, high = self._frame.bounds()
        constraints: list[Any] = []
        for kind, which, sign, count in (
            ("ineq", 0, -1.0, len(self._scales.inside)),
            ("eq", 1, 1.0, len(self._scales.on)),
        ):
            if count:  # SciPy's inequalities are >= 0, MATLAB's <= 0
                constraints.append(
                    {
                        "type": kind,
                        "fun": lambda u, w=which, s=sign: s * self._constraint(u, w),
                        "jac": lambda u, w=which, s=sign: s * self._constraint_slope(u, w),
                    }
                )
        tried_elsewhere = False
        for _ in range(_AFRESH):
            before, self._idle = self._best(), 0
            gone_wrong = self._slsqp(start, low, high, constraints)
            best = self._best()
            if best.violation > self._options.ConstraintTolerance:
                if tried_elsewhere:
                    break
                tried_elsewhere = True
                best = self._feasible_from(best)
            elif not gone_wrong or (
                before.violation <= self._options.ConstraintTolerance
                and before.value - best.value <= 1e-6 * abs(before.value)
            ):
                break
            scaled = self._options.ScaleProblem
            self._frame = Frame.of(self._region, best.x, scaled and self._options.ScaleVariables)
            self._scales = Scales.of(self._frame, best.gradient, best.J_in, best.J_eq, on=scaled)
            start, (low, high) = self._frame.u(best.x), self._frame.bounds()

    def _slsqp(self, start: Array, low: Array, high: Array, constraints: list[Any]) -> bool:
        """Run SLSQP once; return whether it ended otherwise than by no change of value or point."""
        from scipy.optimize import minimize

        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Values in x were outside bounds", category=RuntimeWarning)
            try:
                ended = minimize(
                    self._value,
                    start,
                    jac=self._slope,
                    method="SLSQP",
                    bounds=list(zip(low, high)),
                    constraints=constraints,
                    options={"ftol": _NO_TEST, "maxiter": 10**8},
                )
            except Finished as end:
                if end.message != _STUCK:
                    raise
                return False
        return bool(ended.status != 0)

    def _interior(self, start: Array, first: bool = True) -> str:
        from scipy.optimize import SR1, Bounds, NonlinearConstraint, minimize

        options, (low, high) = self._options, self._frame.bounds()
        matrix = SR1()
        matrix.initialize(len(start), "hess")
        bent: Any = lambda u, v: np.zeros((len(u), len(u)))  # noqa: E731 (in the matrix of the whole Lagrangian)
        constraints: Any = [
            NonlinearConstraint(
                functools.partial(self._constraint, which=which),
                -np.inf if which == 0 else 0.0,
                0.0,
                jac=functools.partial(self._constraint_slope, which=which),
                hess=bent,
            )
            for which, scale in enumerate((self._scales.inside, self._scales.on))
            if len(scale)
        ]
        closed = np.isfinite(low).any() or np.isfinite(high).any()
        settings: Any = {
            "gtol": _NO_TEST,
            "xtol": max(options.StepTolerance or 0.0, 1e-16),
            "barrier_tol": max(options.OptimalityTolerance**2, 1e-30),
            "maxiter": options.MaxIterations,
            "sparse_jacobian": False,
            "initial_barrier_parameter": options.InitBarrierParam or 0.1,
            "initial_tr_radius": options.InitTrustRegionRadius or 1.0,
            "factorization_method": "SVDFactorization" if len(self._scales.on) >= len(start) else None,
        }
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Singular Jacobian matrix", category=UserWarning)
            ended = minimize(
                self._value,
                start,
                jac=self._slope,
                hess=lambda u: self._curvature(matrix),
                method="trust-constr",
                bounds=Bounds(low, high, keep_feasible=True) if closed else None,
                constraints=constraints,
                options=settings,
            )
        if ended.status == 0:
            raise Finished(0, f"Stopped at MaxIterations = {options.MaxIterations}.")
        if first and self._best().violation > options.ConstraintTolerance:
            feasible = self._feasible_from(self._best())
            return self._interior(self._inside(self._frame.u(feasible.x)), first=False)
        return "the trust region is within StepTolerance"

    def _curvature(self, matrix: Any) -> Array:
        """Return the Hessian of the Lagrangian at the last iterate, updated by the step to it (SR1, as it may be
        indefinite). Ours, as SciPy's asks for the gradient at every trial point, those refused included.
        """
        n = int(self._frame.free.sum())
        if len(self.path) > 1 and self._updated < len(self.path):
            now, before, free, width = self.path[-1], self.path[-2], self._frame.free, self._frame.width
            change = now.gradient - before.gradient
            change += (now.J_in - before.J_in).T @ now.inequalities + (now.J_eq - before.J_eq).T @ now.equalities
            step, bend = (now.x - before.x)[free] / width, change[free] * width / self._scales.f
            self._bent = self._bent or bool(bend.any())
            if bend.any():
                matrix.update(step, bend)
        self._updated = len(self.path)
        straight = len(self.path) > 1 and not self._bent  # no curvature so far: then each step goes to the radius
        return np.zeros((n, n)) if straight else np.asarray(matrix.get_matrix())

    def _feasible_from(self, at: Iterate) -> Iterate:
        """Arrive at a feasible point near `at`; raise `Finished` with -2 where none is found."""
        x = self._region.nearest(at.x)
        violation = self._region.violation(x)
        if not violation <= self._options.ConstraintTolerance:
            raise Finished(-2, _INFEASIBLE.format(violation))
        self._arrive(x)
        return self.path[-1]

    def _best(self) -> Iterate:
        """Return the feasible iterate of least merit f + 2 |lambda|_1 violation; without one, the least infeasible.

        By f alone a point outside by less than the tolerance would beat the optimum.
        """
        inside = [i for i in self.path if i.violation <= self._options.ConstraintTolerance]
        if not inside:
            return min(self.path, key=lambda i: i.violation)
        last = inside[-1]
        penalty = 2.0 * float(np.abs(last.inequalities).sum() + np.abs(last.equalities).sum())
        return min(inside, key=lambda i: i.value + penalty * i.violation)

    def _verdict(self, why: str) -> tuple[ExitFlag, str]:
        """Return the flag of a search that SciPy ended, or that had nothing to search."""
        self.answer = best = self._best()
        if best.violation > self._options.ConstraintTolerance:
            return -2, f"No feasible point found: constraints are violated by {best.violation:.3e}."
        if best.first_order <= self._options.OptimalityTolerance:
            return 1, f"Local minimum found: first-order optimality is {best.first_order:.3e}."
        return 2, f"Local minimum possible: {why}, and the constraints are satisfied."

    # ---- the display

    def _header(self) -> None:
        if self._options.Display == "iter":
            print(f"{'':>55}{'':>14}{'Norm of':>14}{'First-order':>14}")
            print(
                f"{'Iter':>5}{'Func-count':>12}{'Fval':>19}{'Feasibility':>15}{'Step length':>14}{'step':>14}"
                f"{'optimality':>14}"
            )

    def _show(self, at: Iterate) -> None:
        if self._options.Display == "iter":
            print(
                f"{self.iteration:5d}{self._asked.count:12d}{at.value:19.6e}{at.violation:15.3e}"
                f"{self.step_length:14.3e}{self.step:14.3e}{at.first_order:14.3e}"
            )


_INFEASIBLE = "No feasible point found: near the last one constraints are violated by at least {:.3e}."
_STUCK = "no further step lowers the objective in double precision"
_UNBOUNDED = "Unbounded: the objective {:.3e} is below ObjectiveLimit {:.1e}, and the constraints are satisfied."
