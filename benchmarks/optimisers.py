"""Our optimisers on one compiled objective (full12, J3, 50 readings), against its bare kernel.

An evaluation is a candidate, not a call; gate, budget, best and trace are included. The libraries' are measured with
the peers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, final

import numpy as np
import pandas as pd

from benchmarks.rounds import Contestant, interleave
from calibench import optimizers, problems
from calibench.bench.gate.evaluator import Evaluator
from calibench.optimizers.base import Array, Stop

_BUDGET = 500_000  # the first thousand generations, which redraw more, are a small part of a run
_N = {"de": 150, "pso": 100, "ga": 100}
_EARLY = {"de": "de early_abandon", "pso": "pso early_abandon"}
_SEEDS = iter(range(10**9))  # a new search each time: a start that is easy for one shows in no median


def rows() -> pd.DataFrame:
    """Return a row for each method."""
    problem = problems.make("full12", error="J3")
    problem.compile()
    tables = []
    for name, size in _N.items():
        optimizers.make(name).compile()
        own: dict[str, Contestant] = {name: partial(_own, problem, name, {})}
        if name in _EARLY:
            own[_EARLY[name]] = partial(_own, problem, name, {"early_abandon": True})
        tables.append(interleave(f"{name}, N={size}, against its kernel", {"kernel": _kernel(problem, size)} | own))
    return pd.concat(tables, ignore_index=True)


def _kernel(problem: Any, size: int) -> Contestant:
    """Return the bare compiled kernel on a population like those it meets half way in a search."""
    kernel, arguments = problem._compiled.kernels.batch, problem._compiled.constants
    points = _half_way(problem, size)

    def work() -> int:
        kernel(points, *arguments)
        return size

    return work


def _half_way(problem: Any, size: int) -> Array:
    seen: list[Array] = []
    watched = _Counted(problem, seen.append)
    with suppress(Stop):
        optimizers.make("de", population=max(size, 4)).minimize(Evaluator(watched, 50_000), np.random.default_rng(0))
    return np.array(seen[-2])


def _own(problem: Any, name: str, options: Mapping[str, Any]) -> int:
    gate = Evaluator(problem, _BUDGET)
    with suppress(Stop):
        optimizers.make(name, **options).minimize(gate, np.random.default_rng(next(_SEEDS)))
    return gate.evaluations


@final
class _Counted:
    """A problem that tells of each batch."""

    side_effect_free = True

    def __init__(self, problem: Any, tell: Callable[[Array], object]) -> None:
        self.lower, self.upper, self.start = problem.lower, problem.upper, problem.start
        self._problem, self._tell = problem, tell

    def __call__(self, x: Array) -> float:
        return float(self._problem(x))

    def batch(self, points: Array) -> Array:
        self._tell(points)
        return np.asarray(self._problem.batch(points))


if __name__ == "__main__":
    print(rows().to_string(index=False, float_format="{:.3g}".format))
