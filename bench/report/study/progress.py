"""How far a report is: a bar on a terminal, plain lines elsewhere, and neither where it is done at once."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from calibench.core.words import print_plain as print
from calibench.core.words import printable

Tell = Callable[[int, int, str], None]
_SOON = 2.0  # seconds, within which nothing is told to a file
_EVERY = 5.0  # seconds between two lines


def nobody(done: int, of: int, what: str) -> None:
    """Tell nobody how far a report is."""


@contextmanager
def report_progress() -> Iterator[Tell]:
    """Yield a tell(done, of, what) to call before each step of a report."""
    if not sys.stderr.isatty():
        yield _lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("")
        yield lambda done, of, what: bar.update(task, completed=done, total=of, description=printable(what[:60]))


def _lines() -> Tell:
    told = time.monotonic() + _SOON - _EVERY

    def tell(done: int, of: int, what: str) -> None:
        nonlocal told
        if time.monotonic() - told >= _EVERY:
            told = time.monotonic()
            print(f"  report: step {done + 1} of {of}, {what}", file=sys.stderr, flush=True)

    return tell
