"""The topics of the ledger of Cong et al. 2008, in the order of the paper, each a function of (printed, evidence)."""

from __future__ import annotations

from calibench.bench.papers.cong2008 import errata, stopping, tracking
from calibench.bench.papers.cong2008.actual import actual_rows, column_rows, local_rows
from calibench.bench.papers.cong2008.machine import gauge_rows, machine_rows
from calibench.bench.papers.cong2008.search import reading_rows, search_rows

TOPICS = (
    machine_rows,
    tracking.rows,
    column_rows,
    local_rows,
    stopping.rows,
    gauge_rows,
    search_rows,
    reading_rows,
    actual_rows,
    errata.rows,
)
