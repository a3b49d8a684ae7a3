"""`BlackBox`: a function of a foreign library as a problem, whose calls the library counts too.

What such a library builds belongs to one process and takes one call at a time: it is built where it is first called,
once more in a forked process, and a pickle holds the options alone. `bbob` has the 24 noiseless functions of COCO
(Hansen et al. 2021, Optimization Methods and Software 36(1), 114-144), `ioh` the continuous suites of IOHexperimenter
(de Nobel et al. 2024; docs/suites.md), without REAL; what a suite maximises is minimised with its sign changed.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from threading import Lock
from typing import Annotated, Any, ClassVar, Literal, Protocol, final

import numpy as np

from calibench.core.options import Range
from calibench.problems.base import Array, frozen, line_of, registry, table_of
from calibench.problems.compiled_problem import vector_of, vectors_of


class Counted(Protocol):
    """What a library built: a call, x of shape (dim,) -> the value to be minimised, and its own count of calls."""

    def __call__(self, x: Array, /) -> float: ...
    @property
    def evaluations(self) -> int: ...


@final
@dataclass(frozen=True, eq=False)
class BlackBox:
    """Minimise a function of which only values can be had. `build` makes it; all else was read once from the library.

    `library` is the package that is called. `minimum` and `truth`, shape (dim,), are None where it does not know them.
    `targets` are levels of f whose first crossing is recorded; `group` is the suite's. `data_id` is how the suite calls
    this very function.
    """

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    name: str
    library: str
    options: Mapping[str, Any]
    build: Callable[[], Counted] = field(repr=False)
    lower: Array
    upper: Array
    start: Array
    default_start: Literal["nominal", "random"]
    truth: Array | None
    minimum: float | None
    targets: tuple[float, ...]
    group: str
    data_id: str
    _built: dict[int, tuple[Counted, Lock]] = field(default_factory=dict, init=False, repr=False)

    side_effect_free: ClassVar[bool] = True
    splits_batches: ClassVar[bool] = True

    __repr__ = line_of
    _repr_html_ = table_of

    def __call__(self, x: Array) -> float:
        """Return the value of the candidate x, shape (dim,): one call of the library."""
        point = vector_of(self, x)
        function, lock = self._here()
        with lock:
            return float(function(point))

    def batch(self, points: Array) -> Array:
        """Return the values, shape (k,), of candidates of shape (k, dim): a call each."""
        return np.array([self(x) for x in vectors_of(self, points)], dtype=float)

    @property
    def evaluations(self) -> int:
        """Return the library's own count of calls in this process."""
        return int(self._here()[0].evaluations)

    @property
    def budgets(self) -> dict[str, int]:
        """Evaluations meant by the words `ci` and `paper`."""
        return {"ci": 1_000 * len(self.lower), "paper": 10_000 * len(self.lower)}

    def __reduce__(self) -> tuple[Any, ...]:
        return _made_again, (self.name, dict(self.options))

    def _here(self) -> tuple[Counted, Lock]:
        me = os.getpid()
        if me not in self._built:
            self._built[me] = self.build(), Lock()
        return self._built[me]

    compile = _here


def package(module: str, distribution: str, problem: str) -> Any:
    """Return the imported `module`; raise `ValueError` that says what to install where it is not there."""
    try:
        return import_module(module)
    except ImportError as error:
        raise ValueError(
            f"problem {problem} needs the package {distribution}, which cannot be imported here ({error}); "
            f"pip install 'calibench[{problem}]' brings it"
        ) from None


def _made_again(name: str, options: dict[str, Any]) -> Any:
    return registry.make(name, **options)


# how far above its minimum a value is looked at, by COCO and IOH: 51 gaps, 1e2 to 1e-8, the floats that cocopp has
COCO_GAPS = tuple(10.0 ** (k / 5) for k in range(10, -41, -1))
Instance = Annotated[int, Range(1)]
Function = Literal[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24]
_GROUPS = (  # last function of each, as the suite divides them
    (5, "separable"), (9, "moderate"), (14, "ill-conditioned"), (19, "multi-modal"), (24, "weak structure"),
)  # fmt: skip


@registry.register("bbob")
def bbob(function: Function = 1, dimension: Literal[2, 3, 5, 10, 20, 40] = 5, instance: Instance = 1) -> BlackBox:
    """One of COCO's 24 noiseless functions (bbob), in an instance; needs the package coco-experiment.

    Raises `ValueError` where the package is missing.
    """
    package("cocoex", "coco-experiment", "bbob")
    bare = package("cocoex.bare_problem", "coco-experiment", "bbob").BareProblem("bbob", function, dimension, instance)
    minimum = float(bare.best_value())
    built = _bbob_function(function, dimension, instance)
    return BlackBox(
        name="bbob", library="coco-experiment",
        options={"function": function, "dimension": dimension, "instance": instance},
        build=partial(_bbob_function, function, dimension, instance), lower=frozen(built.lower_bounds),
        upper=frozen(built.upper_bounds), start=frozen(built.initial_solution), default_start="nominal",
        truth=frozen(bare.best_parameter()), minimum=minimum, targets=tuple(minimum + gap for gap in COCO_GAPS),
        group=_group("BBOB", function), data_id=str(built.id),
    )  # fmt: skip


def _bbob_function(function: int, dimension: int, instance: int) -> Any:
    """Return COCO's problem. The suite is asked for this one alone: it takes a millisecond."""
    cocoex = package("cocoex", "coco-experiment", "bbob")
    suite = cocoex.Suite("bbob", f"instances: {instance}", f"dimensions: {dimension} function_indices: {function}")
    return suite.get_problem_by_function_dimension_instance(function, dimension, instance)


Suite = Literal["BBOB", "SBOX", "CEC2013", "CEC2022", "STAR"]
_USUAL = 5  # dimensions, where neither the user nor the function says how many


@final
@dataclass(frozen=True)
class _Kind:
    """A suite: IOH's name of its class, its first and last function, IOH's number of function 0, its dimensions."""

    problem_class: str
    first: int
    last: int
    offset: int = 0
    dimensions: tuple[int, ...] | None = None  # None: any from `least`
    least: int = 1
    default: int | None = _USUAL  # None: each function has its own
    in_instances: int = 0  # the last function that is there in more than one instance


_KINDS: dict[str, _Kind] = {
    "BBOB": _Kind("BBOB", 1, 24, least=2, in_instances=24),
    "SBOX": _Kind("SBOX", 1, 24, least=2, in_instances=24),
    "CEC2013": _Kind("CEC2013", 1, 20, offset=1100, default=None),
    "CEC2022": _Kind("CEC2022", 1, 12, offset=1000, dimensions=(2, 10, 20), default=10),
    "STAR": _Kind("STAR_REAL", 30, 59, in_instances=39),
}
_COMPETITION = tuple(10.0**-k for k in range(1, 6))  # the accuracy levels of CEC2013's niching competition


@registry.register("ioh")
def ioh(suite: Suite = "BBOB", function: int = 1, dimension: int | None = None, instance: Instance = 1) -> BlackBox:
    """A function of one of IOHexperimenter's continuous suites, in an instance; needs the package ioh.

    Raises `ValueError` for a function, an instance or a dimension that the suite lacks, and where the package is
    missing.
    """
    kind = _KINDS[suite]
    if not kind.first <= function <= kind.last:
        raise ValueError(f"ioh.function={function}: {suite} has {kind.first} to {kind.last}")
    if instance > 1 and function > kind.in_instances:
        raise ValueError(f"ioh.instance={instance}: {suite} has one instance of function {function}; take 1")
    # the number of variables to ask IOH for
    wanted = dimension or kind.default or _USUAL
    if dimension is not None and dimension < kind.least:
        raise ValueError(f"ioh.dimension={dimension}: {suite} needs {kind.least} or more")
    if kind.dimensions is not None and wanted not in kind.dimensions:
        listed = ", ".join(map(str, kind.dimensions))
        raise ValueError(f"ioh.dimension={dimension}: {suite} has {listed}")
    if suite == "CEC2022" and wanted == 2 and _group(suite, function) == "hybrid":  # IOH warns, and has none
        raise ValueError(f"ioh.dimension=2: the hybrid function {function} of CEC2022 needs 10 or 20")
    asked = kind.problem_class, kind.offset + function, instance, wanted
    made = _Function(*asked)
    built = made.problem
    lower, upper = frozen(built.bounds.lb), frozen(built.bounds.ub)
    if dimension is not None and len(lower) != dimension:
        raise ValueError(f"ioh.dimension={dimension}: function {function} of {suite} has {len(lower)}; leave it out")
    # the least value and where it is, as IOH states them, None where it does not know; and the suite's group
    least, place = made.sign * float(built.optimum.y), np.array(built.optimum.x, dtype=float)
    known = bool(np.isfinite(least))
    minimum, truth = least if known else None, frozen(place) if known and np.isfinite(place).all() else None
    gaps = _COMPETITION if suite == "CEC2013" else COCO_GAPS
    return BlackBox(
        name="ioh", library="ioh", build=partial(_Function, *asked), lower=lower, upper=upper,
        options={"suite": suite, "function": function, "dimension": len(lower), "instance": instance},
        start=frozen((lower + upper) / 2),
        default_start="random",  # IOH names no start, and the middle is where some functions have their optimum
        truth=truth if suite != "CEC2013" else None,  # one of many
        minimum=minimum if suite != "CEC2013" else None,  # IOH rounds it: points are known 3e-8 below
        targets=() if minimum is None else tuple(minimum + gap for gap in gaps),
        group=_group(suite, function), data_id=f"{suite}_f{function}_i{instance}_d{len(lower)}",
    )  # fmt: skip


@final
class _Function:
    """IOH's problem as a function to be minimised, and IOH's own count."""

    def __init__(self, problem_class: str, function: int, instance: int, dimension: int) -> None:
        library = package("ioh", "ioh", "ioh")
        self.problem = library.get_problem(function, instance, dimension, library.ProblemClass[problem_class])
        self.sign = -1.0 if self.problem.meta_data.optimization_type.name == "MAX" else 1.0

    def __call__(self, x: Array) -> float:
        return self.sign * float(self.problem(x))

    @property
    def evaluations(self) -> int:
        return int(self.problem.state.evaluations)


def _group(suite: str, function: int) -> str:
    if suite in ("BBOB", "SBOX"):
        return next(name for last, name in _GROUPS if function <= last)
    if suite == "CEC2013":
        return "simple" if function <= 10 else "composition"
    if suite == "CEC2022":
        return "basic" if function <= 5 else "hybrid" if function <= 8 else "composition"
    return ("uniform", "Sobol", "Halton")[(function - 30) // 10]
