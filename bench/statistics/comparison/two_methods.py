"""Two sets of runs of one cell: which is better, by a test that fits how they belong together, and by how much.

Pairs (the same repetition of the same problem: the same data and start) are tested by Wilcoxon's signed-rank test on
the differences of their ranks among all runs of both: where nothing differs, a pair may be exchanged, which only turns
the sign of its difference. Runs without partners are tested by Mann and Whitney's test. Both look at the order of runs
alone (`score`). The p-values are exact, ties and all, of up to 60 pairs, and of runs without partners where SciPy has
an exact way; else they are by SciPy's normal approximation with its correction for ties.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Literal, final

import numpy as np
from numpy.typing import NDArray

from calibench.bench.statistics.comparison.effect_size import Effect, a12
from calibench.bench.statistics.comparison.score import order_of

Array = NDArray[np.float64]
_MOST_PAIRS = 60  # whose exchanges are all counted
_EXACT = 5000  # exchanges of unpaired runs that are gone through one by one
Test = Literal["signed-rank", "Mann-Whitney", "equal", "fact", "none"]


@final
@dataclass(frozen=True)
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
    pairs: int
    p: float
    p_least: float
    sign_p: float
    effect: Effect
    ahead: int


def two_methods(first: Array, second: Array, paired: bool, chance: bool = True) -> Tested:
    """Return the test of the runs `first`, scores of shape (n, 2), against `second`, shape (m, 2).

    `paired`: the i-th of both belong together. Without `chance` a difference is a fact, and not tested.
    """
    n, m = len(first), len(second)
    pairs = n if paired else 0
    effect = a12(second, first, paired) if n and m else Effect(float("nan"), 0.0, 1.0)
    nothing = float("nan")
    if not n or not m:
        return Tested("none", (n, m), pairs, nothing, nothing, nothing, effect, 0)
    ahead = int(np.sign(effect.a12 - 0.5))
    alike = first == second if paired else np.sort(first, axis=0) == np.sort(second, axis=0) if n == m else False
    if np.all(alike):
        return Tested("equal", (n, m), pairs, nothing, nothing, nothing, effect, 0)
    if not chance:
        return Tested("fact", (n, m), pairs, nothing, nothing, nothing, effect, ahead)
    ranks = order_of(np.concatenate([first, second]))
    if paired:
        difference = ranks[n:] - ranks[:n]
        p, way = _signed_rank(difference)
        ahead = ahead if ahead == -way else 0  # a higher rank is behind
        return Tested("signed-rank", (n, m), pairs, p, min(1.0, 2.0 ** (1 - n)), _sign(difference), effect, ahead)
    least = min(1.0, 2.0 / comb(n + m, n))
    return Tested("Mann-Whitney", (n, m), 0, _mann_whitney(ranks[:n], ranks[n:]), least, nothing, effect, ahead)


def _signed_rank(difference: Array) -> tuple[float, int]:
    """Return the two-sided p of Wilcoxon's signed-rank test, shape (n,), and the sign to which the differences lean.

    Pairs that are alike are left out.

    SciPy's exact distribution is for differences without ties, and those of ranks are full of them. Twice the sum of
    the ranks that are above 0 is a sum of independent whole numbers, each there or not: its distribution is a product
    of polynomials.
    """
    from scipy.stats import rankdata, wilcoxon

    apart = difference[difference != 0]
    if not apart.size:
        return 1.0, 0
    twice = np.rint(2 * rankdata(np.abs(apart))).astype(int)
    seen, whole = int(twice[apart > 0].sum()), int(twice.sum())
    way = int(np.sign(2 * seen - whole))
    if len(apart) > _MOST_PAIRS:
        return float(wilcoxon(apart, method="approx").pvalue), way
    ways = np.ones(1)
    for rank in twice.tolist():
        ways = np.convolve(ways, np.concatenate([[0.5], np.zeros(rank - 1), [0.5]]))
    return float(min(1.0, 2 * ways[: min(seen, whole - seen) + 1].sum())), way


def _sign(difference: Array) -> float:
    """Return the two-sided p of the sign test."""
    from scipy.stats import binomtest

    apart = difference[difference != 0]
    return float(binomtest(int((apart > 0).sum()), len(apart)).pvalue) if apart.size else 1.0


def _mann_whitney(first: Array, second: Array) -> float:
    """Return the two-sided p of Mann and Whitney's test."""
    from scipy.stats import PermutationMethod, mannwhitneyu

    n, m = len(first), len(second)
    if len(np.unique(np.concatenate([first, second]))) == 1:
        return 1.0
    if min(n, m) == 1:  # SciPy refuses one run: each of all runs is as likely to be that one
        alone, whole = (first[0] if n == 1 else second[0]), np.concatenate([first, second])
        return float(min(1.0, 2 * min((whole <= alone).mean(), (whole >= alone).mean())))
    if comb(n + m, n) <= _EXACT:
        found = mannwhitneyu(first, second, method=PermutationMethod(n_resamples=_EXACT))
    elif len(np.unique(np.concatenate([first, second]))) == n + m and max(n, m) <= 20:
        found = mannwhitneyu(first, second, method="exact")
    else:
        found = mannwhitneyu(first, second, method="asymptotic")
    return float(found.pvalue)
