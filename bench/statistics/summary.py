"""Statistics of the runs of each cell: quartiles, success rate with its interval, convergence bands."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache
from math import sqrt
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench import optimizers, problems
from calibench.bench.execution.merit import PREFIX
from calibench.bench.execution.request.checks import repetitions_of
from calibench.bench.execution.stochastic import answers, said_by_the_problem
from calibench.bench.provenance.run_id import chosen_options, given_options
from calibench.bench.statistics.by_cell import ByCell, by_cell, by_number, floats
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM
from calibench.bench.statistics.names.presets import preset_names
from calibench.bench.statistics.priced import priced
from calibench.bench.store.lists import lists_of
from calibench.bench.store.options import parts, typed

Array = NDArray[np.float64]
QUARTILES = (0.25, 0.5, 0.75)
_NORMAL_975 = 1.959963984540054  # the normal distribution's quantile at .975
MOST_TOLD = 3  # options of a user's class, up to which all of them are told


def summary(runs: pd.DataFrame, costs: Iterable[Mapping[str, Any]] = ()) -> pd.DataFrame:
    """Return a row for each cell (`bench.statistics.cells`): medians, quartiles, success, failures.

    `success` is the share of all runs, failed ones included, that reached the `goal`: the run's target, or where it had
    none the last of the problem's. A failed run reached nothing. The share's 95 % interval is
    Wilson's, and NaN where chance has no part in the runs. Without a goal there is no success: NaN.
    `charged_to_target` is the median over the runs that did: read it beside `success`. Below `floor` values are not
    compared. Where values are noisy, best_* are of the answers as they were judged afterwards
    (`bench.execution.stochastic`), and `seen_median` is of the values that the runs saw. With `costs`
    (`bench.sweep.costs`) also `objective_s_median`, the seconds that the objective took, and `objective_s_to_target`.
    """
    if runs.empty:
        return pd.DataFrame()
    seconds = priced(runs, costs)
    cells = by_cell(runs)
    first, count = runs.iloc[cells.first], cells.count
    reached, charged = goal_hits(runs).to_numpy(), floats(runs["charged"])
    hit = np.isfinite(reached)
    won = cells.sums(hit)
    level = goals_of(first)
    low, high = np.full(len(count), np.nan), np.full(len(count), np.nan)
    for i in np.flatnonzero((level == level) & chances(runs, cells)):
        low[i], high[i] = success_interval(int(won[i]), int(count[i]))
    q1, median, q3 = cells.quantiles(floats(answers(runs)), QUARTILES)
    unit = runs["unit"].iloc[cells.last] if "unit" in runs else [None] * len(count)
    minimum = _minima(runs, cells)
    known = {
        "runs": count,
        "failed": cells.sums(runs["status"] != "ok"),
        "goal": level,
        "reached": won,
        "success": np.where(level == level, won / count, np.nan),
        "success_low": low,
        "success_high": high,
        "floor": [floor_of(each) for each in level.tolist()],
        "best_q1": q1,
        "best_median": median,
        "best_q3": q3,
        "seen_median": cells.quantiles(floats(runs["best_value"]), (0.5,))[0],
        "charged_median": cells.medians(charged),
        "charged_to_target": cells.medians(np.where(hit, reached, np.nan)),
        "inside_box": cells.sums(runs["inside_box"].fillna(False)),
        "outside_box": cells.sums(outside_box(runs)),
        "restarts": cells.sums(runs["restarts"].fillna(0)),
        "kmrmse_median": cells.medians(floats(runs["kmrmse"])),
        "kmrmse_aligned_median": cells.medians(floats(runs["kmrmse_aligned"])),
        "parameter_error_mm_median": cells.medians(floats(runs["parameter_error_mm"])),
        "gauge_phi_spread": cells.spreads(floats(runs["gauge_phi"])),
        "wall_s_median": cells.medians(floats(runs["wall_s"])),
        "unit": [text if isinstance(text, str) else "" for text in unit],
        "minimum": minimum,
        "noisy": _noisy(runs, cells),
    } | _merits(runs, cells)
    if seconds.notna().any():
        mine = floats(seconds)
        # seconds of its calls until the target, as if all kinds of calls were evenly mixed
        to_target = np.where(hit, mine * (reached / charged), np.nan)
        known |= {
            "objective_s_median": np.where(cells.sums(np.isnan(mine)) > 0, np.nan, cells.medians(mine)),
            "objective_s_to_target": cells.medians(to_target),
        }
    return pd.concat([first[CELL].reset_index(drop=True), pd.DataFrame(known)], axis=1)


def outside_box(runs: pd.DataFrame) -> NDArray[np.bool_]:
    """Return whether each run has an answer that lies outside the box; of published runs nobody knows, so not."""
    left = ~runs["inside_box"].fillna(True).to_numpy(dtype=bool)
    return np.asarray(left & np.isfinite(floats(runs["best_value"])))


def _minima(runs: pd.DataFrame, cells: ByCell) -> Array:
    """Return the minimum that each cell's problem declares; NaN: none, or a run of any cell of the problem is below."""
    if "minimum" not in runs:
        return np.full(len(cells.count), np.nan)
    declared = floats(runs["minimum"].iloc[cells.last])
    inside = runs["inside_box"].fillna(False).astype(bool).to_numpy()
    lowest = cells.least(np.where(inside & np.isfinite(runs["best_value"]), floats(runs["best_value"]), np.nan))
    problem = runs.groupby(PROBLEM, sort=False, dropna=False).ngroup().to_numpy()[cells.first]
    wrong = [
        problem[i]
        for i in np.flatnonzero(lowest < declared).tolist()
        if lowest_below(runs.iloc[cells.rows(i)], float(declared[i])) is not None
    ]
    return np.where(np.isin(problem, wrong), np.nan, declared)  # a declared minimum that a run has passed is wrong


def _noisy(runs: pd.DataFrame, cells: ByCell) -> NDArray[np.bool_]:
    if "judged_value" not in runs:
        return np.zeros(len(cells.count), dtype=bool)
    return cells.sums(runs["judged_evaluations"].notna()) > 0


def _merits(runs: pd.DataFrame, cells: ByCell) -> dict[str, Array]:
    """Return of each ``merit.KEY`` the medians (``_median``), or of flags the shares (``_share``)."""
    found = {}
    for key in (str(key) for key in runs.columns if str(key).startswith(PREFIX)):
        if pd.api.types.is_bool_dtype(runs[key]):
            known = cells.sums(runs[key].notna())
            with np.errstate(invalid="ignore"):
                found[f"{key}_share"] = cells.sums(runs[key].fillna(False)) / known
        elif pd.api.types.is_float_dtype(runs[key]):
            found[f"{key}_median"] = cells.medians(floats(runs[key]))
    return found


def lowest_below(runs: pd.DataFrame, minimum: float) -> float | None:
    """Return the lowest value of an answer inside the box that is below `minimum` by more than rounding, or None.

    Noisy values may be below it by chance, so they do not count.
    """
    if minimum != minimum or said_by_the_problem(runs)["noisy"]:
        return None
    values = floats(runs["best_value"])
    found = values[runs["inside_box"].fillna(False).to_numpy(dtype=bool) & np.isfinite(values)]
    if not found.size:
        return None
    allowed = 1e-9 * max(abs(minimum), float(np.median(np.abs(found))))
    return float(found.min()) if found.min() < minimum - allowed else None


def quantiles(values: Array, at: Sequence[float]) -> Array:
    """Return the quantiles `at` of `values` along their first axis: those between two runs interpolated (type 7).

    A run without a value (infinite, NaN) is worse than all; a quantile on or beside it is infinite, never NaN.

    >>> quantiles(np.array([1.0, 2.0, 4.0, np.inf]), [0.25, 0.5, 0.75]).tolist()
    [1.75, 3.0, inf]
    """
    ordered = np.sort(np.where(np.isnan(values), np.inf, values), axis=0)
    found = []
    for q in at:
        place = q * (len(ordered) - 1)
        below = int(place)
        share = place - below
        low, high = ordered[below], ordered[min(below + 1, len(ordered) - 1)]
        between = low if share == 0 else (1 - share) * low + share * high
        found.append(np.clip(between, low, high))  # of two equal values their value, to the last bit
    return np.array(found)


def median_of_reached(values: Array) -> float:
    """Return the median of what is finite; NaN of nothing."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


@cache
def success_interval(successes: int, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share, as scipy.stats has it to the last bit; that loads for half a second.

    Newcombe, Two-sided confidence intervals for the single proportion, Statistics in Medicine 17 (1998), method 3.
    """
    p, n, z = successes / count, count, _NORMAL_975
    width = 2 * (n + z**2)
    middle, half = (2 * n * p + z**2) / width, z / width * sqrt(4 * n * p * (1 - p) + z**2)
    return (middle - half if successes else 0.0), (middle + half if successes < count else 1.0)


def chances(runs: pd.DataFrame, cells: ByCell) -> NDArray[np.bool_]:
    """Tell of each cell whether chance has a part in its runs: in the method, in its start, or seen in what they gave.

    A deterministic method from one start gives one answer, however often it is run: nothing there is uncertain.
    """
    found = _noisy(runs, cells)  # of a noisy value even one run is a draw
    for name in ("best_value", "charged"):
        values = floats(runs[name])
        unlike = cells.sums(np.isnan(values)) > 0  # a run without a value is like no other
        found |= (cells.count > 1) & (unlike | (cells.least(values) < cells.most(values)))
    first = runs.iloc[cells.first]
    methods = zip(*(first[name].astype(str) for name in (*METHOD, "start")), strict=True)
    return found | [not runs_once(*method) for method in methods]


def has_chance(cell: pd.DataFrame) -> bool:
    """Tell whether chance has a part in the runs of one cell (`chances`)."""
    return bool(chances(cell, by_number(np.zeros(len(cell), dtype=np.int64)))[0])


@cache
def runs_once(optimizer: str, options: str, start: str) -> bool:
    """Tell whether a method, as rows name it, gives one answer however often it is run from this start."""
    try:
        made = optimizers.make(optimizer, **given_options(optimizers.registry, optimizer, json.loads(options)))
    except (Exception, SystemExit):  # somebody's own that is not here: nothing is known of it
        return False
    if not isinstance(getattr(made, "traits", None), optimizers.Traits):  # its row does not tell them
        return False
    return len(repetitions_of(made, "random" if start == "random" else "nominal", range(2))) == 1


def floor_of(goal: float) -> float:
    """Return the level at and below which values are tied: the goal, where there is one; else none is known (-inf)."""
    return goal if goal == goal else -np.inf


def method_names(table: pd.DataFrame) -> pd.Series:
    """Return what each row's method is called: the optimiser, and of its variants here what sets them apart.

    A variant is named by its options that are not the declared default, the first of them if that is enough; a preset
    of two options or more by its own name (`bench.statistics.names.presets`).
    """
    pairs = table[["optimizer", "optimizer_options"]].drop_duplicates().to_numpy().tolist()
    names: dict[tuple[str, str], str] = {}
    ours = set(optimizers.registry.names())
    for optimizer, text in pairs:
        told = chosen_options(optimizers.registry, optimizer, parts(json.loads(text), classes=False))
        others = [parts(json.loads(its)) for name, its in pairs if name == optimizer]
        alone = len(others) == 1
        if (
            optimizer not in ours and len(told) > MOST_TOLD
        ):  # nobody here knows its defaults: what its variants differ in
            told = {key: value for key, value in told.items() if any(each.get(key) != value for each in others)}
        said = [option_text(*option) for option in told.items()]
        preset = preset_names().get((optimizer, text)) if len(said) > 1 else None
        plain = optimizer if alone or not said else f"{optimizer} ({', '.join(said)})"
        names[optimizer, text] = preset or plain
    short = {pair: name.partition(",")[0] + ", …)" if "," in name else name for pair, name in names.items()}
    chosen = short if len(set(short.values())) == len(pairs) else names
    return pd.Series(
        [chosen[pair] for pair in zip(table["optimizer"], table["optimizer_options"], strict=True)],
        index=table.index,
        dtype=str,
    )


def method_name(optimizer: str, options: str) -> str:
    """Return an optimiser alone: its name and the options that are not the declared default."""
    said = chosen_options(optimizers.registry, optimizer, parts(json.loads(options), classes=False))
    return " ".join([optimizer, *(option_text(*option) for option in sorted(said.items()))])


def option_text(key: str, value: Any, short: bool = True) -> str:
    """Return an option as tables say it: None, and where `short` a member of an enumeration, as one types them.

    >>> option_text("shift", None), option_text("restarts", True), option_text("loss", "rig:Loss.L1")
    ('shift=null', 'restarts=True', 'loss=L1')
    """
    return f"{key}={'null' if value is None else typed(value) if short else value}"


def problem_name(problem: str, options: str, but: Sequence[str] = (), also: Collection[str] = ()) -> str:
    """Return what a problem is called beside others: its name and the options that are not the declared default.

    Those in `also` are told at their default too.
    """
    declared = problems.registry.options(problem) if problem in problems.registry.names() else {}
    have = parts(json.loads(options))
    named = parts(json.loads(options), classes=False)
    told = chosen_options(problems.registry, problem, named) | {key: have[key] for key in also if key in have}
    said = [
        option_text(key, value)
        for key, value in sorted(told.items())
        if key not in but
        and not (key == "n" and key in declared and declared[key].default is None)
        and not (value is None and declared)  # a problem of ours says so of what does not apply to its data
    ]
    return " ".join([problem, *said])


def convergence(traces: Iterable[pd.DataFrame], at: Array) -> pd.DataFrame:
    """Return median and quartiles of the best value after `at` charged evaluations, over runs.

    A run that has ended keeps its last value; before its first evaluation it has none, and the band begins where all
    runs have begun. A run that ended without an evaluation, whose trace is empty, is infinite throughout.
    """
    curves = []
    for trace in traces:
        charged = trace["charged"].to_numpy()
        if not len(charged):
            curves.append(np.full(len(at), np.inf))
            continue
        index = np.searchsorted(charged, at, side="right") - 1
        values = trace["best_value"].to_numpy(dtype=float)[np.maximum(index, 0)]
        curves.append(np.where(index >= 0, values, np.nan))
    stack = np.array(curves)
    begun = ~np.isnan(stack).any(axis=0)
    low, middle, high = quantiles(stack[:, begun], QUARTILES)
    return pd.DataFrame({"charged": at[begun], "q1": low, "median": middle, "q3": high, "runs": len(curves)})


def goal(target: float | None, targets: Sequence[float]) -> float:
    """Return the level that counts as success: the run's own target, else the last of the problem's, else NaN."""
    if target is not None and target == target:
        return float(target)
    levels = list(targets)
    return float(levels[-1]) if levels else float("nan")


def goals_of(runs: pd.DataFrame) -> Array:
    """Return the `goal` of each run, shape (runs,)."""
    own = floats(runs["target"])
    return np.where(np.isnan(own), lists_of(runs["targets"]).last, own)


def goal_hits(runs: pd.DataFrame) -> pd.Series:
    """Return for each run the charged evaluations at which its goal was reached; NaN where it never was.

    A failed run reached nothing, whatever it passed: it has no answer that was judged. One that was ended by its time
    limit keeps what it reached before.
    """
    levels, hits = lists_of(runs["targets"]), lists_of(runs["hits_charged"])
    found = np.full(len(runs), np.nan)
    at_goal = np.flatnonzero(levels.flat == np.repeat(goals_of(runs), levels.count))
    rows, first = np.unique(levels.row[at_goal], return_index=True)
    place = at_goal[first] - levels.begins[rows]
    found[rows] = hits.flat[hits.begins[rows] + place]
    found[(runs["status"] == "failed").to_numpy(dtype=bool)] = np.nan
    return pd.Series(found, index=runs.index, dtype=float)
