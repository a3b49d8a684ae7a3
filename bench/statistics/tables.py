"""Tables from results: each returns its DataFrame."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import numpy as np
import pandas as pd

from calibench import problems
from calibench.bench.provenance.run_id import given_options
from calibench.bench.statistics import ranking
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, by_cell
from calibench.bench.statistics.summary import QUARTILES, quantiles, summary
from calibench.bench.store.arrays import lists_of
from calibench.bench.store.columns import floats
from calibench.core.registry import NotImported, names_of_files
from calibench.problems.base import Parameter

MADE = "made"  # the first word of the key under which `once` keeps a problem itself
OF_THE_DATA = "what its data can tell"

_KNOWN: ContextVar[dict[tuple[str, ...], Any] | None] = ContextVar("_KNOWN", default=None)


@contextmanager
def problems_made_once() -> Iterator[dict[tuple[str, ...], Any]]:
    """Let `once`, within the context, ask once for what is told of a problem; yield all that it knows by then."""
    known: dict[tuple[str, ...], Any] = {}
    token = _KNOWN.set(known)
    try:
        yield known
    finally:
        _KNOWN.reset(token)


def once(key: tuple[str, ...], make: Callable[[], Any]) -> Any:
    """Return what ``make()`` returns, within `problems_made_once` what it returned first for this key."""
    known = _KNOWN.get()
    if known is None:
        return make()
    if key not in known:
        known[key] = make()
    return known[key]


def problem_of(row: Mapping[str, Any] | pd.Series, leaves_out: str = OF_THE_DATA) -> Any:
    """Return the problem a row was made with; `leaves_out` is what is not told without it.

    Raises `ValueError` where it cannot be built here: its class, or a file that it reads, is elsewhere.
    """
    name, options = row["problem"], row["problem_options"]
    try:
        with names_of_files(leaves_out=leaves_out):
            return once(
                (MADE, name, options),
                lambda: problems.make(name, **given_options(problems.registry, name, json.loads(options))),
            )
    except NotImported:
        raise
    except (Exception, SystemExit) as error:  # a class of somebody's own may raise anything
        raise ValueError(f"problem {name} cannot be built here: {type(error).__name__}: {error}") from error


OF_PARAMETERS = ("parameter_names", "parameter_units", "parameter_starts", "parameter_truths")


def calibrated(runs: pd.DataFrame) -> pd.DataFrame:
    """Return calibrated values against the truth: a row for each cell (`bench.statistics.cells`) and parameter.

    Columns: those of a cell, parameter, unit, true, start_value, median, q1, q3, worst_error, n (runs that have an
    answer).
    """
    columns = [*CELL, "parameter_values", *(name for name in OF_PARAMETERS if name in runs)]
    answered = runs[columns][runs["parameter_values"].notna()]
    cells, listed = by_cell(answered), lists_of(answered["parameter_values"])
    rows = []
    for number, first in enumerate(answered.iloc[cells.first].to_dict("records")):
        names, parameters = {name: first[name] for name in CELL}, parameters_in(first)
        if not parameters:
            continue
        values = listed.table(cells.rows(number))
        for p, column, (q1, median, q3) in zip(parameters, values.T, quantiles(values, QUARTILES).T, strict=True):
            rows.append(
                names
                | {
                    "parameter": p.name, "unit": p.unit, "true": np.nan if p.true is None else p.true,
                    "start_value": p.start, "median": median, "q1": q1, "q3": q3,
                    "worst_error": np.nan if p.true is None else float(np.abs(column - p.true).max()), "n": len(column),
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def parameters_in(row: Mapping[Any, Any] | pd.Series) -> tuple[Parameter, ...]:
    """Return the parameters that a row tells of: those that its problem declares."""
    columns = [row.get(name) for name in OF_PARAMETERS]
    if any(not isinstance(column, Iterable) for column in columns):  # of a problem without parameters
        return ()
    return tuple(
        Parameter(name, unit, start, float("-inf"), float("inf"), None if true is None or true != true else true)
        for name, unit, start, true in zip(*columns, strict=True)
    )


def overview(
    runs: pd.DataFrame, costs: Iterable[Mapping[str, Any]] = (), cells: pd.DataFrame | None = None
) -> pd.DataFrame:
    """Return a field of methods, best first: a row for each cell (`bench.statistics.cells`), a method's together.

    Columns are `_OVERVIEW`: of the method over all tasks rank, solved, mean_place, tasks, of_tasks; of the cell the
    others; with `costs` objective_s_median and objective_s_to_target. `cells` is the summary, if it is made already.
    """
    cells = summary(runs, costs) if cells is None else cells.copy()
    cells["place"] = ranking.places(cells)
    rows = by_cell(runs)
    first = runs.iloc[rows.first]
    more = {
        "error": [json.loads(text).get("error", "") for text in first["problem_options"]],
        "dimension": first["dimension"].to_numpy(dtype=np.int64),
        "parameter_error_mm": rows.medians(floats(runs["parameter_error_mm_aligned"])),
        "cpu_s": rows.medians(floats(runs["cpu_s"])),
    }
    methods = ranking.methods(cells).rename(columns={"place": "mean_place"})
    table = pd.concat([cells, pd.DataFrame(more)], axis=1).merge(methods, on=METHOD)
    table = table.rename(columns={"optimizer_options": "options"}).sort_values(
        ["rank", "optimizer", "options", "dimension", "problem", "error", "problem_options", "start", "budget"],
        kind="stable",
    )
    money = [name for name in ("objective_s_median", "objective_s_to_target") if name in table]
    return table[[*_OVERVIEW, *money]].reset_index(drop=True)


_OVERVIEW = [
    "rank", "solved", "mean_place", "tasks", "of_tasks", "optimizer", "options", "problem", "error", "problem_options",
    "data_id", "dimension", "start", "budget", "target", "goal", "place", "runs", "failed", "timeouts", "reached",
    "success", "charged_to_target", "best_median", "parameter_error_mm", "cpu_s", "outside_box",
]  # fmt: skip


def identifiability(runs: pd.DataFrame) -> pd.DataFrame:
    """Return what the data of each problem can tell: a row a problem, whatever was run on it.

    The worst standard errors are at the problem's typical `noise`, over the parameters that can be found.
    """
    rows = []
    for name, options, data in runs[PROBLEM].drop_duplicates().itertuples(index=False):
        try:
            known = problems.identify(problem_of({"problem": name, "problem_options": options}))
        except (ValueError, AttributeError):  # not built from names, or without a Jacobian
            continue
        errors = known.to_dict()["standard_errors"]
        worst = {
            f"worst_standard_error_{unit}": max(
                (errors[n] for n, u in zip(known.names, known.units, strict=True) if u == unit and errors[n]),
                default=np.nan,
            )
            for unit in ("mm", "rad")
        }
        rows.append(
            {
                "problem": name, "problem_options": options, "data_id": data, "dimension": known.dimension,
                "rank": known.rank, "condition": known.condition, "finding": known.sentence(), "noise": known.noise,
                "noise_unit": known.noise_unit, **worst,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)
