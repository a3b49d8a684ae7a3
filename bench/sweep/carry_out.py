"""Carry out a request: skip finished runs, give the rest to the workers, collect the tables; from Python too (`sweep`).

Runs do not depend on each other, and their seeds come from their names. So the rows are the same in any order, with any
number of workers, on any machines. Progress is a bar on a terminal and in a notebook, plain lines elsewhere; a thread
reads the folder of the study, where workers, here or elsewhere, write how far long runs are.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from html import escape
from importlib import import_module
from pathlib import Path
from textwrap import shorten
from threading import Timer
from typing import TYPE_CHECKING, Any, Literal, final

from calibench.bench.execution.costly import ReplayFolder, forget_finished
from calibench.bench.execution.in_progress import Running, at_work, read_running, remove_gone
from calibench.bench.execution.kernels import load_kernels
from calibench.bench.execution.run import Run, Spec
from calibench.bench.execution.standing import lost_run
from calibench.bench.gate.processes import CAN_FORK
from calibench.bench.provenance.code_digest import changed_parts
from calibench.bench.statistics.cells import PROBLEM
from calibench.bench.statistics.summary import key_of_costs
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep import costs
from calibench.bench.sweep.remarks import ONE_RUN, remarks_on_rows
from calibench.bench.sweep.request import Request, read_request
from calibench.bench.sweep.words import Execution, read_execution
from calibench.bench.words import RequestError
from calibench.bench.workers.carrier import Carrier, Job, Packs, Serial
from calibench.bench.workers.processes import Processes, printed_files
from calibench.core.process import meanwhile
from calibench.core.words import counted, print_plain as print, printable

if TYPE_CHECKING:
    import pandas as pd


_SILENCE = 2.0  # seconds
_COMPILING = "compiling what these runs need; it is kept, so that the next sweep begins at once"
_PATIENCE = 1.0  # seconds to look again at what could not be built
_ATTEMPTS = 2  # to have a row of each run: something may damage what was kept
Report = Callable[[int, int, str], None]  # done, of, what has just ended
Way = Literal["ask", "rerun", "keep"]  # what to do with rows of other code: stop and say so, replace, or leave


@final
@dataclass(frozen=True)
class Stale:
    """The finished runs of a request that other code made, those nobody can tell of, and what differs, in words.

    Rows without a ``code_digest``, as of a run whose code could not be read, cannot be judged: they are kept and named.
    """

    other: frozenset[str]
    unknown: frozenset[str]
    finished: int
    what: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return how many rows are of other code, and of what; and how many have no digest; a line each."""
        said = (
            (self.other, ("is", "are"), f"of other code: {'; '.join(self.what)}"),
            (self.unknown, ("has", "have"), "no code_digest: what made them is not known"),
        )
        of = f"of {counted(self.finished, 'finished run')}"
        return [f"{len(runs)} {of} {verbs[len(runs) > 1]} {what}" for runs, verbs, what in said if runs]


@final
@dataclass(frozen=True)
class Outcome:
    """What a sweep did: ids asked for, those skipped as done, files set aside as damaged, and rows of other code.

    `unfinished` runs were not begun or ended because of `stop_after`; `printed` are files with what the runs printed.
    """

    asked: tuple[str, ...]
    skipped: int
    aside: tuple[Path, ...]
    stale: Stale
    unfinished: int = 0
    printed: tuple[Path, ...] = ()


def carry_out(
    request: Request, report: Report, retry_failed: bool = False, drop_planned: bool = False, command: str = "",
    way: Way = "ask", tell: Callable[[str], None] = lambda line: None, asks: tuple[str, str] = ("--rerun", "--keep"),
) -> Outcome:  # fmt: skip
    """Run what is not done yet and collect the tables; the manifest keeps the `command` that asked for it.

    A run counts as done when the tables have its row. With `drop_planned` what was planned before and is not asked for
    now is abandoned. Finished runs of other code are done again or kept, as `way` says, in the caller's words `asks`;
    where it is "ask" and there are some, `RequestError` is raised before anything runs, as are `StoreError` and
    `ClusterError`.
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
    # finished runs of other code: the store forgets those that are done again
    stale = find_stale(request, store, failed_before)
    if way == "ask" and stale.other:
        rerun, keep = asks
        raise RequestError(f"{stale.lines()[0]}; {rerun} does them again, {keep} goes on with them; nothing was run")
    for line in stale.lines():
        tell(f"{line}; {'they are done again' if way == 'rerun' else 'they are kept'}")
    again = {*failed_before, *stale.other, *stale.unknown} if way == "rerun" else failed_before
    if again:
        store.forget(again)
    done = store.finished()
    store.plan(
        request.labels, command, request.files, request.called, request.other_shards, request.budgets, drop_planned
    )
    left = {run_id: spec for run_id, spec in request.specs.items() if run_id not in done}
    remove_gone(request.folder)
    forget_finished(request.folder, done)
    goes_on = sum(path.stem in left for path in (request.folder / "replay").glob("*.journal"))
    if goes_on:
        tell(f"{counted(goes_on, 'run')} {'goes' if goes_on == 1 else 'go'} on from the values of before the kill")
    skipped, before = len(request.specs) - len(left), printed_files(request.folder)
    unfinished = 0
    with at_work(request.folder):
        for attempt in range(_ATTEMPTS):
            try:
                unfinished = _do(request, left, store, execution, report, tell)
            finally:
                aside += store.collect(execution.workers)
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
    request: Request, left: Mapping[str, Spec], store: ResultStore, execution: Execution, report: Report,
    tell: Callable[[str], None],
) -> int:  # fmt: skip
    """Do the runs that are `left`; return how many have not been done, because `stop_after` failures had happened."""
    # the rows of runs whose problem or optimiser cannot be built at all
    first: dict[str, Run] = {}  # of a cell: the others differ in their repetition alone
    broken = {run_id: spec for run_id, spec in left.items() if run_id in request.broken}
    for run_id, spec in broken.items():
        label = request.labels[run_id]
        if label not in first:
            first[label] = lost_run(spec, run_id, *request.broken[run_id], patience=_PATIENCE)
        record = replace(first[label].record, run_id=run_id, repetition=spec.repetition)
        store.write(replace(first[label], record=record))

    unbegun = {run_id: spec for run_id, spec in left.items() if run_id not in broken}
    if unbegun and CAN_FORK and execution.address is None:
        with told_after(_SILENCE, lambda: tell(_COMPILING)) as compiling:
            load_kernels(unbegun.values(), compiling=compiling)  # once here, and not again in every child
    measured = list(costs.measured(unbegun.values(), store.manifest().get("costs", [])))
    store.note_costs(measured)
    tell_of_costs(measured, tell)
    jobs = deque(Job(run_id, spec, request.labels[run_id]) for run_id, spec in unbegun.items())
    replay = None if request.replay is False else ReplayFolder(request.folder.resolve(), request.replay is True)
    packs = Packs(jobs, execution.workers, execution.inner, replay)

    carrier: Carrier
    if execution.name == "dask":
        from calibench.bench.workers.dask import Dask

        carrier = Dask(store.folder, store.study, execution.workers, execution.address)
    elif CAN_FORK or execution.workers > 1:
        carrier = Processes(store.folder, store.study, execution.workers)
    else:
        carrier = Serial(store.folder, store.study)
    report(len(broken), len(left), "")
    failed = len(broken)
    with closing(carrier.carry(packs)) as notices:
        for ended, notice in enumerate(notices, start=len(broken) + 1):
            label = request.labels[notice.run_id]
            report(ended, len(left), request.called.get(label, label))
            failed += notice.status == "failed"
            if request.stop_after is not None and failed >= request.stop_after:
                return len(left) - ended
    return 0


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


def find_stale(request: Request, store: ResultStore, but: Collection[str] = ()) -> Stale:
    """Return which finished runs of `request`, `but` those that are done again anyway, other code has made."""
    columns = ["run_id", "problem", "optimizer", "library", "library_version", "code_digest"]
    mine = [row for row in store.rows(columns).to_pylist() if row["run_id"] in request.specs]
    mine = [row for row in mine if row["run_id"] not in but]
    before = store.manifest().get("files", {})
    moved = {  # classes whose file was another in this study, and still is: two files may bear one name
        name: f"{name}, whose file was {before[name]}"
        for name, file in request.files.items()
        if name in before and before[name] != file and Path(before[name]).is_file()
    }
    other, unknown, counts = set(), set(), Counter[tuple[str, ...]]()
    for row in mine:
        run_id, code = str(row["run_id"]), row["code_digest"]
        known = isinstance(code, str) and code != ""
        parts = changed_parts(str(code), request.codes[run_id]) if known else []
        problem, optimizer = str(row["problem"]), str(row["optimizer"])
        library = f"{row['library']} {row['library_version']}" if row["library_version"] else ""
        words = {
            "problem": f"problem {problem}",
            "optimizer": f"optimizer {optimizer}" + (f" (the runs were made with {library})" if library else ""),
            "gate": "calibench's evaluator",
            "files": f"problem {problem}, whose file of data was another (where it writes it: a str)",
        }
        named = [words[part] for part in parts]
        what = tuple(dict.fromkeys([*named, *(moved[name] for name in (problem, optimizer) if name in moved)]))
        if what:
            other.add(run_id)
            counts.update([what])
        elif not known:
            unknown.add(run_id)
    what = tuple(f"{n} of {' and of '.join(what)}" for what, n in counts.items())
    return Stale(frozenset(other), frozenset(unknown), len(mine), what)


_LOOK = 2.0  # seconds between two looks at the runs in progress, for the bar
_LOG = 10.0  # seconds between two lines of a log
_WIDE = 120  # letters of a cell in a line of a log
_AGAIN = 0.2  # seconds between two looks of the bar in a notebook
_LINES = 4  # runs in progress that a log tells of at a time


@contextmanager
def show_progress(folder: Path | None = None) -> Iterator[Report]:
    """Yield a report(done, of, label) to call as runs end; of the study in `folder` runs in progress are told too."""
    python = sys.modules.get("IPython")
    shell = None if python is None else python.get_ipython()
    is_notebook = type(shell).__name__ == "ZMQInteractiveShell"  # IPython in a terminal has a terminal's bar
    if is_notebook or not sys.stderr.isatty():
        shown = _NotebookBar(import_module("IPython.display").display) if is_notebook else _Log()
        with _looking(folder, _LOOK if is_notebook else _LOG, shown.running):
            yield shown.report
        return
    from rich import progress as rich
    from rich.console import Console

    columns = (
        rich.BarColumn(), rich.MofNCompleteColumn(), rich.TimeElapsedColumn(), rich.TimeRemainingColumn(),
        rich.TextColumn("{task.description}"),
    )  # fmt: skip
    with rich.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task, silent = bar.add_task(""), set[str]()

        def running(found: list[Running]) -> None:
            bar.update(task, description=printable(_first_of(found)))
            for line in _new_hints(found, silent):
                bar.console.print(printable(line))

        with _looking(folder, _LOOK, running):
            yield lambda done, of, label: bar.update(task, completed=done, total=of, description=printable(label[:60]))


def _first_of(found: list[Running]) -> str:
    return found[0].line() + (f" (and {len(found) - 1} more)" if found[1:] else "")


def _new_hints(runs: list[Running], known: set[str]) -> list[str]:
    """Return what to do about runs that make no evaluation any more, once of each: `known` are those told of."""
    lines = {run.run_id: run.silent_line() for run in runs if run.run_id not in known}
    silent = {run_id: line for run_id, line in lines.items() if line is not None}
    known.update(silent)
    return list(silent.values())


class _NotebookBar:
    """A bar in the output of a cell, which stays there: HTML alone, so that no widgets are needed."""

    def __init__(self, display: Callable[..., Any]) -> None:
        self._began, self._seconds, self._shown_at = time.monotonic(), 0.0, 0.0
        self._done, self._of, self._label = 0, 0, ""
        self._known, self._silent = set[str](), list[str]()
        self._handle = display(self, display_id=True)

    def report(self, done: int, of: int, label: str) -> None:
        self._done, self._of, self._label = done, of, label
        if done >= of or time.monotonic() - self._shown_at > _AGAIN:
            self._show()

    def running(self, found: list[Running]) -> None:
        self._label = _first_of(found)
        self._silent += _new_hints(found, self._known)
        self._show()

    def _show(self) -> None:
        self._shown_at = time.monotonic()
        self._seconds = self._shown_at - self._began
        self._handle.update(self)

    def __repr__(self) -> str:
        return f"{self._done}/{counted(self._of, 'run')}, {self._seconds:.1f} s"

    def _repr_html_(self) -> str:
        last = "" if self._done >= self._of else f", {escape(shorten(self._label, _WIDE, placeholder=' …'))}"
        bar = f'<progress value="{self._done}" max="{max(self._of, 1)}" style="width:20em"></progress>'
        return "<br>".join([f"{bar} {self!r}{last}", *map(escape, self._silent)])


@dataclass(eq=False)
class _Log:
    """Lines for a file: at each tenth of the way, and when runs take longer than that."""

    _began: float = field(default_factory=time.monotonic)
    _said: int = -1
    _told_at: float = field(default_factory=time.monotonic)
    _known: set[str] = field(default_factory=set)

    def report(self, done: int, of: int, label: str) -> None:
        tenth = 10 * done // of if of else 10
        if done and tenth != self._said:
            self._said = tenth
            last = shorten(label, _WIDE, placeholder=" …")
            self._tell(f"  {done}/{counted(of, 'run')}, {time.monotonic() - self._began:.1f} s, last: {last}")

    def running(self, runs: list[Running]) -> None:
        for line in _new_hints(runs, self._known):
            self._tell(f"  {line}")
        if time.monotonic() - self._told_at >= _LOG:
            more = [f"and {len(runs) - _LINES} more"] if len(runs) > _LINES else []
            self._tell("\n".join(f"  {line}" for line in [*(run.line() for run in runs[:_LINES]), *more]))

    def _tell(self, text: str) -> None:
        self._told_at = time.monotonic()
        print(text, file=sys.stderr, flush=True)


def _looking(folder: Path | None, every: float, tell: Callable[[list[Running]], None]) -> AbstractContextManager[None]:
    if folder is None:
        return nullcontext()

    def look() -> None:
        with suppress(OSError):
            if runs := read_running(folder):
                tell(runs)

    return meanwhile(look, every, every)


def sweep(*arguments: str, way: Way = "ask", progress: bool = False) -> pd.DataFrame:
    """Carry out ``bench run -m`` with `arguments`; return the rows of its runs, those that were done before too.

    Finished runs of other code are refused, done again or kept, as `way` says: "ask", "rerun", "keep". With `progress`
    a bar tells how far it is, in a terminal and in a notebook, and lines do elsewhere; else nothing is printed. What
    the command line remarks on a sweep and its runs is a `UserWarning` each. Raises `RequestError` for a request that
    makes no sense, before anything runs.

    ``sweep("problem=full11,full12", "optimizer=lm,de", "budget=2000", "seeds=5", "study=mine")``
    """
    try:
        request = read_request(arguments, multirun=True)
    except RequestError as error:
        raise error.with_traceback(None) from None  # it says what is wrong with the words: no frame of ours helps
    for line in (*request.left_out, *request.copies, *request.remarks):
        warnings.warn(line, stacklevel=2)
    with show_progress(request.folder) if progress else nullcontext(lambda done, of, label: None) as report:
        asks = ('way="rerun"', 'way="keep"')
        outcome = carry_out(request, report, way=way, tell=lambda line: None, asks=asks)
    store = ResultStore(request.folder)
    runs = store.runs()
    mine = runs[runs["run_id"].isin(outcome.asked)].reset_index(drop=True)
    asked = set(zip(*(mine[name] for name in PROBLEM)))
    costs = [record for record in store.manifest().get("costs", ()) if key_of_costs(record) in asked]
    said: list[str] = []
    tell_of_costs(costs, said.append)
    in_vain = request.seeds > 1 and len(request.specs) + len(request.other_shards) == len(request.budgets)
    for line in (*said, *remarks_on_rows(mine), *([ONE_RUN] if in_vain else [])):
        warnings.warn(line, stacklevel=2)
    return mine
