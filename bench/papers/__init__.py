"""The ledger of the papers: each printed number, claim and erratum beside the result of a rerun, with a verdict.

A paper is a module with ``KEY``, ``STUDIES`` (prepared studies that rerun it) and ``rows(evidence)``; `rerun.PAPERS`
lists them. The verdicts are functions in `ledger`; `rerun.run_paper` carries out the studies and writes the files.
`ADDITIONS` is what the papers add to the report of a study: the command hands it to the report, which knows no paper.
"""

from calibench.bench.papers.cong2008 import figures as _cong2008
from calibench.bench.papers.pashkevich2008 import figures as _pashkevich2008
from calibench.bench.report.study.additions import Addition

_LEDGER = {"the ledger of the papers": "../paper/ledger.html"}

ADDITIONS = (
    _cong2008.ADDITION, _pashkevich2008.ADDITION,
    Addition(links=lambda folder: _LEDGER if (folder.parent / "paper" / "ledger.html").exists() else {}),
)  # fmt: skip
