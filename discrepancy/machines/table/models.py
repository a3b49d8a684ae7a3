"""The base models that a table knows by name: plain functions of columns, the parameters with their starts as defaults.

An argument without a default is a column, one with a default is a parameter. The regressions of NIST that ship are
here under NIST's names; of Nelson the measured column is the logarithm, for so NIST fits it.
"""

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

from calibench.core.registry import Registry
from calibench.problems.suites.nist.models import MODELS
from calibench.problems.suites.nist.regression import table

Function = Callable[..., Any]
models: Registry[Any] = Registry("model", "calibench.table_models")


_FORMULAS: dict[str, tuple[str, Function]] = {
    "constant": ("y = b0.", lambda b0=0.0: b0),
    "line": ("y = b0 + b1 x.", lambda x, b0=0.0, b1=0.0: b0 + b1 * x),
    "parabola": ("y = b0 + b1 x + b2 x^2.", lambda x, b0=0.0, b1=0.0, b2=0.0: b0 + x * (b1 + x * b2)),
    "cubic": (
        "y = b0 + b1 x + b2 x^2 + b3 x^3.",
        lambda x, b0=0.0, b1=0.0, b2=0.0, b3=0.0: b0 + x * (b1 + x * (b2 + x * b3)),
    ),
    "exponential": ("y = b0 + b1 exp(b2 x).", lambda x, b0=0.0, b1=1.0, b2=-0.1: b0 + b1 * np.exp(b2 * x)),
    "power_law": ("y = b1 x^b2.", lambda x, b1=1.0, b2=1.0: b1 * x**b2),
    "linear": (
        "y = b0 + b1 x1 + b2 x2 + ..., a weight for each column of inputs=.",
        lambda *columns, **weights: (
            weights["b0"] + sum(weights[f"b{k}"] * column for k, column in enumerate(columns, start=1))
        ),
    ),
}


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


for _name, (_words, _function) in _FORMULAS.items():
    _function.__doc__, _function.__name__ = _words, _name
    models.register(_name)(_function)
for _name in MODELS:
    models.register(_name)(_of_nist(_name))
