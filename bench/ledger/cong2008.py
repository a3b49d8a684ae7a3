"""The ledger of Cong et al. 2008: its topics in the order of the paper, and its findings in sentences."""

from __future__ import annotations

from collections.abc import Iterator

from bench.ledger import (
    cong2008_actual,
    cong2008_columns,
    cong2008_errata,
    cong2008_gauge,
    cong2008_local,
    cong2008_machine,
    cong2008_readings,
    cong2008_search,
    cong2008_stopping_claims,
    cong2008_tracking,
)
from bench.ledger.evidence import Evidence
from bench.ledger.printed import Printed
from bench.ledger.row import Row

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
