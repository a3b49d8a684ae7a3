"""The best of many methods against each other one: how sure its lead is, and how large.

Tests are one-sided, on each task: of two methods without chance what differs, differs; one without: the sign test; both
with: Wilcoxon's signed-rank test where runs of one repetition share a random start or noisy data, else the rank-sum
test. Tasks are joined by Stouffer's sum; from `MANY` on there is one signed-rank test of the places on them. Holm's
correction runs over the rivals. The best is chosen by the runs that are tested, so its p-values pay for the choice: if
no method differs, one is called better in at most 5 of 100 studies (``python -m benchmarks statistics`` simulates it).

Sources: Stouffer et al., The American Soldier 1, 1949; Holm, Scand. J. Statistics 6 (1979); Hall, The Bootstrap and
Edgeworth Expansion, 1992, section 3 (the interval of the ratio).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import comb, erfc, inf, log, nan, sqrt
from statistics import NormalDist
from typing import Literal, final

import numpy as np
import pandas as pd

from calibench.bench.statistics import ranking
from calibench.bench.statistics.cells import METHOD, TASK
from calibench.bench.statistics.fixed_target import FEWEST, RESAMPLES, in_blocks, weights
from calibench.bench.statistics.ranking import holm, order_of_scores as order_of, scores
from calibench.bench.statistics.summary import goal_hits, goals_of, has_chance
from calibench.bench.statistics.two_studies import beside_fixed, rank_sum_tails, signed_rank_tails
from calibench.bench.store.columns import Array

Method = tuple[str, str]  # an optimiser and its options
Verdict = Literal["worse", "open", "better somewhere", "not compared"]
LEVEL = 0.05
MANY = 10  # shared tasks from which on they, not the repetitions, are what is drawn at random
_BOUNDED = 1e6  # times a ratio: an end beyond this, either way, means that the runs are too few for a bound
_READ = (*TASK, *METHOD, "repetition", "charged", "best_value", "chance", "judged_value", "judged_evaluations")
_MOST_RUNS = 1000  # beyond which no number of runs is proposed


@final
@dataclass(frozen=True, kw_only=True)
class Ratio:
    """How many times the ERT of the best a rival needs, over `tasks`; `never`: those it never solved. NaN: unknown."""

    value: float = nan
    low: float = nan
    high: float = nan
    tasks: int = 0
    never: int = 0


@final
@dataclass(frozen=True, kw_only=True)
class Rival:
    """One other method beside the best: the `verdict` on it, and what that rests on.

    `p` is one-sided, as tested; `p_adjusted` that of the whole comparison; `p_least` the least that so many runs can
    give. `chance`: `p` decides; `fact`: nothing was tested. `enough` runs, or tasks, could decide; 0 where these could,
    or none.
    """

    method: Method
    verdict: Verdict
    tasks: int
    p: float = nan
    p_adjusted: float = nan
    p_least: float = nan
    chance: bool = False
    fact: bool = False
    enough: int = 0
    ratio: Ratio = Ratio()


@final
@dataclass(frozen=True, kw_only=True)
class Side:
    """The runs of one method on one task, by repetition."""

    scores: Array
    repetitions: tuple[int, ...]
    chance: bool
    shared: bool  # whether runs of one repetition share a start or data drawn at random
    paid: Array  # what each run spent until the goal, or in vain
    won: Array  # whether it reached the goal


def against_each(runs: pd.DataFrame, cells: pd.DataFrame, first: Method, rivals: Sequence[Method]) -> list[Rival]:
    """Return of each of `rivals` what the `runs` say of it beside `first`, the best; `cells` is their summary."""
    order = np.argsort(runs["repetition"].to_numpy(), kind="stable")
    every, hits = scores(runs)[order], goal_hits(runs)[order]
    ordered = runs[[name for name in _READ if name in runs]].assign(goal=goals_of(runs))  # of 1e5 runs all are 150 MB
    ordered = ordered.iloc[order].reset_index(drop=True)
    won = np.isfinite(hits)
    paid = np.where(won, hits, ordered["charged"].to_numpy(dtype=float))
    drawn = (ordered["start"] != "nominal").to_numpy()
    if "judged_value" in ordered:
        drawn = drawn | ordered["judged_value"].notna().to_numpy()
    tasks = [
        {
            (str(pair[0]), str(pair[1])): Side(
                scores=every[mine.index],
                repetitions=tuple(mine["repetition"]),
                chance=has_chance(mine),
                shared=bool(drawn[mine.index].all()),
                paid=paid[mine.index],
                won=won[mine.index].astype(float),
            )
            for pair, mine in task.groupby(METHOD, sort=False)
        }
        for _, task in ordered.groupby(TASK, sort=False, dropna=False)
    ]
    number = cells.groupby(TASK, dropna=False, sort=False).ngroup()
    places = cells.assign(place=ranking.places(cells), task=number)
    return rivals_of(tasks, places.pivot_table(index="task", columns=METHOD, values="place"), first, rivals)


def rivals_of(
    tasks: Sequence[Mapping[Method, Side]], places: pd.DataFrame, first: Method, rivals: Sequence[Method]
) -> list[Rival]:
    """Return the same from the sides on each task and the `places` of the methods (columns) on the tasks (rows)."""
    both = {
        rival: [(sides[first], sides[rival]) for sides in tasks if first in sides and rival in sides]
        for rival in rivals
    }
    uncorrected = [_against(both[rival], places, first, rival) for rival in rivals]
    methods = [first, *rivals]
    drawn = [m for m in methods if any(m in sides and sides[m].chance for sides in tasks)]
    many = any(rival.tasks >= MANY for rival in uncorrected)
    candidates = len(methods) if many else len(drawn)
    fixed = not many and first not in drawn
    both_kinds = not many and 0 < len(drawn) < len(methods)
    price = (2 if both_kinds else 1) * (1 if fixed else max(candidates, 1))
    adjusted = np.minimum(holm([rival.p for rival in uncorrected]) * price, 1.0)
    times = price * sum(rival.chance for rival in uncorrected)
    results = []
    for rival, p in zip(uncorrected, adjusted, strict=True):
        # how many runs a task, or tasks, could decide, where so many as there are cannot
        enough = 0
        if rival.chance and not rival.p_least * times <= LEVEL and rival.tasks >= MANY:
            enough = next((n for n in range(MANY, _MOST_RUNS) if 0.5**n * times <= LEVEL), 0)
        elif rival.chance and not rival.p_least * times <= LEVEL:
            ranked = [a.chance and b.chance and not a.shared for a, b in both[rival.method] if a.chance or b.chance]
            for n in range(1, _MOST_RUNS):
                if _stouffer([1 / comb(2 * n, n) if ranks else 0.5**n for ranks in ranked]) * times <= LEVEL:
                    enough = n
                    break
        verdict: Verdict = "worse" if rival.verdict == "open" and rival.chance and p <= LEVEL else rival.verdict
        results.append(replace(rival, p_adjusted=float(p), verdict=verdict, enough=enough))
    return results


def _against(both: Sequence[tuple[Side, Side]], places: pd.DataFrame, first: Method, rival: Method) -> Rival:
    """Return what is known of `rival` before any correction: `open` is what the test has to decide."""
    if not both:
        return Rival(method=rival, verdict="not compared", tasks=0)
    ratio = ratio_of(both)
    if len(both) >= MANY:
        place = places[[first, rival]].dropna().to_numpy(dtype=float)
        better, _ = signed_rank_tails(place[:, 1] - place[:, 0])
        least = 0.5 ** len(place)
        return Rival(method=rival, verdict="open", tasks=len(both), p=better, p_least=least, chance=True, ratio=ratio)
    # 1 where the one value of the first is better, -1 where worse, else 0
    fixed = [order_of(np.stack([a.scores[0], b.scores[0]])) for a, b in both if not (a.chance or b.chance)]
    facts = [int(np.sign(rank[1] - rank[0])) for rank in fixed]
    # the one-sided p that the first is better on a task, that it is worse, and the least that is possible
    tested: list[tuple[float, float, float]] = []
    for a, b in both:
        n, m = len(a.scores), len(b.scores)
        if a.chance and b.chance:
            ranks = order_of(np.concatenate([a.scores, b.scores]))
            if a.shared and a.repetitions == b.repetitions and len(set(a.repetitions)) == len(a.repetitions):
                tested.append((*signed_rank_tails(ranks[n:] - ranks[:n]), 0.5**n))
            else:
                tested.append((*rank_sum_tails(ranks[:n], ranks[n:]), 1 / comb(n + m, n)))
        elif a.chance or b.chance:
            signs = beside_fixed(a.scores, b.scores) if b.chance else -beside_fixed(b.scores, a.scores)
            n, k = int((signs != 0).sum()), int((signs > 0).sum())
            up, down = (float(sum(comb(n, i) for i in range(heads, n + 1)) / 2**n) for heads in (k, n - k))
            tested.append((up, down, 0.5 ** len(signs)))
    unlike = [(better, worse) for better, worse, _ in tested if not better == worse == 1.0]  # alike runs tell nothing
    behind = any(fact < 0 for fact in facts) or any(worse <= LEVEL / 2 for _, worse in unlike)
    if behind or not tested:
        ahead = not behind and any(fact > 0 for fact in facts)
        verdict: Verdict = "better somewhere" if behind else "worse" if ahead else "open"
        return Rival(method=rival, verdict=verdict, tasks=len(both), fact=not tested, ratio=ratio)
    p = _stouffer([better for better, _ in unlike]) if unlike else 1.0
    least = _stouffer([least for _, _, least in tested])
    return Rival(method=rival, verdict="open", tasks=len(both), p=p, p_least=least, chance=True, ratio=ratio)


def _stouffer(p: Sequence[float]) -> float:
    """Return one p of several independent one-sided ones: that of the sum of their normal scores.

    >>> round(_stouffer([0.5**5] * 6), 8), _stouffer([0.25])
    (2.52e-06, 0.25)
    """
    if len(p) == 1:
        return float(p[0])
    score = NormalDist().inv_cdf
    total = sum(score(each) if 0 < each < 1 else inf * (each - 0.5) for each in p)
    return erfc(-total / sqrt(2 * len(p))) / 2


def ratio_of(both: Sequence[tuple[Side, Side]]) -> Ratio:
    """Return the ERT of the second over that of the first: the geometric mean over the tasks whose goal both reached.

    Its interval is as `fixed_target.ert_interval`, runs of one repetition drawn together where they share a start or
    data.
    """
    with_goal = [(a, b) for a, b in both if a.won.any()]
    shared = [(a, b) for a, b in with_goal if b.won.any()]
    never = len(with_goal) - len(shared)
    if not shared:
        return Ratio(never=never)
    ert = [[float(side.paid.sum()) / float(side.won.sum()) for side in pair] for pair in shared]
    value = np.mean([log(b) - log(a) for a, b in ert])
    ratio = Ratio(value=float(np.exp(value)), tasks=len(shared), never=never)
    if not any(a.chance or b.chance for a, b in shared):
        return replace(ratio, low=ratio.value, high=ratio.value)
    fewest = min(len(side.paid) for pair in shared for side in pair if side.chance)
    if fewest < FEWEST:
        return ratio
    drawn, variances = np.empty((2, RESAMPLES))
    for some in in_blocks(max(len(side.paid) for pair in shared for side in pair)):
        drawn[some], variances[some] = _log_ratio(shared, some)
    error, errors = np.sqrt(_log_ratio(shared)[1][0]), np.sqrt(variances)
    if error == 0:
        return replace(ratio, low=ratio.value, high=ratio.value)
    t = np.where(np.isfinite(drawn), (drawn - value) / np.where(errors > 0, errors, error), drawn)
    out = int(np.floor(0.025 * (RESAMPLES + 1))) - 1
    ends = np.sort(np.where(np.isnan(t), 0.0, t))[[RESAMPLES - 1 - out, out]]
    with np.errstate(over="ignore"):
        low, high = np.exp(value - ends * error * sqrt((fewest - 1) / (fewest - 2))).tolist()
    return replace(
        ratio, low=low if low > ratio.value / _BOUNDED else 0.0, high=high if high < ratio.value * _BOUNDED else inf
    )


def _log_ratio(shared: Sequence[tuple[Side, Side]], some: slice | None = None) -> tuple[Array, Array]:
    """Return the mean over tasks of the log of the ratio of ERTs, and its variance, in `some` resamples or of all runs.

    The logarithm of an ERT has the variance ``n / (n - 1) * sum((paid / A - won / k)^2)``, with A and k the sums.
    """
    logs, variance = np.zeros(1), np.zeros(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        for a, b in shared:
            paired = a.shared and b.shared and a.repetitions == b.repetitions
            terms = []
            for side, way in ((a, -1), (b, 1)):
                n = len(side.paid)
                weight = np.ones((1, n))
                if some is not None and side.chance:  # of the second other draws than those of the first
                    weight = weights(n)[:: 1 if way < 0 or paired else -1][some].astype(float)
                paid, won = weight @ side.paid, weight @ side.won
                logs = logs + way * np.log(paid / won) / len(shared)
                term = np.nan_to_num(side.paid / paid[:, None] - side.won / won[:, None], posinf=0.0, neginf=0.0)
                terms.append(np.sqrt(weight * (n / max(n - 1, 1))) * term)
                variance = variance + (terms[-1] ** 2).sum(axis=1) / len(shared) ** 2
            if paired:
                variance = variance - 2 * (terms[0] * terms[1]).sum(axis=1) / len(shared) ** 2
    return logs, np.maximum(variance, 0.0)
