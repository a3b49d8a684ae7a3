"""Two sets of runs of one cell: which is better, by a test that fits how they belong together, and by how much.

Pairs (the same repetition of the same problem: the same data and start) are tested by Wilcoxon's signed-rank test on
the differences of their ranks among all runs of both: where nothing differs, a pair may be exchanged, which only turns
the sign of its difference. Runs without partners are tested by Mann and Whitney's test, and the runs of one side beside
the one value of a side without chance by the sign test. All look at the order of runs alone (`scores`). The p-values
are exact, ties and all, of up to 60 pairs and of up to 80 runs without partners; beyond they are by SciPy's normal
approximation with its correction for ties.

How much is A12 = P(first better) + P(alike) / 2. Its interval is Brunner and Munzel's (2000) of unpaired runs, Munzel
and Brunner's (2002) of pairs, on the logistic scale with Student's t.

Source: Vargha and Delaney, J. Educ. Behav. Stat. 25 (2000).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, nan
from typing import Literal, final

import numpy as np
from numpy.typing import NDArray

from calibench.bench.statistics.ranking import order_of_scores as order_of

Array = NDArray[np.float64]
_MOST_PAIRS = 60  # whose exchanges are all counted
_MOST_RUNS = 80  # of both sides, whose exchanges are all counted
Test = Literal["signed-rank", "Mann-Whitney", "sign", "equal", "fact", "none"]


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
    from scipy.stats import norm, t

    n, m = len(first), len(second)
    ranks = order_of(np.concatenate([first, second]))
    within = [order_of(first), order_of(second)]
    of_first = 1 - (ranks[:n] - within[0]) / m  # the share of the second that each run of the first beats
    of_second = (ranks[n:] - within[1]) / n  # the share of the first that beats each run of the second
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
    if not 0 < effect < 1 or variance <= 0:  # what complete separation of n runs still allows: Wilson's interval
        k, z2 = min(n, m), float(norm.ppf((1 + level) / 2)) ** 2
        middle = (effect + z2 / (2 * k)) / (1 + z2 / k)
        reach = np.sqrt(z2 * (effect * (1 - effect) / k + z2 / (4 * k * k))) / (1 + z2 / k)
        return Effect(effect, max(0.0, float(middle - reach)), min(1.0, float(middle + reach)))
    middle = np.log(effect / (1 - effect))
    reach = float(t.ppf((1 + level) / 2, freedom)) * np.sqrt(variance) / (effect * (1 - effect))
    low, high = (1 / (1 + np.exp(-(middle + side * reach))) for side in (-1, 1))
    return Effect(effect, float(low), float(high))


@final
@dataclass(frozen=True, kw_only=True)
class Tested:
    """What a test of two sets of runs says: `p` two-sided, `sign_p` of the sign test (of pairs, else NaN).

    `runs` of the first and second; `pairs` (0: unpaired); `p_least` the least p that so many runs can give. `test`:
    "equal" where the runs are the same in every score, "fact" where neither side has chance in it and both differ,
    "none" where no test can be made; then p is NaN. `effect` is A12 of the second over the first. `ahead`: 1 where the
    second is, -1 where the first is, 0 where neither is: many pairs that differ a little may lean to one side, and few
    that differ much to the other, so that the test of pairs and A12 contradict each other.
    """

    test: Test
    runs: tuple[int, int]
    effect: Effect
    pairs: int = 0
    p: float = nan
    p_least: float = nan
    sign_p: float = nan
    ahead: int = 0


def two_methods(first: Array, second: Array, paired: bool, chance: tuple[bool, bool] = (True, True)) -> Tested:
    """Return the test of the runs `first`, scores of shape (n, 2), against `second`, shape (m, 2).

    `paired`: the i-th of both belong together. `chance` tells of both whether it has a part: where it has none in
    either, a difference is a fact, and not tested.
    """
    n, m = runs = len(first), len(second)
    pairs = n if paired else 0
    if not n or not m:
        return Tested(test="none", runs=runs, pairs=pairs, effect=Effect(nan, 0.0, 1.0))
    effect = a12(second, first, paired)
    ahead = int(np.sign(effect.a12 - 0.5))
    alike = first == second if paired else np.sort(first, axis=0) == np.sort(second, axis=0) if n == m else False
    if np.all(alike):
        return Tested(test="equal", runs=runs, pairs=pairs, effect=effect)
    if not any(chance):
        return Tested(test="fact", runs=runs, pairs=pairs, effect=effect, ahead=ahead)
    if not all(chance):
        signs = beside_fixed(first, second) if chance[1] else -beside_fixed(second, first)
        p, least = _sign(signs), min(1.0, 2.0 ** (1 - len(signs)))
        return Tested(test="sign", runs=runs, p=p, p_least=least, sign_p=p, effect=effect, ahead=ahead)
    ranks = order_of(np.concatenate([first, second]))
    if not paired:
        p, least = min(1.0, 2 * min(rank_sum_tails(ranks[:n], ranks[n:]))), min(1.0, 2.0 / comb(n + m, n))
        return Tested(test="Mann-Whitney", runs=runs, p=p, p_least=least, effect=effect, ahead=ahead)
    difference = ranks[n:] - ranks[:n]
    above, below = signed_rank_tails(difference)
    return Tested(
        test="signed-rank",
        runs=runs,
        pairs=n,
        p=min(1.0, 2 * min(above, below)),
        p_least=min(1.0, 2.0 ** (1 - n)),
        sign_p=_sign(difference),
        effect=effect,
        ahead=ahead if ahead == int(np.sign(above - below)) else 0,  # a higher rank is behind
    )


def signed_rank_tails(difference: Array) -> tuple[float, float]:
    """Return the one-sided p of Wilcoxon's signed-rank test that differences, shape (n,), are above 0, and below.

    Pairs that are alike are left out. SciPy's exact distribution is for differences without ties, and those of ranks
    are full of them. Twice the sum of the ranks that are above 0 is a sum of independent whole numbers, each there or
    not: its distribution is a product of polynomials.
    """
    from scipy.stats import rankdata, wilcoxon

    apart = difference[difference != 0]
    if not apart.size:
        return 1.0, 1.0
    if len(apart) > _MOST_PAIRS:
        above, below = (wilcoxon(apart, method="approx", alternative=way).pvalue for way in ("greater", "less"))
        return float(above), float(below)
    twice = np.rint(2 * rankdata(np.abs(apart))).astype(int)
    seen, whole = int(twice[apart > 0].sum()), int(twice.sum())
    ways = np.ones(1)
    for rank in twice.tolist():
        ways = np.convolve(ways, np.concatenate([[0.5], np.zeros(rank - 1), [0.5]]))
    return _at_most_1(ways[: whole - seen + 1].sum()), _at_most_1(ways[: seen + 1].sum())


def rank_sum_tails(first: Array, second: Array) -> tuple[float, float]:
    """Return the one-sided p of Wilcoxon, Mann and Whitney's test that the ranks `first` are below `second`, and above.

    Shapes (n,) and (m,). Up to `_MOST_RUNS` runs in all every exchange is counted, ties and all: the number of ways to
    choose k of the ranks with sum s, rank by rank. Beyond, SciPy's normal approximation.
    """
    from scipy.stats import mannwhitneyu, rankdata

    n = len(first)
    both = np.concatenate([first, second])
    if len(np.unique(both)) == 1:
        return 1.0, 1.0
    if len(both) > _MOST_RUNS:
        below, above = (mannwhitneyu(first, second, alternative=way).pvalue for way in ("less", "greater"))
        return float(below), float(above)
    twice = np.rint(2 * rankdata(both)).astype(int)
    ways = np.zeros((n + 1, int(np.sort(twice)[-n:].sum()) + 1))
    ways[0, 0] = 1.0
    for rank in twice.tolist():
        ways[1:, rank:] += ways[:-1, : ways.shape[1] - rank].copy()
    share, seen = ways[n] / ways[n].sum(), int(twice[:n].sum())
    return _at_most_1(share[: seen + 1].sum()), _at_most_1(share[seen:].sum())


def _at_most_1(p: float) -> float:
    return min(1.0, float(p))  # of a sum that rounding has brought above


def beside_fixed(fixed: Array, drawn: Array) -> Array:
    """Return 1 for each run of `drawn` that is behind the one value of `fixed`, -1 for one ahead, else 0."""
    ranks = order_of(np.concatenate([fixed[:1], drawn]))
    signs: Array = np.sign(ranks[1:] - ranks[0])
    return signs


def _sign(difference: Array) -> float:
    from scipy.stats import binomtest

    apart = difference[difference != 0]
    return float(binomtest(int((apart > 0).sum()), len(apart)).pvalue) if apart.size else 1.0
