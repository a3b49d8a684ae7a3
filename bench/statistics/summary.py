"""Statistics of the runs of each cell, and what methods and problems are called in tables.

A cell's row has quartiles, the success rate with its interval, and what failed. A name says only what sets a method
apart here; options that are just those of a preset (a file of ``conf/optimizer/``) are said by the preset's name.
The seconds that the objective takes (`priced`) are a second currency: counts of calls times the costs of
`bench.sweep.costs`, records with the columns of `PROBLEM` and of `KINDS` in seconds.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calibench import conf, optimizers, problems
from calibench.bench.execution.answer import PREFIX
from calibench.bench.execution.request import repetitions_of
from calibench.bench.provenance.run_id import canonical, chosen_options, given_options, options_of
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, ByCell, answers, by_cell, by_number, judged
from calibench.bench.store.arrays import Array, Flags, lists_of
from calibench.bench.store.columns import Columns, floats, known, name_rows, numbered, parts, plain, true, typed
from calibench.core.registry import NotImported, names_of_files

if TYPE_CHECKING:
    import pandas as pd

SAME = 1e-9  # of a value: what is closer to it is the same value
QUARTILES = (0.25, 0.5, 0.75)
_NORMAL_975 = 1.959963984540054  # the normal distribution's quantile at .975
KINDS = ("value_s", "batch_s", "residuals_s", "jacobian_s", "gradient_s", "joint_s")  # of calls, columns of costs
CONF = Path(conf.__file__).resolve().parent


def summary(runs: pd.DataFrame, costs: Iterable[Mapping[str, Any]] = ()) -> pd.DataFrame:
    """Return a row for each cell (`bench.statistics.cells`): medians, quartiles, success, failures.

    `success` is the share of all runs that reached the `goal`, with Wilson's interval where chance has a part;
    `charged_to_target` the median over the runs that did. Below `floor` values are not compared. Where values are
    noisy, best_* are of the answers as judged, and `seen_median` of the values seen. Of each ``merit.KEY`` there is the
    median (``_median``), or of flags the share (``_share``). With `costs` (`bench.sweep.costs`) also
    `objective_s_median` and `objective_s_to_target`.
    """
    import pandas as pd

    if runs.empty:
        return pd.DataFrame()
    cells = by_cell(runs)
    columns = _statistics(runs, cells)
    for key in (str(key) for key in runs.columns if str(key).startswith(PREFIX)):
        if pd.api.types.is_bool_dtype(runs[key]):
            with np.errstate(invalid="ignore"):
                columns[f"{key}_share"] = cells.sums(runs[key].fillna(False)) / cells.sums(runs[key].notna())
        elif pd.api.types.is_float_dtype(runs[key]):
            columns[f"{key}_median"] = cells.medians(floats(runs[key]))
    seconds = floats(priced(runs, costs))
    if not np.isnan(seconds).all():
        hits, charged = goal_hits(runs), floats(runs["charged"])
        # seconds of its calls until the target, as if all kinds of calls were evenly mixed
        to_target = np.where(np.isfinite(hits), seconds * (hits / charged), np.nan)
        columns |= {
            "objective_s_median": np.where(cells.sums(np.isnan(seconds)) > 0, np.nan, cells.medians(seconds)),
            "objective_s_to_target": cells.medians(to_target),
        }
    first = runs.iloc[cells.first][CELL].reset_index(drop=True)
    return pd.concat([first, pd.DataFrame(columns)], axis=1)


def priced(runs: pd.DataFrame, costs: Iterable[Mapping[str, Any]]) -> pd.Series:
    """Return the seconds that each run's calls of the objective take: counts by kind times `costs`; NaN: not known."""
    import pandas as pd

    known = {key_of_costs(record): record for record in costs}
    problem = numbered(runs[column] for column in PROBLEM)
    first = runs[PROBLEM].iloc[np.unique(problem, return_index=True)[1]]
    records = [known.get(key, {}) for key in first.itertuples(index=False, name=None)]
    batched, residuals = runs["batch_evaluations"], runs["residual_evaluations"]
    gradients, joint = (
        runs[name].fillna(0) if name in runs else 0 for name in ("gradient_evaluations", "joint_evaluations")
    )  # no run from before these columns had any
    singles, slopes = runs["evaluations"] - batched - residuals - joint, runs["jacobian_evaluations"] - gradients
    alone = gradients - joint + 0 * slopes
    counts = (singles, batched, residuals, slopes, alone, joint + 0 * slopes)
    total = pd.Series(0.0, index=runs.index)
    for kind, column in zip(KINDS, counts, strict=True):
        count = column.astype(float)
        seconds = np.array([record.get(kind, np.nan) for record in records], dtype=float)[problem]
        total += (count * seconds).mask(count == 0, 0.0)
    total[np.array([not record for record in records], dtype=bool)[problem]] = np.nan
    return total


def key_of_costs(record: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the problem that a record of costs is of."""
    return tuple(record.get(column) for column in PROBLEM)


def summary_columns(runs: Columns) -> dict[str, list[Any]]:
    """Return the columns of `summary` that every study has, without pandas."""
    cells = by_cell(runs)
    named = {name: plain(runs[name]) for name in CELL if name != "target"} | {"target": floats(runs["target"]).tolist()}
    first = {name: [column[i] for i in cells.first] for name, column in named.items()}
    return first | {name: np.asarray(column).tolist() for name, column in _statistics(runs, cells).items()}


def _statistics(runs: Columns, cells: ByCell) -> dict[str, Any]:
    count = cells.count
    reached, charged, status = goal_hits(runs), floats(runs["charged"]), plain(runs["status"])
    hit, inside, noisy = np.isfinite(reached), true(runs["inside_box"]), cells.sums(judged(runs)) > 0
    won, level = cells.sums(hit), goals_of(runs)[cells.first]
    low, high = np.full(len(count), np.nan), np.full(len(count), np.nan)
    for i in np.flatnonzero((level == level) & chances(runs, cells)):
        low[i], high[i] = success_interval(int(won[i]), int(count[i]))
    # quartiles of what was answered and what was seen, shapes (cells,)
    (q1, median, q3), (_, seen, _) = (
        np.array([quantiles(values[cells.rows(i)], QUARTILES) for i in range(len(count))]).reshape(-1, 3).T
        for values in (answers(runs), floats(runs["best_value"]))
    )
    unit = plain(runs["unit"]) if "unit" in runs else [None] * len(charged)
    phi = floats(runs["gauge_phi"])
    with np.errstate(invalid="ignore"):
        spread = cells.over(np.fmax, phi) - cells.over(np.fmin, phi)

    minimum = np.full(len(count), np.nan)
    if "minimum" in runs:  # one that a run of any cell of the problem has passed is wrong
        declared, values = floats(runs["minimum"])[cells.last], floats(runs["best_value"])
        below = cells.over(np.fmin, np.where(inside & np.isfinite(values), values, np.nan)) < declared
        problem = numbered(runs[name] for name in PROBLEM)[cells.first]
        suspects = np.flatnonzero(below & ~noisy).tolist()
        wrong = [problem[i] for i in suspects if lowest_below(runs, float(declared[i]), cells.rows(i)) is not None]
        minimum = np.where(np.isin(problem, wrong), np.nan, declared)

    return {
        "runs": count,
        "failed": cells.sums([how == "failed" for how in status]),
        "timeouts": cells.sums([how == "timeout" for how in status]),
        "goal": level,
        "reached": won,
        "success": np.where(level == level, won / count, np.nan),
        "success_low": low,
        "success_high": high,
        "floor": np.where(level == level, level, -np.inf),  # at and below it values are tied
        "best_q1": q1,
        "best_median": median,
        "best_q3": q3,
        "seen_median": seen,
        "charged_median": cells.medians(charged),
        "charged_to_target": cells.medians(np.where(hit, reached, np.nan)),
        "inside_box": cells.sums(inside),
        "outside_box": cells.sums(outside_box(runs)),
        "restarts": cells.sums(np.nan_to_num(floats(runs["restarts"]))),
        "kmrmse_median": cells.medians(floats(runs["kmrmse"])),
        "kmrmse_aligned_median": cells.medians(floats(runs["kmrmse_aligned"])),
        "parameter_error_mm_median": cells.medians(floats(runs["parameter_error_mm"])),
        "gauge_phi_spread": spread,
        "wall_s_median": cells.medians(floats(runs["wall_s"])),
        "unit": [text if isinstance(text, str) else "" for text in (unit[i] for i in cells.last)],
        "minimum": minimum,
        "noisy": noisy,
    }


def outside_box(runs: Columns) -> Flags:
    """Return whether each run has an answer that lies outside the box; of published runs nobody knows, so not."""
    outside = known(runs["inside_box"]) & ~true(runs["inside_box"])
    return np.asarray(outside & np.isfinite(floats(runs["best_value"])))


def lowest_below(runs: Columns, minimum: float, rows: Any = slice(None)) -> float | None:
    """Return the lowest value inside the box that is below `minimum` by more than rounding; None: none, or noisy."""
    values = floats(runs["best_value"])[rows]
    values = values[true(runs["inside_box"])[rows] & np.isfinite(values)]
    if minimum != minimum or not values.size or judged(runs)[rows].any():
        return None
    allowed = SAME * max(abs(minimum), float(np.median(np.abs(values))))
    return float(values.min()) if values.min() < minimum - allowed else None


def quantiles(values: Array, at: Sequence[float]) -> Array:
    """Return the quantiles `at` of `values` along their first axis: those between two runs interpolated (type 7).

    A run without a value (infinite, NaN) is worse than all; a quantile on or beside it is infinite, never NaN.

    >>> quantiles(np.array([1.0, 2.0, 4.0, np.inf]), [0.25, 0.5, 0.75]).tolist()
    [1.75, 3.0, inf]
    """
    places = [int(q * (len(values) - 1)) for q in at]
    needed = sorted({min(place + more, len(values) - 1) for place in places for more in (0, 1)})
    ordered = np.partition(np.where(np.isnan(values), np.inf, values), needed, axis=0)
    levels = []
    for q in at:
        place = q * (len(ordered) - 1)
        below = int(place)
        share = place - below
        low, high = ordered[below], ordered[min(below + 1, len(ordered) - 1)]
        between = low if share == 0 else (1 - share) * low + share * high
        levels.append(np.clip(between, low, high))  # of two equal values their value, to the last bit
    return np.array(levels)


def median_of_reached(values: Array) -> float:
    """Return the median of what is finite; NaN of nothing."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


@cache
def success_interval(successes: int, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share, as scipy.stats has it to the last bit; that loads for half a second.

    Newcombe, Statistics in Medicine 17 (1998), method 3.
    """
    p, n, z = successes / count, count, _NORMAL_975
    width = 2 * (n + z**2)
    middle, half = (2 * n * p + z**2) / width, z / width * sqrt(4 * n * p * (1 - p) + z**2)
    return (middle - half if successes else 0.0), (middle + half if successes < count else 1.0)


def chances(runs: Columns, cells: ByCell) -> Flags:
    """Tell for each cell whether its runs depend on chance: by the method, by its start, or by differing results."""
    by_results = cells.sums(judged(runs)) > 0  # of a noisy value even one run is a draw
    for name in ("best_value", "charged"):
        values = floats(runs[name])
        unlike = cells.sums(np.isnan(values)) > 0  # a run without a value is like no other
        by_results |= (cells.count > 1) & (unlike | (cells.over(np.fmin, values) < cells.over(np.fmax, values)))
    names = [plain(runs[name]) for name in (*METHOD, "start")]
    stated = plain(runs["chance"]) if "chance" in runs else [None] * len(names[0])
    return by_results | [
        not runs_once(*(str(column[i]) for column in names)) if stated[i] is None else bool(stated[i])
        for i in cells.first.tolist()
    ]


def has_chance(cell: pd.DataFrame) -> bool:
    """Tell whether the runs of one cell depend on chance (`chances`)."""
    return bool(chances(cell, by_number(np.zeros(len(cell), dtype=np.int64)))[0])


def runs_once(optimizer: str, options: str, start: str) -> bool:
    """Tell whether a method, as rows name it, gives one answer however often it is run; of one not imported: no."""
    key = optimizer, options, start
    if key not in _RUNS_ONCE:
        made: Any = None
        try:
            with names_of_files(leaves_out="whether chance has a part"):
                given = given_options(optimizers.registry, optimizer, json.loads(options))
                made = optimizers.make(optimizer, **given)
        except NotImported:
            return False
        except (Exception, SystemExit):  # options of another version, or whatever a class raises
            pass
        has_traits = isinstance(getattr(made, "traits", None), optimizers.Traits)  # else its row does not tell them
        which: Any = "random" if start == "random" else "nominal"
        _RUNS_ONCE[key] = has_traits and len(repetitions_of(made, which, range(2))) == 1
    return _RUNS_ONCE[key]


_RUNS_ONCE: dict[tuple[str, str, str], bool] = {}  # of a method and its start


def alike(values: Array) -> Array:
    """Return values, shape (n,), where those that follow each other within `SAME` of themselves are the least of them.

    >>> alike(np.array([2.0, 1.0, np.inf, 1.0 + 1e-12, 0.0, 1e-30])).tolist()
    [2.0, 1.0, inf, 1.0, 0.0, 1e-30]
    """
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    with np.errstate(invalid="ignore"):
        apart = ~(np.diff(ordered) <= SAME * np.minimum(np.abs(ordered[1:]), np.abs(ordered[:-1])))
    first = np.concatenate([[0], np.cumsum(apart)]).astype(np.int64)[: len(values)]
    joined = np.empty(len(values))
    joined[order] = ordered[np.flatnonzero(np.concatenate([[True], apart]))[first]] if len(values) else ordered
    return joined


def method_names(table: pd.DataFrame) -> pd.Series:
    """Return what each row's method is called beside the others here (`names_of_methods`)."""
    return name_rows(table, METHOD, names_of_methods)


def names_of_methods(methods: Iterable[tuple[str, str]]) -> list[str]:
    """Return what each method (optimiser, options) is called: the optimiser, and of its variants what sets them apart.

    That is the options that are not the default, the first if that is enough; of a preset of two or more its own name.
    Of a class of one's own nobody knows the defaults: the options in which its variants here differ are said.
    """
    asked = list(methods)
    pairs = list(dict.fromkeys(asked))
    names: dict[tuple[str, str], str] = {}
    for optimizer, text in pairs:
        options = chosen_options(optimizers.registry, optimizer, parts(json.loads(text), classes=False))
        others = [parts(json.loads(its)) for name, its in pairs if name == optimizer]
        if optimizer not in optimizers.registry:
            options = {key: value for key, value in options.items() if any(each.get(key) != value for each in others)}
        texts = [option_text(*option) for option in options.items()]
        preset = preset_names().get((optimizer, text)) if len(texts) > 1 else None
        alone = len(others) == 1
        names[optimizer, text] = preset or (optimizer if alone or not texts else f"{optimizer} ({', '.join(texts)})")
    short = {pair: name.partition(",")[0] + ", …)" if "," in name else name for pair, name in names.items()}
    chosen = short if len(set(short.values())) == len(pairs) else names
    return [chosen[pair] for pair in asked]


def method_name(optimizer: str, options: str) -> str:
    """Return an optimiser alone: its name and the options that are not the declared default."""
    chosen = chosen_options(optimizers.registry, optimizer, parts(json.loads(options), classes=False))
    return " ".join([optimizer, *(option_text(*option) for option in sorted(chosen.items()))])


def option_text(key: str, value: Any, short: bool = True) -> str:
    """Return an option as tables say it: None, and where `short` a member of an enumeration, as one types them.

    >>> option_text("shift", None), option_text("restarts", True), option_text("loss", "rig:Loss.L1")
    ('shift=null', 'restarts=True', 'loss=L1')
    """
    return f"{key}={'null' if value is None else typed(value) if short else value}"


def problem_name(problem: str, options: str, but: Sequence[str] = (), also: Collection[str] = ()) -> str:
    """Return a problem's name and the options that are not the declared default; those in `also` always."""
    declared = problems.registry.options(problem) if problem in problems.registry else {}
    have = parts(json.loads(options))
    named = parts(json.loads(options), classes=False)
    chosen = chosen_options(problems.registry, problem, named) | {key: have[key] for key in also if key in have}
    texts = [
        option_text(key, value)
        for key, value in sorted(chosen.items())
        if key not in but
        and not (key == "n" and key in declared and declared[key].default is None)
        and not (value is None and declared)  # a problem of ours says so of what does not apply to its data
    ]
    return " ".join([problem, *texts])


def goals_of(runs: Columns) -> Array:
    """Return the level that counts as success of each run: its own target, else the last of its problem's, else NaN."""
    target = floats(runs["target"])
    return np.where(np.isnan(target), lists_of(runs["targets"]).last, target)


def goal_hits(runs: Columns) -> Array:
    """Return the charged evaluations at which each run reached its goal; NaN: never, or it failed. Shape (runs,)."""
    levels, hits, target = lists_of(runs["targets"]), lists_of(runs["hits_charged"]), floats(runs["target"])
    charged, goals = np.full(len(levels.count), np.nan), np.where(np.isnan(target), levels.last, target)
    at_goal = np.flatnonzero(levels.flat == np.repeat(goals, levels.count))
    rows, first = np.unique(levels.row[at_goal], return_index=True)
    place = at_goal[first] - levels.begins[rows]
    charged[rows] = hits.flat[hits.begins[rows] + place]
    charged[[status == "failed" for status in plain(runs["status"])]] = np.nan
    return charged


def endings(table: pd.DataFrame) -> pd.Series:
    """Return of each row's method "restarts", "stops", or "" where it spends the budget or is not known here."""
    kinds = dict.fromkeys(zip(*(plain(table[name]) for name in METHOD), strict=True), "")
    for optimizer, text in kinds:
        options = json.loads(text)
        if options.get("restarts"):
            kinds[optimizer, text] = "restarts"
        elif optimizer in optimizers.registry:
            given = given_options(optimizers.registry, optimizer, options)
            with suppress(ValueError, AttributeError):  # options of another version, or a class without traits
                stops = optimizers.make(optimizer, **given).traits.self_terminating
                kinds[optimizer, text] = "stops" if stops else ""
    return name_rows(table, METHOD, lambda methods: [kinds[method] for method in methods])


@cache
def preset_names() -> dict[tuple[str, str], str]:
    """Return (optimiser, its options as canonical JSON) -> the preset that has just these options."""
    from omegaconf import OmegaConf

    names: dict[tuple[str, str], str] = {}
    for preset in sorted((CONF / "optimizer").glob("*.yaml")):
        name = preset.stem
        options: dict[str, Any] = {}
        while (path := CONF / "optimizer" / f"{name}.yaml").is_file():  # to the registered name at its end
            content: Any = OmegaConf.to_container(OmegaConf.load(path))
            name = content.pop("name", name)
            name = str(next((entry for entry in content.pop("defaults", []) if entry != "_self_"), name))
            options = content | options
        if name in optimizers.registry:
            names.setdefault((name, canonical(options_of(optimizers.make(name, **options)))), preset.stem)
    return names
