"""The ledger of Cong et al. 2008: its topics in the order of the paper, and its findings in sentences."""

from __future__ import annotations

from collections.abc import Iterator

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
from calibench.bench.papers.evidence import Evidence
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row

KEY = "cong2008"
STUDIES = ("cong2008", "cong2008_plans", "cong2008_readings", "cong2008_circle")
_TOPICS = (
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


def rows(evidence: Evidence) -> Iterator[Row]:
    """Yield every row: a printed number, a claim or an erratum each."""
    for topic in _TOPICS:
        yield from topic.rows(Printed(KEY), evidence)
