"""Anytime performance: the area over the convergence curve (AOCC) of log10 gap, between bounds that stand beside it.

AOCC = 1 - mean over 1 .. B of (clip(log10 gap, lower, upper) - lower) / (upper - lower): 1 is at the lower bound from
the first evaluation on, 0 never below the upper one. It depends on bounds and budget, so numbers with other ones are
not comparable. The mean is over evaluations (`axis="linear"`) or over their logarithm ("log").

Source: van Stein et al., GECCO 2024 (AOCC); Hansen et al., anytime assessment, 2022.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench.bench.statistics.cells import CELL
from calibench.bench.statistics.fixed_budget.gaps import Curves, curves
from calibench.bench.statistics.summary import QUARTILES, quantiles
from calibench.core.options import shown, suggest

Array = NDArray[np.float64]
BOUNDS = (-8.0, 2.0)  # of log10 gap, as COCO's targets
Axis = Literal["linear", "log"]
COLUMNS = [*CELL, "q1", "median", "q3", "mean", "runs", "lower", "upper", "charged", "axis", "floor"]


def anytime(
    runs: pd.DataFrame,
    traces: pd.DataFrame,
    bounds: tuple[float, float] = BOUNDS,
    axis: Axis = "linear",
    budget: float | None = None,
) -> pd.DataFrame:
    """Return a row for each cell: q1, median, q3 and mean of AOCC over its runs, with what they depend on.

    That is lower, upper, charged, axis and floor. `charged` is the budget over which the mean is taken, the cell's own
    unless `budget` is given. `floor` is the gap that counts as the least, as in `gaps`: where it is above 10^lower, no
    run comes to an AOCC of 1. Raises `ValueError` where the bounds are not in order, and for another axis.
    """
    lower, upper = bounds
    if not lower < upper:
        raise ValueError(f"bounds={bounds}: the lower one must be below the upper")
    if axis not in get_args(Axis):
        raise ValueError(f"axis={shown(axis)}: {suggest(str(axis), get_args(Axis))}")
    rows = []
    for cell in curves(runs, traces):
        own = dict(zip(CELL, cell.key, strict=True))
        whole = float(own["budget"]) if budget is None else float(budget)  # type: ignore[arg-type]
        areas = area(cell, lower, upper, axis, whole)
        q1, median, q3 = quantiles(areas, QUARTILES)
        told = {"q1": q1, "median": median, "q3": q3, "mean": areas.mean(), "runs": len(areas)}
        rows.append(own | told | {"lower": lower, "upper": upper, "charged": whole, "axis": axis, "floor": cell.floor})
    return pd.DataFrame(rows, columns=COLUMNS)


def area(cell: Curves, lower: float, upper: float, axis: Axis, budget: float) -> Array:
    """Return the AOCC of each run of a cell, shape (runs,)."""
    found = np.empty(len(cell.counts))
    ends = np.cumsum(cell.counts)
    for i, (end, count) in enumerate(zip(ends.tolist(), cell.counts.tolist(), strict=True)):
        mine = slice(end - count, end)
        steps = np.append(np.minimum(cell.charged[mine], budget + 1), budget + 1)  # each value counts until the next
        with np.errstate(divide="ignore"):
            height = 1 - (np.clip(np.log10(cell.gap[mine]), lower, upper) - lower) / (upper - lower)
        place = np.log(steps) if axis == "log" else steps
        found[i] = float((height * np.diff(place)).sum()) / (np.log(budget + 1) if axis == "log" else budget)
    return found
