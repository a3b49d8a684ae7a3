"""`Fmincon`: the search of the function `fmincon` as a registered optimiser, in the box of a problem, through the gate.

MATLAB's tolerances stop a calibration early: with 1e-6 full12 ends at J2 of 1e-14 .. 1e-10 mm^4, where rounding is at
1e-19. So the registered optimiser's tolerances are 0: on to rounding. What then limits it is the gradient: its error
moves the minimiser in proportion, and J is the square of that. Forward differences err by their step, eps^(1/2) of the
box, and J stalls at 1e-2 .. 1; central ones by the square of theirs, eps^(1/3), and J stalls at 1e-8 .. 1e-7; only the
analytic gradient vanishes where the residuals do. See docs/fmincon.md.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar, final

import numpy as np

from calibench.optimizers.base import Array, Objective, Reason, Traits, registry, with_restarts
from calibench.optimizers.derivatives import Memoized
from calibench.optimizers.fmincon.options import (
    Algorithm,
    DifferenceType,
    Display,
    Numbers,
    Options,
    StepRule,
    StopPlace,
    StopRule,
    optimoptions,
)


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

    Algorithm: Algorithm = "sqp"
    SpecifyObjectiveGradient: bool = True
    FiniteDifferenceType: DifferenceType = "forward"
    OptimalityTolerance: float = 0.0
    StepTolerance: float = 0.0
    ConstraintTolerance: float = 1e-6
    ObjectiveLimit: float = -1e20
    MaxIterations: int = 10_000
    MaxFunctionEvaluations: int | None = None
    ScaleProblem: bool = True
    Display: Display = "off"
    InitBarrierParam: float | None = None
    InitTrustRegionRadius: float | None = None
    restarts: bool = False
    FiniteDifferenceStepRule: StepRule = "box"
    FiniteDifferenceStepSize: Numbers | None = None
    TypicalX: Numbers | None = None
    DiffMinChange: float | None = None
    DiffMaxChange: float | None = None
    StopRule: StopRule = "relative"
    StopPlace: StopPlace | None = None
    FunctionTolerance: float | None = None
    ScaleVariables: bool = True

    name: ClassVar[str] = "fmincon"
    library: ClassVar[str] = "scipy"

    def __post_init__(self) -> None:
        self._options(None)  # so that a wrong value is told when it is made, not when it runs

    @property
    def traits(self) -> Traits:
        """Return the traits; with `restarts` it goes on, at random, until it is stopped."""
        return Traits(
            stochastic=self.restarts,
            uses_gradient=True,
            self_terminating=not self.restarts,
            needs_finite_bounds=self.restarts,
        )

    def compile(self) -> None:
        """Import the search and SciPy's part of it, so that no clock sees it."""
        import scipy.optimize  # noqa: F401

        import calibench.optimizers.fmincon.search  # noqa: F401

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Descend from the start; with `restarts`, again from random points of the box."""
        return with_restarts(lambda start: self._descend(objective, start), objective, self.restarts)

    def _descend(self, objective: Objective, start: Array) -> None:
        from calibench.optimizers.fmincon.constraints import region  # here, as the names of all methods are listed
        from calibench.optimizers.fmincon.search import search

        asked = Memoized(objective, self.SpecifyObjectiveGradient, self.FiniteDifferenceType)
        while not np.isfinite(asked.value(start)):
            start = objective.restart()
        box = region(
            objective.dimension, None, b=None, Aeq=None, beq=None, lb=objective.lower, ub=objective.upper, nonlcon=None
        )
        search(asked, box, self._options(objective.remaining + 1), start)

    def _options(self, budget: int | None) -> Options:
        """Return the options of a search; without a limit of one's own the budget, one beyond it, is the limit."""
        own = ("SpecifyObjectiveGradient", "MaxFunctionEvaluations", "restarts")  # not handed on as they are
        names = [field.name for field in fields(self) if field.name not in own]
        most = self.MaxFunctionEvaluations if budget is None else min(self.MaxFunctionEvaluations or budget, budget)
        return optimoptions(**{name: getattr(self, name) for name in names}, MaxFunctionEvaluations=most)
