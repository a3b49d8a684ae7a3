"""The state of one search of `fmincon`, a value: each thing that happens to a search returns the next state.

What happens: a point is tried (`tried`) and its value found (`looked`); a step is taken (`stepped`, `headed`) and ends
at an iterate (`arrived`), or stops short of its gradient (`stopped_at`); SQP begins afresh (`afresh`, `reframed`); the
interior point takes iterates into its matrix (`bent_by`); an iterate is chosen as the answer (`settled`).

How a search of `fmincon` ends: MATLAB's exit flags, the tests that lead to them, and their messages.

A test is a function of an iterate and the options. It returns a `Finished` where it is met, else None; who asks raises
it. SciPy lets that exception through, so that both algorithms end by the same tests and the same messages.

Output of a search of `fmincon` along the way: lines of its display, and calls of the user's OutputFcn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, final

import numpy as np

from calibench.optimizers.base import Array
from calibench.optimizers.fmincon.constraints import Frame, Iterate, Scales
from calibench.optimizers.fmincon.options import Options, absolute_stop

_PATIENCE = 10  # iterates in a row without progress: SLSQP's line search gives up after ten cuts, and goes on


@final
@dataclass(frozen=True, eq=False)
class Seen:
    """The last point at which the objective was called; `defined`: it and the constraints are finite numbers there."""

    x: Array
    value: float
    defined: bool


@final
@dataclass(frozen=True)
class Least:
    """The least value (of feasible iterates), violation and first-order measure so far."""

    value: float = np.inf
    violation: float = np.inf
    first_order: float = np.inf


@final
@dataclass(frozen=True, eq=False)
class State:
    """Where a search is. `path` are its iterates, from the start; x and steps are in the user's units.

    `trial`, shape (n,), is the first point tried after the last iterate, and `direction`, shape (n,), from the iterate
    before to its `trial`, the whole d of the line search that led to the last one. `step` is the norm of the last step,
    `step_length` its part of d. `idle` counts the iterates in a row that brought no progress. `known` is how many
    iterates the interior point's matrix has seen, `bent` whether any of them showed a curvature.
    """

    frame: Frame
    scales: Scales
    seen: Seen
    path: tuple[Iterate, ...] = ()
    trial: Array | None = None
    direction: Array | None = None
    step: float = 0.0
    step_length: float = 0.0
    least: Least = Least()
    idle: int = 0
    known: int = 0
    bent: bool = False
    chosen: Iterate | None = None

    @property
    def iteration(self) -> int:
        """Return the number of the last iterate; the start is 0."""
        return len(self.path) - 1

    @property
    def last(self) -> Iterate:
        """Return the last iterate."""
        return self.path[-1]

    @property
    def answer(self) -> Iterate:
        """Return the iterate that was chosen as the answer; until then the last."""
        return self.path[-1] if self.chosen is None else self.chosen

    @property
    def is_stuck(self) -> bool:
        """Tell whether the last iterates brought no lower value, violation or first-order measure."""
        return self.idle >= _PATIENCE

    def best(self, tolerance: float) -> Iterate:
        """Return the feasible iterate of least merit f + 2 |lambda|_1 violation; without one, the least infeasible.

        By f alone a point outside by less than the tolerance would beat the optimum.
        """
        inside = [i for i in self.path if i.violation <= tolerance]
        if not inside:
            return min(self.path, key=lambda i: i.violation)
        last = inside[-1]
        penalty = 2.0 * float(np.abs(last.inequalities).sum() + np.abs(last.equalities).sum())
        return min(inside, key=lambda i: i.value + penalty * i.violation)

    # ---- transitions

    def tried(self, x: Array) -> State:
        """Note that x is asked about: the first such point away from the last iterate is the trial."""
        if self.trial is not None or np.array_equal(x, self.last.x):
            return self
        return replace(self, trial=x)

    def looked(self, seen: Seen) -> State:
        """Remember what was found at the last point asked."""
        return replace(self, seen=seen)

    def stepped(self, x: Array) -> State:
        """Take the step from the last iterate to x, which is no iterate yet."""
        if not self.path:
            return self
        step = float(np.linalg.norm(x - self.last.x))
        whole = 0.0 if self.trial is None else float(np.linalg.norm(self.trial - self.last.x))
        return replace(self, step=step, step_length=step / whole if whole else 0.0)

    def headed(self) -> State:
        """Fix the direction of the step that was taken."""
        return replace(self, direction=None if self.trial is None else self.trial - self.last.x)

    def arrived(self, iterate: Iterate, tolerance: float) -> State:
        """Make the iterate the last one; it is feasible where its violation is within `tolerance`."""
        feasible, least = iterate.violation <= tolerance, self.least
        progress = (
            (feasible and iterate.value < least.value)
            or iterate.violation < 0.9 * least.violation
            or iterate.first_order < 0.9 * least.first_order
        )
        return replace(
            self,
            path=(*self.path, iterate),
            trial=None,
            idle=0 if progress else self.idle + 1,
            least=Least(
                min(least.value, iterate.value) if feasible else least.value,
                min(least.violation, iterate.violation),
                min(least.first_order, iterate.first_order),
            ),
        )

    def stopped_at(self, x: Array, value: float, violation: float) -> State:
        """Make x the last iterate though its derivatives stay unknown: those of the one before stand for them."""
        return replace(self, path=(*self.path, replace(self.last, x=x, value=value, violation=violation)))

    def afresh(self) -> State:
        """Count iterates without progress from nought."""
        return replace(self, idle=0)

    def reframed(self, frame: Frame, scales: Scales) -> State:
        """Go on in other coordinates and scales."""
        return replace(self, frame=frame, scales=scales)

    def bent_by(self, bend: bool) -> State:
        """Note that the matrix has seen all iterates, and whether the last of them showed a curvature."""
        return replace(self, known=len(self.path), bent=self.bent or bend)

    def settled(self, answer: Iterate) -> State:
        """Choose the answer."""
        return replace(self, chosen=answer)


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


def tell(state: State, count: int, options: Options, when: Literal["init", "iter", "done"]) -> bool:
    """Call the OutputFcn, if there is one, after `count` evaluations; return whether it asks to stop.

    Raises `RuntimeError` that says at which iteration, where it raises anything.
    """
    if options.OutputFcn is None:
        return False
    at = state.answer
    values = OptimValues(
        state.iteration, count, fval=at.value, constrviolation=at.violation, stepsize=state.step,
        lssteplength=state.step_length, firstorderopt=at.first_order, gradient=at.gradient.copy(),
        searchdirection=None if state.direction is None else state.direction.copy(),
    )  # fmt: skip
    try:
        return bool(options.OutputFcn(at.x.copy(), values, when))
    except Exception as error:
        raise RuntimeError(
            f"OutputFcn raised {type(error).__name__} at iteration {state.iteration} ({when}): {error}"
        ) from error


def print_header(options: Options) -> None:
    """Print the heads of the columns where Display is iter."""
    if options.Display == "iter":
        print(f"{'':>55}{'':>14}{'Norm of':>14}{'First-order':>14}")
        print(
            f"{'Iter':>5}{'Func-count':>12}{'Fval':>19}{'Feasibility':>15}{'Step length':>14}{'step':>14}"
            f"{'optimality':>14}"
        )


def print_iterate(state: State, count: int, options: Options) -> None:
    """Print the line of the last iterate where Display is iter."""
    if options.Display == "iter":
        at = state.last
        print(
            f"{state.iteration:5d}{count:12d}{at.value:19.6e}{at.violation:15.3e}"
            f"{state.step_length:14.3e}{state.step:14.3e}{at.first_order:14.3e}"
        )


def print_message(message: str, options: Options) -> None:
    """Print how the search ended, unless Display is off."""
    if options.Display != "off":
        print(f"\n{message}")
