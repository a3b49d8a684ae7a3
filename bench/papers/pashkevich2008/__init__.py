"""The ledger of Pashkevich et al. 2008: its topics in the order of the paper. No study reruns it: it only fits."""

from collections.abc import Iterator

from calibench.bench.papers.ledger import Evidence, Printed, Row

KEY = "pashkevich2008"
STUDIES: tuple[str, ...] = ()


def rows(evidence: Evidence) -> Iterator[Row]:
    """Yield every row: a printed number, a claim or an erratum each."""
    from calibench.bench.papers.pashkevich2008 import claims, figures, machine  # no report needs it

    for topic in (
        machine.rows, claims.equation_rows, figures.rows, claims.text_rows, claims.identification_rows,
        claims.improvement_rows, claims.assumption_rows, claims.erratum_rows,
    ):  # fmt: skip
        yield from topic(Printed(KEY))
