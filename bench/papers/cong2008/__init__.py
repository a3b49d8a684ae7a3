"""The ledger of Cong et al. 2008: its topics in the order of the paper, and its findings in sentences."""

from collections.abc import Iterator

from calibench.bench.papers.ledger import Evidence, Printed, Row

KEY = "cong2008"
STUDIES: tuple[str, ...] = ("cong2008", "cong2008_plans", "cong2008_readings", "cong2008_circle")


def rows(evidence: Evidence) -> Iterator[Row]:
    """Yield every row: a printed number, a claim or an erratum each."""
    # no report needs these
    from calibench.bench.papers.cong2008 import actual, machine, search, stopping

    for topic in (
        machine.machine_rows, machine.tracking_rows, actual.column_rows, actual.claim_rows, stopping.rows,
        machine.gauge_rows, search.search_rows, search.reading_rows, actual.actual_rows, search.erratum_rows,
    ):  # fmt: skip
        yield from topic(Printed(KEY), evidence)
