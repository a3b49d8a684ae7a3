"""Progress: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from calibench.bench.sweep.carry_out import Report
from calibench.core.counted import counted


@contextmanager
def progress(folder: Path | None = None) -> Iterator[Report]:
    """Yield a report(done, of, label) to call as runs end; of the study in `folder` runs in progress are told too."""
    if not sys.stderr.isatty():
        yield _plain()
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
            bar.update(task, completed=done, total=of, description=label[:60])

        yield report


def _plain() -> Report:
    """Return a report that prints a line at each tenth of the way."""
    began, said = time.perf_counter(), [-1]

    def report(done: int, of: int, label: str) -> None:
        tenth = 10 * done // of if of else 10
        if done and tenth != said[0]:
            said[0] = tenth
            print(f"  {done}/{counted(of, 'run')}, {time.perf_counter() - began:.1f} s, last: {label}", file=sys.stderr)

    return report
