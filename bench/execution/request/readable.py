"""Read the attributes of a problem or optimiser once before anything runs: each can be read, and is of its kind.

An attribute may be a property, which is foreign code: any exception of it is reported in one line.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.bench.execution.request.own_problem import OPTIONAL
from calibench.bench.gate.frames import text_of
from calibench.problems.base import extra_of

_METHODS = (
    "residuals", "jacobian", "gradient", "value_and_gradient", "batch", "batch_below", "compile", "compile_values",
    "physical", "seeded",
)  # fmt: skip
_OF_A_PROBLEM = (
    "lower", "upper", "start", *OPTIONAL, *_METHODS, "side_effect_free", "data_id", "default_start", "kernel",
    "merit", "name", "noise_free", "options",
)  # fmt: skip
_OF_AN_OPTIMIZER = ("traits", "library", "name", "options", "compile", "minimize")
_TRAITS = ("stochastic", "uses_residuals", "uses_start", "minimum_dimension", "maximum_dimension")


def check_problem_is_readable(problem: Any, who: str) -> None:
    """Raise `ValueError`, one line, where an attribute of `problem` cannot be read, or is of the wrong kind."""
    _read(problem, f"problem {who}", _OF_A_PROBLEM)
    for name in _METHODS:
        if not callable(getattr(problem, name, None) or float):
            raise ValueError(f"problem {who}: {name} is no method")
    _is_text(problem, f"problem {who}", "data_id", "a digest of its data, say")
    kernel = getattr(problem, "kernel", None)
    if kernel is not None and not (isinstance(kernel, tuple) and len(kernel) == 2 and callable(kernel[0])):
        raise ValueError(f"problem {who}: kernel: a function and what it takes beside x, as a pair, are needed")


def check_optimizer_is_readable(optimizer: Any, who: str) -> None:
    """Raise `ValueError` likewise for `optimizer`."""
    _read(optimizer, f"optimizer {who}", _OF_AN_OPTIMIZER)
    _is_text(optimizer, f"optimizer {who}", "library", "the name of a package")
    traits = getattr(optimizer, "traits", None)
    if traits is not None and not all(hasattr(traits, name) for name in _TRAITS):
        raise ValueError(f"optimizer {who}: traits={traits!r:.60}: an optimizers.base.Traits is needed")
    if not callable(extra_of(optimizer, "compile", float)):
        raise ValueError(f"optimizer {who}: compile is no method")


def floats_of(problem: Any, who: str, attribute: str) -> NDArray[np.float64]:
    """Return `lower`, `upper` or `start` as numbers. Raises `ValueError` where it is none."""
    value = getattr(problem, attribute)
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"problem {who}: {attribute}={value!r:.60}: numbers are needed, one a coordinate") from None


def _read(thing: Any, label: str, names: tuple[str, ...]) -> None:
    for name in names:
        try:
            getattr(thing, name, None)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit too
            told = f"{type(error).__name__}: {text_of(error)}"
            raise ValueError(f"{label}: its {name} cannot be read: {told}") from error


def _is_text(thing: Any, label: str, name: str, such_as: str) -> None:
    value = getattr(thing, name, None)
    if value is not None and not isinstance(value, str):
        raise ValueError(f"{label}: {name}={value!r:.60}: text is needed, {such_as}")
