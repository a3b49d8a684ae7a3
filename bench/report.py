"""Write what a study says: ``summary.csv``, the table of calibrated values, and the figures."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from bench import figures, paper_tables, stats, tables
from bench.drawing import save
from bench.store import ResultStore, StoreError


def write_report(store: ResultStore) -> list[Path]:
    """Write tables and figures of `store` into its folder; return their paths. Raises `StoreError` without runs."""
    runs, traces = store.runs(), store.traces()
    if runs.empty:
        raise StoreError(f"{store.folder}: holds no finished run yet")
    written = [
        _write(stats.summary(runs), store.folder / "summary.csv"),
        _write(tables.calibrated(runs), store.folder / "calibrated.csv"),
        _write(tables.identifiability(runs), store.folder / "identifiability.csv"),
    ]
    if runs["optimizer"].nunique() > 1:
        written.append(_write(tables.overview(runs), store.folder / "overview.csv"))
    for name, build in paper_tables.TABLES.items():
        if not (table := build(runs)).empty:
            (store.folder / "tables").mkdir(exist_ok=True)
            written.append(_write(table, store.folder / "tables" / f"{name}.csv"))
    for name, drawing in figures.study_figures(runs, traces):
        written += save(name, drawing, store.folder / "figures")
    return written


def _write(table: pd.DataFrame, path: Path) -> Path:
    table.to_csv(path, index=False)
    return path
