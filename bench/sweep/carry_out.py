"""Carry out a request: skip what is done, run the rest in one process or several, write each run as it ends.

A run knows nothing of the others and its seeds come from its names, so the rows are the same in any order and with any
number of workers.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, final

from calibench import problems
from calibench.bench.execution.run import Spec
from calibench.bench.gate.forked_worker import CAN_FORK, forked
from calibench.bench.provenance.run_id import canonical
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep import costs
from calibench.bench.sweep.request import Request
from calibench.bench.sweep.stale import Stale, Way, find_stale, settle
from calibench.bench.sweep.values import RequestError
from calibench.core import user_file
from calibench.core.compiler import load_compiler
from calibench.core.sources import file_of, is_ours

_FOR_EVER = 1e9  # seconds: a time limit that only asks for a process of its own
Report = Callable[[int, int, str], None]  # done, of, what has just ended


@final
@dataclass(frozen=True)
class Outcome:
    """What a sweep did: ids asked for, those skipped as done, parts set aside as damaged, and rows of other code."""

    asked: tuple[str, ...]
    skipped: int
    aside: tuple[Path, ...]
    stale: Stale


def carry_out(
    request: Request,
    report: Report,
    retry_failed: bool = False,
    command: str = "",
    way: Way = "ask",
    tell: Callable[[str], None] = lambda line: None,
) -> Outcome:
    """Run what is not done yet and collect the tables; the manifest keeps the `command` that asked for it.

    Finished runs of other code (`bench.sweep.stale`) are done again or kept, as `way` says, and are told before
    anything runs. Raises `RequestError`, `StoreError` before anything runs: also where there are such and the way is
    "ask".
    """
    workers = _workers(request.execution)
    store = ResultStore(request.folder)
    store.open()
    aside = store.collect() if store.damaged() else []
    if retry_failed:
        runs = store.runs()
        store.forget(set(runs.loc[runs["status"] != "ok", "run_id"]) & set(request.specs))
    stale = find_stale(request, store)
    again = settle(stale, way)
    for line in (stale.told(), stale.told_unknown()):
        if line:
            tell(f"{line}; {'they are done again' if way == 'rerun' else 'they are kept'}")
    if again:
        store.forget(again)
    done = store.finished()
    store.plan(request.labels, command, request.files)
    left = {run_id: spec for run_id, spec in request.specs.items() if run_id not in done}
    if left and CAN_FORK:
        load_compiler()  # once here, and not again in every child
        _load_kernels(left.values())
    store.note_costs(list(costs.measured(left.values(), store.manifest().get("costs", []))))
    report(0, len(left), "")
    try:
        for count, run_id in enumerate(_run_all(left, store.folder, workers), start=1):
            report(count, len(left), request.labels[run_id])
    finally:
        aside += store.collect()
    return Outcome(tuple(request.specs), len(request.specs) - len(left), tuple(aside), stale)


def _load_kernels(specs: Iterable[Spec]) -> None:
    """Compile (or load) the kernels of our own problems, which all children then have; a user's may end a process."""
    for spec in {(s.problem, canonical(s.problem_options)): s for s in specs}.values():
        problem: Any = problems.make(spec.problem, **spec.problem_options)
        file = file_of(type(problem).__module__)
        if file is not None and is_ours(file) and hasattr(problem, "compile"):
            with suppress(Exception):  # its runs will say what is wrong with it
                problem.compile()


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
        yield from _one_by_one(specs, folder)
        return
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    jobs = (delayed(_run_one)(spec, folder.resolve(), sys.path) for spec in specs.values())
    try:
        yield from Parallel(n_jobs=workers, backend="loky", return_as="generator_unordered")(jobs)
    except TerminatedWorkerError:  # some run took its process down: which one, the rest will show
        done = ResultStore(folder).finished()
        yield from _one_by_one({run_id: spec for run_id, spec in specs.items() if run_id not in done}, folder)


def _one_by_one(specs: Mapping[str, Spec], folder: Path) -> Iterator[str]:
    """Yield the ids of runs in order, all from one child process, so that this one outlives what they do.

    A run that takes the child down is done again by itself, watched, for its row; a new child does those after it.
    """
    left = dict(specs)
    while left:
        for run_id in (_in_a_child if CAN_FORK else _here)(list(left.values()), folder):
            del left[run_id]
            yield run_id
        if left:
            run_id = next(iter(left))
            spec = left.pop(run_id)
            yield _run_one(replace(spec, time_limit=spec.time_limit or _FOR_EVER), folder, sys.path)


def _here(specs: Sequence[Spec], folder: Path) -> Iterator[str]:
    """Execute runs in this process; yield the id of each."""
    with user_file.as_loaded():
        for spec in specs:
            yield _run_one(spec, folder, sys.path)


def _in_a_child(specs: Sequence[Spec], folder: Path) -> Iterator[str]:
    """Yield the ids of the runs until all are done or the child is gone; raise what it raised."""

    def work(theirs: Connection) -> None:
        try:
            for run_id in _here(specs, folder):
                theirs.send(run_id)
        except Exception as error:  # no run does; a full disk, say
            theirs.send(error)

    with forked(work) as (_, ours):
        while True:
            try:
                told = ours.recv()
            except EOFError:
                return
            if isinstance(told, Exception):
                raise told
            yield told


def _run_one(spec: Spec, folder: Path, path: Sequence[str]) -> str:
    """Execute a run where it stands, write its part, return its id. `path` lets a worker import the user's classes."""
    sys.path[:] = list(dict.fromkeys([*sys.path, *path]))
    run = spec.execute()
    ResultStore(folder).write(run)
    return run.run_id
