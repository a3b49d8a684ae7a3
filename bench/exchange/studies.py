"""The study that is to be written elsewhere: its rows, their courses, and one name for each algorithm.

Elsewhere an algorithm is a name, and all its runs on a problem are repetitions. So what our cells tell apart on one
problem (start, budget, target) goes into the name; a budget that differs from problem to problem does not.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import pandas as pd

from calibench.bench.exchange.course import Improvement, course_of, traces_by_run
from calibench.bench.statistics.cells import METHOD, PROBLEM
from calibench.bench.statistics.names.labels import setting_text, several
from calibench.bench.statistics.summary import method_names
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore


@final
@dataclass(frozen=True)
class Study:
    """The finished runs of a study as they are stored: `runs` and `traces` as `ResultStore` returns them."""

    store: ResultStore
    runs: pd.DataFrame
    traces: pd.DataFrame


@final
@dataclass(frozen=True)
class ToldRun:
    """A run as other formats tell it: its row, the name of its algorithm, its problem's options, its improvements.

    A failed run reached nothing, whatever it passed, and is charged all the same: it has no improvements.
    """

    row: Mapping[str, Any]
    algorithm: str
    options: Mapping[str, Any]
    course: list[Improvement]

    @property
    def minimum(self) -> float | None:
        """Return the least value that the problem declares; None where it declares none."""
        found = self.row["minimum"]
        return None if found is None or found != found else float(found)


def read_study(folder: str | Path) -> Study:
    """Return the study in `folder`. Raises `StoreError` where it is none of ours, or has no finished run."""
    store = ResultStore(folder)
    store.manifest()
    runs = store.runs()
    if runs.empty:
        raise StoreError(f"{folder}: no run is finished; there is nothing to write")
    return Study(store, runs, store.traces())


def told_runs(study: Study) -> list[ToldRun]:
    """Return the runs of a study as other formats tell them, in the order of its table."""
    names = algorithm_names(study.runs)
    traces = traces_by_run(study.traces)
    wanted = [*METHOD, *PROBLEM, *_COLUMNS]
    rows = records(study.runs[wanted])
    options: dict[str, Mapping[str, Any]] = {text: json.loads(text) for text in study.runs["problem_options"].unique()}
    return [
        ToldRun(
            row,
            name,
            options[row["problem_options"]],
            course_of(row, traces.get(row["run_id"])) if row["status"] != "failed" else [],
        )
        for row, name in zip(rows, names, strict=True)
    ]


_COLUMNS = [
    "run_id", "dimension", "repetition", "start", "budget", "target", "evaluations", "charged", "restarts", "status",
    "best_value", "best_evaluation", "best_x", "targets", "hits_charged", "unit", "minimum", "judged_evaluations",
    "library", "library_version", "jacobian_evaluations",
]  # fmt: skip


def records(runs: pd.DataFrame) -> list[dict[str, Any]]:
    """Return rows as mappings from the names of their columns."""
    return [{str(name): value for name, value in row.items()} for row in runs.to_dict("records")]


def algorithm_names(runs: pd.DataFrame) -> pd.Series:
    """Return what each row's algorithm is called: its method, and what else differs between its runs on one problem."""
    names = method_names(runs)
    for _, mine in runs.groupby(METHOD, sort=False):
        told = sorted({column for _, same in mine.groupby(PROBLEM, sort=False) for column in several(same)})
        for key, same in mine.groupby(told, dropna=False) if told else ():
            said = [setting_text(column, value) for column, value in zip(told, key, strict=True)]
            names.loc[same.index] = [", ".join([name, *said]) for name in names.loc[same.index]]
    return names
