"""How often a run of one method beats a run of another: A12 = P(first better) + P(alike) / 2, with its interval.

0.5: none is better; 1: every run of the first beats every run of the second. The interval is Brunner and Munzel's
(2000) of unpaired runs, Munzel and Brunner's (2002) of pairs, on the logistic scale with Student's t; where all runs of
one beat all of the other their variance is 0, and the bound is that of Wilson for so many of so many runs.

Source: Vargha and Delaney, J. Educ. Behav. Stat. 25 (2000).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from calibench.bench.statistics.comparison.score import order_of

Array = NDArray[np.float64]


@final
@dataclass(frozen=True)
class Effect:
    """A12 of the first over the second, and its interval."""

    a12: float
    low: float
    high: float


def a12(first: Array, second: Array, paired: bool = False, level: float = 0.95) -> Effect:
    """Return the effect of `first` over `second`, scores of shapes (n, 2) and (m, 2), smaller is better.

    `paired`: the i-th of both belong together. The interval is (0, 1) of fewer than two runs of either.
    """
    from scipy.stats import t

    n, m = len(first), len(second)
    ranks = order_of(np.concatenate([first, second]))
    own = [order_of(first), order_of(second)]
    of_first = 1 - (ranks[:n] - own[0]) / m  # the share of the second that each run of the first beats
    of_second = (ranks[n:] - own[1]) / n  # the share of the first that beats each run of the second
    effect = float(of_first.mean())
    if n < 2 or m < 2:
        return Effect(effect, 0.0, 1.0)
    if paired:
        both = of_first + of_second
        variance, freedom = float(both.var(ddof=1)) / n, n - 1.0
    else:
        parts = float(of_first.var(ddof=1)) / n, float(of_second.var(ddof=1)) / m
        variance = sum(parts)
        below = parts[0] ** 2 / (n - 1) + parts[1] ** 2 / (m - 1)
        freedom = variance**2 / below if below else float(min(n, m) - 1)
    if not 0 < effect < 1 or variance <= 0:
        return _by_wilson(effect, min(n, m), level)
    middle = np.log(effect / (1 - effect))
    reach = float(t.ppf((1 + level) / 2, freedom)) * np.sqrt(variance) / (effect * (1 - effect))
    low, high = (1 / (1 + np.exp(-(middle + side * reach))) for side in (-1, 1))
    return Effect(effect, float(low), float(high))


def _by_wilson(effect: float, n: int, level: float) -> Effect:
    """Return Wilson's interval for a share `effect` of `n`: what complete separation of n runs still allows."""
    from scipy.stats import norm

    z2 = float(norm.ppf((1 + level) / 2)) ** 2
    middle = (effect + z2 / (2 * n)) / (1 + z2 / n)
    reach = np.sqrt(z2 * (effect * (1 - effect) / n + z2 / (4 * n * n))) / (1 + z2 / n)
    return Effect(effect, max(0.0, float(middle - reach)), min(1.0, float(middle + reach)))
