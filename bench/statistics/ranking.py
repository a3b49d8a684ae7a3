"""The order of runs, of the methods on a task, and of methods over many tasks.

Runs (`scores`): first those that reached the goal, then those that paid less, then those with the lower value. Methods
on a task take places, with ties; over tasks the mean of the places counts. Friedman's test, with Nemenyi's and Holm's
comparisons, has a task as its block, with the median over repetitions of each run's rank among all runs of the task.

Sources: Demsar, J. Machine Learning Research 7 (2006); Holm, Scand. J. Statistics 6 (1979), which SciPy 1.17 has not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import TYPE_CHECKING, Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike

from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, TASK, answers, by_cell, by_number
from calibench.bench.statistics.names import in_order, method_labels
from calibench.bench.statistics.summary import alike, goal_hits, goals_of, method_names
from calibench.bench.store.columns import Array, Columns, Counts, floats, numbered, plain

if TYPE_CHECKING:
    import pandas as pd

By = Literal["goal", "value", "charged", "success"]
FEWEST = 10  # blocks, below which chi squared is far from Friedman's statistic and ranks say little
LEVEL = 0.05
LOOK = "look"  # the column of runs that holds the number of a method's colour and line style


def places(cells: Columns) -> Array:
    """Return the place of each row of `summary` on its task: 1 is best, ties share their mean.

    By the share of runs at the goal, then the cost to get there, then the median value, to nine digits above the floor.
    """
    success, cost = floats(cells["success"]), floats(cells["charged_to_target"])
    keys = np.column_stack(
        [
            np.where(np.isnan(success), 0.0, -success),
            np.where(np.isnan(cost), np.inf, cost),
            np.maximum(floats(cells["best_median"]), floats(cells["floor"])),
        ]
    )
    tasks, places = by_cell(cells, TASK), np.empty(len(keys))
    for task in range(len(tasks.count)):
        mine = tasks.rows(task)
        keys[mine, 2] = alike(keys[mine, 2])
        _, place, ties = np.unique(keys[mine], axis=0, return_inverse=True, return_counts=True)
        places[mine] = (np.cumsum(ties) - (ties - 1) / 2)[place.ravel()]
    return places


def best_first(cells: pd.DataFrame) -> pd.DataFrame:
    """Return cells with a column `method` (its name), best first (`order_of`), and their `place`."""
    return cells.assign(place=places(cells)).iloc[order_of(cells)].reset_index(drop=True)


def order_of(cells: Columns) -> Counts:
    """Return the order of cells with a column `method`: by problem, best first; ties by failed runs, then by name."""
    pairs = list(zip(plain(cells["problem"]), plain(cells["problem_options"]), strict=True))
    keys = [
        _ranks(pairs, lambda pair: [in_order(text) for text in pair]),
        _ranks(plain(cells["start"]), lambda start: (start is None, start)),  # published runs tell none
        floats(cells["budget"]),
        -floats(cells["goal"]),
        places(cells),
        floats(cells["failed"]),
        _ranks(plain(cells["method"])),
    ]
    return np.lexsort(keys[::-1])  # what is NaN stands last


def _ranks(values: Sequence[Any], key: Callable[[Any], Any] | None = None) -> Counts:
    place = {value: i for i, value in enumerate(sorted(set(values), key=key))}
    return np.array([place[value] for value in values], dtype=np.int64)


def methods(cells: pd.DataFrame) -> pd.DataFrame:
    """Return a row a method, best first over all tasks: rank, METHOD, solved, place (both means), tasks, of_tasks.

    A method that was run on fewer tasks stands behind those that were run on more: what was not run is not known.
    """
    import pandas as pd

    ranked = cells.assign(place=places(cells), task=numbered(cells[name] for name in TASK))
    total = ranked["task"].nunique()
    rows = []
    for pair, group in ranked.groupby(METHOD, sort=False):
        means_of = []  # by task
        for some, column in ((group, "place"), (group[group["goal"].notna()], "success")):
            values: dict[int, list[float]] = {}
            for task, value in zip(some["task"].tolist(), some[column].tolist(), strict=True):
                values.setdefault(task, []).append(value)
            of_one = {task: of[0] if len(of) == 1 else float(pd.Series(of).mean()) for task, of in values.items()}
            means_of.append(of_one)
        place, solved = means_of
        share = sum(solved.values()) / len(solved) if solved else np.nan
        means = {"solved": share, "place": sum(place.values()) / len(place)}
        rows.append(dict(zip(METHOD, pair, strict=True)) | means | {"tasks": len(place), "of_tasks": total})
    order = ["tasks", "solved", "place"]
    table = pd.DataFrame(rows).sort_values(order, ascending=[False, False, True], kind="stable")
    alike = table[order].fillna(0.0).round(12).apply(tuple, axis=1).tolist()
    table.insert(0, "rank", [1 + alike.index(triple) for triple in alike])  # in order: the first of those alike
    return table.reset_index(drop=True)


def scores(runs: pd.DataFrame, by: By = "goal") -> Array:
    """Return for each run a pair of numbers, shape (runs, 2): smaller is better, the first decides.

    goal: (charged at the goal, 0), or (infinite, value); value: that of the answer; charged: that of a run that ended
    well; success: 0 where the goal was reached, else 1.
    """
    values = answers(runs)
    values = np.where(np.isnan(values), np.inf, values)
    zeros = np.zeros(len(runs))
    if by == "charged":
        ended = (runs["status"] == "ok").to_numpy()  # a run that crashed at its second call is not the cheapest
        return np.column_stack([np.where(ended, runs["charged"].to_numpy(dtype=float), np.inf), zeros])
    if by == "value":
        return np.column_stack([zeros, values])
    hits = goal_hits(runs)
    reached = np.isfinite(hits)
    if by == "success":
        return np.column_stack([np.where(reached, 0.0, 1.0), zeros])
    return np.column_stack([np.where(reached, hits, np.inf), np.where(reached, 0.0, values)])


def order_of_scores(pairs: Array) -> Array:
    """Return the ranks of scores, shape (n, 2) -> (n,): 1 is best, those alike (`summary.alike`) share their mean."""
    pairs = np.column_stack([pairs[:, 0], alike(pairs[:, 1])])
    return mean_ranks(np.unique(pairs, axis=0, return_inverse=True)[1].ravel())


def mean_ranks(values: Any) -> Array:
    """Return the ranks of values, shape (n,), none of them NaN: 1 is the least, equal ones share their mean.

    `scipy.stats.rankdata` does the same, and takes half a second to load.
    """
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    ranks: Array = (np.cumsum(count) - (count - 1) / 2)[place]
    return ranks


@final
@dataclass(frozen=True)
class Blocks:
    """What each method did in each block: `medians`, shape (blocks, methods); `left_out` is a sentence, or ''."""

    methods: tuple[str, ...]
    medians: Array
    left_out: str = ""


@final
@dataclass(frozen=True, kw_only=True)
class Ranked:
    """Friedman's test of some methods, best first, or why it is `refused`: then the numbers are NaN.

    Mean ranks further apart than Nemenyi's `critical_difference` differ at `LEVEL`. `nemenyi` and `against_best` (by
    Holm) are p-values.
    """

    methods: tuple[str, ...]
    mean_ranks: Array
    blocks: int
    statistic: float = nan
    p: float = nan
    critical_difference: float = nan
    nemenyi: Array
    against_best: Array
    refused: str
    left_out: str

    def groups(self) -> list[tuple[int, int]]:
        """Return the longest spans (first, last) of methods whose mean ranks differ by less than the difference."""
        spans: list[tuple[int, int]] = []
        for i, rank in enumerate(self.mean_ranks):
            last = int(np.flatnonzero(self.mean_ranks - rank < self.critical_difference).max(initial=i))
            if last > i and (not spans or last > spans[-1][1]):
                spans.append((i, last))
        return spans


def blocks_of(runs: pd.DataFrame) -> Blocks:
    """Return the blocks of `runs`, each at the largest budget that every method has, with their median ranks."""
    import pandas as pd

    rows = runs.reset_index(drop=True).assign(goal=goals_of(runs))
    rows["_method"], score = method_names(rows), scores(rows)
    number, listed = pd.factorize(rows["_method"])
    names = tuple(str(name) for name in listed)
    blocks: dict[tuple[object, ...], tuple[int, Array]] = {}
    asked: set[tuple[object, ...]] = set()
    tasks = by_cell(rows, TASK)
    largest_first = np.argsort(-floats(rows["budget"])[tasks.first], kind="stable")
    for task in largest_first.tolist():
        at = tasks.rows(task)
        block = tuple(rows[[*PROBLEM, "start", "goal"]].iloc[at[0]].astype(object).where(lambda v: v.notna(), None))
        asked.add(block)
        if block not in blocks and len(np.unique(number[at])) == len(names):
            medians = by_number(number[at].astype(np.int64)).medians(order_of_scores(score[at]))
            blocks[block] = (task, medians)  # runs of a smaller budget are the beginnings of these
    in_their_order = [medians for _, medians in sorted(blocks.values(), key=lambda pair: pair[0])]
    incomplete = len(asked) - len(blocks)
    left_out = f"{incomplete} tasks, on which not all {len(names)} methods were run, are left out" if incomplete else ""
    return Blocks(names, np.array(in_their_order, dtype=np.float64).reshape(len(blocks), len(names)), left_out)


def friedman(blocks: Blocks) -> Ranked:
    """Return Friedman's test of the methods in `blocks`, with Nemenyi's and Holm's comparisons."""
    n, k = blocks.medians.shape
    ranks, mean = blocks.medians, np.full(k, np.nan)
    if n:  # within each block: 1 is best, ties share their mean
        from scipy.stats import rankdata

        ranks = np.asarray(rankdata(blocks.medians, axis=1))
        mean = ranks.mean(axis=0)
    order = np.argsort(mean, kind="stable")
    methods, mean = tuple(blocks.methods[i] for i in order), mean[order]
    refused = ""
    if k < 3:
        refused = f"Friedman's test needs three methods, and there are {k}: compare the two by `bench compare`"
    elif n < FEWEST:
        refused = (
            f"Friedman's test needs {FEWEST} blocks (a problem with its instance; repetitions are none), and there are "
            f"{n}{': ' + blocks.left_out if blocks.left_out else ''}"
        )
    ranked = Ranked(
        methods=methods, mean_ranks=mean, blocks=n, refused=refused, left_out=blocks.left_out,
        nemenyi=np.full((k, k), np.nan), against_best=np.full(k, np.nan),
    )  # fmt: skip
    if refused:
        return ranked
    from scipy.stats import friedmanchisquare, norm, studentized_range  # half a second: only where there is a test

    if (ranks == ranks[:, :1]).all():  # alike everywhere
        statistic, p = 0.0, 1.0
    else:
        statistic, p = (float(value) for value in friedmanchisquare(*blocks.medians.T))
    error = np.sqrt(k * (k + 1) / (6 * n))
    apart = np.abs(mean[:, None] - mean[None, :]) / error
    nemenyi = np.asarray(studentized_range.sf(apart * np.sqrt(2), k, np.inf), dtype=float)
    np.fill_diagonal(nemenyi, 1.0)
    against = np.concatenate([[np.nan], holm(2 * norm.sf(apart[0, 1:]))])
    difference = float(studentized_range.ppf(1 - LEVEL, k, np.inf)) / np.sqrt(2) * error
    return replace(
        ranked, statistic=statistic, p=p, critical_difference=float(difference), nemenyi=nemenyi, against_best=against
    )


def methods_in_order(runs: pd.DataFrame, summary: pd.DataFrame) -> list[str]:
    """Return the names (`method_labels`) of the methods of `runs`, the best over all problems of `summary` first."""
    first = runs.assign(method=method_labels(runs)).drop_duplicates(CELL)[[*CELL, "method"]]
    numbers = first.merge(summary, on=CELL, how="left")
    by_name = sorted(range(len(numbers)), key=lambda k: in_order(numbers["method"].iloc[k]))
    numbers = numbers.iloc[by_name].reset_index(drop=True)  # so that ties do not hang on the order of the rows
    place = {tuple(pair): i for i, pair in enumerate(methods(numbers)[METHOD].itertuples(index=False))}
    pairs = [place[pair] for pair in zip(numbers["optimizer"], numbers["optimizer_options"], strict=True)]
    return list(dict.fromkeys(numbers.assign(place=pairs).sort_values("place", kind="stable")["method"]))


def with_looks(runs: pd.DataFrame, summary: pd.DataFrame) -> pd.DataFrame:
    """Return `runs` with the number of each method's colour in the column `LOOK`, for drawings of any part of them."""
    place = {name: i for i, name in enumerate(methods_in_order(runs, summary))}
    return runs.assign(**{LOOK: method_labels(runs).map(place)})


def looks_of(named: pd.DataFrame, methods: list[str]) -> dict[str, int]:
    """Return method -> the number of its look, of runs with a column `method`; their order where none is given."""
    if LOOK not in named:
        return {method: i for i, method in enumerate(methods)}
    looks = named[["method", LOOK]].drop_duplicates()
    return dict(zip(looks["method"], looks[LOOK].astype(int), strict=True))


def holm(p: ArrayLike) -> Array:
    """Return adjusted p-values, shape (n,), of `p`, shape (n,); NaN (no test was made) stays NaN and counts for none.

    >>> holm([0.01, 0.04, 0.03]).round(3).tolist()
    [0.03, 0.06, 0.06]
    """
    given = np.asarray(p, dtype=float)
    tested = np.flatnonzero(~np.isnan(given))
    order = tested[np.argsort(given[tested], kind="stable")]
    stepped = np.maximum.accumulate(given[order] * np.arange(len(order), 0, -1))
    adjusted = np.full(given.shape, np.nan)
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted
