"""The checks of a request: a problem and an optimiser that fit each other, a budget, a repetition and a start.

All are made once, before anything runs. A run that has begun raises nothing: its row reports the failure.
"""

from __future__ import annotations

from inspect import getattr_static
from types import FunctionType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calibench.bench.execution.request.own_problem import check_extras
from calibench.bench.execution.request.readable import check_optimizer_is_readable, check_problem_is_readable, floats_of
from calibench.bench.execution.stochastic import is_stochastic
from calibench.bench.provenance.run_id import name_of, seed_sequence
from calibench.core.options import LARGEST_WHOLE, is_number, shown
from calibench.problems.base import extra_of

Array = NDArray[np.float64]
Start = Literal["nominal", "random"]
MOST_EVALUATIONS = 2_000_000_000  # of one run: libraries in C count them by 32 bits, and a run of so many takes hours
_FINITE_BOUNDS = "finite bounds"
LONGEST_TIME = 1e9  # seconds of one run: thirty years; clocks of libraries end before infinity


def check_request(
    problem: Any, optimizer: Any, budget: Any, seed: Any, target: Any = None, time_limit: Any = None
) -> None:
    """Raise `ValueError` where this problem and optimiser cannot be run with this budget and repetition."""
    check_numbers(budget, seed, target, time_limit)
    check_pair(problem, optimizer)
    check_target(problem, target)


def check_numbers(budget: Any, seed: Any, target: Any = None, time_limit: Any = None) -> None:
    """Raise `ValueError` where one of these cannot be asked of any run."""
    if isinstance(budget, bool) or not isinstance(budget, int | np.integer) or budget < 1:
        raise ValueError(f"budget={budget}: a whole number of evaluations, 1 or more, is needed")
    if budget > MOST_EVALUATIONS:
        raise ValueError(f"budget={shown(budget)}: at most {MOST_EVALUATIONS:.0e} evaluations can be counted")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed={seed}: a whole number, 0 or more, is needed")
    if seed > LARGEST_WHOLE:
        raise ValueError(f"seed={shown(seed)}: at most {LARGEST_WHOLE} is needed")
    if target is not None and not is_number(target):
        raise ValueError(f"target={shown(target)}: a finite number is needed")
    if time_limit is not None and not (_is_number(time_limit) and 0 < time_limit <= LONGEST_TIME):
        raise ValueError(
            f"time_limit={shown(time_limit)}: seconds above 0, at most {LONGEST_TIME:g}, are needed, or null for no "
            "limit"
        )


def check_target(problem: Any, target: float | None) -> None:
    """Raise `ValueError` where `target` cannot end a run on `problem`."""
    if target is not None and is_stochastic(problem):
        raise ValueError(
            f"target={target}: problem {_named(problem)} is stochastic, and a lucky value would end the run; give the "
            "problem targets, which are judged by the answer"
        )


def check_pair(problem: Any, optimizer: Any) -> None:
    """Raise `ValueError` where `optimizer` cannot be run on `problem`, whatever else is asked."""
    _check_is_object("problem", problem)
    _check_is_object("optimizer", optimizer)
    who, method = _named(problem), _named(optimizer)
    check_problem_is_readable(problem, who)
    check_optimizer_is_readable(optimizer, method)
    missing = [a for a in ("lower", "upper", "start") if not hasattr(problem, a)]
    if missing or not callable(problem):
        raise ValueError(f"problem {who} has no {', '.join(missing) or '__call__'}: lower, upper, start, a call needed")
    lower, upper, start = (floats_of(problem, who, a) for a in ("lower", "upper", "start"))
    if lower.shape == (0,):
        raise ValueError(f"problem {who}: lower is empty: one parameter or more is needed, and this problem has none")
    if lower.shape == upper.shape == start.shape and lower.ndim != 1:
        raise ValueError(f"problem {who}: lower, upper and start have shape {lower.shape}; one axis is needed, (dim,)")
    if not lower.shape == upper.shape == start.shape:
        raise ValueError(
            f"problem {who}: shapes of lower {lower.shape}, upper {upper.shape}, start {start.shape} differ"
        )
    if not (lower <= upper).all():
        raise ValueError(f"problem {who}: lower[{np.argmin(lower <= upper)}] is above upper, or not a number")
    _check_inside(who, start, lower, upper)
    check_extras(problem, who)
    if not callable(getattr(optimizer, "minimize", None)):
        what = " is a function and" if isinstance(optimizer, FunctionType) else ""
        raise ValueError(f"optimizer {method}{what} has no minimize(objective, rng): make it a method of a class")
    needs = unmet_need(problem, optimizer)
    if needs:
        raise ValueError(f"{method} needs {needs}, and problem {who} has {_has(problem, needs)}")


def _check_is_object(kind: str, thing: Any) -> None:
    """Raise `ValueError` for a name, or a class, in the place of its object; a static `minimize` needs no object."""
    if isinstance(thing, str):
        lack = "minimize(objective, rng)" if kind == "optimizer" else "lower, upper, start"
        raise ValueError(f"{kind} {thing!r} is a name and has no {lack}: {kind}s.make({thing!r}) makes the object")
    if isinstance(thing, type) and not isinstance(getattr_static(thing, "minimize", None), classmethod | staticmethod):
        raise ValueError(f"{kind} {thing.__name__} is a class, and an object is needed: {thing.__name__}(...)")


def unmet_need(problem: Any, optimizer: Any) -> str:
    """Return what `optimizer` needs and `problem` lacks, such as "residuals"; '' where it can run."""
    traits = getattr(optimizer, "traits", None)
    if traits is None:
        return ""
    if traits.uses_residuals and getattr(problem, "residuals", None) is None:
        return "residuals"
    least, most, size = traits.minimum_dimension, traits.maximum_dimension, np.size(problem.lower)
    if size < least or (most is not None and size > most):
        return f"{least} or more dimensions" if most is None else f"{least} .. {most} dimensions"
    if getattr(traits, "needs_finite_bounds", False) and _open_side(problem):
        return _FINITE_BOUNDS
    return ""


def repetitions_of(optimizer: Any, start: Start, wanted: range, stochastic: bool = False) -> range:
    """Return the repetitions that can differ: a deterministic method from one start on one set of data runs once.

    So does, from whatever start, a deterministic method that ignores it. That one is repetition 0, whichever are
    `wanted`, so that more seeds do not make it twice. On a problem whose values are noisy (`stochastic`) all differ.
    """
    traits = getattr(optimizer, "traits", None)
    if stochastic or traits is None or traits.stochastic:
        return wanted
    if start == "nominal" or not traits.uses_start:
        return range(1)
    return wanted


def preferred_start(problem: Any, start: Start | None) -> Start:
    """Return `start`, or what the problem prefers."""
    preferred: Start = extra_of(problem, "default_start", "nominal")
    return preferred if start is None else start


def starting_point(problem: Any, start: Start | Array | None, key: Any, repetition: int) -> tuple[str, Array]:
    """Return what the start is called (nominal, random, given) and the point, shape (dim,); `key` names the problem.

    Raises `ValueError` for a point outside the box, another shape, or a random start in an open box.
    """
    lower, upper = np.asarray(problem.lower, dtype=float), np.asarray(problem.upper, dtype=float)
    if start is not None and not isinstance(start, str):
        point = np.array(start, dtype=float)
        if point.shape != lower.shape:
            raise ValueError(f"start has shape {point.shape}, the problem {lower.shape}")
        _check_inside(name_of(problem), point, lower, upper)
        return "given", point.clip(lower, upper)
    chosen = preferred_start(problem, start)
    if chosen == "nominal":
        return chosen, np.array(problem.start, dtype=float).clip(lower, upper)
    if chosen != "random":
        raise ValueError(f"start={chosen}: choices: nominal, random")
    if not np.isfinite(upper - lower).all():
        raise ValueError(f"problem {name_of(problem)}: a random start needs finite bounds; take start=nominal")
    rng = np.random.default_rng(seed_sequence(key, "start", repetition=repetition))
    return chosen, np.minimum(lower + rng.random(lower.size) * (upper - lower), upper)


def _named(thing: Any) -> str:
    """Return the name of a problem or optimiser; where its own cannot be read, its class's."""
    try:
        return name_of(thing)
    except Exception:
        return type(thing).__qualname__


def _check_inside(who: str, start: Array, lower: Array, upper: Array) -> None:
    """Raise `ValueError` for a start beyond a bound by more than one rounding: `starting_point` puts that right."""
    outside = np.flatnonzero(~((np.nextafter(lower, -np.inf) <= start) & (start <= np.nextafter(upper, np.inf))))
    if outside.size:
        i = int(outside[0])
        raise ValueError(f"problem {who}: start[{i}]={start[i]:g} lies outside its box {lower[i]:g} .. {upper[i]:g}")


def _has(problem: Any, needs: str) -> str:
    """Return what a problem has in place of what is needed, and what to do."""
    if needs == "residuals":
        return "none; choose another optimizer"
    if needs == _FINITE_BOUNDS:
        return f"{_open_side(problem)}; give it two ends, or take a method without the trait needs_finite_bounds"
    return str(np.size(problem.lower))


def _open_side(problem: Any) -> str:
    """Return the first bound without an end, such as "upper[2]=inf"; '' where all parameters have a finite width."""
    lower, upper = np.asarray(problem.lower, dtype=float), np.asarray(problem.upper, dtype=float)
    with np.errstate(over="ignore"):  # two finite ends may lie further apart than a double can say
        wide = np.flatnonzero(~np.isfinite(upper - lower))
    if not wide.size:
        return ""
    i = int(wide[0])
    ends = {"lower": float(lower[i]), "upper": float(upper[i])}
    told = {name: end for name, end in ends.items() if np.isinf(end)} or ends
    return ", ".join(f"{name}[{i}]={end:g}" for name, end in told.items())


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
