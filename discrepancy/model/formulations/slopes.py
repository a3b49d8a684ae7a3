"""Check the slopes of a formulation that its author wrote as a function: by differences, on a few rows."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibench.core.options import suggest
from calibench.discrepancy.model.machine import Formulation, Numbers
from calibench.discrepancy.model.measured.data import DataError
from calibench.discrepancy.model.roles import inputs_of

_ROWS = 5
_STEP = 1e-6


def check_slopes(formulation: Formulation, words: str) -> None:
    """Raise `DataError` where slopes and central differences disagree on the first rows; `words` name the function.

    It also raises for a function that fails, or that asks for a quantity that nothing states.
    """
    few = formulation.on(formulation.data.rows(np.arange(len(formulation.data)) < _ROWS))
    q: dict[str, Numbers] = {name: np.asarray(value) for name, value in few.fixed.items()}
    q |= {p.name: np.asarray(p.start) for p in few.parameters}
    q |= {name: np.asarray(few.data[name], dtype=float) for name in (*inputs_of(few), *few.readings)}
    way_out = "write it with analytic functions: no abs, norm, hypot, arctan2 or comparison of quantities"
    try:
        size = max(1.0, float(np.max(np.abs(few.constraints(q)))))
    except DataError:
        raise
    except KeyError as error:
        raise DataError(_asked(words, str(error.args[0]), formulation, q)) from error
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(at.filename).name}, line {at.lineno}"
        compares = "; it is given all readings at once: no if, and no comparison" if "truth value" in str(error) else ""
        told = f"{words} failed at the start values: {type(error).__name__}: {error} ({where})"
        raise DataError(f"{told}{compares}") from error
    try:
        slopes = few.slopes(q)
    except TypeError as error:
        raise DataError(f"{words} takes no complex numbers ({error}); {way_out}") from None
    for name, value in q.items():
        h = _STEP * max(1.0, float(np.max(np.abs(value))))
        difference = (few.constraints({**q, name: value + h}) - few.constraints({**q, name: value - h})) / (2 * h)
        wide = 1e-4 * (np.abs(slopes[name]) + np.abs(difference)) + 1e-9 * size / h
        if (np.abs(slopes[name] - difference) > wide).any():
            raise DataError(f"{words}: its slope in {name} by complex step is not its difference; {way_out}")


def _asked(words: str, name: str, formulation: Formulation, q: Mapping[str, Numbers]) -> str:
    """Return a sentence on a function that asks for `name`, which is not among the quantities `q`."""
    if name in formulation.data:
        way_out = "state the column with its standard deviation, or in inputs= where it carries no noise"
    else:
        way_out = f"no column of the file, no parameter and no held number is called so; {suggest(name, q)}"
    return f"{words} asks for {name!r}: {way_out}"
