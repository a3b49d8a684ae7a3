"""What the papers add to the report of a study. The command hands it to the report, which knows no paper."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from calibench.bench.papers.cong2008 import figures as cong2008
from calibench.bench.papers.pashkevich2008 import figures as pashkevich2008
from calibench.bench.report.study.additions import Addition


def _ledger_beside(folder: Path) -> Mapping[str, str]:
    there = (folder.parent / "paper" / "ledger.html").exists()
    return {"the ledger of the papers": "../paper/ledger.html"} if there else {}


ADDITIONS = (cong2008.ADDITION, pashkevich2008.ADDITION, Addition(links=_ledger_beside))
