"""Carry out a request: skip finished runs, give the rest to the workers, collect the tables.

Runs do not depend on each other, and their seeds come from their names. So the rows are the same in any order, with any
number of workers, on any machines.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Timer
from typing import Any, final

from calibench.bench.execution.costly import ReplayFolder, forget_finished, values_of
from calibench.bench.execution.in_progress import at_work, remove_gone
from calibench.bench.execution.kernels import load_kernels
from calibench.bench.execution.lost import lost_run
from calibench.bench.execution.run import Run, Spec
from calibench.bench.gate.processes import CAN_FORK
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep import costs
from calibench.bench.sweep.execution import Execution, read_execution
from calibench.bench.sweep.request import Request
from calibench.bench.sweep.stale import Stale, Way, find_stale, settle
from calibench.bench.workers.carrier import Carrier, How, Job, Packs, Serial
from calibench.bench.workers.processes import Processes, printed_files
from calibench.core.words import counted

_SILENCE = 2.0  # seconds
_COMPILING = "compiling what these runs need; it is kept, so that the next sweep begins at once"
_PATIENCE = 1.0  # seconds to look again at what could not be built
_ATTEMPTS = 2  # to have a row of each run: something may damage what was kept
Report = Callable[[int, int, str], None]  # done, of, what has just ended


@final
@dataclass(frozen=True)
class Outcome:
    """What a sweep did: ids asked for, those skipped as done, files set aside as damaged, and rows of other code.

    `unfinished` counts the runs that were not begun or not ended because `stop_after` failures had happened. `printed`
    are the files with what the runs printed.
    """

    asked: tuple[str, ...]
    skipped: int
    aside: tuple[Path, ...]
    stale: Stale
    unfinished: int = 0
    printed: tuple[Path, ...] = ()


def carry_out(
    request: Request,
    report: Report,
    retry_failed: bool = False,
    drop_planned: bool = False,
    command: str = "",
    way: Way = "ask",
    tell: Callable[[str], None] = lambda line: None,
) -> Outcome:
    """Run what is not done yet and collect the tables; the manifest keeps the `command` that asked for it.

    A run counts as done when the tables have its row: one that has none after all were done is done once more.
    With `drop_planned` what was planned before and is not asked for now is abandoned.
    Finished runs of other code (`bench.sweep.stale`) are done again or kept, as `way` says, and are told before
    anything runs. Raises `RequestError`, `StoreError` before anything runs: also where there are such and the way is
    "ask". Raises `ClusterError` before anything is written where a Dask cluster is asked for and cannot be had.
    """
    execution = read_execution(request.execution)
    store = ResultStore(request.folder)
    if execution.name == "dask" and not (store.is_begun and store.collected() >= request.specs.keys()):
        from calibench.bench.workers.dask import check_cluster

        check_cluster(execution.address)  # checked again later; but here no folder has been made yet
    store.open()
    aside = store.collect() if store.has_journals() else []  # of a call that was killed
    failed_before: set[str] = set()
    if retry_failed:
        runs = store.runs(["run_id", "status"])
        failed_before = set(runs.loc[runs["status"] != "ok", "run_id"]) & set(request.specs)
    stale = _settled(request, store, way, tell, failed_before)
    done = store.finished()
    store.plan(
        request.labels, command, request.files, request.called, request.other_shards, request.budgets, drop_planned
    )
    left = {run_id: spec for run_id, spec in request.specs.items() if run_id not in done}
    remove_gone(request.folder)
    forget_finished(request.folder, done)
    goes_on = len([run_id for run_id in values_of(request.folder) if run_id in left])
    if goes_on:
        tell(f"{counted(goes_on, 'run')} {'goes' if goes_on == 1 else 'go'} on from the values of before the kill")
    skipped, before = len(request.specs) - len(left), printed_files(request.folder)
    unfinished = 0
    with at_work(request.folder):
        for attempt in range(_ATTEMPTS):
            try:
                unfinished = _do(request, left, store, execution, report, tell)
            finally:
                aside += store.collect()
                kept = store.collected()
                remove_gone(request.folder)
                forget_finished(request.folder, kept)
            left = {run_id: spec for run_id, spec in request.specs.items() if run_id not in kept}
            if unfinished or not left:
                break
            if attempt + 1 < _ATTEMPTS:
                them = "it" if len(left) == 1 else "them"
                tell(f"{counted(len(left), 'run')} had ended, and the folder has no row of {them}: done once more")
    printed = tuple(sorted(printed_files(request.folder) - before))
    return Outcome(tuple(request.specs), skipped, tuple(aside), stale, unfinished, printed)


def _do(
    request: Request,
    left: Mapping[str, Spec],
    store: ResultStore,
    execution: Execution,
    report: Report,
    tell: Callable[[str], None],
) -> int:
    """Do the runs that are `left`; return how many have not been done, because `stop_after` failures had happened."""
    broken = _fail_broken(request, left, store)
    unbegun = {run_id: spec for run_id, spec in left.items() if run_id not in broken}
    if unbegun and CAN_FORK and execution.name != "dask":
        with told_after(_SILENCE, lambda: tell(_COMPILING)) as compiling:
            load_kernels(unbegun.values(), compiling=compiling)  # once here, and not again in every child
    measured = list(costs.measured(unbegun.values(), store.manifest().get("costs", [])))
    store.note_costs(measured)
    tell_of_costs(measured, tell)
    jobs = [Job(run_id, spec, request.labels[run_id]) for run_id, spec in unbegun.items()]
    replay = None if request.replay is False else ReplayFolder(request.folder.resolve(), request.replay is True)
    packs = Packs(jobs, execution.workers, How(execution.inner, replay))
    report(len(broken), len(left), "")
    failed = len(broken)
    with closing(_carrier_of(execution, store).carry(packs)) as notices:
        for ended, notice in enumerate(notices, start=len(broken) + 1):
            label = request.labels[notice.run_id]
            report(ended, len(left), request.called.get(label, label))
            failed += notice.status == "failed"
            if request.stop_after is not None and failed >= request.stop_after:
                return len(left) - ended
    return 0


def _settled(
    request: Request, store: ResultStore, way: Way, tell: Callable[[str], None], failed: Collection[str]
) -> Stale:
    """Return the finished runs of other code after the decision on them, and after the store has forgotten some.

    `failed` are forgotten too, whatever code made them. Raises `RequestError` where there are runs of other code and
    the way is "ask"; nothing is forgotten then.
    """
    stale = find_stale(request, store, failed)
    again = settle(stale, way) | set(failed)
    for line in (stale.told(), stale.told_unknown()):
        if line:
            tell(f"{line}; {'they are done again' if way == 'rerun' else 'they are kept'}")
    if again:
        store.forget(again)
    return stale


def tell_of_costs(measured: Iterable[Mapping[str, Any]], tell: Callable[[str], None]) -> None:
    """Tell of which problems a value or a slope was found to be none; `measured` are records of `bench.sweep.costs`."""
    for record in measured:
        problem = record["problem"]
        if costs.UNLIKE in record:
            first, second = record[costs.UNLIKE]
            tell(
                f"{problem}: the same point gave {first:.6g} and then {second:.6g}; say stochastic = True where that "
                "is noise, so that all seeds run and answers are judged apart, or keep no state between calls"
            )
        if costs.WRONG_SLOPE in record:
            kind, slope, differences = record[costs.WRONG_SLOPE]
            tell(
                f"{problem}: its {kind} is wrong: along a line through the box it says {slope:.3g}, differences say "
                f"{differences:.3g}; calibench.testing.check_problem names the entry"
            )
        if costs.TWO_GOALS in record:
            value, squared = record[costs.TWO_GOALS]
            tell(
                f"{problem}: at its start the value is {value:g} and the sum of its squared residuals {squared:g}: "
                "methods that use residuals search and report that sum, all others the value; let the call return "
                "r @ r"
            )


@contextmanager
def told_after(seconds: float, say: Callable[[], None]) -> Iterator[Callable[[], None]]:
    """Yield what the block calls as that begins which may take long: `say` is called once if it does, in `seconds`."""
    clock = Timer(seconds, say)
    clock.daemon = True

    def begin() -> None:
        if clock.ident is None:
            clock.start()

    try:
        yield begin
    finally:
        clock.cancel()
        if clock.ident is not None:
            clock.join()


def _fail_broken(request: Request, left: Mapping[str, Spec], store: ResultStore) -> set[str]:
    """Keep the rows of runs whose problem or optimiser cannot be built at all; return their ids."""
    broken = {run_id: spec for run_id, spec in left.items() if run_id in request.broken}
    first: dict[str, Run] = {}  # of a cell: the others differ in their repetition alone
    for run_id, spec in broken.items():
        label = request.labels[run_id]
        if label not in first:
            first[label] = lost_run(spec, run_id, *request.broken[run_id], patience=_PATIENCE)
        record = replace(first[label].record, run_id=run_id, repetition=spec.repetition)
        store.write(replace(first[label], record=record))
    return set(broken)


def _carrier_of(execution: Execution, store: ResultStore) -> Carrier:
    if execution.name == "dask":
        from calibench.bench.workers.dask import Dask

        return Dask(store.folder, store.study, execution.workers, execution.address)
    if CAN_FORK or execution.workers > 1:
        return Processes(store.folder, store.study, execution.workers)
    return Serial(store.folder, store.study)
