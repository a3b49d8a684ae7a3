"""The topics of the ledger of Pashkevich et al. 2008, in the order of the paper, each a function of (printed)."""

from __future__ import annotations

from calibench.bench.papers.pashkevich2008 import errata, figures, machine
from calibench.bench.papers.pashkevich2008.claims import assumption_rows, claim_rows, equation_rows, text_rows

TOPICS = (
    machine.rows,
    equation_rows,
    figures.rows,
    text_rows,
    claim_rows,
    assumption_rows,
    errata.rows,
)
