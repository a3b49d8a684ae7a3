"""Fixed target: what a method pays until it gets there. Expected running time (ERT), success, and runtime ECDF.

ERT = (sum over all runs of what each spent) / (number of runs that reached the target): a run that reached it spent
until its hit, one that did not spent all that *it* was charged, not the budget and not the largest count of others. It
is the expected cost of a method that begins again until it is there. Where no run reached the target it is infinite and
only a bound is known: `at_least`, all that was spent.

Source: Hansen et al., COCO: Performance Assessment, 2016, section 4; Auger and Hansen, CEC 2005.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, final, get_args

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from calibench.bench.statistics.by_cell import ByCell, by_cell
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, SETTING
from calibench.bench.statistics.fixed_target.ert_interval import ert_interval
from calibench.bench.statistics.fixed_target.instances import pooled
from calibench.bench.statistics.fixed_target.restarted import restarted
from calibench.bench.statistics.summary import chances, success_interval
from calibench.bench.store.options import PREFIXES
from calibench.core.options import suggest

Array = NDArray[np.float64]
Currency = Literal["charged", "evaluations"]
TARGET = ["quantity", "target"]
_CELL = [*CELL[:-1], "target_value"]  # the run's own target, beside the target that is looked at


@final
@dataclass(frozen=True)
class Runtimes:
    """The runs of one problem against its targets, as arrays.

    `runs` are rows of runs, with a column `instance`; `targets` has the columns quantity, target; `spent`, shape
    (runs,), is what each run was charged; `time` and `earliest`, shape (runs, targets), are counts at which a target
    was surely reached and at which it may have been (a trace is thinned), infinite where it never was.
    """

    runs: pd.DataFrame
    targets: pd.DataFrame
    spent: Array
    time: Array
    earliest: Array

    @property
    def paid(self) -> Array:
        """Return what each run spent until each target, or in vain, shape (runs, targets)."""
        return np.where(np.isfinite(self.time), self.time, self.spent[:, None])


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
    rows = pooled(runs, instances).reset_index(drop=True)
    where = pc.index_in(
        pa.array(hits["run_id"], pa.string()), value_set=pa.array(rows["run_id"], pa.string())
    ).to_numpy(zero_copy_only=False)
    known = ~np.isnan(where.astype(float))
    row = where[known].astype(np.int64)
    targets, code = _codes(hits.loc[known, TARGET])
    time = hits[currency].to_numpy(dtype=float, na_value=np.nan)[known]
    after = hits[f"{currency}_after"].to_numpy(dtype=float, na_value=np.nan)[known]
    problem = rows.groupby(PROBLEM, sort=False, dropna=False).ngroup().to_numpy()
    order = np.argsort(problem[row], kind="stable")
    ends = np.searchsorted(problem[row][order], np.arange(problem.max() + 2 if len(problem) else 1))
    for low, high in pairwise(ends.tolist()):
        if low == high:
            continue
        mine = order[low:high]
        at, place = np.unique(row[mine], return_inverse=True)
        level, column = np.unique(code[mine], return_inverse=True)
        sizes = len(at), len(level)
        table, early = np.full(sizes, np.nan), np.full(sizes, np.nan)
        table[place, column], early[place, column] = time[mine], after[mine] + 1
        some = rows.iloc[at].reset_index(drop=True)
        yield Runtimes(
            runs=some,
            targets=targets.iloc[level].reset_index(drop=True),
            spent=some[currency].to_numpy(dtype=float),
            time=np.where(np.isnan(table), np.inf, table),
            earliest=np.where(np.isnan(early), np.inf, early),
        )


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
    (95 %, `fixed_target.ert_interval`; an infinite end says that the runs are too few to bound it), at_least (spent,
    where none reached it, else NaN), ert_earliest (with each hit at the earliest count that its thinned trace allows),
    resampled (what the interval speaks of: other "runs", or other "instances"; '' where there is none). Counts are of
    `currency`.

    Problems that differ only in the options `instances`, such as ("instance",), are one. From five instances on these
    are resampled, with all their runs. Where chance has no part in a cell there is no interval.
    """
    columns = [str(name) for name in runs.columns]
    swept = [name for name in columns if name.startswith(PREFIXES) and name.partition(".")[2] not in instances]
    needed = runs[[name for name in columns if name in _NEEDED or name in swept]]  # a slice of few columns is cheap
    tables = [_of_problem(one, intervals, swept) for one in runtimes(hits, needed, currency, instances)]
    if not tables:
        return pd.DataFrame(columns=[*_CELL, *swept, "dimension", *TARGET, *_TOLD])
    joined = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    low, high = success_intervals(joined["reached"], joined["runs"])
    chance = joined.pop("chance")
    joined |= {
        "success": joined["reached"] / joined["runs"],
        "success_low": np.where(chance, low, np.nan),
        "success_high": np.where(chance, high, np.nan),
    }
    bound = chance & (joined["reached"] == 0)  # what the runs cost on average, over the largest success they allow
    joined["ert_low"] = np.where(bound, joined["spent"] / joined["runs"] / high, joined["ert_low"])
    joined["ert_high"] = np.where(bound, np.inf, joined["ert_high"])
    joined["ert_low"] = np.maximum(joined["ert_low"], 1.0)  # nothing is reached without an evaluation
    unbounded = joined["ert_high"] > _BOUNDED * joined["ert"]
    joined["ert_high"] = np.where(unbounded, np.inf, joined["ert_high"])
    return pd.DataFrame(joined)[[*_CELL, *swept, "dimension", *TARGET, *_TOLD]]


def _of_problem(one: Runtimes, intervals: bool, swept: Sequence[str]) -> dict[str, Any]:
    """Return the columns of `ert` of one problem, cell by cell and there target by target."""
    runs = one.runs
    cell = runs.groupby(CELL, sort=False, dropna=False).ngroup().to_numpy()
    instance = pd.factorize(runs["instance"], sort=True)[0]
    order = np.lexsort([runs["repetition"].to_numpy(), instance, cell])  # in a cell the same for every method
    begins = np.flatnonzero(np.diff(cell[order], prepend=-1))
    count, chance = np.diff(begins, append=len(order)), _chances(runs, order, begins)
    won = np.isfinite(one.time[order])
    paid = one.paid[order]
    early = np.where(won, one.earliest[order], one.spent[order, None])
    spent, least = (np.add.reduceat(table, begins, axis=0) for table in (paid, early))
    reached = np.add.reduceat(won.astype(np.int64), begins, axis=0)
    low, high = np.full(spent.shape, np.nan), np.full(spent.shape, np.nan)
    units = np.full(len(begins), "", dtype=object)
    for i in np.flatnonzero(chance & intervals):
        mine = slice(begins[i], begins[i] + count[i])
        starts = np.flatnonzero(np.diff(instance[order][mine], prepend=-1))
        clustered = len(starts) >= _ENOUGH
        units[i] = "instances" if clustered else "runs"
        sums = (
            np.add.reduceat(table[mine].astype(float), starts, axis=0) if clustered else table[mine]
            for table in (paid, won)
        )
        low[i], high[i] = ert_interval(*sums)
    targets = len(one.targets)
    first = runs.iloc[order[begins]]
    found: dict[str, Any] = {
        name: np.repeat(first[own].to_numpy(), targets) for name, own in zip(_CELL, CELL, strict=True)
    } | {name: np.repeat(first[name].to_numpy(), targets) for name in swept}
    found |= {name: np.tile(one.targets[name].to_numpy(), len(begins)) for name in TARGET}
    with np.errstate(divide="ignore"):
        return found | {
            "dimension": np.repeat(first["dimension"].to_numpy(), targets), "runs": np.repeat(count, targets),
            "reached": reached.ravel(), "spent": spent.ravel(), "ert": (spent / reached).ravel(),
            "ert_low": low.ravel(), "ert_high": high.ravel(),
            "at_least": np.where(reached == 0, spent, np.nan).ravel(), "ert_earliest": (least / reached).ravel(),
            "chance": np.repeat(chance, targets),
            "resampled": np.where(np.isnan(low).ravel(), "", np.repeat(units, targets)),
        }  # fmt: skip


def _chances(runs: pd.DataFrame, order: NDArray[np.int64], begins: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return of each cell what `has_chance` says, shape (cells,)."""
    return chances(runs, ByCell(order, begins, np.diff(begins, append=len(order))))


_TOLD = [
    "runs", "reached", "success", "success_low", "success_high", "spent", "ert", "ert_low", "ert_high", "at_least",
    "ert_earliest", "resampled",
]  # fmt: skip
_BOUNDED = 1e6  # times ERT: an upper end beyond says that the runs are too few to tell one
_NEEDED = {
    "run_id", *CELL, "dimension", "repetition", "evaluations", "charged", "best_value", "judged_value",
    "judged_evaluations",
}  # fmt: skip  # columns of runs that expected running times come from
_ENOUGH = 5  # instances, from which on they are what is resampled


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
    / dimension. Every problem of the group counts the same, whatever the number of its runs and targets; on a problem
    where a method was not run it reached nothing, as `problems` of `of_problems` tell. With `restarts` above 0 so many
    costs of each target are drawn with simulated restarts (`fixed_target.restarted`) in place of the runs' own.
    """
    for name in by:
        if name not in runs:
            raise ValueError(f"runs have no column {name!r} to group by; {suggest(name, map(str, runs.columns))}")
    method = [*METHOD, *SETTING]
    runs = runs[list(dict.fromkeys(["run_id", *PROBLEM, *method, *by, "dimension", currency]))]  # few are cheap to cut
    methods = by_cell(runs, method)
    told_of = list(runs[method].iloc[methods.first].itertuples(index=False, name=None))
    whole = list(runtimes(hits, runs.assign(_method=methods.number), currency))
    scale = [one.runs["dimension"].to_numpy(dtype=float) if per_dimension else np.ones(len(one.runs)) for one in whole]
    cost = np.asarray([] if at is None else at, dtype=float)
    if at is None:
        most = max((float((one.spent / s).max()) for one, s in zip(whole, scale, strict=True)), default=1.0)
        cost = 10 ** (np.arange(0, np.ceil(np.log10(max(most, 1.0)) * 20) + 1) / 20)
    shares: dict[tuple[object, ...], dict[tuple[object, ...], list[Array]]] = {}
    problems: dict[tuple[object, ...], int] = {}
    for one, s in zip(whole, scale, strict=True):
        for quantity, levels in one.targets.groupby("quantity", sort=False):
            group = (*(_missing_alike(one.runs[name].iloc[0]) for name in by), quantity)
            problems[group] = problems.get(group, 0) + 1
            numbers = one.runs["_method"].to_numpy()
            for number in dict.fromkeys(numbers.tolist()):
                rows = np.flatnonzero(numbers == number)
                times = one.time[rows[:, None], levels.index.to_numpy()] / s[rows, None]
                if restarts:
                    times = restarted(times, one.spent[rows] / s[rows], restarts)
                times = np.sort(times.ravel())
                told = tuple(np.nan if part != part else part for part in told_of[number])
                found = np.searchsorted(times, cost, side="right") / len(times)
                shares.setdefault(group, {}).setdefault(told, []).append(found)
    keys = [*by, "quantity", *METHOD, "start", "budget", "target_value"]
    tables = [
        pd.DataFrame(
            dict(zip(keys, (*group, *told), strict=True))
            | {
                "cost": cost,
                "share": np.sum(found, axis=0) / problems[group],
                "problems": len(found),
                "of_problems": problems[group],
            }
        )
        for group, of_group in shares.items()
        for told, found in of_group.items()
    ]
    columns = [*keys, "cost", "share", "problems", "of_problems"]
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=columns)


def _codes(pairs: pd.DataFrame) -> tuple[pd.DataFrame, NDArray[np.int64]]:
    """Return the different (quantity, target), in the order in which they come, and the number of each row's."""
    q, different_names = pd.factorize(pairs["quantity"])
    names = list(different_names)
    level, values = pd.factorize(pairs["target"].to_numpy(dtype=float))
    code, different = pd.factorize(q.astype(np.int64) * max(len(values), 1) + level)
    told = pd.DataFrame(
        {
            "quantity": [names[i // max(len(values), 1)] for i in different],
            "target": values[different % max(len(values), 1)] if len(values) else [],
        }
    )
    return told, code.astype(np.int64)


def _missing_alike(value: object) -> object:
    """Return the value, or for any that is missing the one NaN: NaNs are keys of different groups otherwise."""
    return np.nan if pd.isna(value) else value  # type: ignore[call-overload]
