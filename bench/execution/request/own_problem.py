"""The optional attributes of a problem besides its box, start and call: read and checked once, before anything runs.

They are `targets`, `minimum`, `unit`, `group`, `parameters`, `truth`, `merit`, `stochastic` with `noise_free`
(`bench.execution.stochastic`). Tasks that no optimiser here can solve (constraints, whole numbers, several objectives)
are refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sized
from numbers import Real
from typing import Any

import numpy as np

from calibench.bench.execution.stochastic import check_stochastic
from calibench.problems.base import coordinates_of, extra_of, parameters_of

OPTIONAL = (
    "residuals", "jacobian", "gradient", "value_and_gradient", "batch", "targets", "minimum", "unit", "group",
    "parameters", "coordinates", "truth", "budgets", "stochastic",
)  # fmt: skip  # what is read before a run begins
_MANY = "give one number, such as a weighted sum"
_OUT_OF_SCOPE = {
    "constraints": "constraints are not handled: put a penalty into the value, or choose a box that holds them",
    "constraint": "constraints are not handled: put a penalty into the value, or choose a box that holds them",
    "integrality": "whole numbers are not handled: every coordinate is real",
    "integers": "whole numbers are not handled: every coordinate is real",
    "integer": "whole numbers are not handled: every coordinate is real",
    "categories": "categories are not handled: every coordinate is real",
    "objectives": f"several objectives are not handled: {_MANY}",
    "n_objectives": f"several objectives are not handled: {_MANY}",
}
_ALIKE = {
    **{f"{kind}_constraints": "constraints" for kind in ("equality", "inequality", "linear", "nonlinear")},
    **dict.fromkeys(("integer_variables", "discrete", "is_integer"), "integers"), "categorical": "categories",
    **dict.fromkeys(("n_obj", "nobj", "number_of_objectives"), "n_objectives"),
}  # fmt: skip


def check_extras(problem: Any, who: str) -> None:
    """Raise `ValueError`, one line, where an attribute of `problem` is wrong or asks for an unsupported task."""
    for attribute, kind in {**{key: key for key in _OUT_OF_SCOPE}, **_ALIKE}.items():
        asked = getattr(problem, attribute, None)
        if asked is not None and _asks(asked, kind, np.size(problem.lower)):
            raise ValueError(f"problem {who}: {attribute}: {_OUT_OF_SCOPE[kind]}")
    for read in (coordinates_of, parameters_of):
        try:
            read(problem)
        except (TypeError, ValueError) as error:
            raise ValueError(f"problem {who}: {error}") from None
    minimum, levels = _minimum(problem, who), _targets(problem, who)
    if minimum is not None and minimum < 0 and getattr(problem, "residuals", None) is not None:
        raise ValueError(f"problem {who}: minimum={minimum:g}: a sum of squared residuals is never below 0")
    for level in levels:
        if minimum is not None and level < minimum:
            raise ValueError(f"problem {who}: the target {level:g} lies below minimum={minimum:g}: no run can reach it")
    for attribute, such in (("unit", "mm"), ("group", "separable")):
        text = extra_of(problem, attribute, "")
        if not isinstance(text, str):
            raise ValueError(f"problem {who}: {attribute}={text!r}: text is needed, such as {such!r}")
    truth = getattr(problem, "truth", None)
    if truth is not None and np.shape(truth) != np.shape(problem.lower):
        raise ValueError(f"problem {who}: truth has shape {np.shape(truth)}, lower {np.shape(problem.lower)}")
    if not isinstance(extra_of(problem, "budgets", {}), Mapping):
        raise ValueError(f"problem {who}: budgets: a mapping from ci and paper to numbers is needed")
    if not callable(extra_of(problem, "merit", dict)):
        raise ValueError(f"problem {who}: merit is no method: merit(x) returns names and numbers")
    check_stochastic(problem, who)


def minimum_of(problem: Any) -> float | None:
    """Return the least value of the problem where it knows it (of a noisy one, without its noise), else None."""
    minimum = getattr(problem, "minimum", None)
    return None if minimum is None else float(minimum)


def unit_of(problem: Any) -> str:
    """Return the unit of the value; '' where the problem does not say."""
    return str(extra_of(problem, "unit", ""))


def _minimum(problem: Any, who: str) -> float | None:
    minimum = getattr(problem, "minimum", None)
    if minimum is None:
        return None
    if not _is_finite(minimum):
        raise ValueError(
            f"problem {who}: minimum={minimum!r:.60}: a finite number is needed, the least value that can be had"
        )
    return float(minimum)


def _targets(problem: Any, who: str) -> list[float]:
    targets = extra_of(problem, "targets", ())
    listed = list(targets) if isinstance(targets, tuple | list | np.ndarray) and np.ndim(targets) == 1 else None
    if listed is None or not all(_is_finite(level) for level in listed):
        raise ValueError(f"problem {who}: targets={targets!r:.60}: a list of finite numbers is needed, such as (1e-8,)")
    return [float(level) for level in listed]


def _is_finite(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and bool(np.isfinite(float(value)))


def _asks(asked: Any, kind: str, dimension: int) -> bool:
    """Tell whether an attribute asks for such a task; an empty list, False, 0 coordinates, or one objective do not."""
    if callable(asked) or isinstance(asked, str):
        return True
    if kind == "n_objectives":
        return bool(asked != 1)
    if kind == "objectives":
        return isinstance(asked, Sized) and len(asked) > 1
    if isinstance(asked, Mapping):
        return bool(asked)
    if isinstance(asked, Sized) and len(asked) != dimension:  # not flags, one a coordinate: which ones, or functions
        return len(asked) > 0
    try:
        return bool(np.any(np.asarray(asked, dtype=float)))
    except (TypeError, ValueError):
        return True


def group_of(problem: Any) -> str:
    """Return the group of its suite that the problem belongs to; '' where it does not say."""
    return str(extra_of(problem, "group", ""))
