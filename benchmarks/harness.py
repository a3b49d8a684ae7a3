"""What it costs to be counted: our gate, in nanoseconds an evaluation.

The objective is trivial. It is compared with the same call without the gate, alone and in batches; "overhead" is the
difference of the medians. Other tools stand on the page of peers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

import numpy as np
import pandas as pd

from benchmarks.rounds import COLUMNS, Contestant, interleave
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.face import doors_of, face_of
from calibench.optimizers.base import Array, Objective

_CALLS = 1000
_DIMENSION = 10
_ENDLESS = 10**12


def rows() -> pd.DataFrame:
    """Return rows of the bare call, the call through the gate, and the overhead."""
    points = np.random.default_rng(0).uniform(-5, 5, (_CALLS, _DIMENSION))
    tables = [_compare("gate", lambda x: _first(x), _gate(_Trivial()), points), _batches(points)]
    return pd.concat(tables, ignore_index=True)


def _gate(problem: Any) -> Objective:
    """Return what an optimiser gets."""
    gate = Evaluator(problem, _ENDLESS)
    return face_of(gate, doors_of(gate))


def _first(x: Any) -> float:
    return float(x[0])


@final
class _Trivial:
    """The first coordinate."""

    side_effect_free = True  # it keeps nothing and changes nothing

    def __init__(self) -> None:
        self.lower, self.upper = np.full(_DIMENSION, -5.0), np.full(_DIMENSION, 5.0)
        self.start = np.zeros(_DIMENSION)

    def __call__(self, x: Array) -> float:
        return float(x[0])

    def batch(self, points: Array) -> Array:
        return points[:, 0].copy()


def _compare(name: str, bare: Callable[[Any], Any], harnessed: Callable[[Any], Any], points: Array) -> pd.DataFrame:
    table = interleave(f"harness: {name}", {"bare": _calls(bare, points), "harnessed": _calls(harnessed, points)})
    overhead = table["ns_per_evaluation"].iloc[1] - table["ns_per_evaluation"].iloc[0]
    return pd.concat([table, _told(f"harness: {name}", "overhead", overhead, int(table["rounds"].iloc[0]))])


def _calls(function: Callable[[Any], Any], points: Array) -> Contestant:
    given = list(points)

    def work() -> int:
        for x in given:
            function(x)
        return len(given)

    return work


def _batches(points: Array) -> pd.DataFrame:
    """Return the gate's rows for batches of a hundred."""
    problem, hundred = _Trivial(), points[:100]
    gate = _gate(problem)

    def through(function: Callable[[Array], Array]) -> Contestant:
        def work() -> int:
            for _ in range(20):
                function(hundred)
            return 20 * len(hundred)

        return work

    name = "harness: gate, batches of 100"
    table = interleave(name, {"bare": through(problem.batch), "harnessed": through(gate.batch)})
    overhead = table["ns_per_evaluation"].iloc[1] - table["ns_per_evaluation"].iloc[0]
    return pd.concat([table, _told(name, "overhead", overhead, int(table["rounds"].iloc[0]))])


def _told(benchmark: str, contestant: str, ns: float, rounds: int) -> pd.DataFrame:
    nan = float("nan")
    return pd.DataFrame([(benchmark, contestant, ns, nan, nan, nan, rounds)], columns=list(COLUMNS))


if __name__ == "__main__":
    print(rows().to_string(index=False, float_format="{:.3g}".format))
