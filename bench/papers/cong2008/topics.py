"""The topics of the ledger of Cong et al. 2008, in the order of the paper, each with ``rows(printed, evidence)``."""

from __future__ import annotations

from calibench.bench.papers.cong2008 import errata as cong2008_errata
from calibench.bench.papers.cong2008 import gauge as cong2008_gauge
from calibench.bench.papers.cong2008 import machine as cong2008_machine
from calibench.bench.papers.cong2008 import tracking as cong2008_tracking
from calibench.bench.papers.cong2008.section3 import actual as cong2008_actual
from calibench.bench.papers.cong2008.section3 import columns as cong2008_columns
from calibench.bench.papers.cong2008.section3 import local as cong2008_local
from calibench.bench.papers.cong2008.section3 import stopping_claims as cong2008_stopping_claims
from calibench.bench.papers.cong2008.section4 import readings as cong2008_readings
from calibench.bench.papers.cong2008.section4 import search as cong2008_search

TOPICS = (
    cong2008_machine,
    cong2008_tracking,
    cong2008_columns,
    cong2008_local,
    cong2008_stopping_claims,
    cong2008_gauge,
    cong2008_search,
    cong2008_readings,
    cong2008_actual,
    cong2008_errata,
)
