"""What the statistics promise, measured: how often an interval of ERT holds the truth, and equals are told apart.

Every number of a batch follows from its seed, which is printed before anything is drawn, and every batch is printed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from calibench.bench.statistics.best import LEVEL, Method, Side, rivals_of
from calibench.bench.statistics.fixed_target import RESAMPLES, ert_interval, weights
from calibench.bench.statistics.ranking import order_of_scores as order_of
from calibench.bench.statistics.two_studies import two_methods, verdicts

Array = NDArray[np.float64]
SEED = 20081500  # of the first batch; the next has the next
RUNS = (5, 8, 10, 15, 20, 30, 50)
SUCCESS = (0.5, 0.65, 0.8, 0.95, 1.0)
COSTS: dict[str, Any] = {
    "exponential": stats.expon(), "gamma(3)": stats.gamma(3), "lognormal(.5)": stats.lognorm(0.5),
    "lognormal(1)": stats.lognorm(1.0),
}  # fmt: skip
_TRUE, _MOST = 0.05, 3.0  # false positives that are allowed, and standard errors of the count above that


def main(arguments: Sequence[str]) -> None:
    """Measure coverage and false positives, print every batch and what they come to."""
    parser = argparse.ArgumentParser(prog="benchmarks statistics", description=__doc__)
    parser.add_argument("--studies", type=int, default=1000, help="studies a batch")
    parser.add_argument("--only", choices=("coverage", "false-positives", "best"), help="one of them; else all")
    chosen = parser.parse_args(arguments)
    if chosen.only in (None, "coverage"):
        tell_coverage(pd.DataFrame(coverage(chosen.studies)))
    if chosen.only in (None, "false-positives"):
        list(false_positives(chosen.studies))
    if chosen.only in (None, "best"):
        list(best_of_many(chosen.studies))


def coverage(studies: int) -> Iterator[dict[str, Any]]:
    """Yield of each batch how often the 95 % interval of ERT holds the true one, over studies with any success."""
    seed = SEED
    for runs in RUNS:
        for ending in ("wall", "gives up"):
            for name, cost in COSTS.items():
                for success in SUCCESS:
                    if ending == "gives up" and success == 1.0:
                        continue
                    head = f"seed {seed}: {runs} runs, {name}, success {success}, {ending}"
                    paid, won, true = _drawn(np.random.default_rng(seed), cost, success, ending, (runs, studies))
                    some = won.sum(axis=0) > 0
                    low, high = ert_interval(paid[:, some], won[:, some])
                    left, right = _percentile(paid[:, some], won[:, some])
                    held = float(((low <= true) & (true <= high)).mean())
                    plain = float(((left <= true) & (true <= right)).mean())
                    print(f"{head}: covers {held:.3f} (percentile bootstrap {plain:.3f}) of {some.sum()}", flush=True)
                    yield {"runs": runs, "cost": name, "coverage": held, "percentile": plain}
                    seed += 1


def tell_coverage(batches: pd.DataFrame) -> None:
    """Print what the batches come to, a line a number of runs and one for all of 15 runs and more."""
    groups = [(f"{runs} runs", mine) for runs, mine in batches.groupby("runs")]
    for title, mine in [*groups, ("15 runs or more", batches[batches["runs"] >= 15])]:
        c, p = mine["coverage"], mine["percentile"]
        inside = int(c.between(0.93, 0.97).sum())
        print(
            f"{title}: mean coverage {c.mean():.3f}, batches {c.min():.3f} .. {c.max():.3f}, {inside} of {len(c)} in "
            f".93 .. .97; percentile bootstrap {p.mean():.3f}, {p.min():.3f} .. {p.max():.3f}"
        )


def _drawn(
    rng: np.random.Generator, cost: Any, success: float, ending: str, shape: tuple[int, int]
) -> tuple[Array, Array, float]:
    """Return what each run paid, whether it arrived, shapes (runs, studies), and the true ERT.

    "wall": a run arrives when its cost is within the budget, and else pays all of that. "gives up": it stops by itself,
    and has arrived with the probability `success`, whatever it paid.
    """
    drawn = np.asarray(cost.rvs(size=shape, random_state=rng), dtype=float)
    if ending == "gives up":
        return drawn, rng.random(shape) < success, float(cost.mean()) / success
    if success == 1.0:
        return drawn, np.ones(shape, dtype=bool), float(cost.mean())
    wall = float(cost.ppf(success))
    arrived = float(cost.expect(lambda x: x, lb=0, ub=wall))
    return np.minimum(drawn, wall), drawn <= wall, (arrived + (1 - success) * wall) / success


def _percentile(paid: Array, won: Array) -> tuple[Array, Array]:
    w = weights(len(paid))
    with np.errstate(divide="ignore"):
        ratios = np.sort((w @ paid) / (w @ won.astype(float)), axis=0)
    return ratios[int(0.025 * (RESAMPLES + 1)) - 1], ratios[int(0.975 * (RESAMPLES + 1)) - 1]


def false_positives(studies: int, cells: int = 4, settings: Sequence[int] = range(6)) -> Iterator[tuple[str, float]]:
    """Yield of each setting in how many pairs of studies of one method some cell is told to differ.

    Scores are drawn; what is made of them is what ``bench compare`` makes.
    """
    for number in settings:
        title, n, m, goal, ties = _SETTINGS[number]
        seed = SEED + 10_000 + number
        print(f"seed {seed}: {title}", end=": ", flush=True)
        rng = np.random.default_rng(seed)
        told = better = single = 0
        for _ in range(studies):
            results = [
                two_methods(_scores(rng, n, goal, ties), _scores(rng, m, goal, ties), paired=n == m)
                for _ in range(cells)
            ]
            found = [verdict for _, verdict, _ in verdicts(results)]
            told += "better" in found or "worse" in found
            better += "better" in found
            single += sum(result.p <= _TRUE for result in results)
        allowed = _TRUE + _MOST * (_TRUE * (1 - _TRUE) / studies) ** 0.5
        print(
            f"told to differ {told / studies:.3f}, better {better / studies:.3f} of {studies} studies of {cells} cells "
            f"(allowed {allowed:.3f}); of single tests {single / studies / cells:.3f} at .05",
            flush=True,
        )
        yield title, told / studies


_SETTINGS = (
    ("6 pairs, values", 6, 6, False, False),
    ("10 pairs, values", 10, 10, False, False),
    ("15 pairs, costs to a target that two of three reach", 15, 15, True, False),
    ("20 pairs, values with many ties", 20, 20, False, True),
    ("8 and 12 runs without partners, values", 8, 12, False, False),
    ("15 and 25 runs without partners, costs to a target", 15, 25, True, True),
)  # title, runs of both, whether there is a target, whether scores are rounded


def _scores(rng: np.random.Generator, n: int, target: bool, ties: bool) -> Array:
    """Return the scores of `n` runs of one random method, shape (n, 2); two of three reach the target, if there is one.

    As `bench.statistics.ranking` makes them.
    """
    values = rng.lognormal(size=n)
    values = np.round(values) if ties else values
    if not target:
        return np.column_stack([np.zeros(n), values])
    costs = rng.integers(10, 20 if ties else 10**6, size=n)
    reached = rng.random(n) < 2 / 3
    return np.column_stack([np.where(reached, costs, np.inf), np.where(reached, 0.0, values)])


def best_of_many(studies: int, settings: Sequence[int] | None = None) -> Iterator[tuple[str, float, float, float]]:
    """Yield of each setting how often the best is called better than one that it is not, and than all, and by how many.

    Costs are lognormal, the medians of the methods stand `apart` times each other; every second method has no chance in
    it, its cost is its median. Beside it the rule of all pairs: each p-value times the pairs of methods and the tasks.
    """
    for number in range(len(_MANY)) if settings is None else settings:
        methods, tasks, seeds, apart, fixed, start = _MANY[number]
        seed = SEED + 20_000 + number
        title = f"{methods} methods ({fixed} without chance), {tasks} problems, {seeds} seeds, {start} start, x {apart}"
        print(f"seed {seed}: {title}", end=": ", flush=True)
        rng = np.random.default_rng(seed)
        false = decided = old_false = old_decided = 0
        share = old_share = 0.0
        for _ in range(studies):
            study = [_sides(rng, methods, seeds, apart, fixed, start) for _ in range(tasks)]
            names = list(study[0])
            standing = np.mean([_medians(sides) for sides in study], axis=0)
            order = [names[i] for i in np.argsort(standing, kind="stable")]
            first = order[0]
            worse = {
                rival.method for rival in rivals_of(study, pd.DataFrame(), first, order[1:]) if rival.verdict == "worse"
            }
            by_pairs = {rival for rival in order[1:] if _by_all_pairs(study, first, rival)}
            not_better = {name for name in names if apart == 1.0 or int(name[0]) < int(first[0])}
            false += bool(worse & not_better)
            old_false += bool(by_pairs & not_better)
            decided += len(worse) == methods - 1
            old_decided += len(by_pairs) == methods - 1
            share += len(worse) / (methods - 1) / studies
            old_share += len(by_pairs) / (methods - 1) / studies
        print(
            f"false 'better' in {false / studies:.3f} of {studies} studies (all pairs {old_false / studies:.3f}); "
            f"better than all in {decided / studies:.3f} ({old_decided / studies:.3f}), than {share:.3f} of the others "
            f"({old_share:.3f})",
            flush=True,
        )
        yield title, false / studies, decided / studies, share


def _sides(
    rng: np.random.Generator, methods: int, seeds: int, apart: float, fixed: int, start: str
) -> dict[Method, Side]:
    """Return drawn costs to a goal as the sides of one task; the first `fixed` of every second method are medians."""
    own = rng.normal(0, 0.5, seeds) if start == "random" else np.zeros(seeds)  # of each start, shared by all methods
    found = {}
    for i in range(methods):
        chance = not (i % 2 == 1 and i // 2 < fixed)
        middle = 1000.0 * apart**i
        costs = middle * np.exp(own + rng.normal(0, 0.6, seeds)) if chance else np.array([middle])
        costs = np.rint(costs)
        found[str(i), "{}"] = Side(
            scores=np.column_stack([costs, np.zeros(len(costs))]),
            repetitions=tuple(range(len(costs))),
            chance=chance,
            shared=start == "random",
            paid=costs,
            won=np.ones(len(costs)),
        )
    return found


def _medians(sides: dict[Method, Side]) -> Array:
    medians = np.array([np.median(side.paid) for side in sides.values()])
    return order_of(np.column_stack([medians, np.zeros(len(medians))]))


def _by_all_pairs(study: Sequence[dict[Method, Side]], first: Method, rival: Method) -> bool:
    """Tell what the rule of all pairs says: surely better on one task at least, surely worse on none."""
    methods = len(study[0])
    signs = []
    for sides in study:
        a, b = sides[first], sides[rival]
        found = two_methods(a.scores, b.scores, a.repetitions == b.repetitions, (a.chance or b.chance,) * 2)
        sure = found.test == "fact" or found.p * methods * (methods - 1) / 2 * len(study) <= LEVEL
        signs.append(-found.ahead if sure else 0)
    return max(signs) > 0 and min(signs) >= 0


_MANY = (
    (2, 1, 15, 1.0, 0, "nominal"), (2, 1, 15, 1.0, 1, "nominal"), (6, 1, 15, 1.0, 0, "nominal"),
    (6, 3, 10, 1.0, 2, "nominal"), (6, 3, 10, 1.0, 0, "random"), (20, 2, 15, 1.0, 6, "nominal"),
    (6, 1, 15, 1.3, 2, "nominal"), (6, 3, 10, 1.3, 2, "nominal"), (6, 3, 10, 1.3, 0, "random"),
    (6, 1, 15, 2.5, 2, "nominal"), (20, 2, 15, 1.5, 6, "nominal"), (20, 1, 5, 2.0, 6, "nominal"),
)  # methods, problems, seeds, how many times the cost of the one before, methods without chance, start  # fmt: skip
