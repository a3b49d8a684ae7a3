"""Fixed target: the cost of a method until it reaches a target. Expected running time (ERT), success, runtime ECDF.

ERT = (sum over all runs of what each spent) / (number of runs that reached the target): a run that reached it spent
until its hit, one that did not spent all that *it* was charged, not the budget and not the largest count of others. It
is the expected cost of a method that begins again until it reaches the target. Where no run reached the target it is
infinite and only a bound is known: `at_least`, all that was spent.

Source: Hansen et al., COCO: Performance Assessment, 2016, section 4; Auger and Hansen, CEC 2005.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench.bench.statistics.by_cell import by_cell
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, SETTING
from calibench.bench.statistics.fixed_target.ert_interval import ert_interval
from calibench.bench.statistics.fixed_target.restarted import restarted
from calibench.bench.statistics.fixed_target.runtimes import TARGET, Currency, Runtimes, runtimes
from calibench.bench.statistics.summary import chances, success_interval
from calibench.bench.store.options import PREFIXES
from calibench.core.options import suggest

Array = NDArray[np.float64]
_CELL = [*CELL[:-1], "target_value"]  # the run's own target, beside the target that is looked at


def ert(
    hits: pd.DataFrame,
    runs: pd.DataFrame,
    *,
    currency: Currency = "charged",
    instances: Sequence[str] = (),
    intervals: bool = True,
) -> pd.DataFrame:
    """Return a row for each cell (`bench.statistics.cells`) and target of `hits`.

    Columns: those of `CELL`, the run's own target as target_value; the swept options that `runs` has as columns;
    dimension, quantity, target, runs, reached, success with success_low and success_high (Wilson, 95 %), spent (of all
    runs until the target or in vain), ert (= spent / reached; infinite where none reached it) with ert_low and ert_high
    (95 %, `fixed_target.ert_interval`; an end that is infinite, or 1, says that the runs are too few to bound it),
    at_least (spent, where none reached it, else NaN), ert_earliest (with each hit at the earliest count that its
    thinned trace allows), resampled (what the interval speaks of: other "runs", or other "instances"; '' where there is
    none). Counts are of `currency`.

    Problems that differ only in the options `instances`, such as ("instance",), are one. From five instances on these
    are resampled, with all their runs. A target counts the runs that have it: what one instance declares is not asked
    of the others. There is no interval where not all runs of a cell have the target, nor where chance has no part.
    """
    columns = [str(name) for name in runs.columns]
    swept = [name for name in columns if name.startswith(PREFIXES) and name.partition(".")[2] not in instances]
    needed = runs[[name for name in columns if name in _NEEDED or name in swept]]  # cutting few columns is cheap
    whole = list(runtimes(hits, needed, currency, instances))
    if not whole:
        return pd.DataFrame(columns=[*_CELL, *swept, "dimension", *TARGET, *_TOLD])
    joined = _told(whole, intervals, swept)
    low, high = success_intervals(joined["reached"], joined["runs"])
    chance = joined.pop("chance")
    joined |= {
        "success": joined["reached"] / joined["runs"],
        "success_low": np.where(chance, low, np.nan),
        "success_high": np.where(chance, high, np.nan),
    }
    # the mean cost of a run, divided by the largest success rate that these runs allow
    bound = chance & (joined["reached"] == 0)
    joined["ert_low"] = np.where(bound, joined["spent"] / joined["runs"] / high, joined["ert_low"])
    joined["ert_high"] = np.where(bound, np.inf, joined["ert_high"])
    joined["ert_low"] = np.maximum(joined["ert_low"], 1.0)  # nothing is reached without an evaluation
    unbounded = joined["ert_high"] > _BOUNDED * joined["ert"]
    joined["ert_high"] = np.where(unbounded, np.inf, joined["ert_high"])
    return pd.DataFrame(joined)[[*_CELL, *swept, "dimension", *TARGET, *_TOLD]]


def _told(whole: Sequence[Runtimes], intervals: bool, swept: Sequence[str]) -> dict[str, Any]:
    """Return the columns of `ert`, problem by problem, in it cell by cell and there target by target."""
    runs, levels = whole[0].all_runs, whole[0].all_targets
    cells = by_cell(runs)
    number, chances_of = cells.number, chances(runs, cells)
    instances, repetition = pd.factorize(runs["instance"], sort=True)[0], runs["repetition"].to_numpy()
    parts: dict[str, list[Any]] = {
        name: [] for name in ("run", "level", "size", "runs", "chance", "reached", "spent", "least")
    }
    units: list[Units | None] = []
    for one in whole:
        cell, instance = pd.factorize(number[one.at])[0], instances[one.at]
        order = np.lexsort([repetition[one.at], instance, cell])  # in a cell the same for every method
        begins = np.flatnonzero(np.diff(cell[order], prepend=-1))
        count = np.diff(begins, append=len(order))
        first, instance = one.at[order[begins]], instance[order]
        won, paid = np.isfinite(one.time[order]), one.paid[order]
        early, asked = np.where(won, one.earliest[order], paid), one.asked[order].astype(np.int64)
        for begin, size, chance in zip(
            begins.tolist(), count.tolist(), chances_of[number[first]].tolist(), strict=True
        ):
            mine = slice(begin, begin + size)
            units.append(_units(paid[mine], won[mine], instance[mine]) if chance and intervals else None)
        for name, values in (("run", first), ("size", count), ("chance", chances_of[number[first]])):
            parts[name].append(np.repeat(values, len(one.level)))
        parts["level"].append(np.tile(one.level, len(begins)))
        for name, table in (("spent", paid), ("least", early), ("reached", won.astype(np.int64)), ("runs", asked)):
            parts[name].append(np.add.reduceat(table, begins, axis=0).ravel())
    column = {name: np.concatenate(values) for name, values in parts.items()}
    low, high, resampled = _intervals(units, [len(one.level) for one in whole for _ in range(one.cells(number))])
    low[column["runs"] < column["size"]] = high[column["runs"] < column["size"]] = np.nan
    known = column["runs"] > 0
    column, low, high, resampled = {n: v[known] for n, v in column.items()}, low[known], high[known], resampled[known]
    own = dict(zip(_CELL, CELL, strict=True)) | {name: name for name in (*swept, "dimension")}
    found: dict[str, Any] = {name: runs[source].to_numpy()[column["run"]] for name, source in own.items()}
    found |= {name: levels[name].to_numpy()[column["level"]] for name in TARGET}
    found |= {name: column[name] for name in ("runs", "reached", "spent", "chance")}
    never = column["reached"] == 0
    one = np.maximum(column["reached"], 1)
    return found | {
        "ert": np.where(never, np.inf, column["spent"] / one), "ert_low": low, "ert_high": high,
        "at_least": np.where(never, column["spent"], np.nan),
        "ert_earliest": np.where(never, np.inf, column["least"] / one),
        "resampled": np.where(np.isnan(low), "", resampled),
    }  # fmt: skip


Units = tuple[Array, Array, str]  # of each unit what it paid and won, shapes (units, targets), and what units are


def _units(paid: Array, won: NDArray[np.bool_], instance: NDArray[np.int64]) -> Units:
    """Return the units that are resampled for a cell: the runs, or from five instances on these."""
    starts = np.flatnonzero(np.diff(instance, prepend=-1))
    if len(starts) < _ENOUGH:
        return paid, won.astype(float), "runs"
    return np.add.reduceat(paid, starts, axis=0), np.add.reduceat(won.astype(float), starts, axis=0), "instances"


def _intervals(units: Sequence[Units | None], sizes: Sequence[int]) -> tuple[Array, Array, NDArray[np.object_]]:
    """Return low, high and what was resampled, cell by cell, `sizes` targets each.

    Cells of as many units share their draws, and are resampled at once.
    """
    ends = np.cumsum(sizes)
    low, high = np.full(int(ends[-1]), np.nan), np.full(int(ends[-1]), np.nan)
    kind = np.full(len(low), "", dtype=object)
    alike: dict[int, list[int]] = {}
    for i, one in enumerate(units):
        if one is not None:
            alike.setdefault(len(one[0]), []).append(i)
    for cells in alike.values():
        paid, won = (np.concatenate([units[i][k] for i in cells], axis=1) for k in (0, 1))  # type: ignore[index]
        place = np.concatenate([np.arange(ends[i] - sizes[i], ends[i]) for i in cells])
        kind[place] = np.repeat([units[i][2] for i in cells], [sizes[i] for i in cells])  # type: ignore[index]
        for begin in range(0, len(place), _AT_ONCE):
            some = slice(begin, begin + _AT_ONCE)
            low[place[some]], high[place[some]] = ert_interval(paid[:, some], won[:, some])
    return low, high, kind


_AT_ONCE = 4096  # targets, of which 999 resamples take some tens of megabytes
_TOLD = [
    "runs", "reached", "success", "success_low", "success_high", "spent", "ert", "ert_low", "ert_high", "at_least",
    "ert_earliest", "resampled",
]  # fmt: skip
_BOUNDED = 1e6  # times ERT: an upper end beyond this means that the runs are too few for a bound
_NEEDED = {
    "run_id", *CELL, "dimension", "repetition", "evaluations", "charged", "best_value", "judged_value",
    "judged_evaluations",
}  # fmt: skip  # columns of runs that expected running times come from
_ENOUGH = 5  # instances: from so many on, instances are resampled instead of runs


def success_intervals(successes: NDArray[np.int64], counts: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return Wilson's 95 % intervals of shares, shapes (n,): `scipy.stats.binomtest`, once for each pair of numbers."""
    pairs, where = np.unique(np.column_stack([successes, counts]), axis=0, return_inverse=True)
    found = np.array([success_interval(int(k), int(n)) for k, n in pairs]).reshape(-1, 2)[where.ravel()]
    return found[:, 0], found[:, 1]


def ecdf(
    hits: pd.DataFrame,
    runs: pd.DataFrame,
    by: Sequence[str] = (),
    *,
    currency: Currency = "charged",
    at: Sequence[float] | None = None,
    per_dimension: bool = False,
    restarts: int = 0,
) -> pd.DataFrame:
    """Return the runtime ECDF of each method: the share of (run, target) pairs that it reached within a cost.

    Columns: `by` (columns of runs that make a group, such as ("problem",); none: all), quantity (targets of several are
    never mixed), optimizer, optimizer_options, start, budget, target_value (the run's own, NaN: none), cost, share,
    problems, of_problems. `cost`, by default 20 values a decade up to the largest, is in charged evaluations, or these
    / dimension. The share is over the problems of the group on which all its methods were run: `problems` of its
    `of_problems`. Where there is none, it is over those of the method, as its `problems` tells. Every problem counts
    the same, whatever the number of its runs and targets. With `restarts` above 0 so many costs of each target are
    drawn with simulated restarts (`fixed_target.restarted`) in place of the runs' own.
    """
    for name in by:
        if name not in runs:
            raise ValueError(f"runs have no column {name!r} to group by; {suggest(name, map(str, runs.columns))}")
    method = [*METHOD, *SETTING]
    runs = runs[list(dict.fromkeys(["run_id", *PROBLEM, *method, *by, "dimension", currency]))]  # few are cheap to cut
    methods = by_cell(runs, method)
    told_of = list(runs[method].iloc[methods.first].itertuples(index=False, name=None))
    whole = list(runtimes(hits, runs.assign(_method=methods.number), currency))
    rows = whole[0].all_runs if whole else runs.iloc[:0].assign(_method=0)
    groups = list(rows[list(by)].itertuples(index=False, name=None)) if by else [()] * len(rows)
    method_of = rows["_method"].to_numpy()
    parameters = rows["dimension"].to_numpy(dtype=float) if per_dimension else np.ones(len(rows))
    quantity_of = whole[0].all_targets["quantity"].to_numpy(dtype=object) if whole else np.empty(0, dtype=object)
    scale = [parameters[one.at] for one in whole]
    cost = np.asarray([] if at is None else at, dtype=float)
    if at is None:
        most = max((float((one.spent / s).max()) for one, s in zip(whole, scale, strict=True)), default=1.0)
        cost = 10 ** (np.arange(0, np.ceil(np.log10(max(most, 1.0)) * 20) + 1) / 20)
    shares: dict[tuple[object, ...], dict[tuple[object, ...], dict[int, Array]]] = {}  # group, method, problem
    problems: dict[tuple[object, ...], int] = {}
    for place, (one, s) in enumerate(zip(whole, scale, strict=True)):
        names = quantity_of[one.level]
        for quantity in dict.fromkeys(names.tolist()):
            group = (*(_missing_alike(value) for value in groups[one.at[0]]), quantity)
            problems[group] = problems.get(group, 0) + 1
            for number, found in _shares_within(
                cost, one, s, method_of[one.at], np.flatnonzero(names == quantity), restarts
            ):
                told = tuple(np.nan if part != part else part for part in told_of[number])
                shares.setdefault(group, {}).setdefault(told, {})[place] = found
    keys = [*by, "quantity", *METHOD, "start", "budget", "target_value"]
    tables = [
        pd.DataFrame(
            dict(zip(keys, (*group, *told), strict=True))
            | {
                "cost": cost,
                "share": np.mean([found[place] for place in over], axis=0),
                "problems": len(over),
                "of_problems": problems[group],
            }
        )
        for group, of_group in shares.items()
        for shared in [set.intersection(*map(set, of_group.values()))]
        for told, found in of_group.items()
        for over in [shared or found.keys()]
    ]
    if not tables:
        return pd.DataFrame(columns=[*keys, "cost", "share", "problems", "of_problems"])
    # a start that no published run tells is still a text: as a number it could not be joined with `runs`
    return pd.concat(tables, ignore_index=True).astype({"start": runs["start"].dtype})


def _shares_within(
    cost: Array, one: Runtimes, scale: Array, method_of: NDArray[np.intp], columns: NDArray[np.intp], restarts: int
) -> Iterator[tuple[int, Array]]:
    """Yield the number of each method on one problem, and its share of (run, target) pairs within each `cost`.

    `scale` and `method_of` are of the problem's runs, shape (runs,); `columns` are the targets of one quantity.
    """
    for number in dict.fromkeys(method_of.tolist()):
        mine = np.flatnonzero(method_of == number)
        times = one.time[mine[:, None], columns] / scale[mine, None]
        if restarts:
            times = restarted(times, one.spent[mine] / scale[mine], restarts)
        times = np.sort(times.ravel())
        yield number, np.searchsorted(times, cost, side="right") / len(times)


def _missing_alike(value: object) -> object:
    """Return the value, or the one NaN for any missing value: different NaNs would be different keys."""
    return np.nan if pd.isna(value) else value  # type: ignore[call-overload]
