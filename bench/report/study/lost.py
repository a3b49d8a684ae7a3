"""Runs that did not end well: who failed reached nothing, who was ended by its time limit keeps what it reached.

`bench.statistics.summary.goal_hits` counts them so. In the tables of a summary `failed` is both together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import pandas as pd

from calibench.bench.statistics.cells import CELL
from calibench.core.counted import counted


@final
@dataclass(frozen=True)
class Lost:
    """How many of some runs failed, and how many were ended by their time limit."""

    failed: int
    late: int

    def told(self, of: int | None = None) -> str:
        """Return both counts in words, `of` so many runs; "" where every run ended well.

        >>> Lost(2, 0).told()
        '2 runs failed and count as not arrived'
        >>> Lost(0, 1).told(of=8)
        '1 of 8 runs was ended by its time limit and keeps what it reached'
        """
        failed = "failed and counts" if self.failed == 1 else "failed and count"
        late = ("was", "its", "keeps", "it") if self.late == 1 else ("were", "their", "keep", "they")
        said = (
            (self.failed, f"{failed} as not arrived"),
            (self.late, "{} ended by {} time limit and {} what {} reached".format(*late)),
        )
        return "; ".join(f"{_runs(n, of)} {what}" for n, what in said if n)


def lost_of(runs: pd.DataFrame) -> Lost:
    """Return how many of the runs failed and how many were late."""
    late = int((runs["status"] == "timeout").sum())
    return Lost(int((runs["status"] != "ok").sum()) - late, late)


def with_late(cells: pd.DataFrame, runs: pd.DataFrame) -> pd.DataFrame:
    """Return the summary of cells with `late`, how many of the `runs` of each were ended by their time limit."""
    ended = runs[runs["status"] == "timeout"]
    if ended.empty:
        return cells.assign(late=0)
    late = ended.groupby(CELL, dropna=False).size().rename("late").reset_index()
    found = cells.merge(late, on=CELL, how="left")
    return found.assign(late=found["late"].fillna(0).astype(int))


def _runs(n: int, of: int | None) -> str:
    return counted(n, "run") if of is None else f"{n} of {counted(of, 'run')}"
