"""The ledger of Pashkevich et al. 2008: its topics in the order of the paper. No study reruns it: it only fits."""

from __future__ import annotations

from collections.abc import Iterator

from calibench.bench.papers.evidence import Evidence
from calibench.bench.papers.pashkevich2008 import assumptions as pashkevich2008_assumptions
from calibench.bench.papers.pashkevich2008 import claims as pashkevich2008_claims
from calibench.bench.papers.pashkevich2008 import equations as pashkevich2008_equations
from calibench.bench.papers.pashkevich2008 import errata as pashkevich2008_errata
from calibench.bench.papers.pashkevich2008 import machine as pashkevich2008_machine
from calibench.bench.papers.pashkevich2008 import tables as pashkevich2008_tables
from calibench.bench.papers.pashkevich2008 import text as pashkevich2008_text
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row

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
