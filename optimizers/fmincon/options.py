"""The options of `fmincon` under MATLAB's names, checked once: unknown, misspelt, old or another algorithm's.

Defaults are MATLAB's but for Algorithm (sqp), ScaleProblem (true: SLSQP needs it) and Display (off).
OptimalityTolerance is absolute. The rules of steps, stops and scales have no name in MATLAB: there the release decides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from typing import Annotated, Any, Literal, final

import numpy as np

from calibench.core.options import Range, declared_options, suggest
from calibench.optimizers.base import Array

StopRule = Literal["relative", "absolute"]
StopPlace = Literal["after_step", "next_gradient", "before_step"]


def absolute_stop(
    direction: Array, slope: float, step_tolerance: float, slope_limit: float
) -> tuple[Literal[4, 5], str] | None:
    """Return the exit flag and the words where d or the change g d that it promises is small at a feasible point.

    `direction`, shape (n,), is d in the user's units; `slope` is g d; `slope_limit` what |g d| is compared with.
    Nothing is relative: in a unit that makes f smaller a search ends earlier. Its place in the loop changed (revisions
    of `nlconst`: 1.20 of August 1998, 1.41 of February 2003, 1.1.4.25 of December 2009):

    after_step     1998. The line search is over: g is the gradient at the old point, the new point is the answer.
    next_gradient  by 2003. The gradient g at the new point is known; d is the direction that led there.
    before_step    by the end of 2009. No step is taken: the limit is FunctionTolerance, not twice that.

    >>> absolute_stop(np.array([1e-7, -3e-6]), -1.0, 2e-6, 2e-6)
    (4, 'Local minimum possible: the search direction 3.000e-06 is less than 2 StepTolerance, and feasible.')
    """
    longest = float(np.max(np.abs(direction), initial=0.0))
    if longest < 2.0 * step_tolerance:
        words = f"the search direction {longest:.3e} is less than 2 StepTolerance"
        return 4, f"Local minimum possible: {words}, and feasible."
    if abs(slope) < slope_limit:
        words = f"the directional derivative {abs(slope):.3e} is less than its limit {slope_limit:.1e}"
        return 5, f"Local minimum possible: {words} by FunctionTolerance, and feasible."
    return None


Algorithm = Literal["sqp", "interior-point"]
DifferenceType = Literal["forward", "central"]
Display = Literal["off", "iter", "final"]
StepRule = Literal["box", "typical_x", "gradient"]
Numbers = float | tuple[float, ...]
_NotNegative = Annotated[float, Range(0)]
_NotNegativeOrNone = Annotated[float | None, Range(0)]
_Positive = Annotated[float | None, Range(0, above=True)]
_PositiveNumbers = Annotated[Numbers | None, Range(0, above=True)]

_FORMER = {
    "TolX": "StepTolerance", "TolFun": "OptimalityTolerance", "TolCon": "ConstraintTolerance",
    "MaxIter": "MaxIterations", "MaxFunEvals": "MaxFunctionEvaluations", "GradObj": "SpecifyObjectiveGradient",
    "GradConstr": "SpecifyConstraintGradient", "FinDiffType": "FiniteDifferenceType",
    "FinDiffRelStep": "FiniteDifferenceStepSize", "AlwaysHonorConstraints": "HonorBounds",
}  # fmt: skip
_ELSEWHERE = {  # MATLAB's options of algorithms, and of parts of algorithms, that are not here
    "active-set": ("MaxSQPIterations", "RelLineSrchBnd", "RelLineSrchBndDuration", "TolConSQP"),
    "trust-region-reflective": ("HessianMultiplyFcn", "MaxPCGIterations", "PrecondBandWidth"),
    "MATLAB's interior-point": (
        "BarrierParamUpdate", "EnableFeasibilityMode", "HessianApproximation", "HessianFcn", "HonorBounds",
        "MaxProjCGIterations", "SubproblemAlgorithm", "TolProjCG", "TolProjCGAbs",
    ),
}  # fmt: skip
_INTERIOR_ONLY = ("InitBarrierParam", "InitTrustRegionRadius")
_ONLY_WITH = {  # option: the option and the values of it that it belongs to
    "FiniteDifferenceStepSize": ("FiniteDifferenceStepRule", ("typical_x",)),
    "TypicalX": ("FiniteDifferenceStepRule", ("typical_x",)),
    "DiffMinChange": ("FiniteDifferenceStepRule", ("typical_x", "gradient")),
    "DiffMaxChange": ("FiniteDifferenceStepRule", ("typical_x", "gradient")),
    "StopPlace": ("StopRule", ("absolute",)),
    "FunctionTolerance": ("StopRule", ("absolute",)),
}


@final
@dataclass(frozen=True)
class Options:
    """What `fmincon` may be told, under MATLAB's names; None stands for the default of the chosen algorithm.

    sqp: StepTolerance 1e-6, MaxIterations 400, MaxFunctionEvaluations 100 n. interior-point: 1e-10, 1000, 3000.
    OptimalityTolerance and ConstraintTolerance are absolute, in the units of the user's f and constraints;
    StepTolerance is relative to 1 + abs(x). A tolerance of 0 goes on to rounding. MaxFunctionEvaluations is tested
    before a trial point, so that the differences at one iterate may pass it. Raises `ValueError` for a value outside
    its choices and for an option of the other algorithm or of a rule that is not chosen.

    FiniteDifferenceStepRule: box, typical_x or gradient. With typical_x, FiniteDifferenceStepSize (None: eps^(1/2)
    forward, eps^(1/3) central) and TypicalX (None: 1) are one number or one a variable; with typical_x and gradient
    DiffMinChange and DiffMaxChange hold the steps, None: 0 and infinity with typical_x, 1e-8 and .1 with gradient.

    ScaleProblem divides f and constraints and, with ScaleVariables, searches in a unit box; else in the user's units.

    StopRule: relative, or with sqp absolute: over where the search direction d has max|d| < 2 StepTolerance or |g d| <
    2 FunctionTolerance (None: 1e-6), tested at StopPlace (None: next_gradient). OptimalityTolerance is tested besides.
    """

    Algorithm: Algorithm = "sqp"
    OptimalityTolerance: _NotNegative = 1e-6
    ConstraintTolerance: _NotNegative = 1e-6
    StepTolerance: _NotNegativeOrNone = None
    ObjectiveLimit: float = -1e20
    MaxIterations: Annotated[int | None, Range(0)] = None
    MaxFunctionEvaluations: Annotated[int | None, Range(0, above=True)] = None
    FiniteDifferenceType: DifferenceType = "forward"
    ScaleProblem: bool = True
    Display: Display = "off"
    OutputFcn: Callable[..., Any] | None = None
    SpecifyObjectiveGradient: bool = False
    SpecifyConstraintGradient: bool = False
    InitBarrierParam: _Positive = None
    InitTrustRegionRadius: _Positive = None
    FiniteDifferenceStepRule: StepRule = "box"
    FiniteDifferenceStepSize: _PositiveNumbers = None
    TypicalX: _PositiveNumbers = None
    DiffMinChange: _NotNegativeOrNone = None
    DiffMaxChange: _Positive = None
    StopRule: StopRule = "relative"
    StopPlace: StopPlace | None = None
    FunctionTolerance: _NotNegativeOrNone = None
    ScaleVariables: bool = True

    def __post_init__(self) -> None:
        for name, option in _declared().items():
            value = getattr(self, name)
            if name == "ObjectiveLimit" and value == float("-inf"):
                continue
            if name == "OutputFcn":
                if value is not None and not callable(value):
                    raise ValueError(f"OutputFcn={value!r}: a function of (x, optimValues, state) is needed")
                continue
            object.__setattr__(self, name, option.taken(name, value))
        if self.Algorithm == "sqp":
            for name in _INTERIOR_ONLY:
                if getattr(self, name) is not None:
                    raise ValueError(f"{name} is an option of Algorithm='interior-point'; Algorithm is 'sqp'")
        elif self.StopRule == "absolute":
            raise ValueError("StopRule='absolute' is an option of Algorithm='sqp'; Algorithm is 'interior-point'")
        for name, (rule, choices) in _ONLY_WITH.items():
            if getattr(self, name) is not None and getattr(self, rule) not in choices:
                wanted = " or ".join(repr(choice) for choice in choices)
                raise ValueError(f"{name} is an option of {rule}={wanted}; {rule} is {getattr(self, rule)!r}")
        if self.DiffMinChange is not None or self.DiffMaxChange is not None:
            least, most = self.change_limits
            if not least < most:
                raise ValueError(f"DiffMinChange={least:g} must be below DiffMaxChange={most:g}")

    @property
    def change_limits(self) -> tuple[float, float]:
        """Return the least and the largest length of a difference step."""
        least, most = (1e-8, 0.1) if self.FiniteDifferenceStepRule == "gradient" else (0.0, float("inf"))
        return _or(self.DiffMinChange, least), _or(self.DiffMaxChange, most)

    def filled(self, dimension: int) -> Options:
        """Return the options with the defaults of the algorithm in place of None."""
        sqp = self.Algorithm == "sqp"
        return replace(
            self,
            StepTolerance=_or(self.StepTolerance, 1e-6 if sqp else 1e-10),
            MaxIterations=_or(self.MaxIterations, 400 if sqp else 1000),
            MaxFunctionEvaluations=_or(self.MaxFunctionEvaluations, 100 * dimension if sqp else 3000),
            StopPlace=_or(self.StopPlace, "next_gradient") if self.StopRule == "absolute" else None,
            FunctionTolerance=_or(self.FunctionTolerance, 1e-6) if self.StopRule == "absolute" else None,
        )


_declared = cache(partial(declared_options, Options))  # it takes 2 ms, and a search makes options a dozen times


def optimoptions(options: Options | Mapping[str, Any] | None = None, /, **changes: Any) -> Options:
    """Return checked options from `options` (or the defaults) with `changes`, as MATLAB's function of that name.

    Raises `ValueError` in one line for an unknown name (with the nearest), a former one (with the present one), and
    one that belongs to an algorithm which is not chosen or not here.

    >>> optimoptions(Algorithm="interior-point", StepTolerance=1e-8).StepTolerance
    1e-08
    >>> optimoptions(StepTolerence=1e-8)
    Traceback (most recent call last):
    ...
    ValueError: fmincon has no option 'StepTolerence'; did you mean 'StepTolerance'? choices: Algorithm, ...
    """
    if not (options is None or isinstance(options, Options | Mapping)):
        raise ValueError(f"options={options!r}: Options, a mapping of names to values, or None is needed")
    given = {**({} if options is None or isinstance(options, Options) else options), **changes}
    known = [field.name for field in fields(Options)]
    for name in map(str, given):
        if name in known:
            continue
        if _FORMER.get(name) in known:
            raise ValueError(f"fmincon's option {name!r} is now called {_FORMER[name]!r}")
        for algorithm, names in _ELSEWHERE.items():
            if _FORMER.get(name, name) in names:
                elsewhere = f"{name} is an option of {algorithm}, which is not here"
                raise ValueError(f"{elsewhere}; algorithms: sqp, interior-point")
        raise ValueError(f"fmincon has no option {name!r}; {suggest(name, known)}")
    return replace(options, **given) if isinstance(options, Options) else Options(**given)


def _or(value: Any, default: Any) -> Any:
    return default if value is None else value
