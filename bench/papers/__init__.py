"""The ledger of the papers: each printed number, claim and erratum beside what a rerun gives, with a verdict.

A paper is a module with ``KEY``, ``STUDIES`` (prepared studies that rerun it) and ``rows(evidence)``; `PAPERS` lists
them. The verdicts are functions in `bench.papers.row`; `run_paper` carries out the studies and writes the three files.
"""

from __future__ import annotations

from calibench.bench.papers.rerun import PAPERS, Ledger, run_paper
from calibench.bench.papers.row import KINDS, VERDICTS, Ours, Row, Ruling, Tolerance, Verdict, judge

__all__ = [
    "KINDS", "PAPERS", "VERDICTS", "Ledger", "Ours", "Row", "Ruling", "Tolerance", "Verdict", "judge", "run_paper",
]  # fmt: skip
