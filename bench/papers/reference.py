"""The reference: one full run of the papers, small enough to commit, in ``results/reference/``.

The printed numbers; the ledger; and of each study the runs, thinned traces, the papers' tables and the figures the
papers are about. Times of day and clocks are left out, so the same code on the same machine writes the same rows.
A study folder of it reads as any other: ``bench report results/reference/cong2008`` draws everything again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np
import pandas as pd

from calibench.bench.papers import files
from calibench.bench.papers.additions import ADDITIONS
from calibench.bench.papers.cong2008 import figures as printed_figures
from calibench.bench.papers.cong2008 import tables as paper_tables
from calibench.bench.papers.page import by_kind
from calibench.bench.papers.published import quantities
from calibench.bench.papers.row import KINDS, Evidence, Row
from calibench.bench.provenance.environment import provenance
from calibench.bench.report.shared.drawing import save
from calibench.bench.report.study import figures
from calibench.bench.statistics import summary as stats
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore

PRINTED = "printed.csv"
_NOISE = ["wall_s", "cpu_s", "started_at"]
_PER_DECADE = 8
# of all figures those that show what the papers show: Figs 3 to 5 and what they cost, the gauge, the plans, Table 2
_FIGURES = (
    *printed_figures.FIGURES, "convergence_full12", "target_full12", "gauge", "plans", "orthoglide_residuals",
)  # fmt: skip
_OWN_GAUGE = "gaugexa2"  # what a figure's name ends in where a study has other gauges too


@final
@dataclass(frozen=True)
class Asked:
    """What a reference is of: the command's words, and the papers whose printed numbers it holds."""

    budget: str
    seeds: str
    papers: Sequence[str]


def check_folder(folder: Path) -> None:
    """Raise `StoreError` where a reference cannot be written: files that are none of ours stand there."""
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir()) and not (folder / PRINTED).exists()):
        raise StoreError(f"to={folder}: holds something else (no {PRINTED}); take an empty folder, or a reference")


def write_reference(rows: Sequence[Row], evidence: Sequence[Evidence], asked: Asked, folder: Path) -> list[Path]:
    """Write the reference of a ledger and its runs into `folder`, in place of one that is there; return the paths."""
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = [
        write_printed(asked.papers, folder / PRINTED),
        files.write_parquet(rows, folder / "ledger.parquet"),
        files.write_csv(rows, folder / "ledger.csv"),
    ]
    counts, to_draw = [], list(_FIGURES)
    for one in evidence:
        for study, runs in one.runs.groupby("study", sort=False) if "study" in one.runs else ():
            traces = one.traces[one.traces["run_id"].isin(runs["run_id"])]
            written += _write_study(runs, thinned(traces), to_draw, folder / str(study))
            counts.append(f"| `{study}` | {len(runs)} | {int(runs['budget'].max()):,} | {_ended(runs)} |")
    text = _readme(rows, counts, asked)
    (folder / "README.md").write_text(text, encoding="utf-8")
    return [*written, folder / "README.md"]


def write_printed(papers: Sequence[str], path: Path) -> Path:
    """Write every printed number of `papers`, with what to read and why where the print is wrong."""
    table = pd.DataFrame(
        {
            "paper": paper, "key": key, "place": entry.place, "unit": entry.unit, "printed": entry.printed,
            "read": entry.value, "certain": entry.certain, "why": entry.why.strip(), "doubt": entry.doubt.strip(),
        }
        for paper in papers for key, entry in quantities(paper).items()
    )  # fmt: skip
    table.to_csv(path, index=False)
    return path


def thinned(traces: pd.DataFrame) -> pd.DataFrame:
    """Return of each run's trace the first point and the last of each eighth of a decade, and so the last of all."""
    eighth = np.floor(_PER_DECADE * np.log10(traces["charged"].clip(lower=1))).astype(int)
    last = ~traces.assign(eighth=eighth).duplicated(["run_id", "eighth"], keep="last")
    return traces[last | ~traces.duplicated("run_id")].reset_index(drop=True)


def study_tables(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return by name the tables that are kept of a study: its summary, and the papers' tables it can fill."""
    summary = stats.summary(runs).drop(columns="wall_s_median")
    tables = {name: build(runs) for name, build in paper_tables.TABLES.items()}
    return {"summary": summary} | {name: table for name, table in tables.items() if not table.empty}


def _write_study(runs: pd.DataFrame, traces: pd.DataFrame, to_draw: list[str], folder: Path) -> list[Path]:
    """Write a study's files, and its figures that are still `to_draw`."""
    quiet = runs.assign(**dict.fromkeys(_NOISE)).reset_index(drop=True)
    written = ResultStore(folder).fill(quiet, traces)
    for name, table in study_tables(runs).items():
        written.append(folder / f"{name}.csv")
        table.to_csv(written[-1], index=False)
    wanted = {name: name for name in to_draw} | {f"{name}_{_OWN_GAUGE}": name for name in to_draw}
    for full_name, drawing in list(figures.study_figures(runs, traces, list(wanted), ADDITIONS)) if to_draw else ():
        name = wanted[full_name]
        to_draw.remove(name)
        svg, png, numbers = save(name, drawing, folder / "figures")
        svg.unlink()  # it is larger than all the rest, and drawn again from the rows
        numbers.unlink()
        written.append(png)
    return written


def _ended(runs: pd.DataFrame) -> str:
    counts = runs["stop_reason"].value_counts().sort_index()
    return ", ".join(f"{count} {reason}" for reason, count in counts.items())


def _readme(rows: Sequence[Row], counts: Sequence[str], asked: Asked) -> str:
    origin = provenance()
    verdicts = "\n".join(
        f"| {v} | {' | '.join(map(str, [sum(of.values()), *of.values()]))} |" for v, of in by_kind(rows).items()
    )
    commit = (origin["git_commit"][:10] or "unknown") + (" with changes" if origin["git_dirty"] else "")
    return f"""# Reference: one run of both papers, kept

Written by `make reference`, whose last step is `bench paper budget={asked.budget} seeds={asked.seeds} to=...`,
at commit {commit}, on {origin["platform"]}; the versions of all packages are in the rows.
Do not edit: a test holds these files to the papers' data files and to each other.

- `{PRINTED}`: every printed number, what to read, and why where the print is wrong.
- `ledger.parquet`, `ledger.csv`: the ledger (columns: `docs/ledger.md`).
- A folder a study: `runs.parquet` (without clocks), `traces.parquet` ({_PER_DECADE} points a decade), `summary.csv`,
  the papers' tables as `table2.csv` and so on, `figures/`. `bench report` on such a folder draws all other figures.

| verdict | rows | {" | ".join(KINDS)} |
|{"---|" * (2 + len(KINDS))}
{verdicts}

| study | runs | largest budget | ended by |
|---|---|---|---|
{chr(10).join(counts)}
"""
