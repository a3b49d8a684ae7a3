"""The function `fmincon`: the direct call, with MATLAB's arguments, outputs and signs of the multipliers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from calibench.optimizers.base import Array
from calibench.optimizers.derivatives import differences
from calibench.optimizers.fmincon.constraints import Iterate, lagrangian_hessian, region, step_sizes
from calibench.optimizers.fmincon.options import Options, optimoptions
from calibench.optimizers.fmincon.search import ExitFlag, search


@final
@dataclass(frozen=True, eq=False)
class Multipliers:
    """Lagrange multipliers under MATLAB's names and with its signs.

    grad f + A^T ineqlin + Aeq^T eqlin + grad c^T ineqnonlin + grad ceq^T eqnonlin - lower + upper = 0, all but those of
    equalities >= 0.
    """

    lower: Array
    upper: Array
    ineqlin: Array
    eqlin: Array
    ineqnonlin: Array
    eqnonlin: Array


@final
@dataclass(frozen=True)
class Output:
    """How the search went, under MATLAB's names: `stepsize` is the norm of the last step in x, `funcCount` counts calls
    of the objective, those of differences included.
    """

    iterations: int
    funcCount: int
    stepsize: float
    lssteplength: float
    constrviolation: float
    firstorderopt: float
    algorithm: str
    message: str


@final
@dataclass(frozen=True, eq=False)
class Result:
    """What `fmincon` returns: the outputs of MATLAB's function by name.

    exitflag: 1 first-order optimality met, 2 step below StepTolerance, with StopRule absolute 4 search direction below
    2 StepTolerance and 5 |g d| below 2 FunctionTolerance, 0 MaxIterations or MaxFunctionEvaluations
    reached, -1 stopped by OutputFcn, -2 no feasible point found, -3 objective below ObjectiveLimit. `hessian` is a
    quasi-Newton approximation of the Hessian of the Lagrangian, from the gradients along the way.
    """

    x: Array
    fval: float
    exitflag: ExitFlag
    output: Output
    lambda_: Multipliers
    grad: Array
    hessian: Array


def fmincon(
    fun: Callable[[Array], Any], x0: ArrayLike, A: ArrayLike | None = None, b: ArrayLike | None = None,
    Aeq: ArrayLike | None = None, beq: ArrayLike | None = None, lb: ArrayLike | None = None,
    ub: ArrayLike | None = None, nonlcon: Callable[[Array], Any] | None = None,
    options: Options | Mapping[str, Any] | None = None,
) -> Result:  # fmt: skip
    """Minimise fun(x) subject to A x <= b, Aeq x = beq, lb <= x <= ub, c(x) <= 0 and ceq(x) = 0, from x0 of shape (n,).

    `fun` returns f, or (f, gradient) with SpecifyObjectiveGradient; `nonlcon` returns (c, ceq), or with
    SpecifyConstraintGradient (c, ceq, gradc, gradceq), gradients of shape (n, m), one column a constraint. x0 is moved
    inside the bounds. A value that is not a finite real number is a refused step, but at x0 a `ValueError`, as are
    wrong shapes and options. What `fun` and `nonlcon` raise passes through; what OutputFcn raises comes as a
    `RuntimeError` that says at which iteration. Bounds or linear constraints that contradict each other are no error
    but exit flag -2.

    >>> r = fmincon(lambda x: (x[0] - 2) ** 2 + (x[1] - 1) ** 2, [0, 0], A=[[1, 1]], b=[2], lb=[0, 0])
    >>> r.x.round(6).tolist(), r.exitflag, r.lambda_.ineqlin.round(5).tolist()
    ([1.5, 0.5], 1, [1.0])
    """
    if not callable(fun):
        raise ValueError(f"fun={fun!r}: a function of x is needed")
    chosen = optimoptions(options)
    try:
        start = np.atleast_1d(np.array(x0, dtype=float))
    except (TypeError, ValueError):
        raise ValueError("x0 must hold real numbers") from None
    if start.ndim != 1 or not start.size or not np.isfinite(start).all():
        trouble = f"has shape {start.shape}" if start.ndim != 1 or not start.size else "is not finite"
        raise ValueError(f"x0 {trouble}: a vector of n finite numbers is needed")
    gradients, kind, n = chosen.SpecifyConstraintGradient, chosen.FiniteDifferenceType, len(start)
    where = region(n, A, b=b, Aeq=Aeq, beq=beq, lb=lb, ub=ub, nonlcon=nonlcon, gradients=gradients, kind=kind)
    asked = Called(fun, chosen.filled(n), where.lower, where.upper)
    (end, walk), m, m_eq = search(asked, where, chosen, start), len(where.b), len(where.beq)
    if walk is None:  # it asked nothing
        zero, nan = np.zeros(n), float("nan")
        answer = Iterate(
            start, nan, np.full(n, nan), np.zeros((m, n)), np.zeros((m_eq, n)), violation=nan, first_order=nan,
            inequalities=np.zeros(m), equalities=np.zeros(m_eq), at_lower=zero, at_upper=zero,
        )  # fmt: skip
        path, iterations, step, step_length = list[Iterate](), 0, 0.0, 0.0
    else:
        answer, path, iterations = walk.answer, walk.path, len(walk.path) - 1
        step, step_length = walk.step, walk.step_length
    return Result(
        x=answer.x, fval=answer.value, exitflag=end.flag,
        output=Output(
            iterations, asked.count, stepsize=step, lssteplength=step_length, constrviolation=answer.violation,
            firstorderopt=answer.first_order, algorithm=chosen.Algorithm, message=end.message,
        ),
        lambda_=Multipliers(
            answer.at_lower, answer.at_upper, answer.inequalities[:m], answer.equalities[:m_eq],
            answer.inequalities[m:], answer.equalities[m_eq:],
        ),
        grad=answer.gradient,
        hessian=lagrangian_hessian(
            [(i.x, i.gradient + i.J_in.T @ answer.inequalities + i.J_eq.T @ answer.equalities) for i in path], n
        ),
    )  # fmt: skip


@final
@dataclass(eq=False)
class Called:
    """The user's function: one point is one call, however often it is asked about. `count` is the calls so far."""

    fun: Callable[[Array], Any]
    options: Options
    lower: Array
    upper: Array
    count: int = 0
    _last: tuple[Array, float, Array | None] | None = None

    def value(self, x: Array) -> float:
        """Return f(x); NaN where it is complex."""
        return self._ask(x)[0]

    def gradient(self, x: Array, steps: Array | None = None) -> Array:
        """Return the gradient at x, shape (n,); `steps` are those of `differences`."""
        value, gradient = self._ask(x)
        if gradient is not None:
            return gradient
        size = step_sizes(x, self.lower, self.upper)
        call, kind = (lambda at: self._call(at)[0]), self.options.FiniteDifferenceType
        return differences(call, x, value, self.lower, self.upper, size=size, kind=kind, steps=steps)

    def _ask(self, x: Array) -> tuple[float, Array | None]:
        if self._last is None or not np.array_equal(x, self._last[0]):
            self._last = (x.copy(), *self._call(x))
        return self._last[1:]

    def _call(self, x: Array) -> tuple[float, Array | None]:
        self.count += 1
        value, gradient = self.fun(x.copy()), None
        if self.options.SpecifyObjectiveGradient:
            if not isinstance(value, tuple | list) or len(value) < 2:
                kind = type(value).__name__
                raise ValueError(f"fun returned {kind}: (f, gradient) is needed, as SpecifyObjectiveGradient")
            gradient, value = np.asarray(value[1], dtype=float), value[0]
            if gradient.shape != x.shape:
                raise ValueError(f"fun returned a gradient of shape {gradient.shape}: {x.shape} is needed")
        try:
            given = np.asarray(value)
            if given.size == 1 and given.dtype.kind == "c":  # NaN, so that the point is refused
                number = complex(given.reshape(()))
                return number.real if number.imag == 0 else float("nan"), gradient
            return float(given.reshape(())), gradient
        except (TypeError, ValueError):
            kind = f"an array of shape {np.shape(value)}" if isinstance(value, np.ndarray) else type(value).__name__
            raise ValueError(f"fun returned {kind}: one real number is needed") from None
