"""Write what a study says: ``summary.csv``, the table of calibrated values, the figures, and the page of it all."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from bench import figures, paper_tables, stats, tables
from bench.drawing import save
from bench.request import study_preset
from bench.store import ResultStore, StoreError
from bench.study_page import StudyPage
from bench.whole import write_whole


def write_report(store: ResultStore) -> list[Path]:
    """Write tables, figures and page of `store` into its folder; return their paths, the page's last.

    Raises `StoreError` without runs.
    """
    runs, traces = store.runs(), store.traces()
    if runs.empty:
        raise StoreError(f"{store.folder}: holds no finished run yet")
    identifiability = tables.identifiability(runs)
    written = [
        _write(stats.summary(runs), store.folder / "summary.csv"),
        _write(tables.calibrated(runs), store.folder / "calibrated.csv"),
        _write(identifiability, store.folder / "identifiability.csv"),
    ]
    if runs["optimizer"].nunique() > 1:
        written.append(_write(tables.overview(runs), store.folder / "overview.csv"))
    papers = {name: table for name, build in paper_tables.TABLES.items() if not (table := build(runs)).empty}
    for name, table in papers.items():
        (store.folder / "tables").mkdir(exist_ok=True)
        written.append(_write(table, store.folder / "tables" / f"{name}.csv"))
    drawings: dict[str, Path] = {}
    for name, drawing in figures.study_figures(runs, traces):
        paths = save(name, drawing, store.folder / "figures")
        drawings[name] = paths[0]
        written += paths
    about, beside = (study_preset(store.study) or {}).get("description", ""), {}
    if (store.folder.parent / "paper" / "ledger.html").exists():
        beside["the ledger of the papers"] = "../paper/ledger.html"
    page = StudyPage(store.folder, runs, papers, identifiability, drawings, store.manifest(), about, beside).html()
    written.append(write_whole(store.folder / "report.html", lambda file: file.write(page.encode())))
    return written


def _write(table: pd.DataFrame, path: Path) -> Path:
    table.to_csv(path, index=False)
    return path
