"""A row of the ledger, and the functions of numbers that give it its verdict.

A verdict is never written by hand: a row is made from what is printed, what to read, what a rerun or recomputation
gave, and a tolerance with its reason; the functions here say what follows.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import inf, isfinite, log10, nan
from typing import Literal, final

import numpy as np

Verdict = Literal[
    "reproduced",
    "reproduced in kind",
    "misprint, corrected",
    "artefact of the stopping tolerance",
    "depends on the release",
    "not reproduced",
    "not checkable",
]
VERDICTS: tuple[Verdict, ...] = (
    "reproduced",
    "reproduced in kind",
    "misprint, corrected",
    "artefact of the stopping tolerance",
    "depends on the release",
    "not reproduced",
    "not checkable",
)


@final
@dataclass(frozen=True)
class Ours:
    """What we computed: median and quartiles of n numbers. Those that are not finite are left out; n may be 0."""

    median: float
    q1: float
    q3: float
    n: int

    @staticmethod
    def of(values: Iterable[float] | float) -> Ours:
        """Return the summary of one number or many."""
        numbers = np.atleast_1d(np.asarray(values if isinstance(values, float | int) else list(values), dtype=float))
        numbers = numbers[np.isfinite(numbers)]
        if not numbers.size:
            return NOTHING
        q1, median, q3 = (float(q) for q in np.quantile(numbers, [0.25, 0.5, 0.75]))
        return Ours(median, q1, q3, int(numbers.size))


NOTHING = Ours(nan, nan, nan, 0)


@final
@dataclass(frozen=True)
class Tolerance:
    """How near is the same number (`exact`), how near is the same in kind, and why.

    `in_kind` is an absolute distance in the row's unit, or with ``decades=True`` a distance of decimal logarithms.
    """

    exact: float
    why: str
    in_kind: float = nan
    decades: bool = False

    def same(self, ours: float, other: float) -> bool:
        """Tell whether two numbers are the same to print."""
        return abs(ours - other) <= self.exact

    def same_in_kind(self, ours: float, other: float) -> bool:
        """Tell whether two numbers are the same in kind; never where no such tolerance was given."""
        if not isfinite(self.in_kind):
            return False
        return (decades_between(ours, other) if self.decades else abs(ours - other)) <= self.in_kind


@final
@dataclass(frozen=True)
class Row:
    """A row of the ledger. Its fields are the columns of ``ledger.parquet``."""

    paper: str
    key: str
    place: str
    quantity: str
    unit: str
    printed: float
    read: float
    ours_median: float
    ours_q1: float
    ours_q3: float
    n: int
    tolerance: float
    tolerance_in_kind: float
    tolerance_in_decades: bool
    why_tolerance: str
    verdict: Verdict
    reason: str
    method: str


def make_row(
    paper: str,
    key: str,
    place: str,
    quantity: str,
    unit: str,
    printed: float,
    read: float,
    ours: Ours,
    tolerance: Tolerance,
    verdict: Verdict,
    reason: str,
    method: str,
) -> Row:
    """Return the row of these parts."""
    return Row(
        paper, key, place, quantity, unit, float(printed), float(read), ours.median, ours.q1, ours.q3, ours.n,
        tolerance.exact, tolerance.in_kind, tolerance.decades, tolerance.why, verdict, " ".join(reason.split()), method,
    )  # fmt: skip


def judge(printed: float, read: float, ours: float, tolerance: Tolerance) -> Verdict:
    """Return the verdict on a printed number. `printed` is NaN where nothing legible stands there.

    A misprint is where ours agrees with what to read, to print or in kind, and with what is printed does not.

    >>> half = Tolerance(0.05, "half a digit")
    >>> judge(244.5, 243.5, 243.52, half), judge(243.5, 243.5, 243.52, half), judge(243.5, 243.5, 244.0, half)
    ('misprint, corrected', 'reproduced', 'not reproduced')
    """
    if not isfinite(ours):
        return "not checkable"
    if tolerance.same(ours, printed):
        return "reproduced"
    corrected = printed != read
    if corrected and tolerance.same(ours, read):
        return "misprint, corrected"
    if tolerance.same_in_kind(ours, printed):
        return "reproduced in kind"
    if corrected and tolerance.same_in_kind(ours, read):
        return "misprint, corrected"
    return "not reproduced"


def judge_limit(ours: float, below: float, below_in_kind: float = -inf) -> Verdict:
    """Return the verdict on a claim that holds where a number is at or below `below`, in kind to `below_in_kind`.

    >>> judge_limit(0.5, 1.0), judge_limit(1.5, 1.0, 2.0), judge_limit(3.0, 1.0, 2.0)
    ('reproduced', 'reproduced in kind', 'not reproduced')
    """
    if not isfinite(ours):
        return "not checkable"
    if ours <= below:
        return "reproduced"
    return "reproduced in kind" if ours <= below_in_kind else "not reproduced"


def judge_level(
    printed: float, ours: Ours, budget: float, printed_budget: float, ranking_holds: bool, decades: float
) -> Verdict:
    """Return the verdict on the level that a search is said to reach with `printed_budget` evaluations.

    With less budget a search can only be higher: then the ranking decides, in kind or not at all. A search that is
    `decades` below what is printed, with no more budget, refutes it at any; above it, only with the whole budget.

    >>> judge_level(1e3, Ours.of(12.0), 20_000, 5e7, True, 1.0)
    'not reproduced'
    >>> judge_level(1e-14, Ours.of(12.0), 20_000, 5e7, True, 1.0)
    'reproduced in kind'
    """
    if not isfinite(ours.median):
        return "not checkable"
    if decades_between(ours.median, printed) <= decades:
        return "reproduced in kind"
    below = ours.median < printed
    if below or budget >= printed_budget:
        return "not reproduced"
    return "reproduced in kind" if ranking_holds else "not checkable"


def judge_ranking(holds: bool, budget: float, printed_budget: float) -> Verdict:
    """Return the verdict on an order that is said of `printed_budget` evaluations.

    With less it holds in kind, or shows nothing: the order may still come about.
    """
    if budget >= printed_budget:
        return "reproduced" if holds else "not reproduced"
    return "reproduced in kind" if holds else "not checkable"


def decades_between(a: float, b: float) -> float:
    """Return the distance of two numbers in decades; infinite unless both are above 0."""
    return abs(log10(a / b)) if a > 0 and b > 0 else inf
