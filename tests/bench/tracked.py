"""Studies for the tests of the catalogue, of histories and of packs: few runs, made in this process."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path

import pandas as pd

from calibench import bench, optimizers, problems
from calibench.bench.execution.run import Run
from calibench.bench.store.runs import ResultStore

BEGAN = datetime(2026, 11, 1, tzinfo=UTC)


@cache
def run_of(problem: str = "sensor_zero", method: str = "lm", seed: int = 0) -> Run:
    return bench.execute(problems.make(problem), optimizers.make(method), budget=160, seed=seed)


def study(folder: Path, problem: str = "sensor_zero", method: str = "lm", day: int = 0) -> Path:
    """Make a study of one run, begun so many days after the first of November."""
    run = run_of(problem, method)
    row = run.row | {"started_at": BEGAN + timedelta(days=day)}
    ResultStore(folder).fill(pd.DataFrame([row]), run.trace.assign(run_id=row["run_id"]))
    return folder


def version(folder: Path, code: str, values: list[float], day: int) -> Path:
    """Make the study that one version of the code ran: a run a value, of the same cell."""
    run = run_of("sensor_zero", "de")
    rows, traces = [], []
    for k, value in enumerate(values):
        own = {
            "run_id": f"{day:04d}{k:012d}", "repetition": k, "seed": f"{k:016d}", "best_value": value, "chance": True,
            "code_digest": f"{code}.{code}.{code}", "git_commit": code * 4, "started_at": BEGAN + timedelta(days=day),
            "hits": [None] * len(run.row["targets"]), "hits_charged": [None] * len(run.row["targets"]),
        }  # fmt: skip
        rows.append(run.row | own)
        traces.append(run.trace.assign(run_id=own["run_id"]))
    ResultStore(folder).fill(pd.DataFrame(rows), pd.concat(traces))
    return folder
