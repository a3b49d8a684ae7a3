"""The ledger of the papers: each printed number, claim and erratum beside the result of a rerun, with a verdict.

A paper is a module with ``KEY``, ``STUDIES`` (prepared studies that rerun it) and ``rows(evidence)``; `PAPERS` lists
them. The verdicts are functions in `bench.papers.row`; `run_paper` carries out the studies and writes the three files.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibench.bench.papers.rerun import PAPERS, Ledger, run_paper
    from calibench.bench.papers.row import KINDS, VERDICTS, Ours, Row, Ruling, Tolerance, Verdict, judge

__all__ = [
    "KINDS", "PAPERS", "VERDICTS", "Ledger", "Ours", "Row", "Ruling", "Tolerance", "Verdict", "judge", "run_paper",
]  # fmt: skip

_OF_RERUN = ("PAPERS", "Ledger", "run_paper")


def __getattr__(name: str) -> Any:
    """Load a name when it is first asked for: ``bench report`` needs what a paper adds to it, and no rerun."""
    if name not in __all__:
        raise AttributeError(f"module 'bench.papers' has no attribute {name!r}")
    home = "rerun" if name in _OF_RERUN else "row"
    return getattr(import_module(f"calibench.bench.papers.{home}"), name)
