"""What the gate costs: the same array through the bare kernel, through the problem, and through the gate.

Asked as an optimiser asks it: best, trace and the look for what is not finite are on. Whether a point is in the box is
looked at of a user's optimiser, and where its trait says that it is not bounded.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.rounds import COLUMNS, Contestant, interleave
from calibench import problems
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.face import Doors, doors_of, face_of, watched_doors_of
from calibench.optimizers.base import Objective
from calibench.problems.base import Array

_CALLS = 100
_BATCH = 100


def rows() -> pd.DataFrame:
    """Return the rows of single calls and of batches, each with the difference that the gate makes."""
    problem = problems.make("full12", error="J3")
    problem.compile()
    gate, watched = (_seen(problem, doors) for doors in (doors_of, watched_doors_of))
    kernel, fixed = problem.kernel
    x = problem.start.copy()
    single = interleave(
        "one call, full12 J3",
        {
            "kernel": _kernel(kernel, x, fixed),
            "problem": _single(problem, x),
            "gate": _single(gate, x),
            "gate, box looked at": _single(watched, x),
        },
        rounds=41,
    )
    points = np.repeat(x[None], _BATCH, axis=0)
    many = interleave(
        f"a candidate in a batch of {_BATCH}, full12 J3",
        {
            "kernel": _kernel(problem._compiled.kernels.batch, points, fixed),
            "problem": _single(problem.batch, points),
            "gate": _single(gate.batch, points),
            "gate, box looked at": _single(watched.batch, points),
        },
        rounds=41,
    )
    plain = _Plain()
    classes = interleave(
        "one call, a plain class of five parameters",
        {
            "problem": _single(plain, plain.truth),
            "gate": _single(_seen(plain, doors_of), plain.truth),
            "gate, box looked at": _single(_seen(plain, watched_doors_of), plain.truth),
        },
        rounds=41,
    )
    tables = [
        single, _less(single, "kernel"), _less(single, "problem"), many, _less(many, "kernel"), classes,
        _less(classes, "problem"),
    ]  # fmt: skip
    return pd.concat(tables, ignore_index=True)


class _Plain:
    lower, upper, start = np.full(5, -2.0), np.full(5, 2.0), np.zeros(5)
    truth = np.ones(5)

    def __call__(self, x: Array) -> float:
        return float(np.sum(100 * (x[1:] - x[:-1] ** 2) ** 2 + (1 - x[:-1]) ** 2))


def _seen(problem: Any, doors: Callable[[Evaluator], Doors]) -> Objective:
    """Return what an optimiser gets, of a gate that has seen the best point."""
    gate = Evaluator(problem, budget=10**15)
    gate(problem.truth)
    return face_of(gate, doors(gate))


def _kernel(kernel: Any, x: Array, fixed: Array) -> Contestant:
    count = _CALLS * (len(x) if x.ndim > 1 else 1)

    def work() -> int:
        for _ in range(_CALLS):
            kernel(x, fixed)
        return count

    return work


def _single(call: Callable[[Array], Any], x: Array) -> Contestant:
    count = _CALLS * (len(x) if x.ndim > 1 else 1)

    def work() -> int:
        for _ in range(_CALLS):
            call(x)
        return count

    return work


def _less(table: pd.DataFrame, without: str) -> pd.DataFrame:
    """Return the row of the gate less another, both medians."""
    times = table.set_index("contestant")["ns_per_evaluation"]
    title, rounds = table.loc[0, ["benchmark", "rounds"]]
    gap = times["gate"] - times[without]
    return pd.DataFrame([(title, f"gate less {without}", gap, np.nan, np.nan, np.nan, rounds)], columns=list(COLUMNS))
