"""Progress of a sweep: a bar on a terminal and in a notebook, plain lines elsewhere; with the runs in progress.

A thread reads the folder of the study every few seconds, where workers, here or elsewhere, write how far long runs are
(`bench.execution.in_progress`).
"""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from html import escape
from importlib import import_module
from pathlib import Path
from textwrap import shorten
from typing import Any

from calibench.bench.execution.in_progress import Running, read_running
from calibench.bench.sweep.carry_out import Report
from calibench.core.words import counted, print_plain as print, printable

_LOOK = 2.0  # seconds between two looks at the runs in progress, for the bar
_LOG = 10.0  # seconds between two lines of a log
_WIDE = 120  # letters of a cell in a line of a log
_AGAIN = 0.2  # seconds between two looks of the bar in a notebook
_LINES = 4  # runs in progress that a log tells of at a time


@contextmanager
def progress(folder: Path | None = None) -> Iterator[Report]:
    """Yield a report(done, of, label) to call as runs end; of the study in `folder` runs in progress are told too."""
    python = sys.modules.get("IPython")
    shell = None if python is None else python.get_ipython()
    if type(shell).__name__ == "ZMQInteractiveShell":  # a notebook; IPython in a terminal has a terminal's bar
        display: Callable[..., Any] = import_module("IPython.display").display
        bar_there = _NotebookBar(display)
        with _looking(folder, _LOOK, bar_there.running):
            yield bar_there.report
        return
    if not sys.stderr.isatty():
        log = _Log()
        with _looking(folder, _LOG, log.running):
            yield log.report
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


@contextmanager
def _looking(folder: Path | None, every: float, tell: Callable[[list[Running]], None]) -> Iterator[None]:
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
