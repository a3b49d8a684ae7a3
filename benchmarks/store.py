"""The store with thousands of runs: writing runs, the first collection, one more run, opening, reading. Wall time."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.rounds import COLUMNS
from calibench import bench, optimizers, problems
from calibench.bench.execution.run import Run
from calibench.bench.store.runs import ResultStore

_RUNS = 1000
_ROUNDS = 3


def rows(count: int = _RUNS) -> pd.DataFrame:
    """Return a row for each step: time for a run, over that of writing one."""
    run = bench.execute(problems.make("full12", error="J3"), optimizers.make("de"), budget=20_000, seed=0)
    times: dict[str, list[float]] = {}
    for _ in range(_ROUNDS):
        with tempfile.TemporaryDirectory() as folder:
            for step, ns in _steps(ResultStore(Path(folder) / "study"), run, count):
                times.setdefault(step, []).append(ns)
    name = f"store, {count} runs of {len(run.points)} trace points, wall time a run"
    table = []
    for step, ns in times.items():
        first, middle, third = np.quantile(ns, [0.25, 0.5, 0.75])
        ratio = float(np.median(np.array(ns) / np.array(times["write runs"])))
        table.append((name, step, middle, first, third, ratio, _ROUNDS))
    return pd.DataFrame(table, columns=list(COLUMNS))


def _steps(store: ResultStore, run: Run, count: int) -> list[tuple[str, float]]:
    """Return (step, nanoseconds a run) of one life of a store."""
    store.open()
    runs = [_another(run, i) for i in range(count + 1)]

    def write() -> None:
        for one in runs[:count]:
            store.write(one)

    def one_more() -> None:
        store.write(runs[count])
        store.collect()

    steps: tuple[tuple[str, Callable[[], Any]], ...] = (
        ("write runs", write),
        ("finished, not collected", store.finished),
        ("first collect", store.collect),
        ("finished, collected", store.finished),
        ("collect again, nothing new", store.collect),
        ("one more run, collected", one_more),
        ("read runs", store.runs),
        ("read traces", store.traces),
    )
    return [(name, _time(step) / count) for name, step in steps]


def _another(run: Run, number: int) -> Run:
    return replace(run, record=replace(run.record, run_id=f"{number:016x}", repetition=number))


def _time(step: Callable[[], Any]) -> int:
    before = perf_counter_ns()
    step()
    return perf_counter_ns() - before


if __name__ == "__main__":
    print(rows().to_string(index=False, float_format="{:.3g}".format))
