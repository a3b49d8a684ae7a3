"""Fixed target: the cost of a method until it reaches a target. Expected running time (ERT), success, runtime ECDF.

ERT = (sum over all runs of what each spent, until its hit or in vain) / (number of runs that reached the target). Its
interval is a studentised bootstrap of log ERT over units (a run, or an instance with its runs), of standard error
``sqrt(n / (n - 1) * sum((paid / A - won / k)^2))``, A and k the sums; its quantiles are widened by
``sqrt((n - 1) / (n - 2))`` (``python -m benchmarks statistics`` measures how often it covers). Draws depend on n alone.

Sources: Hansen et al., COCO: Performance Assessment, 2016, sections 4 and 5; Auger and Hansen, CEC 2005; Hall, The
Bootstrap and Edgeworth Expansion, 1992, section 3; Dolan and More, 2002 (profiles).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any, ClassVar, Self, final

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from calibench.bench.provenance.run_id import canonical
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, SETTING, by_cell
from calibench.bench.statistics.summary import chances, success_interval
from calibench.bench.store.arrays import dictionary, index_in
from calibench.bench.store.columns import PREFIXES, Array, Counts, Flags, floats, numbered
from calibench.core.options import suggest

TARGET = ["quantity", "target"]
_COUNTS = ("charged", "charged_after")
RESAMPLES = 999
LEVEL = 0.95
FEWEST = 3  # units; of fewer nothing can be said
_SEED = (2008, 0x455254)
_AT_ONCE = 4096  # targets, of which 999 resamples take some tens of megabytes
_BOUNDED = 1e6  # times ERT: an upper end beyond this means that the runs are too few for a bound
_ENOUGH = 5  # instances: from so many on, instances are resampled instead of runs
_CELL = [*CELL[:-1], "target_value"]  # the run's own target, beside the target that is looked at
_TASK = [*PROBLEM, "start", "budget", "target_value", *TARGET]
_NUMBERS = [
    "runs", "reached", "success", "success_low", "success_high", "spent", "ert", "ert_low", "ert_high", "at_least",
    "ert_earliest", "resampled",
]  # fmt: skip
_NEEDED = {
    "run_id", *CELL, "dimension", "repetition", "charged", "best_value", "judged_value", "judged_evaluations",
}  # fmt: skip  # columns of runs that expected running times come from


@final
@dataclass(frozen=True)
class Runtimes:
    """The runs of one problem against its targets: `at` and `level` are their places in `all_runs` and `all_targets`.

    `spent`, shape (runs,), is what each run was charged; of shape (runs, targets) `asked` tells which target is one of
    the run's, `time` and `earliest` at which counts it was surely reached and may have been, infinite where it never
    was, and `paid` what was spent until it was, or in vain.
    """

    all_runs: pd.DataFrame
    all_targets: pd.DataFrame
    at: Counts
    level: Counts
    spent: Array
    asked: Flags
    time: Array
    earliest: Array
    paid: Array


@final
@dataclass(frozen=True)
class Hits:
    """Hits as numbers: `run` and `level`, shapes (hits,), are places in `ids` and `targets`; `charged` and `after` are
    the counts at which a target was surely reached, and surely not yet; NaN: never."""

    COLUMNS: ClassVar = ["run_id", *TARGET, *_COUNTS]

    ids: pa.Array
    targets: pd.DataFrame  # columns of `TARGET`
    run: Counts
    level: Counts
    charged: Array
    after: Array

    @classmethod
    def of(cls, table: pd.DataFrame | pa.Table) -> Self:
        """Return the hits of a table with columns of `HITS_SCHEMA`."""
        coded = {}
        for name in ("run_id", "quantity"):
            column = (
                table[name] if isinstance(table, pa.Table) else pa.chunked_array([pa.array(table[name], pa.string())])
            )
            coded[name] = dictionary(column)
        value, values = pd.factorize(floats(table["target"]))
        levels = max(len(values), 1)
        names, quantity = coded["quantity"]
        level, different = pd.factorize(quantity * levels + value)
        named = names.to_numpy(zero_copy_only=False)[different // levels]
        targets = pd.DataFrame({"quantity": named, "target": values[different % levels] if len(values) else []})
        return cls(coded["run_id"][0], targets, coded["run_id"][1], level, *(floats(table[name]) for name in _COUNTS))

    def where(self, flags: Flags) -> Hits:
        """Return the hits whose flag is true."""
        if flags.all():
            return self
        return replace(self, **{name: getattr(self, name)[flags] for name in ("run", "level", "charged", "after")})

    def of_quantity(self, name: str) -> Hits:
        """Return the hits of the targets of one quantity."""
        return self.where((self.targets["quantity"] == name).to_numpy()[self.level])

    def of_runs(self, run_ids: pd.Series) -> Hits:
        """Return the hits of some runs."""
        return self.where(np.isin(self.ids.to_numpy(zero_copy_only=False), run_ids)[self.run])

    def different(self) -> pd.DataFrame:
        """Return the targets that some hit is of."""
        return self.targets.iloc[np.flatnonzero(np.bincount(self.level, minlength=len(self.targets)))]


def _in_order(codes: Counts, most: int) -> tuple[Counts, Counts]:
    """Return the different ones of codes below `most`, in order, and the place of each: `np.unique` without sorting."""
    present = np.bincount(codes, minlength=most) > 0
    return np.flatnonzero(present), (np.cumsum(present) - 1)[codes]


def runtimes(hits: Hits | pd.DataFrame, runs: pd.DataFrame, instances: Sequence[str] = ()) -> Iterator[Runtimes]:
    """Yield the `Runtimes` of each problem in `runs`, in their order; runs without any target are left out.

    Problems that differ only in the options `instances` (and their data) are one; its runs have a column `instance`.
    """
    hits = hits if isinstance(hits, Hits) else Hits.of(hits)
    rows = pooled(runs, instances)
    where = index_in(hits.ids, pa.array(rows["run_id"], pa.string())).to_numpy(zero_copy_only=False)
    place = np.where(np.isnan(where.astype(float)), -1, where).astype(np.int64)[hits.run]
    hits = hits.where(place >= 0)
    seen, row = _in_order(place[place >= 0], len(rows))
    rows = rows.iloc[seen].reset_index(drop=True)
    code, different = pd.factorize(hits.level)  # in the order in which they come
    targets = hits.targets.iloc[different].reset_index(drop=True)

    spent = rows["charged"].to_numpy(dtype=float)
    problem = numbered(rows[name] for name in PROBLEM)
    order = np.argsort(problem[row], kind="stable")
    ends = np.searchsorted(problem[row][order], np.arange(problem.max() + 2 if len(problem) else 1))
    for low, high in pairwise(ends.tolist()):
        mine = order[low:high]
        at, place = _in_order(row[mine], len(rows))
        level, column = _in_order(code[mine], len(targets))
        table, early = np.full((2, len(at), len(level)), np.nan)
        table[place, column], early[place, column] = hits.charged[mine], hits.after[mine] + 1
        asked = np.zeros(table.shape, dtype=bool)
        asked[place, column] = True
        yield Runtimes(
            all_runs=rows,
            all_targets=targets,
            at=at,
            level=level,
            spent=spent[at],
            asked=asked,
            time=np.where(np.isnan(table), np.inf, table),
            earliest=np.where(np.isnan(early), np.inf, early),
            paid=np.where(np.isnan(table), np.where(asked, spent[at][:, None], 0.0), table),
        )


def pooled(runs: pd.DataFrame, options: Sequence[str]) -> pd.DataFrame:
    """Return `runs` with problems that differ in `options` alone as one, apart by a column `instance`."""
    if not options:
        return runs.assign(instance="")
    texts = {text: json.loads(text) for text in runs["problem_options"].unique()}
    known = {key for held in texts.values() for key in held}
    for key in options:
        if key not in known:
            raise ValueError(f"no problem of these runs has an option {key!r}; {suggest(key, sorted(known))}")
    rest = {
        text: canonical({key: value for key, value in held.items() if key not in options})
        for text, held in texts.items()
    }
    chosen = {text: canonical({key: held[key] for key in options if key in held}) for text, held in texts.items()}
    has = runs["problem_options"].map({text: bool(chosen[text] != "{}") for text in texts}).to_numpy(dtype=bool)
    instance = runs["problem_options"].map(chosen).astype(str) + " " + runs["data_id"].astype(str)
    return runs.assign(
        problem_options=runs["problem_options"].map(rest),
        data_id=runs["data_id"].where(~has, ""),
        instance=instance.where(has, ""),
    )


def ert(
    hits: Hits | pd.DataFrame, runs: pd.DataFrame, *, instances: Sequence[str] = (), intervals: bool = True
) -> pd.DataFrame:
    """Return a row for each cell (`bench.statistics.cells`) and target of `hits`; counts are of what was charged.

    Columns: those of `CELL`, the run's own target as target_value; the swept options that `runs` has as columns;
    dimension, quantity, target, runs, reached, success (Wilson's interval), spent, ert (infinite where none reached it;
    an end of its interval that is infinite, or 1, is not bounded), at_least (spent, where none reached it),
    ert_earliest (each hit as early as its trace allows), resampled ("runs", or from five on "instances": problems that
    differ only in the options `instances`). There is no interval where not all runs of a cell have the target, nor
    where chance has no part.
    """
    columns = [str(name) for name in runs.columns]
    swept = [name for name in columns if name.startswith(PREFIXES) and name.partition(".")[2] not in instances]
    needed = runs[[name for name in columns if name in _NEEDED or name in swept]]  # cutting few columns is cheap
    whole = list(runtimes(hits, needed, instances))
    if not whole:
        return pd.DataFrame(columns=[*_CELL, *swept, "dimension", *TARGET, *_NUMBERS])
    rows, levels = whole[0].all_runs, whole[0].all_targets
    column = _sums(whole, intervals)
    reached, counted, spent, chance = (column[name] for name in ("reached", "runs", "spent", "chance"))
    low, high = success_intervals(reached, counted)
    never, one = reached == 0, np.maximum(reached, 1)
    costs = np.where(never, np.inf, spent / one)
    # of none that reached it: the mean cost of a run, divided by the largest success rate that these runs allow
    ert_low = np.where(chance & never, spent / counted / high, column["low"])
    ert_high = np.where(chance & never, np.inf, column["high"])

    sources = dict(zip(_CELL, CELL, strict=True)) | {name: name for name in (*swept, "dimension")}
    joined: dict[str, Any] = {name: rows[source].to_numpy()[column["run"]] for name, source in sources.items()}
    joined |= {name: levels[name].to_numpy()[column["level"]] for name in TARGET}
    joined |= {
        "runs": counted,
        "reached": reached,
        "success": reached / counted,
        "success_low": np.where(chance, low, np.nan),
        "success_high": np.where(chance, high, np.nan),
        "spent": spent,
        "ert": costs,
        "ert_low": np.maximum(ert_low, 1.0),  # nothing is reached without an evaluation
        "ert_high": np.where(ert_high > _BOUNDED * costs, np.inf, ert_high),
        "at_least": np.where(never, spent, np.nan),
        "ert_earliest": np.where(never, np.inf, column["least"] / one),
        "resampled": np.where(np.isnan(column["low"]), "", column["resampled"]),
    }
    return pd.DataFrame(joined)[[*_CELL, *swept, "dimension", *TARGET, *_NUMBERS]]


def _sums(whole: Sequence[Runtimes], intervals: bool) -> dict[str, NDArray[Any]]:
    """Return sums and intervals, problem by problem, in it cell by cell and there target by target."""
    runs = whole[0].all_runs
    cells = by_cell(runs)
    number, chances_of = cells.number, chances(runs, cells)
    instances, repetition = pd.factorize(runs["instance"], sort=True)[0], runs["repetition"].to_numpy()
    names = ("run", "level", "size", "runs", "chance", "reached", "spent", "least")
    parts: dict[str, list[Any]] = {name: [] for name in names}
    units: dict[int, list[tuple[int, Array, Array, str]]] = {}  # by their number: begin, what each paid and won, kind
    begin_of_cell = 0
    for one in whole:
        cell, instance = pd.factorize(number[one.at])[0], instances[one.at]
        order = np.lexsort([repetition[one.at], instance, cell])  # in a cell the same for every method
        begins = np.flatnonzero(np.diff(cell[order], prepend=-1))
        count = np.diff(begins, append=len(order))
        first, instance = one.at[order[begins]], instance[order]
        won, paid = np.isfinite(one.time[order]), one.paid[order]
        early, asked = np.where(won, one.earliest[order], paid), one.asked[order].astype(np.int64)
        chance = chances_of[number[first]]
        for begin, size, by_chance in zip(begins.tolist(), count.tolist(), chance.tolist(), strict=True):
            if by_chance and intervals:
                mine = slice(begin, begin + size)
                spent, hit, kind = paid[mine], won[mine].astype(float), "runs"
                starts = np.flatnonzero(np.diff(instance[mine], prepend=-1))
                if len(starts) >= _ENOUGH:
                    spent, hit, kind = np.add.reduceat(spent, starts), np.add.reduceat(hit, starts), "instances"
                units.setdefault(len(spent), []).append((begin_of_cell, spent, hit, kind))
            begin_of_cell += len(one.level)
        for name, values in (("run", first), ("size", count), ("chance", chance)):
            parts[name].append(np.repeat(values, len(one.level)))
        parts["level"].append(np.tile(one.level, len(begins)))
        for name, table in (("spent", paid), ("least", early), ("reached", won.astype(np.int64)), ("runs", asked)):
            parts[name].append(np.add.reduceat(table, begins, axis=0).ravel())
    column = {name: np.concatenate(values) for name, values in parts.items()}

    low, high = np.full((2, begin_of_cell), np.nan)
    resampled = np.full(begin_of_cell, "", dtype=object)
    for alike in units.values():  # cells of as many units share their draws, and are resampled at once
        paid, won = (np.concatenate([unit[k] for unit in alike], axis=1) for k in (1, 2))
        place = np.concatenate([begin + np.arange(spent.shape[1]) for begin, spent, _, _ in alike])
        resampled[place] = np.repeat([kind for *_, kind in alike], [spent.shape[1] for _, spent, _, _ in alike])
        for begin in range(0, len(place), _AT_ONCE):
            some = slice(begin, begin + _AT_ONCE)
            low[place[some]], high[place[some]] = ert_interval(paid[:, some], won[:, some])
    low[column["runs"] < column["size"]] = high[column["runs"] < column["size"]] = np.nan
    column |= {"low": low, "high": high, "resampled": resampled}
    some_asked = column["runs"] > 0
    return {name: values[some_asked] for name, values in column.items()}


def success_intervals(successes: Counts, counts: Counts) -> tuple[Array, Array]:
    """Return Wilson's 95 % intervals of shares, shapes (n,): `scipy.stats.binomtest`, once for each pair of numbers."""
    pairs, where = np.unique(np.column_stack([successes, counts]), axis=0, return_inverse=True)
    intervals = np.array([success_interval(int(k), int(n)) for k, n in pairs]).reshape(-1, 2)[where.ravel()]
    return intervals[:, 0], intervals[:, 1]


def ecdf(
    hits: Hits | pd.DataFrame, runs: pd.DataFrame, by: Sequence[str] = (), *, at: Sequence[float] | None = None
) -> pd.DataFrame:
    """Return the runtime ECDF of each method: the share of (run, target) pairs that it reached within a cost.

    Columns: `by` (columns of runs that make a group; none: all), quantity, optimizer, optimizer_options, start, budget,
    target_value, cost (`at`, by default 20 values a decade), share, problems, of_problems. The share is over the
    `problems` of the group on which all its methods were run, or where there is none those of the method; every problem
    counts the same.
    """
    for name in by:
        if name not in runs:
            raise ValueError(f"runs have no column {name!r} to group by; {suggest(name, map(str, runs.columns))}")
    method = [*METHOD, *SETTING]
    runs = runs[list(dict.fromkeys(["run_id", *PROBLEM, *method, *by, "charged"]))]  # few are cheap to cut
    methods = by_cell(runs, method)
    keys_of_methods = list(runs[method].iloc[methods.first].itertuples(index=False, name=None))
    whole = list(runtimes(hits, runs.assign(_method=methods.number)))
    rows = whole[0].all_runs if whole else runs.iloc[:0].assign(_method=0)
    groups = list(rows[list(by)].itertuples(index=False, name=None)) if by else [()] * len(rows)
    method_of = rows["_method"].to_numpy()
    cost = np.asarray([] if at is None else at, dtype=float)
    if at is None:
        most = max((float(one.spent.max()) for one in whole), default=1.0)
        cost = 10 ** (np.arange(0, np.ceil(np.log10(max(most, 1.0)) * 20) + 1) / 20)

    shares: dict[tuple[object, ...], dict[tuple[object, ...], dict[int, Array]]] = {}  # group, method, problem
    problems: dict[tuple[object, ...], int] = {}
    for place, one in enumerate(whole):
        names = one.all_targets["quantity"].to_numpy(dtype=object)[one.level]
        for quantity in dict.fromkeys(names.tolist()):
            # one NaN for any missing value: different NaNs would be different keys
            group = (*(np.nan if pd.isna(value) else value for value in groups[one.at[0]]), quantity)
            problems[group] = problems.get(group, 0) + 1
            for number in dict.fromkeys(method_of[one.at].tolist()):
                mine = np.flatnonzero(method_of[one.at] == number)
                times = np.sort(one.time[mine[:, None], np.flatnonzero(names == quantity)].ravel())
                key = tuple(np.nan if part != part else part for part in keys_of_methods[number])
                share = np.searchsorted(times, cost, side="right") / len(times)
                shares.setdefault(group, {}).setdefault(key, {})[place] = share
    keys = [*by, "quantity", *METHOD, "start", "budget", "target_value"]
    tables = [
        pd.DataFrame(
            dict(zip(keys, (*group, *key), strict=True))
            | {"cost": cost, "share": np.mean([of_problem[place] for place in over], axis=0)}
            | {"problems": len(over), "of_problems": problems[group]}
        )
        for group, of_group in shares.items()
        for shared in [set.intersection(*map(set, of_group.values()))]
        for key, of_problem in of_group.items()
        for over in [shared or of_problem.keys()]
    ]
    if not tables:
        return pd.DataFrame(columns=[*keys, "cost", "share", "problems", "of_problems"])
    # a start that no published run tells is still a text: as a number it could not be joined with `runs`
    return pd.concat(tables, ignore_index=True).astype({"start": runs["start"].dtype})


def ert_interval(paid: Array, won: Array) -> tuple[Array, Array]:
    """Return low and high, shapes (targets,), of the ERT ``paid.sum(0) / won.sum(0)``, shapes (units, targets).

    NaN of fewer than `FEWEST` units, and where none reached the target.
    """
    units, targets = paid.shape
    low, high = np.full((2, targets), np.nan)
    some = np.flatnonzero(won.sum(axis=0) > 0)
    if units < FEWEST or not len(some):
        return low, high
    columns, where = _different_columns(np.concatenate([paid[:, some], won[:, some]]))
    p, w = columns[:units], columns[units:].astype(float)
    ratio, error = _log_ratio(np.ones((1, units)), p, w)
    ratios, errors = _log_ratio(weights(units), p, w)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (ratios - ratio) / np.where(errors > 0, errors, error)  # one of equal units has the spread of all
    t = np.where(np.isposinf(ratios), np.inf, np.where(np.isnan(t), 0.0, t))  # one without a hit
    first = int(np.floor((1 - LEVEL) / 2 * (RESAMPLES + 1))) - 1
    last = RESAMPLES - 1 - first
    ends = np.partition(t, [first, last], axis=0)
    reach = error[0] * np.sqrt((units - 1) / (units - 2))
    with np.errstate(invalid="ignore", over="ignore"):
        below = np.where(reach == 0, 0.0, -ends[last] * reach)
        above = np.where(reach == 0, 0.0, -ends[first] * reach)
        low[some] = np.exp(ratio[0] + below)[where]
        high[some] = np.exp(ratio[0] + above)[where]
    return low, high


def _different_columns(table: Array) -> tuple[Array, Counts]:
    """Return the different columns in order, and the place of each column among them."""
    seen: dict[bytes, int] = {}
    place = [seen.setdefault(column.tobytes(), len(seen)) for column in table.T]
    columns = np.array([np.frombuffer(column) for column in seen]).T
    ordered, where = np.unique(columns, axis=1, return_inverse=True)  # of all columns it would sort long rows
    return ordered, where.ravel()[place]


def _log_ratio(weight: Array, paid: Array, won: Array) -> tuple[Array, Array]:
    """Return log ERT and its standard error in each resample, shapes (resamples, targets); infinite without a hit."""
    n = paid.shape[0]
    a, k = weight @ paid, weight @ won
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = weight @ paid**2 / a**2 - 2 * (weight @ (paid * won)) / (a * k) + weight @ won**2 / k**2
        ratio = np.where(k > 0, np.log(a / k), np.inf)
    spread = np.where(variance > 1e-14, variance, 0.0)  # what is left of equal units by rounding is none
    return ratio, np.sqrt(spread * n / (n - 1))


@cache
def weights(units: int) -> Array:
    """Return how often each unit is drawn in each resample, shape (RESAMPLES, units)."""
    rng = np.random.default_rng(np.random.SeedSequence([*_SEED, units]))
    drawn: Array = rng.multinomial(units, np.full(units, 1 / units), size=RESAMPLES).astype(float)
    return drawn


def performance_profile(table: pd.DataFrame) -> pd.DataFrame:
    """Return the steps of each method's profile, of `ert` of one quantity: METHOD, ratio, share, tasks, of_tasks."""
    cost = table["ert"].astype(float)  # of a table without rows it is none
    best = cost.groupby([table[key] for key in _TASK], dropna=False).transform("min")
    with np.errstate(invalid="ignore"):
        ratio = np.where(np.isfinite(cost), cost / best, np.inf)
    table = table.assign(ratio=ratio, task=table.groupby(_TASK, dropna=False, sort=False).ngroup())
    tasks_of = {key: set(rows["task"]) for key, rows in table.groupby(METHOD, sort=False)}
    shared = set.intersection(*tasks_of.values()) if tasks_of else set()
    profiles = []
    for key, rows in table.groupby(METHOD, sort=False):
        over = shared or tasks_of[key]
        costs = np.sort(rows.loc[rows["task"].isin(over), "ratio"].to_numpy(dtype=float))
        at, counts = np.unique(costs[np.isfinite(costs)], return_counts=True)
        share = np.cumsum(counts) / len(over)
        steps = {"ratio": at, "share": share} if len(at) else {"ratio": [np.inf], "share": [0.0]}
        named = dict(zip(METHOD, key, strict=True))
        profiles.append(pd.DataFrame(named | steps | {"tasks": len(over), "of_tasks": table["task"].nunique()}))
    columns = [*METHOD, "ratio", "share", "tasks", "of_tasks"]
    return pd.concat(profiles, ignore_index=True)[columns] if profiles else pd.DataFrame(columns=columns)
