"""Rerun the papers: carry out their studies (what is done is skipped), make the rows, write the ledger.

One print, one verdict: a row's `about` names the printed numbers it is about (a cell that repeats another, a sentence
that repeats a cell, an erratum of a cell). Rows that pass judgement on the same print agree, or say why they do not.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol, final

import pandas as pd

from calibench.bench.gate.processes import at_once
from calibench.bench.papers import cong2008, files, page, pashkevich2008, reference
from calibench.bench.papers.cong2008 import figures as printed_figures, stopping
from calibench.bench.papers.pashkevich2008 import experiments as orthoglide
from calibench.bench.papers.row import VERDICTS, Evidence, Row
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.carry_out import Report, carry_out
from calibench.bench.sweep.request import Request, read_request
from calibench.bench.sweep.studies import study_preset
from calibench.core.words import print_plain as print


class Paper(Protocol):
    """A paper's module: its key, the prepared studies that rerun it, and its rows."""

    @property
    def KEY(self) -> str: ...
    @property
    def STUDIES(self) -> Sequence[str]: ...
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
        reference.check_folder(Path(to))
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

    def experiments() -> tuple[list[Row], list[Path]]:
        return [], [orthoglide.write_page(folder / "orthoglide-experiments.md")]

    calls: list[Callable[[], tuple[list[Row], list[Path]]]]
    calls = [*(partial(of_paper, paper) for paper in PAPERS), experiments]
    made = at_once(calls)
    rows = agreed([row for some, _ in made for row in some])
    drawings = printed_figures.write(evidence[cong2008.KEY], folder / "figures")
    paths = [
        *files.write_ledger(rows, folder),
        page.write_page(rows, str(budget), folder / "ledger.html", {cong2008.KEY: drawings}),
        *(path for _, pages in made for path in pages), *drawings,
    ]  # fmt: skip
    every = [*evidence.values(), *([_carry_out(beside, report)] if beside else [])]
    if to is not None:
        asked = reference.Asked(str(budget), chosen, [paper.KEY for paper in PAPERS])
        paths += reference.write_reference(rows, every, asked, Path(to))
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
