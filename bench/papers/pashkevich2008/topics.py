"""The topics of the ledger of Pashkevich et al. 2008, in the order of the paper, each with ``rows(printed)``."""

from __future__ import annotations

from calibench.bench.papers.pashkevich2008 import assumptions as pashkevich2008_assumptions
from calibench.bench.papers.pashkevich2008 import claims as pashkevich2008_claims
from calibench.bench.papers.pashkevich2008 import equations as pashkevich2008_equations
from calibench.bench.papers.pashkevich2008 import errata as pashkevich2008_errata
from calibench.bench.papers.pashkevich2008 import machine as pashkevich2008_machine
from calibench.bench.papers.pashkevich2008 import tables as pashkevich2008_tables
from calibench.bench.papers.pashkevich2008 import text as pashkevich2008_text

TOPICS = (
    pashkevich2008_machine,
    pashkevich2008_equations,
    pashkevich2008_tables,
    pashkevich2008_text,
    pashkevich2008_claims,
    pashkevich2008_assumptions,
    pashkevich2008_errata,
)
