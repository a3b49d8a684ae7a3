"""Write what a study says: ``summary.csv``, the table of calibrated values, the figures, and the page of it all."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pandas as pd

from calibench.bench.report.shared.drawing import save
from calibench.bench.report.study import figures
from calibench.bench.report.study.additions import Additions, captions_of, filled_sections, links_for, printed_values
from calibench.bench.report.study.page import StudyPage
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics import tables
from calibench.bench.statistics.cells import METHOD
from calibench.bench.statistics.targets import levels_of
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.studies import study_preset


def write_report(store: ResultStore, additions: Additions = ()) -> list[Path]:
    """Write tables, figures and page of `store` into its folder; return their paths, the page's last.

    `additions` are what others set beside the runs: printed tables, figures, links.
    Raises `StoreError` without runs.
    """
    runs, traces = store.runs(), store.traces()
    if runs.empty:
        raise StoreError(f"{store.folder}: holds no finished run yet")
    manifest = store.manifest()
    costs = manifest.get("costs", [])
    identifiability = tables.identifiability(runs)
    found = {
        "summary": stats.summary(runs, costs),
        "calibrated": tables.calibrated(runs, partial(printed_values, additions)),
        "identifiability": identifiability,
        "overview": tables.overview(runs, costs) if len(runs[METHOD].drop_duplicates()) > 1 else pd.DataFrame(),
    }
    sections = filled_sections(additions, runs)
    printed = [(f"tables/{table.name}", rows) for _, filled in sections for table, rows in filled]
    written = [
        path for name, table in [*found.items(), *printed] for path in _write(table, store.folder / f"{name}.csv")
    ]
    written.append(store.write_hits(levels_of(runs)))
    drawings: dict[str, Path] = {}
    for name, drawing in figures.study_figures(runs, traces, additions=additions):
        paths = save(name, drawing, store.folder / "figures")
        drawings[name] = paths[0]
        written += paths
    about, beside = (study_preset(store.study) or {}).get("description", ""), links_for(additions, store.folder)
    page = StudyPage(
        store.folder, runs, sections, identifiability, drawings, manifest, about, beside, captions_of(additions)
    ).html()
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
