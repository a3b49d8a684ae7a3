"""Carry out a request: skip what is done, run the rest in one process or several, write each run as it ends.

A run knows nothing of the others and its seeds come from its names, so the rows are the same in any order and with any
number of workers.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

from bench.request import Request
from bench.request_values import RequestError
from bench.run import Spec
from bench.store import ResultStore

_FOR_EVER = 1e9  # seconds: a time limit that only asks for a process of its own
Report = Callable[[int, int, str], None]  # done, of, what has just ended


@final
@dataclass(frozen=True)
class Outcome:
    """What a sweep did: ids asked for, those skipped as done, and parts that were set aside as damaged."""

    asked: tuple[str, ...]
    skipped: int
    aside: tuple[Path, ...]


def carry_out(request: Request, report: Report, retry_failed: bool = False) -> Outcome:
    """Run what is not done yet and collect the tables. Raises `RequestError`, `StoreError` before anything runs."""
    workers = _workers(request.execution)
    store = ResultStore(request.folder)
    store.open()
    aside = store.collect() if store.damaged() else []
    if retry_failed:
        runs = store.runs()
        store.forget(set(runs.loc[runs["status"] != "ok", "run_id"]) & set(request.specs))
    done = store.finished()
    store.plan(request.labels)
    left = {run_id: spec for run_id, spec in request.specs.items() if run_id not in done}
    report(0, len(left), "")
    try:
        for count, run_id in enumerate(_run_all(left, store.folder, workers), start=1):
            report(count, len(left), request.labels[run_id])
    finally:
        aside += store.collect()
    return Outcome(tuple(request.specs), len(request.specs) - len(left), tuple(aside))


def _workers(execution: Mapping[str, Any]) -> int:
    unknown = set(execution) - {"name", "n_jobs"}
    if unknown:
        raise RequestError(f"execution.{min(unknown)}: unknown; choices: n_jobs")
    n_jobs = execution.get("n_jobs", 1)
    if isinstance(n_jobs, bool) or not isinstance(n_jobs, int) or n_jobs == 0 or n_jobs < -1:
        raise RequestError(f"execution.n_jobs={n_jobs}: a number of processes, or -1 for one a core, is needed")
    return os.cpu_count() or 1 if n_jobs == -1 else n_jobs


def _run_all(specs: Mapping[str, Spec], folder: Path, workers: int) -> Iterator[str]:
    """Yield the id of each run as it is written."""
    if workers == 1 or len(specs) < 2:
        for spec in specs.values():
            yield _run_one(spec, folder, sys.path)
        return
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    jobs = (delayed(_run_one)(spec, folder.resolve(), sys.path) for spec in specs.values())
    try:
        yield from Parallel(n_jobs=workers, backend="loky", return_as="generator_unordered")(jobs)
    except TerminatedWorkerError:  # some run took its process down: each that is left gets a process of its own
        done = ResultStore(folder).finished()
        for run_id, spec in specs.items():
            if run_id not in done:
                yield _run_one(replace(spec, time_limit=spec.time_limit or _FOR_EVER), folder, sys.path)


def _run_one(spec: Spec, folder: Path, path: Sequence[str]) -> str:
    """Execute a run where it stands, write its part, return its id. `path` lets a worker import the user's classes."""
    sys.path[:] = list(dict.fromkeys([*sys.path, *path]))
    run = spec.execute()
    ResultStore(folder).write(run)
    return run.run_id
