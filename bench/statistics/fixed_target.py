"""Fixed target: the cost of a method until it reaches a target. Expected running time (ERT), success, runtime ECDF.

ERT = (sum over all runs of what each spent) / (number of runs that reached the target): a run that reached it spent
until its hit, one that did not spent all that *it* was charged, not the budget and not the largest count of others. It
is the expected cost of a method that begins again until it reaches the target. Where no run reached the target it is
infinite and only a bound is known: `at_least`, all that was spent. Simulated restarts (`restarted`) suppose that a run
that did not arrive may be begun again from where another run began.

The interval of an ERT is a studentised bootstrap of log ERT over units (a run, or an instance with its runs). The
logarithm has the standard error ``sqrt(n / (n - 1) * sum((paid / A - won / k)^2))``, with A and k the sums. Each
resample has a log ERT and a standard error of its own (that of all units where those drawn are equal); the quantiles of
their studentised differences, turned over, give the interval, widened by ``sqrt((n - 1) / (n - 2))``, as two sums are
estimated. Draws depend on n alone, and units stand in the order of instance and repetition: methods with the same units
are resampled alike. At 15 runs a percentile interval covers the true ERT in .85 to .94 of studies in place of .95;
``python -m benchmarks statistics`` measures this one beside it.

A performance profile (Dolan and More, 2002) counts tasks whose ERT is within `ratio` times the least ERT of any method;
a data profile (More and Wild, 2009) those whose ERT is within `groups` of dimension + 1 evaluations. A task that no
method reached counts in the whole, as solved by none. Counted are the tasks on which all methods were run, and where
there is none, of each method its own.

Sources: Hansen et al., COCO: Performance Assessment, 2016, sections 4 and 5; Auger and Hansen, CEC 2005; Hall, The
Bootstrap and Edgeworth Expansion, 1992, section 3.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, Literal, final, get_args

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from calibench.bench.provenance.run_id import canonical
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, SETTING, by_cell
from calibench.bench.statistics.summary import chances, success_interval
from calibench.bench.store.arrays import index_in
from calibench.bench.store.columns import PREFIXES
from calibench.core.options import suggest

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Currency = Literal["charged", "evaluations"]
TARGET = ["quantity", "target"]


@final
@dataclass(frozen=True)
class Runtimes:
    """The runs of one problem against its targets, as arrays.

    `all_runs` are those of all problems that have a hit, rows of runs with a column `instance`, and `all_targets` have
    the columns quantity, target; `at`, shape (runs,), and `level`, shape (targets,), are the places in them of those of
    this problem. `spent`, shape (runs,), is what each run was charged; `asked`, shape (runs, targets), tells which
    target is one of the run's; `time` and `earliest`, shape (runs, targets),
    are counts at which a target was surely reached and at which it may have been (a trace is thinned), infinite where
    it never was.
    """

    all_runs: pd.DataFrame
    all_targets: pd.DataFrame
    at: Counts
    level: Counts
    spent: Array
    asked: NDArray[np.bool_]
    time: Array
    earliest: Array

    @property
    def runs(self) -> pd.DataFrame:
        """Return the rows of the runs of this problem."""
        return self.all_runs.iloc[self.at].reset_index(drop=True)

    @property
    def targets(self) -> pd.DataFrame:
        """Return its targets."""
        return self.all_targets.iloc[self.level].reset_index(drop=True)

    @property
    def paid(self) -> Array:
        """Return what each run spent until each of its targets, or in vain, shape (runs, targets)."""
        return np.where(np.isfinite(self.time), self.time, np.where(self.asked, self.spent[:, None], 0.0))

    def cells(self, number: Counts) -> int:
        """Return how many cells there are here, by the `number` of the cell of each of all runs."""
        return len(set(number[self.at].tolist()))


def runtimes(
    hits: pd.DataFrame, runs: pd.DataFrame, currency: Currency = "charged", instances: Sequence[str] = ()
) -> Iterator[Runtimes]:
    """Yield the `Runtimes` of each problem in `runs`, in their order; runs without any target are left out.

    `hits` are rows of ``hits.parquet`` (or some of its targets), `runs` of ``runs.parquet``. Problems that differ only
    in the options `instances` (and their data) are one problem; its runs have a column `instance`. Raises `ValueError`
    for a currency that is none, and an option that no problem has.
    """
    if currency not in get_args(Currency):
        raise ValueError(f"there is no currency {currency!r}; {suggest(currency, get_args(Currency))}")
    rows = pooled(runs, instances)
    where = index_in(pa.array(hits["run_id"], pa.string()), pa.array(rows["run_id"], pa.string())).to_numpy(
        zero_copy_only=False
    )
    known = ~np.isnan(where.astype(float))
    seen, row = np.unique(where[known].astype(np.int64), return_inverse=True)
    rows = rows.iloc[seen].reset_index(drop=True)
    targets, code = _codes(hits.loc[known, TARGET])
    time = hits[currency].to_numpy(dtype=float, na_value=np.nan)[known]
    after = hits[f"{currency}_after"].to_numpy(dtype=float, na_value=np.nan)[known]
    spent = rows[currency].to_numpy(dtype=float)
    problem = rows.groupby(PROBLEM, sort=False, dropna=False).ngroup().to_numpy()
    order = np.argsort(problem[row], kind="stable")
    ends = np.searchsorted(problem[row][order], np.arange(problem.max() + 2 if len(problem) else 1))
    for low, high in pairwise(ends.tolist()):
        mine = order[low:high]
        at, place = np.unique(row[mine], return_inverse=True)
        level, column = np.unique(code[mine], return_inverse=True)
        sizes = len(at), len(level)
        table, early = np.full(sizes, np.nan), np.full(sizes, np.nan)
        table[place, column], early[place, column] = time[mine], after[mine] + 1
        asked = np.zeros(sizes, dtype=bool)
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
        )


def _codes(pairs: pd.DataFrame) -> tuple[pd.DataFrame, NDArray[np.int64]]:
    """Return the different (quantity, target), in the order in which they come, and the number of each row's."""
    q, different_names = pd.factorize(pairs["quantity"])
    names = list(different_names)
    level, values = pd.factorize(pairs["target"].to_numpy(dtype=float))
    code, different = pd.factorize(q.astype(np.int64) * max(len(values), 1) + level)
    targets = pd.DataFrame(
        {
            "quantity": [names[i // max(len(values), 1)] for i in different],
            "target": values[different % max(len(values), 1)] if len(values) else [],
        }
    )
    return targets, code.astype(np.int64)


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
        return pd.DataFrame(columns=[*_CELL, *swept, "dimension", *TARGET, *_NUMBERS])
    joined = _sums(whole, intervals, swept)
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
    return pd.DataFrame(joined)[[*_CELL, *swept, "dimension", *TARGET, *_NUMBERS]]


def _sums(whole: Sequence[Runtimes], intervals: bool, swept: Sequence[str]) -> dict[str, Any]:
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
    sources = dict(zip(_CELL, CELL, strict=True)) | {name: name for name in (*swept, "dimension")}
    named: dict[str, Any] = {name: runs[source].to_numpy()[column["run"]] for name, source in sources.items()}
    named |= {name: levels[name].to_numpy()[column["level"]] for name in TARGET}
    named |= {name: column[name] for name in ("runs", "reached", "spent", "chance")}
    never = column["reached"] == 0
    one = np.maximum(column["reached"], 1)
    return named | {
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
_NUMBERS = [
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
    intervals = np.array([success_interval(int(k), int(n)) for k, n in pairs]).reshape(-1, 2)[where.ravel()]
    return intervals[:, 0], intervals[:, 1]


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
    keys_of_methods = list(runs[method].iloc[methods.first].itertuples(index=False, name=None))
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
            # one NaN for any missing value: different NaNs would be different keys
            group = (*(np.nan if pd.isna(value) else value for value in groups[one.at[0]]), quantity)
            problems[group] = problems.get(group, 0) + 1
            columns = np.flatnonzero(names == quantity)
            for number, share in _shares_within(cost, one, s, method_of[one.at], columns, restarts):
                key = tuple(np.nan if part != part else part for part in keys_of_methods[number])
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


RESAMPLES = 999
LEVEL = 0.95
FEWEST = 3  # units; of fewer nothing can be said
_SEED = (2008, 0x455254)


def ert_interval(paid: Array, won: Array) -> tuple[Array, Array]:
    """Return low and high, shapes (targets,), of the ERT ``paid.sum(0) / won.sum(0)``.

    `paid` and `won`, shapes (units, targets): what each unit spent, and how many of its runs reached the target. NaN
    of fewer than `FEWEST` units. Where none reached the target only `low` is known: the mean spent over Wilson's upper
    bound of the success; `high` is infinite.
    """
    units, targets = paid.shape
    low, high = np.full(targets, np.nan), np.full(targets, np.nan)
    reached = won.sum(axis=0)
    some = np.flatnonzero(reached > 0)
    if units < FEWEST or not len(some):
        return low, high
    columns, where = np.unique(np.concatenate([paid[:, some], won[:, some]]), axis=1, return_inverse=True)
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
        low[some] = np.exp(ratio[0] + below)[where.ravel()]
        high[some] = np.exp(ratio[0] + above)[where.ravel()]
    return low, high


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


_RESTART_SEED = (2008, 0x524553)


def restarted(time: Array, spent: Array, draws: int) -> Array:
    """Return `draws` costs of reaching each target, shape (draws, targets), in no order; infinite where no run did.

    `time`, shape (runs, targets), is infinite where a run did not reach the target, and `spent`, shape (runs,), what it
    was charged then. The draws are the same for any runs of that number.
    """
    runs, targets = time.shape
    cost = np.full((draws, targets), np.inf)
    rng = np.random.default_rng(np.random.SeedSequence([*_RESTART_SEED, runs]))
    reached = np.isfinite(time)
    open_ = np.broadcast_to(reached.any(axis=0), cost.shape).copy()
    cost[open_] = 0.0
    while open_.any():
        run = rng.integers(runs, size=draws)
        hit = reached[run]
        paid = np.where(hit, time[run], spent[run, None])
        cost[open_] += paid[open_]
        open_ &= ~hit
    return cost


def pooled(runs: pd.DataFrame, options: Sequence[str]) -> pd.DataFrame:
    """Return `runs` with the instances of a problem as one problem, and a column `instance` that tells them apart.

    `options` of the problem, such as ("instance",), choose the instance; without any, a problem is its only instance.
    """
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


_TASK = [*PROBLEM, "start", "budget", "target_value", "quantity", "target"]


def performance_profile(table: pd.DataFrame) -> pd.DataFrame:
    """Return the steps of each method's profile: optimizer, optimizer_options, ratio (>= 1), share, tasks, of_tasks.

    `table` is what `runtime.ert` returns, best of one quantity. From `ratio` on the method has solved `share` of the
    `tasks` within it.
    """
    cost = table["ert"].astype(float)  # of a table without rows it is none
    best = cost.groupby([table[key] for key in _TASK], dropna=False).transform("min")
    with np.errstate(invalid="ignore"):
        ratio = np.where(np.isfinite(cost), cost / best, np.inf)
    return _steps(table.assign(ratio=ratio), "ratio")


def data_profile(table: pd.DataFrame) -> pd.DataFrame:
    """Return the steps of each method's data profile: optimizer, optimizer_options, groups, share, tasks, of_tasks.

    `groups` is ERT / (dimension + 1): how many simplex gradients it could have paid.
    """
    return _steps(table.assign(groups=table["ert"] / (table["dimension"] + 1)), "groups")


def _steps(table: pd.DataFrame, by: str) -> pd.DataFrame:
    table = table.assign(task=table.groupby(_TASK, dropna=False, sort=False).ngroup())
    tasks_of = {key: set(rows["task"]) for key, rows in table.groupby(METHOD, sort=False)}
    shared = set.intersection(*tasks_of.values()) if tasks_of else set()
    profiles = []
    for key, rows in table.groupby(METHOD, sort=False):
        over = shared or tasks_of[key]
        costs = np.sort(rows.loc[rows["task"].isin(over), by].to_numpy(dtype=float))
        at, counts = np.unique(costs[np.isfinite(costs)], return_counts=True)
        share = np.cumsum(counts) / len(over)
        steps = pd.DataFrame({by: at, "share": share}) if len(at) else pd.DataFrame({by: [np.inf], "share": [0.0]})
        named = pd.DataFrame([key] * len(steps), columns=METHOD)
        profiles.append(pd.concat([named, steps.assign(tasks=len(over), of_tasks=table["task"].nunique())], axis=1))
    columns = [*METHOD, by, "share", "tasks", "of_tasks"]
    return pd.concat(profiles, ignore_index=True)[columns] if profiles else pd.DataFrame(columns=columns)
