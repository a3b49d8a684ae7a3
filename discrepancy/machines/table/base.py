"""`Base`: a function whose signature separates columns from parameters, in the form that a `Predicted` needs."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from calibench.core.counted import counted
from calibench.core.options import shown, suggest
from calibench.discrepancy.machines.table.models import Function
from calibench.discrepancy.model.machine import Numbers, Quantities
from calibench.discrepancy.model.measured.data import DataError


@final
@dataclass(frozen=True, eq=False)
class Base:
    """`function` of `columns` (names in the data, in the order of its arguments) with parameters from `starts`."""

    name: str
    function: Function
    columns: tuple[str, ...]
    starts: Mapping[str, float]
    rows: str = ""

    def __call__(self, q: Quantities) -> Numbers:
        """Return the prediction, (n,); a number that is the same in all rows is repeated as `rows` has them."""
        told = np.asarray(self.function(*(q[c] for c in self.columns), **{p: q[p] for p in self.starts}))
        return np.broadcast_to(told, np.shape(q[self.rows])) if not told.ndim else told


def base_of(name: str, function: Function, given: tuple[str, ...], start: Mapping[str, Any], rows: str) -> Base:
    """Return the base model; `given` are the columns for its arguments, in order, where these have other names.

    `rows` is the measured column. Raises `DataError` where arguments and columns do not fit, or a start is not a
    number.
    """
    columns: list[str] = []
    starts: dict[str, Any] = {}
    for argument in inspect.signature(function).parameters.values():
        if argument.kind is argument.VAR_POSITIONAL:  # a weight for each column
            columns, starts = [*given], {f"b{k}": 0.0 for k in range(len(given) + 1)}
        elif argument.kind is argument.VAR_KEYWORD:
            continue
        elif argument.default is argument.empty:
            columns.append(argument.name)
        else:
            starts[argument.name] = argument.default
    if given and len(given) != len(columns):
        raise DataError(
            f"machine.inputs={','.join(given)}: {name} is a function of {counted(len(columns), 'column')}"
            f"{': ' * bool(columns)}{', '.join(columns)}; name as many, in this order"
        )
    if not starts:
        raise DataError(f"{name}: nothing to fit; give the parameters their starts as defaults, such as b1=0.0")
    for key, value in start.items():
        if key not in starts:
            raise DataError(f"machine.start: {name} has no parameter {key!r}; {suggest(key, starts)}")
        starts[key] = value
    for key, value in starts.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise DataError(f"{name}: {key} starts at {shown(value)}: a finite number is needed")
    return Base(name, function, given or tuple(columns), {k: float(v) for k, v in starts.items()}, rows)
