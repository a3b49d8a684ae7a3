"""The base models that a table knows by name: plain functions of columns, the parameters with their starts as defaults.

An argument without a default is a column, one with a default is a parameter. The regressions of NIST that ship are
here under NIST's names; of Nelson the measured column is the logarithm, for so NIST fits it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

from calibench.core.registry import Registry
from calibench.problems.suites.nist.models import MODELS
from calibench.problems.suites.nist.regression import table

Function = Callable[..., Any]
models: Registry[Any] = Registry("model", "calibench.table_models")


@models.register("constant")
def constant(b0: float = 0.0) -> Any:
    """y = b0."""
    return b0


@models.register("line")
def line(x: Any, b0: float = 0.0, b1: float = 0.0) -> Any:
    """y = b0 + b1 x."""
    return b0 + b1 * x


@models.register("parabola")
def parabola(x: Any, b0: float = 0.0, b1: float = 0.0, b2: float = 0.0) -> Any:
    """y = b0 + b1 x + b2 x^2."""
    return b0 + x * (b1 + x * b2)


@models.register("cubic")
def cubic(x: Any, b0: float = 0.0, b1: float = 0.0, b2: float = 0.0, b3: float = 0.0) -> Any:
    """y = b0 + b1 x + b2 x^2 + b3 x^3."""
    return b0 + x * (b1 + x * (b2 + x * b3))


@models.register("exponential")
def exponential(x: Any, b0: float = 0.0, b1: float = 1.0, b2: float = -0.1) -> Any:
    """y = b0 + b1 exp(b2 x)."""
    return b0 + b1 * np.exp(b2 * x)


@models.register("power_law")
def power_law(x: Any, b1: float = 1.0, b2: float = 1.0) -> Any:
    """y = b1 x^b2."""
    return b1 * x**b2


@models.register("linear")
def linear(*columns: Any, **weights: Any) -> Any:
    """y = b0 + b1 x1 + b2 x2 + ..., a weight for each column of inputs=."""
    return weights["b0"] + sum(weights[f"b{k}"] * column for k, column in enumerate(columns, start=1))


def _of_nist(name: str) -> Function:
    """Return one of NIST's regressions as a function of columns, from NIST's second start."""
    printed, model = table(name), MODELS[name]
    count = len(printed.x)
    columns = ("x",) if count == 1 else tuple(f"x{k + 1}" for k in range(count))

    def function(*given: Any, **b: Any) -> Any:
        values = dict(zip(columns, given)) | b
        return model.value([values[p] for p in printed.names], [values[c] for c in columns])  # type: ignore[arg-type]

    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    function.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(c, kind) for c in columns]
        + [inspect.Parameter(p, kind, default=float(s)) for p, s in zip(printed.names, printed.starts[1])]
    )
    function.__doc__ = f"NIST's {name}: {' '.join(printed.model.split())}"
    return function


for _name in MODELS:
    models.register(_name)(_of_nist(_name))
