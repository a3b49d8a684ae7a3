"""The answer of a study in three sentences: which method is best, how sure that is, and what was compared.

The best over all tasks is who reaches the goal in most runs, then who stands first in the mean (`ranking.methods`). It
is called better than another where a test of their runs says so on one problem at least, and the opposite on none;
from `_MANY` problems on the problems themselves are the pairs, and the repetitions say nothing more. As the best is
chosen by the same runs that are tested, each p-value is multiplied by the number of all pairs of methods and problems.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench.bench.report.study.lost import lost_of
from calibench.bench.statistics.cells import METHOD, PROBLEM, TASK
from calibench.bench.statistics.comparison import ranking
from calibench.bench.statistics.comparison.score import scores
from calibench.bench.statistics.comparison.two_methods import two_methods
from calibench.bench.statistics.summary import goals_of, has_chance, outside_box, success_interval
from calibench.core.counted import counted

LEVEL = 0.05
_MANY = 10  # problems from which on they, not the repetitions, are what is drawn at random
_NAMED = 4  # methods named one by one
_FEW = 2  # methods that were run on fewer problems that are named
Array = NDArray[np.float64]
Method = tuple[str, str]  # an optimiser and its options
Verdict = Literal["decided", "undecided", "alone"]


@final
@dataclass(frozen=True)
class Answer:
    """The three sentences, and whether the first is `decided`; ``alone`` where there is nothing to compare."""

    verdict: Verdict
    best: str
    sure: str
    compared: str


def answer(runs: pd.DataFrame, cells: pd.DataFrame, names: pd.Series) -> Answer:
    """Return the answer of these runs; `cells` is their summary, `names` what each run's method is called.

    Where budgets differ, it is the answer at the largest; published runs tell none, and are answered where there are no
    others.
    """
    compared = _compared(runs)
    most = runs["budget"].max()
    told = not pd.isna(most)
    runs, cells = (table[(table["budget"] == most) if told else table["budget"].isna()] for table in (runs, cells))
    within = f"Within {_spaced(most)} evaluations a run" if told else "Of published runs, which tell no budget"
    called = dict(zip(zip(runs["optimizer"], runs["optimizer_options"], strict=True), names[runs.index], strict=True))
    order = [tuple(pair) for pair in ranking.methods(cells)[METHOD].itertuples(index=False)]
    first, rivals = order[0], order[1:]
    best = _best(cells, called, first, within) + _outside(runs, first)
    if not rivals:
        return Answer("alone", best, "There is one method: nothing is compared with it.", compared)
    if not np.isfinite(cells["best_median"]).any() and not cells["reached"].sum():
        return Answer(
            "undecided", best, "No method found a value in most of its runs: they are not compared.", compared
        )
    wins, losses, tasks = _against(runs, cells, first, rivals)
    shared = _shared(cells, first)
    better = [pair for pair in rivals if wins[pair] and not losses[pair]]
    open_ = [called[pair] for pair in rivals if pair not in better]
    test = (
        f"signed-rank tests over the {shared} problems"
        if tasks >= _MANY
        else f"rank tests of the runs on {'each of ' if shared > 1 else ''}{counted(shared, 'problem')}"
    )
    more = ", corrected for all pairs of methods, 5 % level"
    if not open_:
        sure = f"It is better than {'the other method' if len(rivals) == 1 else f'each of the {len(rivals)} others'}: "
        return Answer("decided", best, f"{sure}{test}{more}.", compared)
    few = [pair for pair in rivals if losses[pair]]
    why = (
        f"{_listed([called[pair] for pair in few])} {'is' if len(few) == 1 else 'are'} better on some problems"
        if few
        else _too_few(runs, len(order), tasks) or "the runs are too few or too alike to tell"
    )
    sure = (
        f"Whether it is the best is undecided: it is not told apart from {_listed(open_)} ({why}); "
        f"it is better than {len(better)} of {counted(len(rivals), 'other method')} ({test}{more})."
    )
    return Answer("undecided", best, sure, compared)


def _shared(cells: pd.DataFrame, first: Method) -> int:
    """Return on how many problems the best method and any other were run."""
    own = (cells["optimizer"] == first[0]) & (cells["optimizer_options"] == first[1])
    return len(cells.loc[own, TASK].drop_duplicates().merge(cells.loc[~own, TASK].drop_duplicates(), on=TASK))


def _better_on_fewer(every: pd.DataFrame, called: dict[Method, str], problems: int, share: float) -> str:
    """Return a sentence on methods that reach the goal in a larger share of their runs, on fewer problems."""
    told = []
    for pair, mine in every.groupby(METHOD, sort=False):
        won, total, own = int(mine["reached"].sum()), int(mine["runs"].sum()), len(mine[PROBLEM].drop_duplicates())
        if own < problems and won > share * total:
            name = called[(str(pair[0]), str(pair[1]))]
            told.append(f"{name} in {_spaced(won)} of {counted(total, 'run')} on the {own} that it was run on")
    more = f", and {len(told) - _FEW} more" if len(told) > _FEW else ""
    return f" On fewer problems a larger share reaches it: {'; '.join(told[:_FEW])}{more}." if told else ""


def _outside(runs: pd.DataFrame, first: Method) -> str:
    """Return a sentence where answers of the best method lie outside the box, which others may have kept."""
    mine = runs[
        (runs["optimizer"] == first[0]) & (runs["optimizer_options"] == first[1]) & (runs["status"] != "failed")
    ]
    outside = int(outside_box(mine).sum())
    lie = "lies" if outside == 1 else "lie"
    return f" {_spaced(outside)} of its {counted(len(mine), 'answer')} {lie} outside the box." if outside else ""


def _best(cells: pd.DataFrame, called: dict[Method, str], first: Method, within: str) -> str:
    mine = cells[(cells["optimizer"] == first[0]) & (cells["optimizer_options"] == first[1])]
    known = mine[mine["goal"].notna()]
    every = cells[cells["goal"].notna()]
    if known.empty or not every["reached"].sum():
        places = cells.assign(place=ranking.places(cells)).loc[mine.index, "place"]
        firsts = int(((places == 1) & np.isfinite(mine["best_median"])).sum())
        goal = "no goal is known here" if known.empty else "no method reached the goal of any problem in any run"
        if not np.isfinite(cells["best_median"]).any():  # no method found a value in most of its runs
            return f"{within}, {goal}."
        if not firsts:
            return (
                f"{within}, {called[first]} is behind no other method by its mean place, and has the lowest median "
                f"value alone on no problem; {goal}."
            )
        others = cells.assign(first=ranking.places(cells) == 1).groupby(METHOD)["first"].sum()
        by_place = "comes first by its mean place, and " if others.max() > firsts else ""
        return (
            f"{within}, {called[first]} {by_place}has the lowest median value on {firsts} of "
            f"{counted(len(mine), 'problem')}; {goal}."
        )
    won, total = int(known["reached"].sum()), int(known["runs"].sum())
    low, high = success_interval(won, total)
    cost = known["charged_to_target"].dropna()
    problems = len(known[PROBLEM].drop_duplicates())
    soonest = f", after {_spaced(float(cost.median()))} evaluations (median over the problems)" if len(cost) else ""
    interval = f"; 95 % interval {_percent(low)} to {_percent(high)}" if known["success_low"].notna().any() else ""
    return (
        f"{within}, {called[first]} reaches the goal most: in {_spaced(won)} of {counted(total, 'run')} "
        f"({_percent(won / total)}{interval}) on "
        f"{counted(problems, 'problem')}{soonest}.{_better_on_fewer(every, called, problems, won / total)}"
    )


def _against(
    runs: pd.DataFrame, cells: pd.DataFrame, first: Method, rivals: list[Method]
) -> tuple[dict[Method, int], dict[Method, int], int]:
    """Return of each rival on how many problems `first` is surely better, and surely worse, and the number of these."""
    wins, losses = dict.fromkeys(rivals, 0), dict.fromkeys(rivals, 0)
    pairs = (len(rivals) + 1) * len(rivals) // 2
    tasks = len(cells[TASK].drop_duplicates())
    if tasks >= _MANY:
        table = cells.assign(place=ranking.places(cells))
        place = table.pivot_table(index=TASK, columns=METHOD, values="place", dropna=False, observed=True)
        for rival in rivals:
            both = place[[first, rival]].dropna().to_numpy(dtype=float)
            ours, theirs = (np.column_stack([side, np.zeros(len(both))]) for side in both.T)
            told = _sign(ours, theirs, True, True, pairs)
            wins[rival] += told > 0
            losses[rival] += told < 0
        return wins, losses, tasks
    for sides in _tasks(runs):
        if first not in sides:
            continue
        for rival in rivals:
            if rival in sides:
                told = _told_apart(sides[first], sides[rival], pairs * tasks)
                wins[rival] += told > 0
                losses[rival] += told < 0
    return wins, losses, tasks


def _too_few(runs: pd.DataFrame, methods: int, tasks: int) -> str:
    """Return how many pairs a decision takes, where so few cannot bring one, whatever they hold; else an empty text."""
    each = runs.groupby([*TASK[:-1], *METHOD], dropna=False)["repetition"].nunique()
    many, times = tasks >= _MANY, methods * (methods - 1) // 2 * (1 if tasks >= _MANY else tasks)
    if not many and each.min() != each.max():
        return ""  # not all are pairs
    found, needed = tasks if many else int(each.max()), 1
    while 2.0 ** (1 - needed) * times > LEVEL:  # the least p of a signed-rank test of so many pairs
        needed += 1
    if found >= needed:
        return ""
    where = "" if many else f" on {counted(tasks, 'problem')}"
    return (
        f"{counted(found, 'problem' if many else 'seed')} cannot tell {methods} methods apart{where}, whatever they "
        f"hold; it takes {needed} or more"
    )


def _told_apart(ours: _Side, theirs: _Side, times: int) -> int:
    paired = ours.repetitions == theirs.repetitions and len(set(ours.repetitions)) == len(ours.repetitions)
    return _sign(ours.scores, theirs.scores, paired, ours.chance or theirs.chance, times)


def _sign(ours: Array, theirs: Array, paired: bool, chance: bool, times: int) -> int:
    """Return 1 where the first scores, shape (n, 2), are surely better, -1 where worse, else 0."""
    if min(len(ours), len(theirs)) < 2 and chance:
        return 0  # one run gives no interval
    found = two_methods(ours, theirs, paired, chance)
    if found.test != "fact" and not found.p * times <= LEVEL:  # a p of NaN tells nothing either
        return 0
    return -found.ahead


@final
@dataclass(frozen=True)
class _Side:
    """The runs of one method on one task, by repetition: those of the same number share data and start."""

    scores: Array
    repetitions: list[int]
    chance: bool


def _tasks(runs: pd.DataFrame) -> Iterator[dict[Method, _Side]]:
    """Yield the methods on each task."""
    ordered = runs.assign(goal=goals_of(runs)).sort_values("repetition", kind="stable").reset_index(drop=True)
    every = scores(ordered)
    told = ordered.drop(columns=["targets", "hits", "hits_charged"], errors="ignore")  # lists are slow to slice
    for _, task in told.groupby(TASK, sort=False, dropna=False):
        yield {
            (str(pair[0]), str(pair[1])): _Side(every[mine.index], mine["repetition"].tolist(), has_chance(mine))
            for pair, mine in task.groupby(METHOD, sort=False)
        }


def _compared(runs: pd.DataFrame) -> str:
    methods, problems = (len(runs[columns].drop_duplicates()) for columns in (METHOD, PROBLEM))
    budgets = sorted(set(runs["budget"].dropna()))
    untold = int(runs["budget"].isna().sum())
    within = (
        "no budget told"
        if not budgets
        else f"at most {_spaced(budgets[0])} evaluations each"
        if len(budgets) == 1
        else f"{len(budgets)} budgets from {_spaced(budgets[0])} to {_spaced(budgets[-1])} evaluations (the answer is "
        "at the largest)"
    )
    if budgets and untold:
        within += f", and of {counted(untold, 'published run')} none told (the answer leaves them out)"
    seeds = runs.groupby([*PROBLEM, *METHOD, "start", "budget"], dropna=False).size()
    each = f"{seeds.min()}" if seeds.min() == seeds.max() else f"{seeds.min()} to {seeds.max()}"
    lost = lost_of(runs).told() or "no run failed"
    return (
        f"Compared: {counted(methods, 'method')} on {counted(problems, 'problem')}, {_spaced(len(runs))} "
        f"{'run' if len(runs) == 1 else 'runs'} ({each} a method and problem), {within}; {lost}."
    )


def _listed(names: list[str]) -> str:
    shown = names[:_NAMED] if len(names) > _NAMED + 1 else names
    more = [f"{len(names) - len(shown)} more"] if len(names) > len(shown) else []
    words = [*shown, *more]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _percent(share: float) -> str:
    """Return a share as the tables of the page have it, which a browser rounds: a half up.

    >>> [_percent(share).replace("\\u00a0", " ") for share in (0, 0.004, 0.125, 0.996, 1)]
    ['0 %', '<1 %', '13 %', '>99 %', '100 %']
    """
    told = "<1" if 0 < share < 0.01 else ">99" if 0.99 < share < 1 else f"{int(100 * share + 0.5)}"
    return f"{told}\u00a0%"


def _spaced(value: float) -> str:
    return f"{value:,.0f}".replace(",", "\u202f")
