"""Tables from results: each returns its DataFrame."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from calibench import problems
from calibench.bench.statistics import ranking
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM
from calibench.bench.statistics.summary import QUARTILES, quantiles, summary
from calibench.problems.base import parameters_of

PrintedValues = Callable[[str, Any], Mapping[str, float]]  # of a problem's name and the problem: parameter -> value


def problem_of(row: Mapping[str, Any] | pd.Series) -> Any:
    """Return the problem a row was made with. Raises `ValueError` where it cannot be built again here."""
    options = {k: v for k, v in json.loads(row["problem_options"]).items() if v is not None}
    return problems.make(row["problem"], **options)


def _nothing_printed(name: str, problem: Any) -> Mapping[str, float]:
    return {}


def calibrated(runs: pd.DataFrame, printed_values: PrintedValues = _nothing_printed) -> pd.DataFrame:
    """Return calibrated values against the truth: a row for each cell (`bench.statistics.cells`) and parameter.

    Columns: those of a cell, parameter, unit, true, start_value, printed (a published result for this problem, by
    `printed_values`; NaN where there is none), and ours: median, q1, q3 over the runs that have an answer, worst error,
    n of them.
    """
    rows = []
    for key, cell in runs.groupby(CELL, sort=False, dropna=False):
        names = dict(zip(CELL, key, strict=True))
        found = cell[cell["parameter_values"].notna()]
        try:
            problem = problem_of(found.iloc[0])
        except (ValueError, IndexError):  # a user's own problem, or no answer at all
            continue
        if getattr(problem, "parameters", None) is None:
            continue
        values = np.array([list(v) for v in found["parameter_values"]])
        printed = printed_values(str(names["problem"]), problem)
        for i, p in enumerate(parameters_of(problem)):
            column = values[:, i]
            q1, median, q3 = quantiles(column, QUARTILES)
            rows.append(
                names
                | {
                    "parameter": p.name, "unit": p.unit, "true": np.nan if p.true is None else p.true,
                    "start_value": p.start, "printed": printed.get(p.name, np.nan), "median": median,
                    "q1": q1, "q3": q3,
                    "worst_error": np.nan if p.true is None else float(np.abs(column - p.true).max()), "n": len(column),
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def overview(runs: pd.DataFrame, costs: Iterable[Mapping[str, Any]] = ()) -> pd.DataFrame:
    """Return a field of methods, best first: a row for each cell (`bench.statistics.cells`), a method's together.

    Columns: of the method over all tasks (`bench.statistics.ranking`) rank, solved, mean_place, tasks, of_tasks; of
    the cell optimizer, options, problem, error, problem_options, data_id, dimension, start, budget, target, goal,
    place (within the task, ties share their mean), runs, failed, timeouts, reached, success, charged_to_target (median
    over those that reached it), best_median, parameter_error_mm (aligned, median), cpu_s (median), outside_box; with
    `costs` (`bench.sweep.costs`) objective_s_median and objective_s_to_target.
    """
    cells = summary(runs, costs)
    cells["place"] = ranking.places(cells)
    more = [
        {
            "error": json.loads(cell["problem_options"].iloc[0]).get("error", ""),
            "dimension": int(cell["dimension"].iloc[0]),
            "timeouts": int((cell["status"] == "timeout").sum()),
            "parameter_error_mm": float(cell["parameter_error_mm_aligned"].median()),
            "cpu_s": float(cell["cpu_s"].median()),
            "outside_box": int((~cell["inside_box"].fillna(True).astype(bool)).sum()),  # of published runs unknown
        }
        for _, cell in runs.groupby(CELL, sort=False, dropna=False)
    ]
    cells["failed"] -= [row["timeouts"] for row in more]  # told apart here
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

    Columns: problem, problem_options, data_id, dimension, rank, condition, finding (a sentence),
    worst_standard_error_mm and _rad at the problem's typical `noise` (`noise_unit` a reading) over the parameters that
    can be found.
    """
    rows = []
    for (name, options, data), cell in runs.groupby(PROBLEM, sort=False, dropna=False):
        try:
            found = problems.identify(problem_of(cell.iloc[0]))
        except (ValueError, AttributeError):  # not built from names, or without a Jacobian
            continue
        errors = found.to_dict()["standard_errors"]
        worst = {
            f"worst_standard_error_{unit}": max(
                (errors[n] for n, u in zip(found.names, found.units, strict=True) if u == unit and errors[n]),
                default=np.nan,
            )
            for unit in ("mm", "rad")
        }
        rows.append(
            {
                "problem": name, "problem_options": options, "data_id": data, "dimension": found.dimension,
                "rank": found.rank, "condition": found.condition, "finding": found.sentence(), "noise": found.noise,
                "noise_unit": found.noise_unit, **worst,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)
