"""The names of other suites' functions here: our own problem where we have it, so that rows are compared.

COCO's suite `bbob` is our problem `bbob`, IOHexperimenter's suites are our problem `ioh` (its instances are numbered in
another way). Ids of the data are those that COCO and IOHexperimenter give their problems.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

from calibench import problems
from calibench.bench.provenance.run_id import canonical, options_as_asked

_BBOB = (
    "Sphere", "Ellipsoid", "Rastrigin", "BuecheRastrigin", "LinearSlope", "AttractiveSector", "StepEllipsoid",
    "Rosenbrock", "RosenbrockRotated", "EllipsoidRotated", "Discus", "BentCigar", "SharpRidge", "DifferentPowers",
    "RastriginRotated", "Weierstrass", "Schaffers10", "Schaffers1000", "GriewankRosenbrock", "Schwefel", "Gallagher101",
    "Gallagher21", "Katsuura", "LunacekBiRastrigin",
)  # fmt: skip

_CEC, _CEC_BEFORE = "CEC2022", 1000


@final
@dataclass(frozen=True)
class Named:
    """A problem as rows name it; `minimum` is that of our own problem, None where it cannot be made here."""

    problem: str
    problem_options: str
    data_id: str
    minimum: float | None


def of_coco(suite: str, function: int, dimension: int, instance: int) -> Named:
    """Return a problem of COCO."""
    options = {"function": function, "dimension": dimension, "instance": instance}
    return _named(suite, options, f"{suite}_f{function:03d}_i{instance:02d}_d{dimension:02d}")


def of_ioh(suite: str, function: int, name: str, dimension: int, instance: int) -> Named:
    """Return a problem of IOHexperimenter; where its suite is not told, a function's `name` tells BBOB and CEC 2022.

    IOHexperimenter numbers the functions of CEC 2022 from 1001; ours are those of their paper, from 1.
    """
    if suite == "unknown_suite" and 1 <= function <= len(_BBOB) and _BBOB[function - 1] == name:
        suite = "BBOB"
    if suite in (_CEC, "unknown_suite") and name.startswith(_CEC) and function > _CEC_BEFORE:
        suite, function = _CEC, function - _CEC_BEFORE
    options = {"suite": suite, "function": function, "dimension": dimension, "instance": instance}
    return _named("ioh", options, f"{suite}_f{function}_i{instance}_d{dimension}")


def _named(problem: str, options: dict[str, Any], data_id: str) -> Named:
    if problem not in problems.registry:
        return Named(problem, canonical(options), data_id, None)
    try:
        text = canonical(options_as_asked(problems.registry, problem, options))
    except ValueError:  # of that name here, and of other options: it is another problem
        return Named(problem, canonical(options), data_id, None)
    try:
        minimum = getattr(problems.make(problem, **options), "minimum", None)
    except ValueError:  # its package is not installed
        minimum = None
    return Named(problem, text, data_id, None if minimum is None else float(minimum))
