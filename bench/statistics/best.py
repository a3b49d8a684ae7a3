"""The best of many methods against each other one: how sure its lead is, and how large.

The best is chosen by the runs that are tested, so its p-values pay for the choice. Each test is one-sided (the claim is
"better"), and is made on each task that both methods have:

- two methods without chance: what differs, differs; nothing is tested;
- one without chance, one with: the sign test of n runs against a fixed value;
- both with chance: Wilcoxon's signed-rank test of the runs with the same repetition where these share a random start or
  noisy data, else the rank-sum test of Wilcoxon, Mann and Whitney; both exact, ties and all.

Tasks are joined by Stouffer's sum of normal scores. From `MANY` shared tasks on the tasks are what is drawn at random:
one signed-rank test of the places on them. Holm's correction runs over the rivals of the best, and not over all pairs.
A method without chance that leads is chosen by facts: it has half of the level. One with chance is the luckiest of as
many as have chance, and these share the other half. So if no method differs, one is called better in at most 5 of 100
studies (``python -m benchmarks statistics`` simulates it).

Sources: Stouffer et al., The American Soldier 1, 1949; Holm, Scand. J. Statistics 6 (1979); Hall, The Bootstrap and
Edgeworth Expansion, 1992, section 3 (the interval of the ratio).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import comb, inf, log, nan, sqrt
from typing import Literal, final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench.bench.statistics import ranking
from calibench.bench.statistics.cells import METHOD, TASK
from calibench.bench.statistics.fixed_target import FEWEST, RESAMPLES, weights
from calibench.bench.statistics.ranking import holm, scores
from calibench.bench.statistics.ranking import order_of_scores as order_of
from calibench.bench.statistics.summary import goal_hits, goals_of, has_chance
from calibench.bench.statistics.two_methods import beside_fixed, rank_sum_tails, signed_rank_tails

Array = NDArray[np.float64]
Method = tuple[str, str]  # an optimiser and its options
Verdict = Literal["worse", "open", "better somewhere", "not compared"]
LEVEL = 0.05
MANY = 10  # shared tasks from which on they, not the repetitions, are what is drawn at random
_BOUNDED = 1e6  # times a ratio: an end beyond this, either way, means that the runs are too few for a bound
_MOST_RUNS = 1000  # beyond which no number of runs is proposed


@final
@dataclass(frozen=True, kw_only=True)
class Ratio:
    """How many times the evaluations (or the value) of the best a rival needs: ERT of both, pooled over `tasks`.

    `never` counts the shared tasks whose goal the rival reached in no run: they are not in the ratio. NaN: unknown.
    """

    value: float = nan
    low: float = nan
    high: float = nan
    tasks: int = 0
    never: int = 0


@final
@dataclass(frozen=True, kw_only=True)
class Rival:
    """One other method beside the best: the `verdict` on it, and what that rests on.

    `p` is one-sided, as tested; `p_adjusted` that of the whole comparison (NaN where facts decide). `p_least` is the
    least `p` that so many runs can give, `chance` whether `p` decides, `fact` whether nothing was tested. `enough` is
    the number of runs a method and task, or of tasks, that could decide; 0 where these could, or none can.
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


@final
@dataclass(frozen=True)
class _Tails:
    """One-sided p that the first is better, that it is worse, and the least that so many runs can give."""

    better: float
    worse: float
    least: float


def against_each(runs: pd.DataFrame, cells: pd.DataFrame, first: Method, rivals: Sequence[Method]) -> list[Rival]:
    """Return of each of `rivals` what the `runs` say of it beside `first`, the best; `cells` is their summary."""
    task = cells.groupby(TASK, dropna=False, sort=False).ngroup()
    places = cells.assign(place=ranking.places(cells), task=task).pivot_table(
        index="task", columns=METHOD, values="place"
    )
    return rivals_of(list(_tasks(runs)), places, first, rivals)


def rivals_of(
    tasks: Sequence[Mapping[Method, Side]], places: pd.DataFrame, first: Method, rivals: Sequence[Method]
) -> list[Rival]:
    """Return the same from the sides on each task and the `places` of the methods (columns) on the tasks (rows)."""
    uncorrected = [_against(tasks, places, first, rival) for rival in rivals]
    methods = [first, *rivals]
    drawn = [m for m in methods if any(m in sides and sides[m].chance for sides in tasks)]
    many = any(rival.tasks >= MANY for rival in uncorrected)
    candidates = len(methods) if many else len(drawn)
    fixed = not many and first not in drawn
    both_kinds = not many and 0 < len(drawn) < len(methods)
    price = (2 if both_kinds else 1) * (1 if fixed else max(candidates, 1))
    adjusted = np.minimum(holm([rival.p for rival in uncorrected]) * price, 1.0)
    tested = sum(rival.chance for rival in uncorrected)
    return [
        replace(
            rival,
            p_adjusted=float(p),
            verdict="worse" if rival.verdict == "open" and rival.chance and p <= LEVEL else rival.verdict,
            enough=_enough(rival, tasks, places, first, price * tested),
        )
        for rival, p in zip(uncorrected, adjusted, strict=True)
    ]


def _against(tasks: Sequence[Mapping[Method, Side]], places: pd.DataFrame, first: Method, rival: Method) -> Rival:
    """Return what is known of `rival` before any correction: `open` is what the test has to decide."""
    both = [(sides[first], sides[rival]) for sides in tasks if first in sides and rival in sides]
    if not both:
        return Rival(method=rival, verdict="not compared", tasks=0)
    ratio = ratio_of(both)
    if len(both) >= MANY:
        place = places[[first, rival]].dropna().to_numpy(dtype=float)
        better, _ = signed_rank_tails(place[:, 1] - place[:, 0])
        least = 0.5 ** len(place)
        return Rival(method=rival, verdict="open", tasks=len(both), p=better, p_least=least, chance=True, ratio=ratio)
    # 1 where the one value of the first is better, -1 where worse, else 0
    ranks = [order_of(np.stack([a.scores[0], b.scores[0]])) for a, b in both if not (a.chance or b.chance)]
    facts = [int(np.sign(rank[1] - rank[0])) for rank in ranks]
    tested = [_tails(a, b) for a, b in both if a.chance or b.chance]
    unlike = [one for one in tested if not one.better == one.worse == 1.0]  # runs that are alike tell nothing
    behind = any(fact < 0 for fact in facts) or any(one.worse <= LEVEL / 2 for one in unlike)
    if behind or not tested:
        ahead = not behind and any(fact > 0 for fact in facts)
        verdict: Verdict = "better somewhere" if behind else "worse" if ahead else "open"
        return Rival(method=rival, verdict=verdict, tasks=len(both), fact=not tested, ratio=ratio)
    p, least = (_stouffer(some) if some else 1.0 for some in ([t.better for t in unlike], [t.least for t in tested]))
    return Rival(method=rival, verdict="open", tasks=len(both), p=p, p_least=least, chance=True, ratio=ratio)


def _tails(a: Side, b: Side) -> _Tails:
    """Return the one-sided tests of `a` against `b` on one task, where chance has a part in at least one."""
    if not (a.chance and b.chance):
        signs = beside_fixed(a.scores, b.scores) if b.chance else -beside_fixed(b.scores, a.scores)
        n, k = int((signs != 0).sum()), int((signs > 0).sum())
        return _Tails(_binomial_tail(n, k), _binomial_tail(n, n - k), 0.5 ** len(signs))
    ranks = order_of(np.concatenate([a.scores, b.scores]))
    n, m = len(a.scores), len(b.scores)
    if a.shared and a.repetitions == b.repetitions and len(set(a.repetitions)) == len(a.repetitions):
        return _Tails(*signed_rank_tails(ranks[n:] - ranks[:n]), 0.5**n)
    return _Tails(*rank_sum_tails(ranks[:n], ranks[n:]), 1 / comb(n + m, n))


def _binomial_tail(n: int, k: int) -> float:
    """Return the chance of `k` or more of `n` fair coins."""
    return float(sum(comb(n, i) for i in range(k, n + 1)) / 2**n)


def _stouffer(p: Sequence[float]) -> float:
    """Return one p of several independent one-sided ones: that of the sum of their normal scores.

    >>> round(_stouffer([0.5**5] * 6), 8), _stouffer([0.25])
    (2.52e-06, 0.25)
    """
    from scipy.stats import norm

    if len(p) == 1:
        return float(p[0])
    return float(norm.sf(sum(norm.isf(np.asarray(p))) / sqrt(len(p))))


def _enough(
    rival: Rival, tasks: Sequence[Mapping[Method, Side]], places: pd.DataFrame, first: Method, times: float
) -> int:
    """Return how many runs a task, or tasks, could decide, where so many as there are cannot; else 0."""
    if not rival.chance or rival.p_least * times <= LEVEL:
        return 0
    if rival.tasks >= MANY:
        return next((n for n in range(MANY, _MOST_RUNS) if 0.5**n * times <= LEVEL), 0)
    kinds = [
        (sides[first].chance and sides[rival.method].chance, sides[first].shared)
        for sides in tasks
        if first in sides and rival.method in sides and (sides[first].chance or sides[rival.method].chance)
    ]

    def least(n: int) -> float:
        return _stouffer([1 / comb(2 * n, n) if two and not shared else 0.5**n for two, shared in kinds])

    return next((n for n in range(1, _MOST_RUNS) if least(n) * times <= LEVEL), 0)


def ratio_of(both: Sequence[tuple[Side, Side]]) -> Ratio:
    """Return the ERT of the second over that of the first: the geometric mean over the tasks whose goal both reached.

    The interval is a studentised bootstrap of the logarithm (`fixed_target.ert_interval`): runs of one repetition are
    drawn together where they share a start or data. NaN of fewer than three runs.
    """
    with_goal = [(a, b) for a, b in both if a.won.any()]
    shared = [(a, b) for a, b in with_goal if b.won.any()]
    never = len(with_goal) - len(shared)
    if not shared:
        return Ratio(never=never)
    value = np.mean([_log_ert(b) - _log_ert(a) for a, b in shared])
    ratio = Ratio(value=float(np.exp(value)), tasks=len(shared), never=never)
    if not any(a.chance or b.chance for a, b in shared):
        return replace(ratio, low=ratio.value, high=ratio.value)
    fewest = min(len(side.paid) for pair in shared for side in pair if side.chance)
    if fewest < FEWEST:
        return ratio
    (_, variance), (drawn, variances) = _log_ratio(shared, resampled=False), _log_ratio(shared, resampled=True)
    error, errors = np.sqrt(variance[0]), np.sqrt(variances)
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


def _log_ratio(shared: Sequence[tuple[Side, Side]], resampled: bool) -> tuple[Array, Array]:
    """Return the mean over tasks of the log of the ratio of ERTs, and its variance, in each resample or of all runs.

    The logarithm of an ERT has the variance ``n / (n - 1) * sum((paid / A - won / k)^2)``, with A and k the sums.
    """
    logs, variance = np.zeros(1), np.zeros(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        for a, b in shared:
            paired = a.shared and b.shared and a.repetitions == b.repetitions
            terms = []
            for side, way in ((a, -1), (b, 1)):
                n = len(side.paid)
                weight = weights(n) if resampled and side.chance else np.ones((1, n))
                weight = weight if way < 0 or paired else weight[::-1]  # other draws than those of the first
                paid, won = weight @ side.paid, weight @ side.won
                logs = logs + way * np.log(paid / won) / len(shared)
                term = np.nan_to_num(side.paid / paid[:, None] - side.won / won[:, None], posinf=0.0, neginf=0.0)
                terms.append(np.sqrt(weight * (n / max(n - 1, 1))) * term)
                variance = variance + (terms[-1] ** 2).sum(axis=1) / len(shared) ** 2
            if paired:
                variance = variance - 2 * (terms[0] * terms[1]).sum(axis=1) / len(shared) ** 2
    return logs, np.maximum(variance, 0.0)


def _log_ert(side: Side) -> float:
    return log(float(side.paid.sum()) / float(side.won.sum()))


def _tasks(runs: pd.DataFrame) -> Iterator[dict[Method, Side]]:
    ordered = runs.assign(goal=goals_of(runs)).sort_values("repetition", kind="stable").reset_index(drop=True)
    every, hits = scores(ordered), goal_hits(ordered)
    won = np.isfinite(hits)
    paid = np.where(won, hits, ordered["charged"].to_numpy(dtype=float))
    drawn = (ordered["start"] != "nominal").to_numpy()
    if "judged_value" in ordered:
        drawn = drawn | ordered["judged_value"].notna().to_numpy()
    slim = ordered.drop(columns=["targets", "hits", "hits_charged"], errors="ignore")  # lists are slow to slice
    for _, task in slim.groupby(TASK, sort=False, dropna=False):
        yield {
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
