"""Fixed budget: how good a method is after so many evaluations (`gaps`), and during the run (`anytime`).

The gap of a run at a budget is its best value among the points of the trace that were charged no more, less the
`references` of its problem. A trace is thinned, so a value may be up to a tenth too high between its points; never too
low. A run that has ended keeps its last value; before its first point it has none, and its gap is infinite. The least
gap is a floor: the problem's last target, below which values are tied, or else a rounding of the reference.

AOCC, the area over the convergence curve, is 1 - mean over 1 .. B of (clip(log10 gap, lower, upper) - lower) / (upper -
lower): 1 is at the lower bound from the first evaluation on, 0 never below the upper one. It depends on bounds and
budget, so numbers with other ones are not comparable. The mean is over evaluations (`axis="linear"`) or over their
logarithm ("log").

Source: van Stein et al., GECCO 2024 (AOCC); Hansen et al., anytime assessment, 2022.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, final, get_args

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from calibench.bench.statistics.cells import CELL, PROBLEM, judged
from calibench.bench.statistics.summary import QUARTILES, goal, quantiles
from calibench.bench.statistics.targets import references
from calibench.bench.store.arrays import index_in
from calibench.core.options import shown, suggest

Array = NDArray[np.float64]
BOUNDS = (-8.0, 2.0)  # of log10 gap, as COCO's targets
Axis = Literal["linear", "log"]
ANYTIME_COLUMNS = [*CELL, "q1", "median", "q3", "mean", "runs", "lower", "upper", "charged", "axis", "floor"]
COLUMNS = [*CELL, "charged", "q1", "median", "q3", "runs", "reference", "floor"]
_SMALLEST = float(np.spacing(0.0))


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
        named = dict(zip(CELL, cell.key, strict=True))
        whole = float(named["budget"]) if budget is None else float(budget)  # type: ignore[arg-type]
        areas = area(cell, lower, upper, axis, whole)
        q1, median, q3 = quantiles(areas, QUARTILES)
        named |= {"q1": q1, "median": median, "q3": q3, "mean": areas.mean(), "runs": len(areas)}
        rows.append(named | {"lower": lower, "upper": upper, "charged": whole, "axis": axis, "floor": cell.floor})
    return pd.DataFrame(rows, columns=ANYTIME_COLUMNS)


def area(cell: Curves, lower: float, upper: float, axis: Axis, budget: float) -> Array:
    """Return the AOCC of each run of a cell, shape (runs,)."""
    areas = np.empty(len(cell.counts))
    ends = np.cumsum(cell.counts)
    for i, (end, count) in enumerate(zip(ends.tolist(), cell.counts.tolist(), strict=True)):
        mine = slice(end - count, end)
        steps = np.append(np.minimum(cell.charged[mine], budget + 1), budget + 1)  # each value counts until the next
        with np.errstate(divide="ignore"):
            height = 1 - (np.clip(np.log10(cell.gap[mine]), lower, upper) - lower) / (upper - lower)
        place = np.log(steps) if axis == "log" else steps
        areas[i] = float((height * np.diff(place)).sum()) / (np.log(budget + 1) if axis == "log" else budget)
    return areas


@final
@dataclass(frozen=True)
class Curves:
    """The runs of one cell as steps: `gap`, shape (points,), holds from `charged`, shape (points,), on.

    The points of a run stand together; `counts`, shape (runs,), says how many it has.
    """

    key: tuple[object, ...]
    charged: Array
    gap: Array
    counts: NDArray[np.int64]
    reference: float
    floor: float

    def at(self, budgets: Array) -> Array:
        """Return the gap of each run after each of `budgets`, shape (runs, budgets); infinite before it has one."""
        gaps = np.full((len(self.counts), len(budgets)), np.inf)
        ends = np.cumsum(self.counts)
        for i, (end, count) in enumerate(zip(ends.tolist(), self.counts.tolist(), strict=True)):
            mine = slice(end - count, end)
            place = np.searchsorted(self.charged[mine], budgets, side="right") - 1
            gaps[i, place >= 0] = self.gap[mine][place[place >= 0]]
        return gaps


def gaps(runs: pd.DataFrame, traces: pd.DataFrame, budgets: Sequence[float] | None = None) -> pd.DataFrame:
    """Return median and quartiles (q1, median, q3) of log10 gap at each of `budgets`, a row for each cell and budget.

    Columns: those of a cell, charged (the budget), q1, median, q3, runs, reference, floor. Without `budgets` they are
    10 values a decade up to the budget of the cell. Quantiles are over all runs (type 7); infinite where a run beside
    the place has no value yet.
    """
    tables = []
    for cell in curves(runs, traces):
        named = dict(zip(CELL, cell.key, strict=True))
        at = np.asarray(log_spaced(float(named["budget"])) if budgets is None else budgets, dtype=float)  # type: ignore[arg-type]
        low, middle, high = quantiles(np.log10(cell.at(at)), QUARTILES)
        tables.append(
            pd.DataFrame(
                named
                | {"charged": at, "q1": low, "median": middle, "q3": high, "runs": len(cell.counts)}
                | {"reference": cell.reference, "floor": cell.floor}
            )
        )
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=COLUMNS)


def log_spaced(budget: float, each_decade: int = 10) -> Array:
    """Return budgets from 1 to `budget`, so many a decade, the last included, shape (n,).

    >>> log_spaced(30.0, 2).round(2).tolist()
    [1.0, 3.16, 10.0, 30.0]
    """
    steps = np.arange(int(np.ceil(np.log10(max(budget, 1.0)) * each_decade - 1e-9)))
    return np.append(10 ** (steps / each_decade), budget)


def curves(runs: pd.DataFrame, traces: pd.DataFrame) -> Iterator[Curves]:
    """Yield the runs of each cell as `Curves`.

    Cells of problems without any finite value are left out, and those of noisy values: the lowest value seen is lucky,
    and only the answer is judged.
    """
    rows = runs.reset_index(drop=True)
    least = {tuple(row[:3]): float(row[3]) for row in references(rows).itertuples(index=False)}
    place = index_in(pa.array(traces["run_id"], pa.string()), pa.array(rows["run_id"], pa.string())).to_numpy(
        zero_copy_only=False
    )
    known = ~np.isnan(place.astype(float))
    row = place[known].astype(np.int64)
    order = np.argsort(row, kind="stable")
    charged = traces["charged"].to_numpy(dtype=float)[known][order]
    values = traces["best_value"].to_numpy(dtype=float)[known][order]
    counts = np.bincount(row, minlength=len(rows))
    first = np.cumsum(counts) - counts
    for key, mine in rows.groupby(CELL, sort=False, dropna=False):
        reference = least[tuple(key[: len(PROBLEM)])]
        if reference != reference or judged(mine).any():
            continue
        at = mine.index.to_numpy()
        where = np.concatenate([np.arange(first[i], first[i] + counts[i]) for i in at])
        # the gap below which gaps are tied, above 0: its logarithm is taken
        level = goal(mine["target"].iloc[0], list(mine["targets"].iloc[0]))
        floor = max(level - reference if level == level else 0.0, float(np.spacing(abs(reference))) / 2, _SMALLEST)
        gap = np.where(np.isnan(values[where]), np.inf, np.maximum(values[where] - reference, floor))
        yield Curves(tuple(key), charged[where], gap, counts[at], reference, floor)
