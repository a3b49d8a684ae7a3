"""The interface of a problem: a box, a start, and a value for every point of the box.

A problem needs only `lower`, `upper`, `start` and a call; everything else (residuals, Jacobian, batch, truth, figures
of merit) is extra that an optimiser or a table may use where it is there.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import Range, shown
from calibench.core.registry import Registry
from calibench.core.words import counted, html_table

Array = NDArray[np.float64]
Number = Annotated[int | None, Range(1)]  # of an instance of a family


@dataclass(frozen=True, slots=True)
class Parameter:
    """One unknown: its name, unit, start, bounds, and its true value where that is known."""

    name: str
    unit: str
    start: float
    lower: float
    upper: float
    true: float | None = None


class Problem(Protocol):
    """The least that can be optimised: minimise ``problem(x)`` over ``lower <= x <= upper``, arrays of shape (dim,)."""

    @property
    def lower(self) -> Array: ...
    @property
    def upper(self) -> Array: ...
    @property
    def start(self) -> Array: ...
    def __call__(self, x: Array, /) -> float: ...


class Calibration(Problem, Protocol):
    """A calibration problem: a sum of squared residuals, ``problem(x) == r @ r`` with ``r = problem.residuals(x)``.

    `parameters` are the physical unknowns; `coordinates` are what the vector x holds (the same but for J3, which
    searches l_a cos z and l_a sin z in place of l_a and z). `truth`, shape (dim,), is None where it is not known.
    Shapes: x (dim,), ``residuals(x)`` (m,), ``jacobian(x)`` (m, dim), ``batch(points)`` (k,) of points (k, dim),
    ``physical(x)`` one number for each parameter in its unit; ``merit(x)`` is name -> figure of merit.
    """

    @property
    def name(self) -> str: ...
    @property
    def options(self) -> Mapping[str, Any]: ...
    @property
    def parameters(self) -> tuple[Parameter, ...]: ...
    @property
    def coordinates(self) -> tuple[Parameter, ...]: ...
    @property
    def truth(self) -> Array | None: ...
    def residuals(self, x: Array, /) -> Array: ...
    def jacobian(self, x: Array, /) -> Array: ...
    def batch(self, points: Array, /) -> Array: ...
    def physical(self, x: Array, /) -> Array: ...
    def merit(self, x: Array, /) -> dict[str, float]: ...


def extra_of(thing: Any, name: str, default: Any = None) -> Any:
    """Return what a problem or a method may have beside what it must; `default` where it has none.

    None is none: a subclass switches off by it what it inherits, such as ``merit = None``.
    """
    found = getattr(thing, name, None)
    return default if found is None else found


def parameters_of(problem: Any) -> tuple[Parameter, ...]:
    """Return the parameters a problem names; a plain string is a name, its box and start are the problem's own.

    Without `parameters` they are x0, x1, ... Where `physical` turns x into something else, a string has no box.

    Raises `ValueError` for what is neither text nor has the fields of a `Parameter`.
    """
    return _named(problem, "parameters", own=extra_of(problem, "physical") is None)


def coordinates_of(problem: Any) -> tuple[Parameter, ...]:
    """Return the meaning of the vector x: the `coordinates` of a problem, or its parameters where it has none."""
    if getattr(problem, "coordinates", None) is not None:
        return _named(problem, "coordinates", own=True)
    converted = extra_of(problem, "physical") and len(extra_of(problem, "parameters", ())) != len(problem.lower)
    return _named(problem, "coordinates" if converted else "parameters", own=True)


def _named(problem: Any, attribute: str, own: bool) -> tuple[Parameter, ...]:
    """Return the entries of `attribute` as `Parameter`s; `own`: x holds them, one for one."""
    given = getattr(problem, attribute, None)
    if isinstance(given, str):
        raise ValueError(f"{attribute}={given!r}: a tuple of names is needed, such as ({given!r},)")
    lower, upper, start = (np.asarray(getattr(problem, key), dtype=float) for key in ("lower", "upper", "start"))
    dim = lower.size
    listed = tuple(f"x{i}" for i in range(dim)) if given is None else tuple(given)
    if own and len(listed) != dim:
        raise ValueError(f"{attribute}: {len(listed)} are named, and x has {dim}")

    known = getattr(problem, "truth", None) if own else None
    try:
        truth = np.asarray([] if known is None else known, dtype=float)
    except (TypeError, ValueError):
        truth = np.empty(0)
    if known is not None and truth.shape != (dim,):
        raise ValueError(f"truth has shape {np.shape(known)}, and x has {dim} numbers; these, or None, are needed")

    found = []
    for i, each in enumerate(listed):
        box = (start[i], lower[i], upper[i]) if own else (np.nan, -np.inf, np.inf)
        true = None if known is None else float(truth[i])
        if isinstance(each, str):
            found.append(Parameter(each, "", float(box[0]), float(box[1]), float(box[2]), true))
            continue
        if not isinstance(getattr(each, "name", None), str):
            raise ValueError(f"{attribute}[{i}]={each!r}: a name, or an object with one, such as Parameter, is needed")
        first, low, high = (
            float(getattr(each, k, value)) for k, value in zip(("start", "lower", "upper"), box, strict=True)
        )
        unit = str(getattr(each, "unit", ""))
        found.append(Parameter(each.name, unit, first, low, high, getattr(each, "true", true)))
    names = [p.name for p in found]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ValueError(f"{attribute}: {twice!r} is named twice")
    return tuple(found)


def line_of(problem: Calibration) -> str:
    """Return a problem in a line: its name, its options and how many parameters there are."""
    options = "".join(f" {key}={shown(value)}" for key, value in problem.options.items() if value is not None)
    return f"<problem {problem.name}{options}: {counted(len(problem.lower), 'parameter')}>"


def table_of(problem: Calibration) -> str:
    """Return a problem as a notebook shows it: its line, and a table of its parameters."""
    rows = [(p.name, p.unit, p.start, p.lower, p.upper, p.true) for p in parameters_of(problem)]
    return html_table(line_of(problem).strip("<>"), ("parameter", "unit", "start", "lower", "upper", "true"), rows)


registry: Registry[Problem] = Registry(kind="problem", group="calibench.problems")


def frozen(values: Any) -> Array:
    """Return `values` as an array of floats that nobody can write to."""
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def numbers_of(readings: Any) -> Array:
    """Return readings as a new array of floats. Raises `ValueError` for values that are not numbers."""
    try:
        return np.array(readings, dtype=float)
    except (TypeError, ValueError):
        raise ValueError("readings: an array of numbers, or the path of a CSV file, is needed") from None
