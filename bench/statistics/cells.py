"""A cell: runs that differ only in their repetition. Every statistic is of one cell, never of a mixture.

A problem is its name with its options and data, a method an optimiser with its options; a cell is both under one start,
budget and target. A task is what methods are compared on: a problem under one start, budget and goal. `ByCell` computes
numbers of every cell at once, each from the rows of its own cell alone, to the last bit whatever other cells there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from calibench.bench.store.columns import Array, Columns, Counts, Flags, floats, known, numbered
from calibench.core.words import shortened

if TYPE_CHECKING:
    import pandas as pd

PROBLEM = ["problem", "problem_options", "data_id"]
METHOD = ["optimizer", "optimizer_options"]
SETTING = ["start", "budget", "target"]
CELL = [*PROBLEM, *METHOD, *SETTING]
TASK = [*PROBLEM, "start", "budget", "goal"]  # the goal, not the target: who stops there is compared too


def mixed_code(runs: pd.DataFrame) -> str:
    """Return what is told of cells, and of problems, whose runs are of more than one version of the code; else ''."""
    first = np.unique(numbered(runs[name] for name in (*CELL, "code_digest")), return_index=True)[1]
    some = runs[[*CELL, "code_digest"]].iloc[first]  # a row of each, as a hundred thousand runs have a few
    versions = some.groupby(CELL, dropna=False)["code_digest"].nunique()
    part = some["code_digest"].str.partition(".")[0]
    of_problem = part.groupby([some[name] for name in PROBLEM], dropna=False).nunique()
    others = sorted(set(of_problem.index[of_problem > 1].get_level_values("problem")))
    mixed, said = int((versions > 1).sum()), []
    if mixed:
        said.append(
            f"{mixed} of {len(versions)} cells hold runs of more than one version of the code (column code_digest), "
            "kept with --keep or merged: their medians mix them"
        )
    if others:
        said.append(f"{shortened(', '.join(others))}: not all methods ran on the same version of the problem's code")
    return "; ".join([*said, "the same command with --rerun does them again."]) if said else ""


@final
@dataclass(frozen=True)
class ByCell:
    """Rows by their cell: `order` lists them cell by cell; in it a cell begins at `begins`, and has `count` rows."""

    order: Counts
    begins: Counts
    count: Counts
    first: Counts  # rows of each cell
    last: Counts

    @property
    def number(self) -> Counts:
        """Return the number of each row's cell, shape (rows,), in the order of the rows."""
        number = np.empty(len(self.order), dtype=np.int64)
        number[self.order] = np.repeat(np.arange(len(self.count)), self.count)
        return number

    def rows(self, cell: int) -> Counts:
        """Return the rows of one cell."""
        return self.order[self.begins[cell] : self.begins[cell] + self.count[cell]]

    def over(self, how: np.ufunc, values: Any) -> Any:
        """Return `how` over each cell's values, shape (cells,): of `np.fmin` the least that is not NaN."""
        return how.reduceat(values[self.order], self.begins) if len(self.begins) else values[:0]

    def sums(self, values: Any) -> Counts:
        """Return the sum of whole numbers, or how many are true, in each cell."""
        return np.asarray(self.over(np.add, np.asarray(values).astype(np.int64)))

    def medians(self, values: Array) -> Array:
        """Return the median of each cell's values, those that are NaN left out; NaN of none."""
        known = self.count - self.sums(np.isnan(values))
        ordered = values[self.order]
        ordered = ordered[np.lexsort([ordered, np.repeat(np.arange(len(self.count)), self.count)])]  # NaN last
        low = ordered[self.begins + np.maximum(known - 1, 0) // 2]
        high = ordered[self.begins + np.minimum(known // 2, self.count - 1)]
        with np.errstate(invalid="ignore"):
            between = np.where(known % 2 == 1, low, (low + high) / 2)
        return np.where(known == 0, np.nan, between)


def by_cell(runs: Columns, columns: Sequence[str] = CELL) -> ByCell:
    """Return rows by what they have in `columns`; of two that are NaN it is the same."""
    return by_number(numbered(runs[name] for name in columns))


def by_number(cell: Counts) -> ByCell:
    """Return rows by the numbers of their cells, all from 0 to the largest."""
    order = np.argsort(cell, kind="stable").astype(np.int64)
    begins = np.flatnonzero(np.diff(cell[order], prepend=-1)).astype(np.int64)
    count = np.diff(begins, append=len(order)).astype(np.int64)
    return ByCell(order, begins, count, order[begins], order[begins + count - 1])


def parted(rows: pd.DataFrame, names: pd.Series) -> dict[str, pd.DataFrame]:
    """Return the rows of each name, in the order in which names come; of rows that stand together no copy is made."""
    number, different = names.factorize()
    places = map(by_number(number).rows, range(len(different)))
    return {
        str(name): rows.iloc[slice(at[0], at[-1] + 1) if at[-1] - at[0] == len(at) - 1 else at]
        for name, at in zip(different, places, strict=True)
    }


def answers(runs: Columns) -> Array:
    """Return the value of each run's answer: as it was seen, or where values are noisy as it was judged."""
    seen = floats(runs["best_value"])
    return np.where(judged(runs), floats(runs["judged_value"]), seen) if "judged_value" in runs else seen


def judged(runs: Columns) -> Flags:
    """Tell of which runs the answer was judged apart, because values are noisy."""
    if "judged_value" not in runs:
        return np.zeros(len(runs["best_value"]), dtype=bool)
    return known(runs["judged_evaluations"])
