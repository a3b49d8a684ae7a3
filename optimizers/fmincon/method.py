"""`Fmincon`: the search of the function `fmincon` as a registered optimiser, in the box of a problem, through the gate.

Its tolerances are 0, on to rounding. What then limits it is the gradient: in mm^4 J stalls at 1e-2 .. 1 with forward
differences and at 1e-8 .. 1e-7 with central ones; only the analytic gradient vanishes. See docs/fmincon.md.
"""

from dataclasses import dataclass, fields
from typing import ClassVar, final

import numpy as np

from calibench.optimizers.base import Array, Objective, Reason, Traits, registry, with_restarts
from calibench.optimizers.derivatives import Memoized
from calibench.optimizers.fmincon import options
from calibench.optimizers.fmincon.options import Options, optimoptions


@registry.register("fmincon")
@final
@dataclass(frozen=True)
class Fmincon:
    """MATLAB's fmincon in the box of a problem: Algorithm sqp (SLSQP) or interior-point (trust-constr).

    With SpecifyObjectiveGradient and a problem that has residuals and a Jacobian, the gradient is 2 J^T r: one point is
    one pass of residuals and at most one Jacobian. Else it is differences, which pay for themselves. Tolerances of 0 go
    on to rounding. The run's budget wins over MaxFunctionEvaluations where it is smaller. A start at which the
    objective is undefined is replaced by the points of restarts until one is defined.
    """

    Algorithm: options.Algorithm = "sqp"
    SpecifyObjectiveGradient: bool = True
    FiniteDifferenceType: options.DifferenceType = "forward"
    OptimalityTolerance: float = 0.0
    StepTolerance: float = 0.0
    ConstraintTolerance: float = 1e-6
    ObjectiveLimit: float = -1e20
    MaxIterations: int = 10_000
    MaxFunctionEvaluations: int | None = None
    ScaleProblem: bool = True
    Display: options.Display = "off"
    InitBarrierParam: float | None = None
    InitTrustRegionRadius: float | None = None
    restarts: bool = False
    FiniteDifferenceStepRule: options.StepRule = "box"
    FiniteDifferenceStepSize: options.Numbers | None = None
    TypicalX: options.Numbers | None = None
    DiffMinChange: float | None = None
    DiffMaxChange: float | None = None
    StopRule: options.StopRule = "relative"
    StopPlace: options.StopPlace | None = None
    FunctionTolerance: float | None = None
    ScaleVariables: bool = True

    name: ClassVar[str] = "fmincon"
    library: ClassVar[str] = "scipy"

    def __post_init__(self) -> None:
        self._options(None)  # so that a wrong value is told when it is made, not when it runs

    @property
    def traits(self) -> Traits:
        return Traits(
            stochastic=self.restarts, uses_gradient=True, self_terminating=not self.restarts,
            needs_finite_bounds=self.restarts,
        )  # fmt: skip

    def compile(self) -> None:
        import scipy.optimize  # noqa: F401

        import calibench.optimizers.fmincon.search  # noqa: F401

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Descend from the start; with `restarts`, again from random points of the box."""
        from calibench.optimizers.fmincon.constraints import region  # here, as the names of all methods are listed
        from calibench.optimizers.fmincon.search import search

        def descend(start: Array) -> None:
            asked = Memoized(objective, self.SpecifyObjectiveGradient, self.FiniteDifferenceType)
            while not np.isfinite(asked.value(start)):
                start = objective.restart()
            box = region(objective.dimension, lb=objective.lower, ub=objective.upper)
            search(asked, box, self._options(objective.remaining + 1), start)

        return with_restarts(descend, objective, self.restarts)

    def _options(self, budget: int | None) -> Options:
        """Return the options of a search; without a limit of one's own the budget, one beyond it, is the limit."""
        own = ("SpecifyObjectiveGradient", "MaxFunctionEvaluations", "restarts")  # not handed on as they are
        names = [field.name for field in fields(self) if field.name not in own]
        most = self.MaxFunctionEvaluations if budget is None else min(self.MaxFunctionEvaluations or budget, budget)
        return optimoptions(**{name: getattr(self, name) for name in names}, MaxFunctionEvaluations=most)
