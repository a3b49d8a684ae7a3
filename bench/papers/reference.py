"""The reference, ``results/reference/``: one full run of the papers, small enough to commit, without times of day.

It has the printed numbers, the ledger, and of each study the runs, thinned traces, the papers' tables and figures.
A study folder of it reads as any other: ``bench report results/reference/cong2008`` draws everything again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np
import pandas as pd

from calibench.bench.papers import ADDITIONS, files
from calibench.bench.papers.cong2008 import figures as printed_figures
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
    written = [write_printed(asked.papers, folder / PRINTED), *files.write_ledger(rows, folder)]
    counts, to_draw = [], list(_FIGURES)
    for one in evidence:
        for study, runs in one.runs.groupby("study", sort=False) if "study" in one.runs else ():
            home, traces = folder / str(study), thinned(one.traces[one.traces["run_id"].isin(runs["run_id"])])
            quiet = runs.assign(**dict.fromkeys(_NOISE)).reset_index(drop=True)
            written += ResultStore(home).fill(quiet, traces)
            for name, table in study_tables(runs).items():
                written.append(home / f"{name}.csv")
                table.to_csv(written[-1], index=False)
            wanted = {name: name for name in to_draw} | {f"{name}_{_OWN_GAUGE}": name for name in to_draw}
            drawn = figures.study_figures(runs, traces, list(wanted), ADDITIONS) if to_draw else ()
            for full_name, drawing in list(drawn):
                to_draw.remove(wanted[full_name])
                svg, png, numbers = save(wanted[full_name], drawing, home / "figures")
                svg.unlink()  # it is larger than all the rest, and drawn again from the rows
                numbers.unlink()
                written.append(png)
            ended = runs["stop_reason"].value_counts().sort_index()
            reasons = ", ".join(f"{count} {reason}" for reason, count in ended.items())
            counts.append(f"| `{study}` | {len(runs)} | {int(runs['budget'].max()):,} | {reasons} |")
    origin = provenance()
    verdicts = "\n".join(
        f"| {v} | {' | '.join(map(str, [sum(of.values()), *of.values()]))} |" for v, of in by_kind(rows).items()
    )
    commit = (origin["git_commit"][:10] or "unknown") + (" with changes" if origin["git_dirty"] else "")
    text = f"""# Reference: one run of both papers, kept

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
    tables = {name: build(runs) for name, build in printed_figures.TABLES.items()}
    return {"summary": summary} | {name: table for name, table in tables.items() if not table.empty}
