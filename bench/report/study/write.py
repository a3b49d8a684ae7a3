"""Write the report of a study: ``summary.csv``, the table of calibrated values, the figures, and the page.

How far a report is: a bar on a terminal, plain lines elsewhere, and neither where it is done at once.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pandas as pd

from calibench.bench.report.shared.drawing import Drawings
from calibench.bench.report.study import figures
from calibench.bench.report.study.additions import Additions, captions_of, filled_sections, links_for, printed_values
from calibench.bench.report.study.explored import groups_of
from calibench.bench.report.study.figures import ecdf_figures
from calibench.bench.report.study.page import StudyPage
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics import tables
from calibench.bench.statistics.cells import METHOD, PROBLEM
from calibench.bench.statistics.ranking import with_looks
from calibench.bench.statistics.targets import levels_of, with_lowest_seen
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore
from calibench.bench.store.schema import to_pandas
from calibench.bench.store.tables import parquet_file
from calibench.bench.sweep.studies import study_preset
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


_STEPS = 4  # besides the figures
_DRAWN = 12  # problems with drawings as files: the page draws every problem, and a drawing takes a second
_FEW = 2  # of a study of more than `_MANY` problems, of which a dozen drawings show no more than these
_MANY = 100
_GROUPS = 12  # drawings of groups


def write_report(
    store: ResultStore, additions: Additions = (), tell: Tell = nobody, summary: pd.DataFrame | None = None
) -> list[Path]:
    """Write tables, figures and page of `store` into its folder; return their paths, the page's last.

    `additions` are what others set beside the runs: printed tables, figures, links. `tell(done, of, what)` is called
    before each step. `summary` is that of the runs with the costs of the manifest, where it is made already.
    Raises `StoreError` without runs.
    """
    with tables.problems_made_once():
        return _written(store, additions, tell, summary)


def _written(store: ResultStore, additions: Additions, tell: Tell, summary: pd.DataFrame | None) -> list[Path]:
    tell(0, _STEPS, "the runs")
    runs, traces = store.runs(), store.traces()
    if runs.empty:
        raise StoreError(f"{store.folder}: holds no finished run yet")
    runs = with_lowest_seen(runs, traces)
    manifest = store.manifest()
    costs = manifest.get("costs", [])
    tell(1, _STEPS, "when each run reached each target")
    written = [store.write_hits(levels_of(runs))]
    hits = to_pandas(parquet_file(written[0]).read())
    tell(2, _STEPS, "the tables")
    summary = stats.summary(runs, costs) if summary is None else summary
    drawn = with_looks(runs, summary)
    together = list(ecdf_figures(drawn, hits, groups_of(runs)))[:_GROUPS]
    drawable = [(name, draw) for name, _, draw in together]
    many = len(runs[PROBLEM].drop_duplicates()) > _MANY
    ranked = figures.ranked_over_tasks(runs)
    drawable += figures.drawable(drawn, traces, additions, _FEW if many else _DRAWN, ranked)
    steps = _STEPS + len(drawable)
    at = {name: 3 + i for i, (name, _) in enumerate(reversed(drawable))}  # the last is drawn first
    with Drawings(drawable, store.folder / "figures", lambda name: tell(at[name], steps, f"figure {name}")) as drawings:
        identifiability = tables.identifiability(runs)
        found = {
            "summary": summary,
            "calibrated": tables.calibrated(runs, partial(printed_values, additions)),
            "identifiability": identifiability,
            "overview": tables.overview(runs, costs, summary)
            if len(runs[METHOD].drop_duplicates()) > 1
            else pd.DataFrame(),
        }
        sections = filled_sections(additions, runs)
        printed = [(f"tables/{table.name}", rows) for _, filled in sections for table, rows in filled]
        for name, table in [*found.items(), *printed]:
            written += _write(table, store.folder / f"{name}.csv")
        about, beside = (study_preset(store.study) or {}).get("description", ""), links_for(additions, store.folder)
        page = StudyPage(
            store.folder, runs, sections, identifiability, drawings, manifest, about, beside, captions_of(additions),
            traces, hits, summary, {name: caption for name, caption, _ in together},
            ranked,
        ).html()  # fmt: skip
        written += drawings.files()
    tell(steps - 1, steps, "the page")
    written.append(write_whole(store.folder / "report.html", lambda file: file.write(page.encode())))
    return written


def _write(table: pd.DataFrame, path: Path) -> list[Path]:
    """Write a table and return its path; of one without rows there is no file, nor one from an earlier report."""
    if table.empty:
        path.unlink(missing_ok=True)
        return []
    path.parent.mkdir(exist_ok=True)
    table.to_csv(path, index=False)
    return [path]
