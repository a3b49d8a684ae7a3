"""Two sets of runs, and two studies cell by cell: where the second is better, where worse, where the runs do not tell.

Pairs (the same repetition: the same data and start) are tested by Wilcoxon's signed-rank test on the differences of
their ranks among all runs of both, runs without partners by Mann and Whitney's test, runs beside the one value of a
side without chance by the sign test; exact, ties and all, up to 60 pairs or 80 runs. How much is A12: P(first better)
and half of P(alike), with Brunner and Munzel's interval (2000; of pairs 2002) on the logistic scale with Student's t.
Cells have the same problem, setting and chosen options, or where each side has just one other set of options, that.
Holm's correction is over all cells that are tested. Source of A12: Vargha and Delaney, J. Educ. Behav. Stat. 25 (2000).
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import comb, nan
from typing import Any, Literal, final

import numpy as np
import pandas as pd

from calibench import optimizers, problems
from calibench.bench.provenance.run_id import canonical, chosen_options
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.cells import METHOD, PROBLEM, SETTING, answers
from calibench.bench.statistics.ranking import By, holm, mean_ranks, order_of_scores as order_of, scores
from calibench.bench.store.columns import Array, parts
from calibench.core.words import counted

Verdict = Literal["better", "worse", "equal", "undecided"]
Test = Literal["signed-rank", "Mann-Whitney", "sign", "equal", "fact", "none"]
LEVEL = 0.05
_MOST_PAIRS = 60  # whose exchanges are all counted
_MOST_RUNS = 80  # of both sides, whose exchanges are all counted
_FEW = 8  # runs of a side, so few that the sum of their ranks is not yet normal


@final
@dataclass(frozen=True)
class Compared:
    """A row a shared cell (columns of `compare`), and how many cells only one side has."""

    cells: pd.DataFrame
    only_first: int
    only_second: int

    def count(self, verdict: Verdict) -> int:
        """Return how many cells have this verdict."""
        return int((self.cells["verdict"] == verdict).sum()) if len(self.cells) else 0


def compare(
    first: pd.DataFrame, second: pd.DataFrame, by: By = "goal", methods: tuple[str, str] | None = None
) -> Compared:
    """Return how the runs `second` stand to the runs `first`, cell by cell; `by` is the order of runs (`scores`).

    With `methods` the two are optimisers, and cells are matched whatever their optimiser. Columns are those of the cell
    of the first, other_options (of the second), goal, unit, minimum, and of both (_a, _b) runs, alone (without a
    partner: they are in no number here), outside, reached, charged_to_target, best_median; pairs, test, p, p_holm,
    a12 (how often a run of the second beats one of the first) with its interval, verdict (of the second), why.
    """
    matched, only = _matched(first, second, methods is not None)
    # the runs to compare, and whether they are pairs: as where half of the larger side has a partner
    sides = [partners(a, b) for a, b, _ in matched]
    results = [two_sides(*side, by) for side in sides]
    rows = []
    for (a, b, other_options), side, result, (p, verdict, why) in zip(
        matched, sides, results, verdicts(results, by), strict=True
    ):
        pair = side[:2]
        # what the scores alone do not tell: that nothing ended, that all is at the goal
        if result.test == "equal" and not any(np.isfinite(scores(runs, by)).all(axis=1).any() for runs in pair):
            if by == "charged":
                verdict, why = "undecided", "no run of either side ended well"
            elif not any(np.isfinite(answers(runs)).any() for runs in pair):
                verdict, why = "undecided", "no run of either side found a value"
        hits = [stats.goal_hits(runs) for runs in pair]
        if by == "value" and verdict in ("better", "worse") and all(np.isfinite(hit).all() for hit in hits):
            why = f"{why}; but all runs are below the goal, where values may differ by rounding alone"

        unit = a["unit"].iloc[0]
        least = a["minimum"].iloc[0] if a["judged_value"].isna().all() else None  # of noisy values there is none
        row: dict[str, Any] = {name: a[name].iloc[0] for name in (*PROBLEM, *METHOD)}
        row |= {"other_options": other_options} | {name: a[name].iloc[0] for name in SETTING}
        row |= {"goal": float(stats.goals_of(a)[0]), "unit": unit if isinstance(unit, str) else ""}
        row |= {"minimum": nan if least is None else float(least)}
        row |= {"runs_a": result.runs[0], "runs_b": result.runs[1], "pairs": result.pairs}
        row |= {"alone_a": len(a) - len(pair[0]), "alone_b": len(b) - len(pair[1]), "test": result.test}
        row |= {"p": result.p, "p_holm": p}
        row |= {"a12": result.effect.a12, "a12_low": result.effect.low, "a12_high": result.effect.high}
        for name, runs, hit in zip("ab", pair, hits, strict=True):  # of the runs that were tested
            row |= {
                f"outside_{name}": int(stats.outside_box(runs).sum()),
                f"reached_{name}": int(np.isfinite(hit).sum()),
                f"charged_to_target_{name}": stats.median_of_reached(hit),
                f"best_median_{name}": float(stats.quantiles(answers(runs), (0.5,))[0]),
            }
        rows.append(row | {"verdict": verdict, "why": why})
    return Compared(pd.DataFrame(rows), *only)


def partners(a: pd.DataFrame, b: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame, bool]:
    """Return the runs of two sides to be tested, and whether the i-th of both are a pair: the same repetition."""
    is_unique = a["repetition"].is_unique and b["repetition"].is_unique
    shared = sorted(set(a["repetition"]) & set(b["repetition"])) if is_unique else []
    paired = bool(shared) and len(shared) >= max(len(a), len(b)) / 2
    if paired:
        a, b = (r.set_index("repetition", drop=False).loc[shared].reset_index(drop=True) for r in (a, b))
    return a, b, paired


def two_sides(a: pd.DataFrame, b: pd.DataFrame, paired: bool, by: By) -> "Tested":
    """Return the test of two sides as `partners` returns them."""
    return two_methods(scores(a, by), scores(b, by), paired, (stats.has_chance(a), stats.has_chance(b)))


def _matched(
    first: pd.DataFrame, second: pd.DataFrame, any_method: bool
) -> tuple[list[tuple[pd.DataFrame, pd.DataFrame, str]], tuple[int, int]]:
    """Return the shared cells, with how the options of the second differ, and how many only the one and other has."""
    sides: list[dict[tuple[Any, ...], dict[str, pd.DataFrame]]] = []  # {what is the same: {chosen options: runs}}
    for each in (first, second):
        cells: dict[tuple[Any, ...], dict[str, pd.DataFrame]] = {}
        for key, mine in each.groupby([*PROBLEM, *METHOD, *SETTING], sort=False, dropna=False):
            named: dict[str, Any] = dict(zip([*PROBLEM, *METHOD, *SETTING], key, strict=True))
            problem, method = chosen_of(named)
            setting = [None if named[name] != named[name] else named[name] for name in ("data_id", *SETTING)]
            what = (named["problem"], problem, *setting, *([] if any_method else [named["optimizer"]]))
            options = f"{named['optimizer']} {method}" if any_method else method
            held = cells.setdefault(what, {})
            held[options] = pd.concat([held[options], mine]) if options in held else mine
        sides.append(cells)

    shared, only = [], [0, 0]
    for what in dict.fromkeys([*sides[0], *sides[1]]):
        a, b = (side.get(what, {}) for side in sides)
        shared += [(a[options], b[options], "") for options in a if options in b]
        rest = [[options for options in side if not (options in a and options in b)] for side in (a, b)]
        if len(rest[0]) == len(rest[1]) == 1:
            [its], [other] = rest
            differ = other  # of two methods, each with its name
            if not any_method:  # in the form of the command line
                have, has = (parts(json.loads(text), classes=False) for text in (its, other))
                keys = [key for key in dict.fromkeys([*have, *has]) if have.get(key) != has.get(key)]
                values = {key: stats.option_text(key, has.get(key, "default")).removeprefix(f"{key}=") for key in keys}
                differ = ", ".join(
                    f"{stats.option_text(key, have.get(key, 'default'))} -> {values[key]}" for key in keys
                )
            shared.append((a[its], b[other], differ))
        else:
            only = [count + len(more) for count, more in zip(only, rest, strict=True)]
    return shared, (only[0], only[1])


def chosen_of(row: Mapping[str, Any]) -> tuple[str, str]:
    """Return the options of a row's problem and optimizer that are no defaults, as JSON."""
    problem, method = (
        canonical(chosen_options(registry, row[kind], json.loads(row[f"{kind}_options"])))
        for registry, kind in ((problems.registry, "problem"), (optimizers.registry, "optimizer"))
    )
    return problem, method


@final
@dataclass(frozen=True)
class Effect:
    """A12 of the first over the second, and its interval."""

    a12: float
    low: float
    high: float


@final
@dataclass(frozen=True, kw_only=True)
class Tested:
    """What a test of two sets of runs says: `p` two-sided, `p_least` the least possible.

    `test`: "equal" in every score, "fact" where neither side has chance in it and both differ, "none" where none can be
    made. `effect` is A12 of the second over the first. `ahead`: 1 where the second is, -1 where the first is, 0 where
    neither is, or the test of pairs and A12 contradict each other.
    """

    test: Test
    runs: tuple[int, int]
    effect: Effect
    pairs: int = 0
    p: float = nan
    p_least: float = nan
    ahead: int = 0


_EQUAL = {"charged": "every run was charged the same", "goal": "every run is the same up to its end or goal"}


def verdicts(results: Sequence[Tested], by: By = "goal") -> list[tuple[float, Verdict, str]]:
    """Return of each cell's result Holm's p over all of them, the verdict on the second side, and why."""
    found: list[tuple[float, Verdict, str]] = []
    for result, p in zip(results, holm([result.p for result in results]).tolist(), strict=True):
        way: Verdict = "better" if result.ahead > 0 else "worse"
        if result.test == "equal":
            way, why = "equal", _EQUAL.get(by, "every run gave the same")
        elif result.test == "none":
            way, why = "undecided", "no runs on one side"
        elif result.test == "fact" and result.ahead:
            why = "no chance in it: what differs, differs"
        elif result.test == "fact":
            way, why = "undecided", "runs without chance that differ both ways"
        elif p <= LEVEL and result.ahead:
            why = f"Holm's p {p:.2g}"
        elif p <= LEVEL:
            way, why = "undecided", f"Holm's p {p:.2g}, but of all couples as many or more say the opposite"
        elif result.p_least > LEVEL:
            of = counted(result.pairs, "pair") if result.pairs else f"{result.runs[0]} and {result.runs[1]} runs"
            of += ", of one side without chance," if result.test == "sign" else ""
            way, why = "undecided", f"{of} cannot give a p below {result.p_least:.2g}"
        else:
            way, why = "undecided", f"Holm's p {p:.2g}"
        found.append((p, way, why))
    return found


def two_methods(first: Array, second: Array, paired: bool, chance: tuple[bool, bool] = (True, True)) -> Tested:
    """Return the test of the runs `first`, scores of shape (n, 2), against `second`, shape (m, 2).

    `paired`: the i-th of both belong together. `chance` tells of both whether it has a part.
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
        from scipy.stats import binomtest

        apart = signs[signs != 0]
        p = float(binomtest(int((apart > 0).sum()), len(apart)).pvalue) if apart.size else 1.0
        least = min(1.0, 2.0 ** (1 - len(signs)))
        return Tested(test="sign", runs=runs, p=p, p_least=least, effect=effect, ahead=ahead)
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
        effect=effect,
        ahead=ahead if ahead == int(np.sign(above - below)) else 0,  # a higher rank is behind
    )


def signed_rank_tails(difference: Array) -> tuple[float, float]:
    """Return the one-sided p of Wilcoxon's signed-rank test that differences, shape (n,), are above 0, and below.

    SciPy's exact distribution knows no ties. Twice the sum of the ranks above 0 is a sum of independent whole numbers,
    each there or not: its distribution is a product of polynomials. Pairs that are alike are left out.
    """
    apart = difference[difference != 0]
    if not apart.size:
        return 1.0, 1.0
    ranks = mean_ranks(np.abs(apart))
    if (n := len(apart)) > _MOST_PAIRS:
        error = np.sqrt((float(n * (n + 1) * (2 * n + 1)) - _ties(ranks) / 2) / 24)
        z = (ranks[apart > 0].sum() - n * (n + 1) / 4) / error
        from scipy.special import ndtr  # 0.2 s and 10 MB

        return float(ndtr(-z)), float(ndtr(z))
    twice = np.rint(2 * ranks).astype(int)
    seen, whole = int(twice[apart > 0].sum()), int(twice.sum())
    ways = np.ones(1)
    for rank in twice.tolist():
        ways = np.convolve(ways, np.concatenate([[0.5], np.zeros(rank - 1), [0.5]]))
    return min(1.0, float(ways[: whole - seen + 1].sum())), min(1.0, float(ways[: seen + 1].sum()))  # 1: by rounding


def rank_sum_tails(first: Array, second: Array) -> tuple[float, float]:
    """Return the one-sided p of Wilcoxon, Mann and Whitney's test that the ranks `first` are below `second`, and above.

    Exact, ties and all: the number of ways to choose k of the ranks with sum s, rank by rank.
    """
    n, m = len(first), len(second)
    ranks = mean_ranks(np.concatenate([first, second]))
    if len(np.unique(ranks)) == 1:
        return 1.0, 1.0
    if n + m > _MOST_RUNS and min(n, m) <= _FEW:
        from scipy.stats import mannwhitneyu  # exact where no two are equal; it takes half a second to load

        below, above = (mannwhitneyu(first, second, alternative=way).pvalue for way in ("less", "greater"))
        return float(below), float(above)
    if n + m > _MOST_RUNS:
        ahead = ranks[:n].sum() - n * (n + 1) / 2
        error = np.sqrt(n * m / 12 * ((n + m + 1) - _ties(ranks) / ((n + m) * (n + m - 1))))
        from scipy.special import ndtr

        below, above = (ndtr(-(more - n * m / 2 - 0.5) / error) for more in (n * m - ahead, ahead))
        return float(below), float(above)
    twice = np.rint(2 * ranks).astype(int)
    ways = np.zeros((n + 1, int(np.sort(twice)[-n:].sum()) + 1))
    ways[0, 0] = 1.0
    for rank in twice.tolist():
        ways[1:, rank:] += ways[:-1, : ways.shape[1] - rank].copy()
    share, seen = ways[n] / ways[n].sum(), int(twice[:n].sum())
    return min(1.0, float(share[: seen + 1].sum())), min(1.0, float(share[seen:].sum()))  # 1: by rounding


def _ties(ranks: Array) -> float:
    """Return the sum of t**3 - t over groups of t equal ranks, by which ties narrow the distribution of a sum."""
    t = np.unique(ranks, return_counts=True)[1].astype(float)
    return float((t**3 - t).sum())


def beside_fixed(fixed: Array, drawn: Array) -> Array:
    """Return 1 for each run of `drawn` that is behind the one value of `fixed`, -1 for one ahead, else 0."""
    ranks = order_of(np.concatenate([fixed[:1], drawn]))
    signs: Array = np.sign(ranks[1:] - ranks[0])
    return signs


def a12(first: Array, second: Array, paired: bool = False) -> Effect:
    """Return the effect of `first` over `second`, scores of shapes (n, 2) and (m, 2), `paired` or not."""
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
        k, z2 = min(n, m), float(norm.ppf(1 - LEVEL / 2)) ** 2
        middle = (effect + z2 / (2 * k)) / (1 + z2 / k)
        reach = np.sqrt(z2 * (effect * (1 - effect) / k + z2 / (4 * k * k))) / (1 + z2 / k)
        return Effect(effect, max(0.0, float(middle - reach)), min(1.0, float(middle + reach)))
    middle = np.log(effect / (1 - effect))
    reach = float(t.ppf(1 - LEVEL / 2, freedom)) * np.sqrt(variance) / (effect * (1 - effect))
    low, high = (1 / (1 + np.exp(-(middle + side * reach))) for side in (-1, 1))
    return Effect(effect, float(low), float(high))
