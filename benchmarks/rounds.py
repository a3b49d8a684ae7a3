"""Interleaved rounds: contestants take turns, so that what the machine does meanwhile hits all of them alike.

A ratio is taken within a round, between neighbours in time, and the median over the rounds is told: on a shared machine
it holds where the nanoseconds do not. The clock is the CPU time of this process.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from time import process_time_ns

import numpy as np
import pandas as pd

Contestant = Callable[[], int]

COLUMNS = ("benchmark", "contestant", "ns_per_evaluation", "ns_q1", "ns_q3", "ratio", "rounds")


def interleave(
    benchmark: str,
    contestants: Mapping[str, Contestant],
    rounds: int = 15,
    least_ms: float = 2.0,
    clock: Callable[[], int] = process_time_ns,
) -> pd.DataFrame:
    """Time `contestants` in turns; return a row for each, with the `COLUMNS`.

    A contestant does its work once and returns the number of evaluations that took. In a round it is called as often as
    fills `least_ms` of CPU time, as found in a first round, which is not counted (it compiles and warms). `ratio` is
    the median over the rounds of its time over that of the first contestant in the same round. `clock` tells ns.
    """
    calls = {name: _calls_that_fill(contestant, least_ms * 1e6, clock) for name, contestant in contestants.items()}
    order = list(contestants)
    times = np.empty((rounds, len(order)))
    collects = gc.isenabled()
    gc.disable()
    try:
        for r in range(rounds):
            for i in np.roll(np.arange(len(order)), r):  # nobody is always the one after the slowest
                times[r, i] = _time(contestants[order[i]], calls[order[i]], clock)
            gc.collect()
    finally:
        if collects:
            gc.enable()
    first, middle, third = np.quantile(times, [0.25, 0.5, 0.75], axis=0)
    ratio = np.median(times / times[:, :1], axis=0)
    rows = [(benchmark, *row, rounds) for row in zip(order, middle, first, third, ratio, strict=True)]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _calls_that_fill(contestant: Contestant, least_ns: float, clock: Callable[[], int]) -> int:
    contestant()
    calls = 1
    while True:
        before = clock()
        for _ in range(calls):
            contestant()
        took = clock() - before
        if took >= least_ns:
            return calls
        calls = max(calls + 1, min(10 * calls, round(1.2 * calls * least_ns / max(took, 1))))


def _time(contestant: Contestant, calls: int, clock: Callable[[], int]) -> float:
    """Return nanoseconds an evaluation."""
    evaluations = 0
    before = clock()
    for _ in range(calls):
        evaluations += contestant()
    return (clock() - before) / evaluations
