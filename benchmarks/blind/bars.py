"""A bar is met, open or missed: what the whole 95 % interval says, and never the value alone."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite, isnan, sqrt
from typing import Literal

import numpy as np
from scipy.stats import quantile_test, t as student

Verdict = Literal["met", "open", "missed"]
Interval = tuple[float, float] | tuple[None, None]


def verdict(low: float | None, high: float | None, bar: str) -> Verdict | None:
    """Return met where low .. high lies whole on the good side of `bar`, missed where on the bad side, else open.

    `bar` is as the table prints it: ``>= 0.93``, ``<= 1.4``, ``< 0.5``, ``0.90-0.98``. None without bar or interval.
    """
    if not bar or low is None or high is None:
        return None
    least, most = limits(bar)
    strict = bar.startswith("<") and not bar.startswith("<=")
    if least <= low and (high < most if strict else high <= most):
        return "met"
    return "missed" if high < least or (low >= most if strict else low > most) else "open"


def limits(bar: str) -> tuple[float, float]:
    """Return the least and the most that `bar` allows."""
    sign, _, number = bar.partition(" ")
    if number:
        return (float(number), inf) if sign == ">=" else (-inf, float(number))
    least, _, most = bar.partition("-")
    return float(least), float(most)


def median_interval(values: Sequence[float]) -> Interval:
    """Return the 95 % interval of the median, from the order of `values`; none of fewer than six."""
    if len(values) < 6:
        return None, None
    low, high = (float(v) for v in quantile_test(values, p=0.5).confidence_interval(0.95))
    return (None, None) if isnan(low) or isnan(high) else (low, high)


def mean_interval(values: Sequence[float]) -> Interval:
    """Return Student's 95 % interval of the mean; none of fewer than ten, where it is too rough."""
    n = len(values)
    if n < 10:
        return None, None
    half = float(student.ppf(0.975, n - 1)) * float(np.std(values, ddof=1)) / sqrt(n)
    mean = float(np.mean(values))
    return (mean - half, mean + half) if isfinite(half) else (None, None)
