"""The order of runs, of the methods on a task, and of methods over many tasks.

Runs (`scores`): first those that reached the goal, then those that paid less, then those with the lower value. All
tests compare runs by this order alone, so no scale is needed, and no cost is invented for a run that never reached the
goal; without a goal, runs are ordered by value.

Methods on a task take places, with ties; over tasks, the mean of the places counts, unsolved tasks too. Medians of
different problems have no common scale, and a sum over solved problems would favour a method that solves few. Values at
the floor are tied, because below it they differ by rounding. Colours and lists of a report follow this order.

Many methods on many problems: Friedman's test, and whose mean ranks differ (Nemenyi, or Holm against the best). A block
is a task, and has the median over repetitions of each run's rank among all runs of the task; repetitions are never
blocks: they tell nothing of other problems. Below `FEWEST` blocks there is no test, and it says why not.

Sources: Demsar, J. Machine Learning Research 7 (2006); Holm, Scand. J. Statistics 6 (1979): SciPy 1.17 has
false-discovery control, which promises less, and no Holm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import TYPE_CHECKING, Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibench.bench.statistics.cells import CELL, METHOD, TASK, answers, by_cell, by_number
from calibench.bench.statistics.names import in_order, method_labels
from calibench.bench.statistics.summary import alike, goal_hits, goals_of, method_names
from calibench.bench.store.columns import Columns, Counts, floats, numbered, plain

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
By = Literal["goal", "value", "charged"]
FEWEST = 10  # blocks, below which chi squared is far from Friedman's statistic and ranks say little
LOOK = "look"  # the column of runs that holds the number of a method's colour and line style


def places(cells: Columns) -> Array:
    """Return the place of each cell on its task, shape (cells,): 1 is best, ties share their mean.

    A cell is a row of `bench.statistics.summary.summary`. The order is by the share of runs at the goal, then the cost
    to get there, then the median value, as far as the floor and to nine digits.
    """
    success, cost = floats(cells["success"]), floats(cells["charged_to_target"])
    keys = np.column_stack(
        [
            np.where(np.isnan(success), 0.0, -success),
            np.where(np.isnan(cost), np.inf, cost),
            np.maximum(floats(cells["best_median"]), floats(cells["floor"])),
        ]
    )
    tasks, places = by_number(_tasks(cells)), np.empty(len(keys))
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
    """Return the order of cells with a column `method`: best first on each task; ties by failed runs, then by name.

    Problems stand by name, then by their options, numbers as numbers.
    """
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
    """Return the place of each value among those that differ."""
    place = {value: i for i, value in enumerate(sorted(set(values), key=key))}
    return np.array([place[value] for value in values], dtype=np.int64)


def methods(cells: pd.DataFrame) -> pd.DataFrame:
    """Return a row a method (columns optimizer, optimizer_options), best first, over all tasks of `cells`.

    rank (ties share the lowest), solved (mean share of runs at the goal) and place (mean), both over the tasks on which
    it was run; tasks (how many these are), of_tasks. A method that was run on fewer tasks stands behind those that were
    run on more: what was not run is not known.
    """
    import pandas as pd

    placed = cells.assign(place=places(cells), task=_tasks(cells))
    total = placed["task"].nunique()
    rows = []
    for pair, group in placed.groupby(METHOD, sort=False):
        place, solved = _means(group, "place"), _means(group[group["goal"].notna()], "success")
        share = sum(solved.values()) / len(solved) if solved else np.nan
        means = {"solved": share, "place": sum(place.values()) / len(place)}
        rows.append(dict(zip(METHOD, pair, strict=True)) | means | {"tasks": len(place), "of_tasks": total})
    order = ["tasks", "solved", "place"]
    table = pd.DataFrame(rows).sort_values(order, ascending=[False, False, True], kind="stable")
    alike = table[order].fillna(0.0).round(12).apply(tuple, axis=1).tolist()
    table.insert(0, "rank", [1 + alike.index(triple) for triple in alike])  # in order: the first of those alike
    return table.reset_index(drop=True)


def _means(cells: pd.DataFrame, column: str) -> dict[int, float]:
    import pandas as pd

    values: dict[int, list[float]] = {}
    for task, value in zip(cells["task"].tolist(), cells[column].tolist(), strict=True):
        values.setdefault(task, []).append(value)
    return {task: of[0] if len(of) == 1 else float(pd.Series(of).mean()) for task, of in values.items()}


def _tasks(cells: Columns) -> Counts:
    return numbered(cells[name] for name in TASK)


def scores(runs: pd.DataFrame, by: By = "goal") -> Array:
    """Return for each run a pair of numbers, shape (runs, 2): smaller is better, the first decides.

    ``by="goal"``: (charged at the goal, 0) for a run that reached it, (infinite, value) for another; ``"value"``: only
    the value of the answer, infinite where there is none; ``"charged"``: only the total charge of the run, infinite
    where it failed or ran out of time.
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
    return np.column_stack([np.where(reached, hits, np.inf), np.where(reached, 0.0, values)])


def order_of_scores(pairs: Array) -> Array:
    """Return the ranks of scores, shape (n, 2) -> (n,): 1 is best, those that are alike share their mean rank.

    Values that agree to nine digits are alike (`bench.statistics.summary.alike`).

    >>> order_of_scores(np.array([[np.inf, 3.0], [20.0, 0.0], [np.inf, 1.0], [20.0, 0.0]])).tolist()
    [4.0, 1.5, 3.0, 1.5]
    """
    from scipy.stats import rankdata

    pairs = np.column_stack([pairs[:, 0], alike(pairs[:, 1])])
    return np.asarray(rankdata(np.unique(pairs, axis=0, return_inverse=True)[1].ravel()))


@final
@dataclass(frozen=True)
class Blocks:
    """What each method did in each block: `medians`, shape (blocks, methods), the smaller the better.

    `methods` are their names; `left_out` says what was left out, '' where nothing was.
    """

    methods: tuple[str, ...]
    medians: Array
    left_out: str = ""

    @property
    def ranks(self) -> Array:
        """Return the ranks within each block, shape (blocks, methods): 1 is best, ties share their mean."""
        from scipy.stats import rankdata

        return np.asarray(rankdata(self.medians, axis=1))


@final
@dataclass(frozen=True, kw_only=True)
class Ranked:
    """Friedman's test of some methods, and their mean ranks, best first.

    `refused` says why there is no test ('' where there is one): then the numbers are NaN. `critical_difference` is
    Nemenyi's: mean ranks further apart differ at `level`. `nemenyi`, shape (methods, methods), and `against_best`,
    shape (methods,), are p-values; the second by Holm, NaN of the best itself.
    """

    methods: tuple[str, ...]
    mean_ranks: Array
    blocks: int
    statistic: float = nan
    p: float = nan
    critical_difference: float = nan
    nemenyi: Array
    against_best: Array
    level: float
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


def blocks_of(runs: pd.DataFrame, by: By = "goal") -> Blocks:
    """Return the blocks of `runs` in which every method was run, with the median rank of each method in each."""
    import pandas as pd

    rows = runs.reset_index(drop=True).assign(goal=goals_of(runs))
    rows["_method"], score = method_names(rows), scores(rows, by)
    number, listed = pd.factorize(rows["_method"])
    names = tuple(str(name) for name in listed)
    medians, incomplete = [], 0
    tasks = by_cell(rows, TASK)
    for task in range(len(tasks.count)):
        at = tasks.rows(task)
        if len(np.unique(number[at])) == len(names):
            medians.append(by_number(number[at].astype(np.int64)).medians(order_of_scores(score[at])))
        else:
            incomplete += 1
    left_out = f"{incomplete} tasks, on which not all {len(names)} methods were run, are left out" if incomplete else ""
    return Blocks(names, np.array(medians, dtype=np.float64).reshape(len(medians), len(names)), left_out)


def friedman(blocks: Blocks, level: float = 0.05) -> Ranked:
    """Return Friedman's test of the methods in `blocks`, with Nemenyi's and Holm's comparisons."""
    n, k = blocks.medians.shape
    mean = blocks.ranks.mean(axis=0) if n else np.full(k, np.nan)
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
        methods=methods, mean_ranks=mean, blocks=n, level=level, refused=refused, left_out=blocks.left_out,
        nemenyi=np.full((k, k), np.nan), against_best=np.full(k, np.nan),
    )  # fmt: skip
    if refused:
        return ranked
    from scipy.stats import friedmanchisquare, norm, studentized_range  # half a second: only where there is a test

    if (blocks.ranks == blocks.ranks[:, :1]).all():  # alike everywhere
        statistic, p = 0.0, 1.0
    else:
        statistic, p = (float(value) for value in friedmanchisquare(*blocks.medians.T))
    error = np.sqrt(k * (k + 1) / (6 * n))
    apart = np.abs(mean[:, None] - mean[None, :]) / error
    nemenyi = np.asarray(studentized_range.sf(apart * np.sqrt(2), k, np.inf), dtype=float)
    np.fill_diagonal(nemenyi, 1.0)
    against = np.concatenate([[np.nan], holm(2 * norm.sf(apart[0, 1:]))])
    difference = float(studentized_range.ppf(1 - level, k, np.inf)) / np.sqrt(2) * error
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
    return dict(zip(named["method"], named[LOOK].astype(int), strict=True))


def holm(p: ArrayLike) -> NDArray[np.float64]:
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
