"""One print, one verdict: rows that pass judgement on the same printed number agree, or say why they do not.

A row's `about` names the printed numbers it is about. A cell that repeats another, a sentence that repeats a cell, an
erratum of a cell: each is compared with the row of the key it names.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from calibench.bench.papers.row import Row


def agreed(rows: Sequence[Row]) -> list[Row]:
    """Return the rows; an explanation is kept only where the verdict differs from that of the row's subject."""
    apart = {id(row) for row, _ in differing(rows)}
    return [row if id(row) in apart else replace(row, differs="") for row in rows]


def unexplained(rows: Sequence[Row]) -> list[str]:
    """Return a sentence for each pair of rows about one print whose verdicts differ without an explanation."""
    return [
        f"{row.paper} {row.key}: {row.verdict}, but {other.key}: {other.verdict}"
        for row, other in differing(rows)
        if not row.differs
    ]


def differing(rows: Sequence[Row]) -> Iterator[tuple[Row, Row]]:
    """Yield each row beside the row of a print it is about, where their verdicts differ.

    Raises `KeyError` where a row is about a key that has no row.
    """
    by_key = {(row.paper, row.key): row for row in rows}
    for row in rows:
        for key in row.about.split():
            other = by_key[row.paper, key]
            if other.verdict != row.verdict:
                yield row, other
