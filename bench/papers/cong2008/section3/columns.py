"""Tables 2 to 4 of Cong et al. 2008: values, kmrmse and iterations where fmincon stopped, over plans and releases.

The method is the one that the paper names, from the printed start. Which configurations were sampled and which release
of MATLAB searched is not printed, and the numbers turn with both; so a cell is judged over all of them: each sampling
plan with each release of fmincon is one search, `share` says how many of these are within the band, and the verdict is
the best that half of them reach.

A band that could fail: a value agrees to print within one unit of its last digit. In kind it agrees where its *error*,
value less actual, is that of the print within a decade, as kmrmse must be: a search that stops nearer to the truth than
the printed one did, or farther from it, does not reproduce the column. The printed error itself would be no band: the
truth always lies within it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache

import numpy as np

from calibench.bench.papers.cong2008.section3.stopping import COLUMNS, PLANS, RELEASES, End, column
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row, Tolerance, judge, judge_share


def rows(printed: Printed, _: object) -> Iterator[Row]:
    """Yield the calibrated columns of Tables 2, 3 and 4 (11 values)."""
    for key in COLUMNS:
        if key != "table4.j3_12":  # its values are judged along its gauge curve: cong2008_gauge
            for name in printed.column(key):
                yield row(printed, key, name)


def row(printed: Printed, key: str, name: str) -> Row:
    """Return the row of a cell of a calibrated column, from the searches on every plan by every release."""
    cell = f"{key}.{name}"
    entry, tolerance = printed.column(key).entries[name], tolerance_of(printed, key, name)
    found = {release: [quantity(end, name) for end in ends] for release, ends in searches(key).items()}
    every = [value for values in found.values() for value in values]
    shares = [
        f"{sum(judge(entry.printed, entry.value, v, tolerance) != 'not reproduced' for v in values)} in {release}"
        for release, values in found.items()
    ]
    ruling = judge_share(entry.printed, entry.value, every, tolerance)
    plans = PLANS[COLUMNS[key][0]]
    reason = f"{ruling.share:.0%} of plans and releases are within the band: of {plans} plans {', '.join(shares)}"
    method = f"fmincon from the printed start, {plans} sampling plans in each of {len(found)} releases"
    return printed.cell(cell, every, tolerance, method, reason, ruling)


@cache
def searches(key: str) -> Mapping[str, list[End]]:
    """Return by release where the searches of a printed column end, one for each plan."""
    return {variant.release: column(key, variant) for variant in RELEASES}


def quantity(end: End, name: str) -> float:
    """Return a calibrated value, the kmrmse or the iterations of a search."""
    return {"kmrmse": end.kmrmse, "iterations": float(end.iterations), **end.values}[name]


def tolerance_of(printed: Printed, key: str, name: str) -> Tolerance:
    """Return how near to its print a number of this cell must be."""
    cell = f"{key}.{name}"
    if name == "iterations":
        return Tolerance(0.0, "a count; in kind within a factor of two", float(np.log10(2)), decades=True)
    entry, digit = printed.column(key).entries[name], printed.digit(cell)
    if name == "kmrmse":
        return Tolerance(digit / 2, "half a printed digit; in kind within a decade", 1.0, decades=True)
    actual = printed.column(f"{key.partition('.')[0]}.actual")[name]
    if entry.is_misprint:
        apart = abs(entry.printed - entry.value)
        return Tolerance(
            apart / 4, f"a quarter of what lies between the two readings, {apart:g} {entry.unit}: the cell asks which "
            "of them it is; how far the search stops from the truth is asked of the column's other cells",
        )  # fmt: skip
    if abs(entry.value - actual) < 0.5 * digit:
        return Tolerance(
            digit, "one unit of the last printed digit, which is cut off or rounded: no error is printed, so none in "
            "that digit may be ours",
        )  # fmt: skip
    return Tolerance(
        digit, "one unit of the last printed digit, which is cut off or rounded; in kind where the error, value "
        "less actual, is the printed one within a decade", 1.0,
        decades=True, origin=actual,
    )  # fmt: skip
