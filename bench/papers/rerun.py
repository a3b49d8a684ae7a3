"""Rerun the papers: carry out their studies (what is done is skipped), make the rows, write the ledger.

One print, one verdict: a row's `about` names the printed numbers it is about (a cell that repeats another, a sentence
that repeats a cell, an erratum of a cell). Rows that pass judgement on the same print agree, or say why they do not.

The reference, ``results/reference/``, is one full run, small enough to commit, without times of day: the printed
numbers, the ledger, and of each study the runs, thinned traces, the papers' tables and figures. A study folder of it
reads as any other: ``bench report results/reference/cong2008`` draws everything again.
"""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol, final

import numpy as np
import pandas as pd

from calibench.bench.gate.processes import at_once
from calibench.bench.papers import ADDITIONS, cong2008, page, pashkevich2008
from calibench.bench.papers.cong2008 import figures as printed_figures, stopping
from calibench.bench.papers.ledger import KINDS, VERDICTS, Evidence, Row, quantities, write_ledger
from calibench.bench.papers.page import by_kind
from calibench.bench.papers.pashkevich2008 import experiments as orthoglide
from calibench.bench.provenance.environment import provenance
from calibench.bench.report.shared.drawing import save
from calibench.bench.report.study import figures
from calibench.bench.statistics import summary as stats
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.carry_out import Report, carry_out
from calibench.bench.sweep.composition import study_preset
from calibench.bench.sweep.request import Request, read_request
from calibench.core.words import print_plain as print


class Paper(Protocol):
    """A paper's module: its key, the prepared studies that rerun it, and its rows."""

    KEY: str
    STUDIES: tuple[str, ...]

    def rows(self, evidence: Evidence, /) -> Iterator[Row]: ...


PAPERS: tuple[Paper, ...] = (cong2008, pashkevich2008)
_BESIDE = ("pashkevich2008",)  # studies that no row of the ledger needs and the reference keeps


@final
@dataclass(frozen=True)
class Ledger:
    """What a rerun came to: rows, the files that hold them, and the runs that failed."""

    rows: tuple[Row, ...]
    paths: tuple[Path, ...]
    failed: int

    def counts(self, paper: str | None = None, kind: str | None = None) -> dict[str, int]:
        """Return how many rows, of one paper and kind or of all, have each verdict."""
        mine = [row for row in self.rows if paper in (None, row.paper) and kind in (None, row.kind)]
        return {verdict: sum(row.verdict == verdict for row in mine) for verdict in VERDICTS}


def run_paper(
    budget: str | int = "ci", results: str | Path = "results", seeds: str | int | None = None,
    execution: str = "processes", report: Report = lambda done, of, label: None, to: str | Path | None = None,
) -> Ledger:  # fmt: skip
    """Rerun the papers with `budget` and write ``<results>/paper/ledger.{parquet,csv,html}``.

    `budget` is ci, paper, or a number of evaluations; `seeds` as of ``bench run``, by default those of the budget.
    What is in ``<results>/<study>/`` is not run again. With `to`, the reference of this rerun is written there.
    """
    if to is not None:
        check_folder(Path(to))
    chosen = str(seeds if seeds is not None else budget if isinstance(budget, str) else "ci")

    def request(study: str) -> Request:
        limit = (study_preset(study) or {}).get("budget")  # a study with a budget of its own is only made smaller
        keeps_its_own = isinstance(limit, int) and (isinstance(budget, str) or budget >= limit)
        given = [] if keeps_its_own else [f"budget={budget}", f"seeds={chosen}"]
        return read_request([f"study={study}", *given, f"results={results}", f"execution={execution}"], multirun=False)

    requests = {paper.KEY: [request(study) for study in paper.STUDIES] for paper in PAPERS}
    beside = [] if to is None else [request(study) for study in _BESIDE]
    evidence = {key: _carry_out(mine, report) for key, mine in requests.items()}
    folder = Path(results) / "paper"

    # papers are computed at once, and with them the pages beside the ledger, of what is computed now
    def of_paper(paper: Paper) -> tuple[list[Row], list[Path]]:
        rows = list(paper.rows(evidence[paper.KEY]))
        return rows, [stopping.write_table(folder / "cong2008-stopping.md")] if paper is cong2008 else []

    calls: list[Callable[[], tuple[list[Row], list[Path]]]] = [partial(of_paper, paper) for paper in PAPERS]
    made = at_once([*calls, lambda: ([], [orthoglide.write_page(folder / "orthoglide-experiments.md")])])
    rows = agreed([row for some, _ in made for row in some])
    runs, traces = evidence[cong2008.KEY].runs, evidence[cong2008.KEY].traces
    mine = runs[runs["study"] == cong2008.KEY]  # of the paper's own study, which may fill its figures
    drawings = [
        save(name, printed_figures.draw(error, mine, traces), folder / "figures")[0]
        for name, error in printed_figures.FIGURES.items()
        if printed_figures.applies(error, mine)
    ]
    paths = [
        *write_ledger(rows, folder),
        page.write_page(rows, str(budget), folder / "ledger.html", {cong2008.KEY: drawings}),
        *(path for _, pages in made for path in pages), *drawings,
    ]  # fmt: skip
    every = [*evidence.values(), *([_carry_out(beside, report)] if beside else [])]
    if to is not None:
        paths += write_reference(rows, every, f"budget={budget} seeds={chosen}", Path(to))
    return Ledger(tuple(rows), tuple(paths), sum(int((one.runs["status"] == "failed").sum()) for one in every))


def _carry_out(requests: Sequence[Request], report: Report) -> Evidence:
    """Run what is left of the requests, and return their runs: others in the same folders are not looked at."""
    if not requests:  # a paper that needs no runs
        return Evidence(pd.DataFrame({"status": []}), pd.DataFrame({"run_id": []}))
    runs: list[pd.DataFrame] = []
    traces: list[pd.DataFrame] = []
    for request in requests:
        outcome = carry_out(request, report, way="rerun", tell=lambda line: print(f"bench: {line}", file=sys.stderr))
        store = ResultStore(request.folder)
        for kept, table in ((runs, store.runs()), (traces, store.traces())):
            kept.append(table[table["run_id"].isin(outcome.asked)])
    return Evidence(pd.concat(runs, ignore_index=True), pd.concat(traces, ignore_index=True))


def agreed(rows: Sequence[Row]) -> list[Row]:
    """Return the rows; an explanation is kept only where the verdict differs from that of the row's subject."""
    apart = {id(row) for row, _ in differing(rows)}
    return [row if id(row) in apart else replace(row, differs="") for row in rows]


def differing(rows: Sequence[Row]) -> Iterator[tuple[Row, Row]]:
    """Yield each row beside the row of a print it is about, where their verdicts differ."""
    by_key = {(row.paper, row.key): row for row in rows}
    for row in rows:
        for key in row.about.split():
            other = by_key[row.paper, key]
            if other.verdict != row.verdict:
                yield row, other


PRINTED = "printed.csv"
_NOISE = ["wall_s", "cpu_s", "started_at"]
_PER_DECADE = 8
# of all figures those that show what the papers show: Figs 3 to 5 and what they cost, the gauge, the plans, Table 2
_FIGURES = (
    *printed_figures.FIGURES, "convergence_full12", "target_full12", "gauge", "plans", "orthoglide_residuals",
)  # fmt: skip
_OWN_GAUGE = "gaugexa2"  # what a figure's name ends in where a study has other gauges too


def check_folder(folder: Path) -> None:
    """Raise `StoreError` where a reference cannot be written: files that are none of ours stand there."""
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir()) and not (folder / PRINTED).exists()):
        raise StoreError(f"to={folder}: holds something else (no {PRINTED}); take an empty folder, or a reference")


def write_reference(rows: Sequence[Row], evidence: Sequence[Evidence], asked: str, folder: Path) -> list[Path]:
    """Write the reference of a ledger and its runs into `folder`, in place of one that is there; return the paths.

    `asked` are the words of ``bench paper`` that made them.
    """
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    papers = dict.fromkeys(row.paper for row in rows)
    written = [write_printed(papers, folder / PRINTED), *write_ledger(rows, folder)]
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
            for full_name, draw in list(figures.drawable(runs, traces, ADDITIONS)) if to_draw else ():
                if full_name not in wanted:
                    continue
                to_draw.remove(wanted[full_name])
                svg, png, numbers = save(wanted[full_name], draw(), home / "figures")
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

Written by `make reference`, whose last step is `bench paper {asked} to=...`,
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


def write_printed(papers: Iterable[str], path: Path) -> Path:
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
