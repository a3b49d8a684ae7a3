"""What a run had reached at which cost: each improvement that is known, from its trace and the hits of its targets.

A trace keeps every improvement among the first 64 evaluations; later only those of a tenth and the value at sixteen
counts a decade. The evaluation at which a target of the run was reached is exact all the same: its row says so. So a
course is exact at every target that the run had. At another level it is at most one mark late: 10 ** (1/16), 15.5 %.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray


class Improvement(NamedTuple):
    """A better value: the charged evaluations at which it is known, the value, and the lowest target reached just then.

    Where the trace has no point the value is that target: no more is known of it than that it was reached.
    """

    charged: int
    value: float
    reached: float | None


def traces_by_run(traces: pd.DataFrame) -> dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Return for each run the charged evaluations and best values of its trace, in their order."""
    ids = traces["run_id"].to_numpy()
    charged, values = traces["charged"].to_numpy(np.int64), traces["best_value"].to_numpy(float)
    begins = np.flatnonzero(np.r_[True, ids[1:] != ids[:-1]]) if len(ids) else np.empty(0, int)
    ends = np.r_[begins[1:], len(ids)]
    return {str(ids[b]): (charged[b:e], values[b:e]) for b, e in zip(begins, ends, strict=True)}


def course_of(run: Mapping[str, Any], trace: tuple[NDArray[np.int64], NDArray[np.float64]] | None) -> list[Improvement]:
    """Return the improvements of `run`, a row of ``runs.parquet``, ever better and ever later; [] of a run without one.

    Where values are noisy a target is reached by the judged answer, not by a value that was seen: hits are left out.
    """
    known: dict[int, float] = {}
    for charged, value in zip(*(column.tolist() for column in trace), strict=True) if trace is not None else ():
        known[charged] = min(value, known.get(charged, inf))
    if run["best_evaluation"] and run["charged"] == run["evaluations"]:  # without Jacobians its cost is known too
        at = int(run["best_evaluation"])
        known[at] = min(float(run["best_value"]), known.get(at, inf))
    hits = {} if _is_noisy(run) else _lowest_hits(run)
    course: list[Improvement] = []
    best = inf
    for charged in sorted(known.keys() | hits.keys()):
        level = hits.get(charged)
        value = min(known.get(charged, inf), inf if level is None else level)
        if value < best and isfinite(value):
            course.append(Improvement(charged, value, level))
            best = value
    return course


def _lowest_hits(run: Mapping[str, Any]) -> dict[int, float]:
    """Return the lowest target that was reached at each charged evaluation which reached one."""
    hits: dict[int, float] = {}
    for level, hit in zip(run["targets"], run["hits_charged"], strict=True):
        if hit is not None and hit == hit:
            hits[int(hit)] = min(float(level), hits.get(int(hit), inf))
    return hits


def _is_noisy(run: Mapping[str, Any]) -> bool:
    judged = run["judged_evaluations"]
    return judged is not None and judged == judged
