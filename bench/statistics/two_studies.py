"""Two studies cell by cell: where the second is better, where it is worse, where the runs do not tell.

A cell of one is compared with the same cell of the other: the same problem, optimiser, start, budget and target, with
the same options, or where each side has just one other set of options, with that. Options are the same where those that
differ from the declared ones are: another version may have declared more. Holm's correction is over all cells that are
tested, so that for studies without a difference some cell is reported as different in at most 5 of 100.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, final

import numpy as np
import pandas as pd

from calibench import optimizers, problems
from calibench.bench.provenance.run_id import canonical, chosen_options
from calibench.bench.statistics.cells import METHOD, PROBLEM, SETTING, answers
from calibench.bench.statistics.ranking import By, holm, scores
from calibench.bench.statistics.summary import (
    goal_hits,
    goals_of,
    has_chance,
    median_of_reached,
    option_text,
    outside_box,
    quantiles,
)
from calibench.bench.statistics.two_methods import Tested, two_methods
from calibench.bench.store.columns import parts
from calibench.core.words import counted

Verdict = Literal["better", "worse", "equal", "undecided"]
LEVEL = 0.05
_SHARED = ["data_id", *SETTING]
_UNSAID = "default"


@final
@dataclass(frozen=True)
class Shared:
    """Two sets of runs that are compared, and how the options of the second differ; '' where they do not."""

    first: pd.DataFrame
    second: pd.DataFrame
    other_options: str


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
    """Return how the runs `second` stand to the runs `first`, cell by cell; `by` is the order of runs (`score`).

    With `methods` the two are optimisers, by name, and cells are matched whatever their optimiser. Columns: problem,
    problem_options, data_id, optimizer, optimizer_options (of the first), other_options (of the second, where they
    differ), start, budget, target, goal (NaN: none), unit (of the value), minimum (as declared; NaN: none), runs_a,
    runs_b, pairs (0: unpaired), alone_a and alone_b (runs without a partner, which are left out of pairs and of every
    number here), test, p, p_holm, p_sign, a12 with a12_low and a12_high (how often a run of the second beats one of the
    first), outside_a and outside_b (answers outside the box), reached_a, reached_b, charged_to_target_a and
    _b, best_median_a and _b, verdict (of the second), why.
    """
    matched, only = _matched(first, second, methods)
    sides = [partners(pair.first, pair.second) for pair in matched]
    results = [
        two_methods(scores(a, by), scores(b, by), paired, (has_chance(a), has_chance(b))) for a, b, paired in sides
    ]
    rows = [
        _row(pair, side, result, p, *_of_runs(side, result, verdict, why, by))
        for pair, side, result, (p, verdict, why) in zip(matched, sides, results, verdicts(results, by), strict=True)
    ]
    return Compared(pd.DataFrame(rows), *only)


def verdicts(results: Sequence[Tested], by: By = "goal") -> list[tuple[float, Verdict, str]]:
    """Return of each cell's result Holm's p over all of them, the verdict on the second side, and why."""
    adjusted = [float(p) for p in holm([result.p for result in results])]
    return [(p, *_verdict(result, p, by)) for result, p in zip(results, adjusted, strict=True)]


def _matched(
    first: pd.DataFrame, second: pd.DataFrame, methods: tuple[str, str] | None
) -> tuple[list[Shared], tuple[int, int]]:
    """Return the shared cells, and how many cells only the first and only the second has."""
    sides = [_cells(runs, methods is not None) for runs in (first, second)]
    shared: list[Shared] = []
    only = [0, 0]
    for key in dict.fromkeys([*sides[0], *sides[1]]):
        a, b = (side.get(key, {}) for side in sides)
        same = [options for options in a if options in b]
        shared += [Shared(a[options], b[options], "") for options in same]
        rest = [[options for options in side if options not in same] for side in (a, b)]
        if len(rest[0]) == len(rest[1]) == 1:
            shared.append(Shared(a[rest[0][0]], b[rest[1][0]], _difference(rest[0][0], rest[1][0])))
        else:
            only = [count + len(more) for count, more in zip(only, rest, strict=True)]
    return shared, (only[0], only[1])


def _cells(runs: pd.DataFrame, any_method: bool) -> dict[tuple[Any, ...], dict[str, pd.DataFrame]]:
    """Return {what must be the same: {chosen options of the optimiser: runs}}."""
    cells: dict[tuple[Any, ...], dict[str, pd.DataFrame]] = {}
    for key, mine in runs.groupby([*PROBLEM, *METHOD, *SETTING], sort=False, dropna=False):
        named: dict[str, Any] = dict(zip([*PROBLEM, *METHOD, *SETTING], key, strict=True))
        problem, method = (
            canonical(chosen_options(registry, named[kind], json.loads(named[f"{kind}_options"])))
            for registry, kind in ((problems.registry, "problem"), (optimizers.registry, "optimizer"))
        )
        setting = tuple(None if named[name] != named[name] else named[name] for name in _SHARED)
        what = (named["problem"], problem, *setting, *([] if any_method else [named["optimizer"]]))
        options = f"{named['optimizer']} {method}" if any_method else method
        held = cells.setdefault(what, {})
        held[options] = pd.concat([held[options], mine]) if options in held else mine
    return cells


def _difference(first: str, second: str) -> str:
    """Return how two sets of chosen options differ, in the form of the command line."""
    try:
        a, b = (parts(json.loads(text), classes=False) for text in (first, second))
    except ValueError:  # two methods, each with its name
        return second
    keys = [key for key in dict.fromkeys([*a, *b]) if a.get(key) != b.get(key)]
    others = {key: option_text(key, b.get(key, _UNSAID)).removeprefix(f"{key}=") for key in keys}
    return ", ".join(f"{option_text(key, a.get(key, _UNSAID))} -> {others[key]}" for key in keys)


Sides = tuple[pd.DataFrame, pd.DataFrame, bool]  # the runs of both that are compared, and whether they are pairs


def partners(first: pd.DataFrame, second: pd.DataFrame) -> Sides:
    """Return the runs to compare, and whether they are pairs: runs of one repetition, which share data and start.

    They are where at least half of the runs of the larger side have a partner; then the others are left out.
    """
    if first["repetition"].is_unique and second["repetition"].is_unique:
        shared = sorted(set(first["repetition"]) & set(second["repetition"]))
        if shared and len(shared) >= max(len(first), len(second)) / 2:
            a, b = (runs.set_index("repetition", drop=False).loc[shared] for runs in (first, second))
            return a.reset_index(drop=True), b.reset_index(drop=True), True
    return first, second, False


def _of_runs(side: Sides, result: Tested, verdict: Verdict, why: str, by: By) -> tuple[Verdict, str]:
    """Return verdict and reason with what the scores alone do not tell: that nothing ended, that all is at the goal."""
    first, second, _ = side
    if result.test == "equal" and not any(np.isfinite(scores(runs, by)).all(axis=1).any() for runs in (first, second)):
        if by == "charged":
            return "undecided", "no run of either side ended well"
        if not any(np.isfinite(answers(runs)).any() for runs in (first, second)):
            return "undecided", "no run of either side found a value"
    arrived = all(np.isfinite(goal_hits(runs)).all() for runs in (first, second))
    if by == "value" and verdict in ("better", "worse") and arrived:
        return verdict, f"{why}; but all runs are below the goal, where values may differ by rounding alone"
    return verdict, why


def _row(pair: Shared, side: Sides, result: Tested, p: float, verdict: Verdict, why: str) -> dict[str, Any]:
    row: dict[str, Any] = {name: pair.first[name].iloc[0] for name in (*PROBLEM, *METHOD)}
    row |= {"other_options": pair.other_options} | {name: pair.first[name].iloc[0] for name in SETTING}
    unit = pair.first["unit"].iloc[0]
    row |= {"goal": float(goals_of(pair.first)[0]), "unit": unit if isinstance(unit, str) else ""}
    least = pair.first["minimum"].iloc[0] if pair.first["judged_value"].isna().all() else None
    row |= {"minimum": float("nan") if least is None else float(least)}  # of noisy values there is none
    row |= {"runs_a": result.runs[0], "runs_b": result.runs[1], "pairs": result.pairs}
    row |= {"alone_a": len(pair.first) - len(side[0]), "alone_b": len(pair.second) - len(side[1]), "test": result.test}
    row |= {"p": result.p, "p_holm": p, "p_sign": result.sign_p}
    row |= {"a12": result.effect.a12, "a12_low": result.effect.low, "a12_high": result.effect.high}
    for name, runs in (("a", side[0]), ("b", side[1])):  # of the runs that were tested
        hits = goal_hits(runs)
        values = answers(runs)
        row |= {
            f"outside_{name}": int(outside_box(runs).sum()),
            f"reached_{name}": int(np.isfinite(hits).sum()),
            f"charged_to_target_{name}": median_of_reached(hits),
            f"best_median_{name}": float(quantiles(values, (0.5,))[0]),
        }
    return row | {"verdict": verdict, "why": why}


def _verdict(result: Tested, p: float, by: By) -> tuple[Verdict, str]:
    if result.test == "equal":
        return "equal", "every run was charged the same" if by == "charged" else "every run gave the same"
    if result.test == "none":
        return "undecided", "no runs on one side"
    way: Verdict = "better" if result.ahead > 0 else "worse"
    if result.test == "fact":
        if not result.ahead:
            return "undecided", "runs without chance that differ both ways"
        return way, "no chance in it: what differs, differs"
    if p <= LEVEL and result.ahead:
        return way, f"Holm's p {p:.2g}"
    if p <= LEVEL:
        return "undecided", f"Holm's p {p:.2g}, but of all couples as many or more say the opposite"
    if result.p_least > LEVEL:
        of = counted(result.pairs, "pair") if result.pairs else f"{result.runs[0]} and {result.runs[1]} runs"
        of += ", of one side without chance," if result.test == "sign" else ""
        return "undecided", f"{of} cannot give a p below {result.p_least:.2g}"
    return "undecided", f"Holm's p {p:.2g}"
