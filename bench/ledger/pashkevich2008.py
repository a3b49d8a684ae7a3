"""The ledger of Pashkevich et al. 2008: its topics in the order of the paper. No study reruns it: it only fits."""

from __future__ import annotations

from collections.abc import Iterator

from bench.ledger import (
    pashkevich2008_assumptions,
    pashkevich2008_claims,
    pashkevich2008_equations,
    pashkevich2008_errata,
    pashkevich2008_machine,
    pashkevich2008_tables,
    pashkevich2008_text,
)
from bench.ledger.evidence import Evidence
from bench.ledger.printed import Printed
from bench.ledger.row import Row

KEY = "pashkevich2008"
STUDIES: tuple[str, ...] = ()
_TOPICS = (
    pashkevich2008_machine,
    pashkevich2008_equations,
    pashkevich2008_tables,
    pashkevich2008_text,
    pashkevich2008_claims,
    pashkevich2008_assumptions,
    pashkevich2008_errata,
)


def rows(evidence: Evidence) -> Iterator[Row]:
    """Yield every row: a printed number, a claim or an erratum each."""
    for topic in _TOPICS:
        yield from topic.rows(Printed(KEY))
