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
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain
from typing import Any, ClassVar, Self, final

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from calibench.bench.provenance.run_id import canonical
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, SETTING, by_cell
from calibench.bench.statistics.summary import chances, success_interval
from calibench.bench.store.arrays import HITS_SCHEMA, dictionary, index_in, numbers
from calibench.bench.store.columns import PREFIXES, Array, Counts, Flags, numbered
from calibench.bench.store.hits import NEVER
from calibench.core.options import suggest

TARGET = ["quantity", "target"]
_UNASKED = NEVER - 1  # a target that is none of the run's
RESAMPLES = 999
LEVEL = 0.95
FEWEST = 3  # units; of fewer nothing can be said
_SEED = (2008, 0x455254)
_BLOCK = 250_000  # numbers, of resamples against units
_BOUNDED = 1e6  # times ERT: an upper end beyond this means that the runs are too few for a bound
_ENOUGH = 5  # instances: from so many on, instances are resampled instead of runs
_CELL = [*CELL[:-1], "target_value"]  # the run's own target, beside the target that is looked at
_TASK = [*PROBLEM, "start", "budget", "target_value", *TARGET]
_NUMBERS = [
    "runs", "reached", "success", "success_low", "success_high", "spent", "ert", "ert_low", "ert_high", "at_least",
    "resampled",
]  # fmt: skip


@final
@dataclass(frozen=True)
class Runtimes:
    """The runs of one problem against its targets: `at` and `level` are their places in `all_runs` and `all_targets`.

    `spent`, shape (runs,), is what each run was charged; `charged`, shape (runs, targets), are the counts of `Hits`.
    What is computed of them has the same shape, and costs memory each time it is asked for.
    """

    all_runs: pd.DataFrame
    all_targets: pd.DataFrame
    at: Counts
    level: Counts
    spent: Array
    charged: NDArray[Any]

    @property
    def asked(self) -> Flags:
        """Tell which target is one of the run's."""
        return np.asarray(self.charged != _UNASKED)

    @property
    def time(self) -> Array:
        """Return the counts at which each target was surely reached, infinite where it never was."""
        return np.where(self.charged >= 0, self.charged, np.inf)

    @property
    def paid(self) -> Array:
        """Return what was spent until each target was reached, or in vain."""
        return np.where(self.charged >= 0, self.charged, np.where(self.asked, self.spent[:, None], 0.0))

    def of(self, rows: Counts | Flags, columns: Counts | Flags) -> Runtimes:
        """Return these of the runs, and against some of the targets."""
        at, level, spent = self.at[rows], self.level[columns], self.spent[rows]
        return replace(self, at=at, level=level, spent=spent, charged=self.charged[rows][:, columns])


@final
@dataclass(frozen=True)
class _Block:
    """Runs one after the other that have the same targets: places in `Hits.ids`, shape (runs,), and `Hits.targets`,
    shape (targets,); whole counts of shape (runs, targets), `NEVER` where a target was not reached."""

    run: Counts
    level: Counts
    charged: NDArray[Any]


@final
@dataclass(frozen=True)
class Hits:
    """Hits as numbers, each beside the others of its run: the counts at which a target was surely reached. In a study
    of 1e5 runs they are ten million, of which a table takes gigabytes."""

    COLUMNS: ClassVar = ["run_id", *TARGET, "charged"]

    ids: pa.Array
    targets: pd.DataFrame  # columns of `TARGET`
    blocks: tuple[_Block, ...]

    @classmethod
    def of(cls, tables: pd.DataFrame | pa.Table | Iterable[pa.Table]) -> Self:
        """Return the hits of tables with columns of `HITS_SCHEMA`, of which only one has to be there at a time."""
        if isinstance(tables, pd.DataFrame):
            schema = pa.schema([HITS_SCHEMA.field(name) for name in cls.COLUMNS])
            tables = pa.Table.from_pandas(tables[cls.COLUMNS], schema, preserve_index=False)
        parts: Iterable[pa.Table] = [tables] if isinstance(tables, pa.Table) else tables
        known: dict[tuple[str, float], int] = {}
        ids = [pa.array([], pa.string())]
        blocks: list[_Block] = []
        for table in parts:
            (named, run), (names, quantity) = (dictionary(table[name]) for name in ("run_id", "quantity"))
            value, values = pd.factorize(numbers(table["target"]))
            level, different = pd.factorize(quantity * max(len(values), 1) + value)
            pairs = zip(
                names.take(pa.array(different // max(len(values), 1))).to_pylist(), different % max(len(values), 1)
            )
            place = np.array(
                [known.setdefault((name, float(values[k])), len(known)) for name, k in pairs], dtype=np.int64
            )
            charged = numbers(table["charged"], NEVER)
            most = charged.max(initial=0)
            few = next(kind for kind in (np.int16, np.int32, np.int64) if most <= np.iinfo(kind).max)
            # where runs with the same levels in the same order stand together, and how many levels they have
            begins = np.flatnonzero(np.diff(run, prepend=-1))
            sizes = np.diff(begins, append=len(run))
            before = np.repeat(np.roll(sizes, 1), sizes)  # how many the run before has
            unlike = np.append(level != level[np.maximum(np.arange(len(run)) - before, 0)], False)
            new = np.flatnonzero((np.diff(sizes, prepend=0) != 0) | np.logical_or.reduceat(unlike, begins))
            for k, end in zip(new.tolist(), [*begins[new[1:]].tolist(), len(run)]):
                some, size = slice(int(begins[k]), end), int(sizes[k])
                counts, at = charged[some].reshape(-1, size).astype(few), place[level[some][:size]]
                blocks.append(_Block(run[some][::size] + sum(map(len, ids)), at, counts))
            ids.append(named)
        targets = pd.DataFrame(list(known), columns=TARGET).astype({"quantity": str, "target": float})
        return cls(pa.concat_arrays(ids), targets, tuple(blocks))

    def of_quantity(self, name: str) -> Hits:
        """Return the hits of the targets of one quantity."""
        chosen = (self.targets["quantity"] == name).to_numpy()
        some = []
        for b in self.blocks:
            k = np.flatnonzero(chosen[b.level])
            if len(k):  # one beside the other without a copy
                columns = slice(k[0], k[-1] + 1) if k[-1] - k[0] + 1 == len(k) else k
                some.append(_Block(b.run, b.level[k], b.charged[:, columns]))
        return replace(self, blocks=tuple(some))

    def of_runs(self, run_ids: pd.Series) -> Hits:
        """Return the hits of some runs."""
        chosen = np.isin(self.ids.to_numpy(zero_copy_only=False), run_ids)
        parts = [(block, chosen[block.run]) for block in self.blocks]
        some = [_Block(b.run[k], b.level, b.charged[k]) for b, k in parts if k.any()]
        return replace(self, blocks=tuple(some))


def runtimes(hits: Hits | pd.DataFrame, runs: pd.DataFrame, instances: Sequence[str] = ()) -> Iterator[Runtimes]:
    """Yield the `Runtimes` of each problem in `runs`, in their order; runs without any target are left out.

    Problems that differ only in the options `instances` (and their data) are one; its runs have a column `instance`.
    """
    hits = hits if isinstance(hits, Hits) else Hits.of(hits)
    rows = pooled(runs, instances)
    row_of = numbers(index_in(hits.ids, pa.array(rows["run_id"], pa.string())), -1).astype(np.int64)
    found = [(block, row_of[block.run]) for block in hits.blocks]
    found = [(block, row) for block, row in found if (row >= 0).any()]
    seen = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *(row[row >= 0] for _, row in found)]))
    rows = rows.iloc[seen].reset_index(drop=True)
    levels = dict.fromkeys(level for block, _ in found for level in block.level.tolist())
    code = {level: i for i, level in enumerate(levels)}  # in the order in which they come
    targets = hits.targets.iloc[list(code)].reset_index(drop=True)

    spent = rows["charged"].to_numpy(dtype=float)
    problem = numbered(rows[name] for name in PROBLEM)
    pieces: dict[int, list[tuple[Counts, Counts, _Block, Counts]]] = {}  # of each problem
    for block, row in found:
        known = np.flatnonzero(row >= 0)
        place = np.searchsorted(seen, row[known])
        columns = np.array([code[level] for level in block.level.tolist()], dtype=np.int64)
        for number in np.unique(problem[place]).tolist():
            mine = problem[place] == number
            pieces.setdefault(number, []).append((place[mine], columns, block, known[mine]))
    for _, parts in sorted(pieces.items()):
        at, row = np.unique(np.concatenate([place for place, *_ in parts]), return_inverse=True)
        level, column = np.unique(np.concatenate([columns for _, columns, *_ in parts]), return_inverse=True)
        kind = np.result_type(*(block.charged.dtype for *_, block, _ in parts))
        charged = np.full((len(at), len(level)), _UNASKED, dtype=kind)
        r = c = 0
        for place, columns, block, chosen in parts:
            charged[np.ix_(row[r : r + len(place)], column[c : c + len(columns)])] = block.charged[chosen]
            r, c = r + len(place), c + len(columns)
        yield Runtimes(rows, targets, at, level, spent[at], charged)


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
    an end of its interval that is infinite, or 1, is not bounded), at_least (spent, where none reached it), resampled
    ("runs", or from five on "instances": problems that differ only in the options `instances`). There is no interval
    where not all runs of a cell have the target, nor where chance has no part.
    """
    columns = [str(name) for name in runs.columns]
    swept = [name for name in columns if name.startswith(PREFIXES) and name.partition(".")[2] not in instances]
    whole = runtimes(hits, runs, instances)
    first = next(whole, None)
    if first is None:
        return pd.DataFrame(columns=[*_CELL, *swept, "dimension", *TARGET, *_NUMBERS])
    rows, levels = first.all_runs, first.all_targets
    whole = chain([first], whole)
    del first  # of 1e5 runs 10 MB
    column = _sums(rows, whole, intervals)
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
        "resampled": np.where(np.isnan(column["low"]), "", column["resampled"]),
    }
    return pd.DataFrame(joined)[[*_CELL, *swept, "dimension", *TARGET, *_NUMBERS]]


def _sums(runs: pd.DataFrame, whole: Iterable[Runtimes], intervals: bool) -> dict[str, NDArray[Any]]:
    """Return sums and intervals, problem by problem, in it cell by cell and there target by target."""
    cells = by_cell(runs)
    number, chances_of = cells.number, chances(runs, cells)
    instances, repetition = pd.factorize(runs["instance"], sort=True)[0], runs["repetition"].to_numpy()
    parts: dict[str, list[Any]] = {}
    for one in whole:
        cell, instance = pd.factorize(number[one.at])[0], instances[one.at]
        order = np.lexsort([repetition[one.at], instance, cell])  # in a cell the same for every method
        for rows in np.split(order, np.flatnonzero(np.diff(cell[order])) + 1):
            seen: dict[bytes, int] = {}  # of targets that each run reached at one time, the first is looked at
            where = np.array([seen.setdefault(column.tobytes(), len(seen)) for column in one.charged[rows].T])
            columns = np.unique(where, return_index=True)[1]
            mine, starts = one.of(rows, columns), np.flatnonzero(np.diff(instance[rows], prepend=-1))
            won, paid, first = mine.charged >= 0, mine.paid, one.at[rows[0]]
            chance, by_instance = bool(chances_of[number[first]]), len(starts) >= _ENOUGH
            units = paid, won.astype(float)
            if by_instance:
                units = np.add.reduceat(units[0], starts), np.add.reduceat(units[1], starts)
            low, high = ert_interval(*units) if chance and intervals else np.full((2, len(columns)), np.nan)
            asked = mine.asked.sum(axis=0)
            low[asked < len(rows)] = high[asked < len(rows)] = np.nan
            of_cell = {
                "run": first, "level": one.level, "chance": chance, "runs": asked[where],
                "spent": paid.sum(axis=0)[where], "reached": won.sum(axis=0)[where], "low": low[where],
                "high": high[where], "resampled": "instances" if by_instance else "runs",
            }  # fmt: skip
            for name, values in of_cell.items():
                parts.setdefault(name, []).append(np.broadcast_to(values, len(where))[asked[where] > 0])
    return {name: np.concatenate(values) for name, values in parts.items()}


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
                times = np.sort(one.of(mine, names == quantity).time.ravel())
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
    p, w = paid[:, some], np.asarray(won[:, some], dtype=float)
    products = p, w, p**2, p * w, w**2
    ratio, error = _log_ratio(np.ones((1, units)), products)
    ratios, errors = np.empty((2, RESAMPLES, len(some)))
    for drawn in in_blocks(units):
        ratios[drawn], errors[drawn] = _log_ratio(weights(units)[drawn].astype(float), products)
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
        low[some] = np.exp(ratio[0] + below)
        high[some] = np.exp(ratio[0] + above)
    return low, high


def _log_ratio(weight: Array, products: Sequence[Array]) -> tuple[Array, Array]:
    """Return log ERT and its standard error in each resample, shapes (resamples, targets); infinite without a hit.

    `products` are what was paid and won, and their products: paid**2, paid * won, won**2.
    """
    n = weight.shape[1]
    a, k, a_a, a_k, k_k = (weight @ values for values in products)
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = a_a / a**2 - 2 * a_k / (a * k) + k_k / k**2
        ratio = np.where(k > 0, np.log(a / k), np.inf)
    spread = np.where(variance > 1e-14, variance, 0.0)  # what is left of equal units by rounding is none
    return ratio, np.sqrt(spread * n / (n - 1))


@cache
def weights(units: int) -> NDArray[np.uint8]:
    """Return how often each unit is drawn in each resample, shape (RESAMPLES, units): some times at most."""
    rng = np.random.default_rng(np.random.SeedSequence([*_SEED, units]))
    drawn = np.empty((RESAMPLES, units), dtype=np.uint8)
    for one in drawn:
        one[:] = rng.multinomial(units, np.full(units, 1 / units))
    return drawn


def in_blocks(units: int) -> Iterator[slice]:
    """Yield the resamples in blocks: as numbers, those of 25 000 units would take 200 MB at once."""
    size = max(8, _BLOCK // units // 8 * 8)  # in eights, so that none is summed in another order
    for begin in range(0, RESAMPLES, size):
        yield slice(begin, min(begin + size, RESAMPLES))


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
