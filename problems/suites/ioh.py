"""`ioh`: the continuous suites of IOHexperimenter (de Nobel et al. 2024), called through its package ioh.

- BBOB: the 24 functions of `bbob`, instance by instance to rounding; any dimension from 2.
- SBOX: the same with the optimum anywhere in the box, and nothing defined outside (Vermetten et al. 2023).
- CEC2013: the 20 multimodal functions of the niching competition; each has its dimension.
- CEC2022: the 12 functions of the bound-constrained competition, in 2, 10 or 20 dimensions.
- STAR: the star discrepancy of point sets (Clement et al. 2023), piecewise constant; IOH's numbers 30 to 59.

Functions of the CEC suites are counted from 1, as in their papers. What a suite maximises is minimised with its sign
changed. IOH's counter counts the calls too. Left out are IOH's suites over bits and whole numbers (PBO, INTEGER, GRAPH,
STAR_INTEGER), as every coordinate here is real, and REAL, which repeats what the others hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, final

import numpy as np

from calibench.problems.base import Array, frozen, registry
from calibench.problems.suites.bbob import group, targets
from calibench.problems.suites.black_box import BlackBox, package

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
def ioh(suite: Suite = "BBOB", function: int = 1, dimension: int | None = None, instance: int = 1) -> BlackBox:
    """A function of one of IOHexperimenter's continuous suites, in an instance; needs the package ioh.

    Raises `ValueError` for a function, an instance or a dimension that the suite lacks, and where the package is
    missing.
    """
    kind = _KINDS[suite]
    if not kind.first <= function <= kind.last:
        raise ValueError(f"ioh.function={function}: {suite} has {kind.first} to {kind.last}")
    if instance < 1:
        raise ValueError(f"ioh.instance={instance}: must be 1 or above")
    if instance > 1 and function > kind.in_instances:
        raise ValueError(f"ioh.instance={instance}: {suite} has one instance of function {function}; take 1")
    wanted = _dimension(suite, kind, function, dimension)
    asked = kind.problem_class, kind.offset + function, instance, wanted
    built = _built(*asked)
    lower, upper = frozen(built.bounds.lb), frozen(built.bounds.ub)
    if dimension is not None and len(lower) != dimension:
        raise ValueError(f"ioh.dimension={dimension}: function {function} of {suite} has {len(lower)}; leave it out")
    minimum, truth = _optimum(built)
    return BlackBox(
        name="ioh",
        library="ioh",
        options={"suite": suite, "function": function, "dimension": len(lower), "instance": instance},
        build=partial(_counted, *asked),
        lower=lower,
        upper=upper,
        start=frozen((lower + upper) / 2),
        default_start="random",  # IOH names no start, and the middle is where some functions have their optimum
        truth=truth if suite != "CEC2013" else None,  # one of many
        minimum=minimum if suite != "CEC2013" else None,  # IOH rounds it: points are known 3e-8 below
        targets=_targets(suite, minimum),
        group=_group(suite, function),
        data_id=f"{suite}_f{function}_i{instance}_d{len(lower)}",
    )


@final
class _Function:
    """IOH's problem as a function to be minimised, and IOH's own count."""

    def __init__(self, problem: Any) -> None:
        self._problem = problem
        self._sign = _sign(problem)

    def __call__(self, x: Array) -> float:
        return self._sign * float(self._problem(x))

    @property
    def evaluations(self) -> int:
        """Return IOH's count of calls."""
        return int(self._problem.state.evaluations)


def _counted(problem_class: str, function: int, instance: int, dimension: int) -> _Function:
    return _Function(_built(problem_class, function, instance, dimension))


def _built(problem_class: str, function: int, instance: int, dimension: int) -> Any:
    """Return IOH's problem."""
    library = package("ioh", "ioh", "ioh")
    return library.get_problem(function, instance, dimension, library.ProblemClass[problem_class])


def _sign(problem: Any) -> float:
    """Return -1 for a problem that is to be maximised."""
    return -1.0 if problem.meta_data.optimization_type.name == "MAX" else 1.0


def _dimension(suite: str, kind: _Kind, function: int, dimension: int | None) -> int:
    """Return the number of variables to ask IOH for."""
    wanted = dimension or kind.default or _USUAL
    if dimension is not None and dimension < kind.least:
        raise ValueError(f"ioh.dimension={dimension}: {suite} needs {kind.least} or more")
    if kind.dimensions is not None and wanted not in kind.dimensions:
        listed = ", ".join(map(str, kind.dimensions))
        raise ValueError(f"ioh.dimension={dimension}: {suite} has {listed}")
    if suite == "CEC2022" and wanted == 2 and _group(suite, function) == "hybrid":  # IOH warns, and has none
        raise ValueError(f"ioh.dimension=2: the hybrid function {function} of CEC2022 needs 10 or 20")
    return wanted


def _optimum(problem: Any) -> tuple[float | None, Array | None]:
    """Return the least value and where it is, as IOH states them; None where it does not know."""
    least, place = _sign(problem) * float(problem.optimum.y), np.array(problem.optimum.x, dtype=float)
    known = bool(np.isfinite(least))
    return least if known else None, frozen(place) if known and np.isfinite(place).all() else None


def _targets(suite: str, minimum: float | None) -> tuple[float, ...]:
    """Return levels of f: COCO's above the optimum, the competition's for CEC2013, none where it is not known."""
    if minimum is None:
        return ()
    return tuple(minimum + level for level in _COMPETITION) if suite == "CEC2013" else targets(minimum)


def _group(suite: str, function: int) -> str:
    """Return the group of a function, as its suite divides them."""
    if suite in ("BBOB", "SBOX"):
        return group(function)
    if suite == "CEC2013":
        return "simple" if function <= 10 else "composition"
    if suite == "CEC2022":
        return "basic" if function <= 5 else "hybrid" if function <= 8 else "composition"
    return ("uniform", "Sobol", "Halton")[(function - 30) // 10]
