"""Progress of a sweep: a bar on a terminal and in a notebook, plain lines elsewhere; with the runs in progress.

A thread reads the folder of the study every few seconds, where workers, here or elsewhere, write how far long runs are
(`bench.execution.in_progress`). How long the rest takes is told from the finished runs of a cell, or the cost of a
call.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Set
from contextlib import contextmanager, suppress
from html import escape
from importlib import import_module
from pathlib import Path
from statistics import mean
from textwrap import shorten
from typing import Any

from calibench.bench.execution.in_progress import Running, read_running
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep import costs
from calibench.bench.sweep.carry_out import Report
from calibench.bench.sweep.execution import read_execution
from calibench.bench.sweep.request import Request
from calibench.core.words import counted, printable
from calibench.core.words import print_plain as print

_LOOK = 2.0  # seconds between two looks at the runs in progress, for the bar
_LOG = 10.0  # seconds between two lines of a log
_WIDE = 120  # letters of a cell in a line of a log
_AGAIN = 0.2  # seconds between two looks of the bar in a notebook
_LINES = 4  # runs in progress that a log tells of at a time


@contextmanager
def progress(folder: Path | None = None) -> Iterator[Report]:
    """Yield a report(done, of, label) to call as runs end; of the study in `folder` runs in progress are told too."""
    notebook = _display()
    if notebook is not None:
        bar_there = _NotebookBar(notebook)
        with _looking(folder, _LOOK, bar_there.running):
            yield bar_there.report
        return
    if not sys.stderr.isatty():
        log = _Log()
        with _looking(folder, _LOG, log.running):
            yield log.report
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("")

        def report(done: int, of: int, label: str) -> None:
            bar.update(task, completed=done, total=of, description=printable(label[:60]))

        def running(found: list[Running]) -> None:
            bar.update(
                task, description=printable(found[0].line() + (f" (and {len(found) - 1} more)" if found[1:] else ""))
            )
            for line in hints.new(found):
                bar.console.print(printable(line))

        hints = _Hints()
        with _looking(folder, _LOOK, running):
            yield report


def _display() -> Callable[..., Any] | None:
    """Return what shows an object in the notebook that this process serves; None where it serves none."""
    python = sys.modules.get("IPython")
    shell = None if python is None else python.get_ipython()
    if type(shell).__name__ != "ZMQInteractiveShell":  # that of a terminal has a terminal's bar
        return None
    display: Callable[..., Any] = import_module("IPython.display").display
    return display


class _NotebookBar:
    """A bar in the output of a cell, which stays there: HTML alone, so that no widgets are needed."""

    def __init__(self, display: Callable[..., Any]) -> None:
        self._began, self._seconds, self._shown_at = time.monotonic(), 0.0, 0.0
        self._done, self._of, self._label = 0, 0, ""
        self._hints, self._silent = _Hints(), list[str]()
        self._handle = display(self, display_id=True)

    def report(self, done: int, of: int, label: str) -> None:
        self._done, self._of, self._label = done, of, label
        if done >= of or time.monotonic() - self._shown_at > _AGAIN:
            self._show()

    def running(self, found: list[Running]) -> None:
        self._label = found[0].line() + (f" (and {len(found) - 1} more)" if found[1:] else "")
        self._silent += self._hints.new(found)
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


class _Log:
    """Lines for a file: at each tenth of the way, and when runs take longer than that."""

    def __init__(self) -> None:
        self._began, self._said, self._told_at = time.monotonic(), -1, time.monotonic()
        self._hints = _Hints()

    def report(self, done: int, of: int, label: str) -> None:
        tenth = 10 * done // of if of else 10
        if done and tenth != self._said:
            self._said = tenth
            last = shorten(label, _WIDE, placeholder=" …")
            self._tell(f"  {done}/{counted(of, 'run')}, {time.monotonic() - self._began:.1f} s, last: {last}")

    def running(self, runs: list[Running]) -> None:
        for line in self._hints.new(runs):
            self._tell(f"  {line}")
        if time.monotonic() - self._told_at >= _LOG:
            more = [f"and {len(runs) - _LINES} more"] if len(runs) > _LINES else []
            self._tell("\n".join(f"  {line}" for line in [*(run.line() for run in runs[:_LINES]), *more]))

    def _tell(self, text: str) -> None:
        self._told_at = time.monotonic()
        print(text, file=sys.stderr, flush=True)


class _Hints:
    """What to do about runs that make no evaluation any more, said once of each."""

    def __init__(self) -> None:
        self._said: set[str] = set()

    def new(self, runs: list[Running]) -> list[str]:
        lines = []
        for run in runs:
            line = run.silent_line()
            if line is not None and run.run_id not in self._said:
                self._said.add(run.run_id)
                lines.append(line)
        return lines


@contextmanager
def _looking(folder: Path | None, every: float, tell: Callable[[list[Running]], None]) -> Iterator[None]:
    """Tell of the runs in progress every few seconds, where there are any."""
    if folder is None:
        yield
        return
    ended = threading.Event()

    def look() -> None:
        while not ended.wait(every):
            with suppress(OSError):
                runs = read_running(folder)
                if runs:
                    tell(runs)

    thread = threading.Thread(target=look, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


_OVERHEAD = 0.002  # seconds a run takes besides its evaluations


def seconds_left(request: Request, done: Set[str]) -> float | None:
    """Return the wall time in seconds of the runs of `request` that are not `done`; None where nothing tells.

    Of a cell without a finished run it is the budget times what a call of the problem takes, measured now where the
    study does not know it yet. An optimiser's own time is not in that, so it is a lower limit.
    """
    store = ResultStore(request.folder)
    known = store.manifest().get("costs", []) if store.folder.is_dir() else []
    took: dict[str, list[float]] = {}
    if done:
        rows = store.runs(["run_id", "wall_s"])
        for run_id, wall in zip(rows["run_id"], rows["wall_s"], strict=True):
            if run_id in request.labels:
                took.setdefault(request.labels[run_id], []).append(float(wall))
    usual = {label: mean(walls) + _OVERHEAD for label, walls in took.items()}
    left = {run_id: spec for run_id, spec in request.specs.items() if run_id not in done}
    unknown = [spec for run_id, spec in left.items() if request.labels[run_id] not in usual]
    calls = costs.seconds_a_call(unknown, known) if unknown else {}
    seconds = 0.0
    for run_id, spec in left.items():
        label = request.labels[run_id]
        if label in usual:
            seconds += usual[label]
            continue
        cost = calls.get(costs.problem_of(spec))
        if cost is None:
            return None
        seconds += spec.budget * cost + _OVERHEAD
    return seconds / read_execution(request.execution).workers
