"""The answer of a study in three sentences: which method is best, how sure that is and by how much, what was compared.

The best is who reaches the goal in most runs, then who stands first in the mean (`ranking.methods`), of those run on
every task. Against each other one it is compared on the tasks that both have (`bench.statistics.best`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, Literal, final

import numpy as np
import pandas as pd

from calibench.bench.report.study.html_tables import count, lost_of
from calibench.bench.statistics import ranking, summary as stats
from calibench.bench.statistics.best import MANY, Method, Rival, against_each
from calibench.bench.statistics.cells import METHOD, PROBLEM
from calibench.bench.statistics.names import name_of_each
from calibench.bench.statistics.summary import outside_box, success_interval
from calibench.bench.statistics.targets import COLUMN, with_lowest_seen
from calibench.bench.store.columns import plain
from calibench.bench.store.manifest import remaining_by_budget
from calibench.core.words import counted

_NAMED = 4  # methods named one by one
_FEW = 2  # methods that were run on fewer problems that are named
Verdict = Literal["decided", "undecided", "alone"]


@final
@dataclass(frozen=True)
class Answer:
    """The three sentences, and whether the first is `decided`; ``alone`` where there is nothing to compare."""

    verdict: Verdict
    best: str
    sure: str
    compared: str
    method: str = ""

    def __repr__(self) -> str:
        return f"<answer {self.verdict}: {self.best} {self.sure} {self.compared}>"

    def _repr_html_(self) -> str:
        paragraphs = "".join(f"<p>{escape(sentence)}</p>" for sentence in (self.sure, self.compared))
        return f"<div><b>{escape(self.best)}</b>{paragraphs}</div>"


def answer_of(
    runs: pd.DataFrame, traces: pd.DataFrame, manifest: Mapping[str, Any] | None = None, names: pd.Series | None = None,
    cells: pd.DataFrame | None = None,
) -> Answer:  # fmt: skip
    """Return the answer of a study as its page and command line have it: without the runs that the `manifest` calls
    abandoned; of a problem without targets the goal is the lowest value seen."""
    manifest = manifest or {}
    names = stats.method_names(runs) if names is None else names
    abandoned = manifest.get("abandoned", ())
    planned = runs[~runs["run_id"].isin(abandoned)] if abandoned else runs
    judged = with_lowest_seen(runs if planned.empty else planned, traces)
    if cells is None or len(judged) < len(runs) or (COLUMN not in runs and judged[COLUMN].any()):
        cells = stats.summary(judged)
    return answer(judged, cells, names[judged.index], remaining_by_budget(manifest, {*plain(runs["run_id"])}))


def answer(
    runs: pd.DataFrame, cells: pd.DataFrame, names: pd.Series, remaining: Mapping[int, int] | None = None
) -> Answer:
    """Return the answer at the largest budget of which no planned run is `remaining`, else undecided at the largest;
    `cells` is the summary of the runs, `names` what each run's method is called."""
    compared = _compared(runs)
    remaining = {budget: count for budget, count in (remaining or {}).items() if count}
    budgets = sorted(set(runs["budget"].dropna()))
    finished = [budget for budget in budgets if budget not in remaining]
    most = (finished or budgets)[-1] if budgets else np.nan
    cut = remaining.get(int(most), 0) if budgets else 0
    if len(finished) > 1 or runs["budget"].nunique(dropna=False) > 1:
        runs, cells = (table[table["budget"] == most] for table in (runs, cells))
    within = f"Within {count(most)} evaluations a run" if budgets else "Of published runs, which tell no budget"
    called = name_of_each(runs, names)
    # methods, best first; places are among those that were run on every task, where there are some
    ranked = ranking.methods(cells)
    whole = ranked.loc[ranked["tasks"] == ranked["of_tasks"], METHOD]
    among = ranking.methods(cells.merge(whole, on=METHOD)) if 0 < len(whole) < len(ranked) else ranked
    pairs = (tuple(pair) for table in (among, ranked) for pair in table[METHOD].itertuples(index=False))
    first, *others = dict.fromkeys(pairs)
    if (runs["status"] == "failed").all():
        best = f"{within}, no run ended well: {count(len(runs))} failed."
        return Answer("undecided", best, "Nothing is compared.", compared)
    seen = runs[COLUMN][np.isfinite(stats.goals_of(runs))] if COLUMN in runs else pd.Series(dtype=bool)
    goal = "the goal (or else the lowest value seen)" if seen.any() else "the goal"
    goal = "the lowest value seen (to rounding)" if seen.any() and seen.all() else goal
    best = _best(cells, called, first, within, goal)
    by_first = (runs["optimizer"] == first[0]) & (runs["optimizer_options"] == first[1])
    mine = by_first & (runs["status"] != "failed")
    if outside := int((outside_box(runs) & mine).sum()):  # which others may have kept
        lie = "lies" if outside == 1 else "lie"
        best += f" {count(outside)} of its {counted(int(mine.sum()), 'answer')} {lie} outside the box."
    if cut and not others:
        best = f"{within}, one method has runs so far: {called[first]}."
    if cut:
        done = len(runs)
        share = f"{count(done)} of {count(done + cut)} planned runs are done"
        sure = f"The sweep is not finished ({share}): nothing is decided yet."
        return Answer("undecided", best, sure, compared, called[first])
    if not others:
        return Answer("alone", best, "There is one method: nothing is compared with it.", compared, called[first])
    if not np.isfinite(cells["best_median"]).any() and not cells["reached"].sum():
        sure = "No method found a value in most of its runs: they are not compared."
        return Answer("undecided", best, sure, compared)
    rivals = against_each(runs, cells, first, others)
    verdict, sure = _sure(rivals, called)
    return Answer(verdict, best, sure, compared, called[first])


def _sure(rivals: Sequence[Rival], called: Mapping[Method, str]) -> tuple[Literal["decided", "undecided"], str]:
    """Return whether the best is better than each rival, and a sentence on it, with how much the next is behind."""
    named: dict[str, list[str]] = {}
    for rival in rivals:
        named.setdefault(rival.verdict, []).append(called[rival.method])
    worse, somewhere, apart, open_ = (
        named.get(verdict, []) for verdict in ("worse", "better somewhere", "not compared", "open")
    )
    tasks = max(rival.tasks for rival in rivals)
    tested, facts = (sum(getattr(rival, name) for rival in rivals) for name in ("chance", "fact"))
    how = "no chance has a part in these runs: what differs, differs"
    if facts != len(rivals):
        how = f"signed-rank tests over {tasks} problems" if tasks >= MANY else "exact tests of the runs"
        how += f", {facts} of them by facts without chance" if facts else ""
        if tested:
            how += f", corrected for {counted(tested, 'comparison')} and for choosing the best, 5 % level"
    lead = ""
    if known := [rival for rival in rivals if rival.ratio.tasks]:  # both reach goals
        ratio = known[0].ratio
        pooled = f", pooled over {ratio.tasks} problems" if ratio.tasks > 1 else ""
        never = f", and never reaches the goal of {counted(ratio.never, 'other problem')}" if ratio.never else ""
        low, high = ratio.low > 0, bool(np.isfinite(ratio.high))  # runs may bound one side alone
        ends = f"at least {_times(ratio.low)}" if low else f"at most {_times(ratio.high)}"
        ends = f"{_times(ratio.low)} to {_times(ratio.high)}" if low and high else ends
        interval = "" if not (low or high) or ratio.low == ratio.high else f" (95 % interval {ends})"
        lead = (
            f" The next, {called[known[0].method]}, needs {_times(ratio.value)} times the evaluations to the goal"
            f"{interval}{pooled}{never}."
        )
    if len(worse) == len(rivals):
        others = "the other method" if len(rivals) == 1 else f"each of the {len(rivals)} others"
        return "decided", f"It is better than {others} ({how}).{lead}"
    reasons = [f"{_listed(open_)} {'is' if len(open_) == 1 else 'are'} not told apart from it"] if open_ else []
    where = "on some problem" if tasks > 1 else "in the order of the runs (goal, then cost)"
    reasons += [f"{_listed(somewhere)} {'is' if len(somewhere) == 1 else 'are'} better {where}"] if somewhere else []
    reasons += [f"{_listed(apart)} {'shares' if len(apart) == 1 else 'share'} no problem with it"] if apart else []
    enough = max((rival.enough for rival in rivals if rival.verdict == "open"), default=0)
    what = "problems" if tasks >= MANY else "seeds"
    more = f" So few runs cannot decide, whatever they hold: it takes {enough} {what} or more." if enough else ""
    better = f"It is better than {len(worse)} of {counted(len(rivals), 'other method')}"
    better = better if worse else "No other method is shown to be worse"
    return "undecided", f"{better}; {'; '.join(reasons)} ({how}).{more}{lead}"


def _times(value: float) -> str:
    """Return a ratio as text.

    >>> [_times(value) for value in (0.00123, 0.123, 1.0, 2.345, 17.2, 12345.0)]
    ['0.0012', '0.12', '1.0', '2.3', '17', '12345']
    """
    return f"{value:.2g}" if value < 1 else f"{value:.1f}" if value < 10 else f"{value:.0f}"


def _best(cells: pd.DataFrame, called: dict[Method, str], first: Method, within: str, aim: str) -> str:
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
        by_place = "comes first by its mean place, and " if (others >= firsts).sum() > 1 else ""
        return (
            f"{within}, {called[first]} {by_place}has the lowest median value on {firsts} of "
            f"{counted(len(mine), 'problem')}; {goal}."
        )
    won, total = int(known["reached"].sum()), int(known["runs"].sum())
    low, high = success_interval(won, total)
    cost = known["charged_to_target"].dropna()
    problems = len(known[PROBLEM].drop_duplicates())
    better = []  # who reaches the goal in a larger share of their runs, on fewer problems
    for pair, some in every.groupby(METHOD, sort=False):
        hits, tries, here = int(some["reached"].sum()), int(some["runs"].sum()), len(some[PROBLEM].drop_duplicates())
        if here < problems and hits > won / total * tries:
            name = called[str(pair[0]), str(pair[1])]
            better.append(f"{name} in {count(hits)} of {counted(tries, 'run')} on the {here} that it was run on")
    more = f", and {len(better) - _FEW} more" if len(better) > _FEW else ""
    fewer = f" On fewer problems a larger share reaches it: {'; '.join(better[:_FEW])}{more}." if better else ""
    soonest = f", after {count(float(cost.median()))} evaluations (median over the problems)" if len(cost) else ""
    interval = f"; 95 % interval {_percent(low)} to {_percent(high)}" if known["success_low"].notna().any() else ""
    return (
        f"{within}, {called[first]} reaches {aim} most: in {count(won)} of {counted(total, 'run')} "
        f"({_percent(won / total)}{interval}) on "
        f"{counted(problems, 'problem')}{soonest}.{fewer}"
    )


def _compared(runs: pd.DataFrame) -> str:
    methods, problems = (len(runs[columns].drop_duplicates()) for columns in (METHOD, PROBLEM))
    budgets = sorted(set(runs["budget"].dropna()))
    untold = int(runs["budget"].isna().sum())
    within = (
        "no budget told"
        if not budgets
        else f"at most {count(budgets[0])} evaluations each"
        if len(budgets) == 1
        else f"{len(budgets)} budgets from {count(budgets[0])} to {count(budgets[-1])} evaluations (the answer is "
        "at the largest)"
    )
    if budgets and untold:
        within += f", and of {counted(untold, 'published run')} none told (the answer leaves them out)"
    seeds = runs.groupby([*PROBLEM, *METHOD, "start", "budget"], dropna=False).size()
    each = f"{seeds.min()}" if seeds.min() == seeds.max() else f"{seeds.min()} to {seeds.max()}"
    lost = lost_of(runs).sentence() or "no run failed"
    return (
        f"Compared: {counted(methods, 'method')} on {counted(problems, 'problem')}, {count(len(runs))} "
        f"{'run' if len(runs) == 1 else 'runs'} ({each} a method and problem), {within}; {lost}."
    )


def _listed(names: list[str]) -> str:
    shown = names[:_NAMED] if len(names) > _NAMED + 1 else names
    words = [*shown, *([f"{len(names) - len(shown)} more"] if len(names) > len(shown) else [])]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _percent(share: float) -> str:
    """Return a share as the tables of the page have it, which a browser rounds: a half up.

    >>> [_percent(share).replace("\\u00a0", " ") for share in (0, 0.004, 0.125, 0.996, 1)]
    ['0 %', '<1 %', '13 %', '>99 %', '100 %']
    """
    percent = "<1" if 0 < share < 0.01 else ">99" if 0.99 < share < 1 else f"{int(100 * share + 0.5)}"
    return f"{percent}\u00a0%"
