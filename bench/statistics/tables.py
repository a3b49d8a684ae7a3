"""Tables from results: each returns its DataFrame, printed values beside ours."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from calibench import problems
from calibench.bench.statistics import ranking
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM
from calibench.bench.statistics.summary import QUARTILES, quantiles, summary
from calibench.problems import constants
from calibench.problems.base import parameters_of

_PAPER = "cong2008"


def problem_of(row: Mapping[str, Any] | pd.Series) -> Any:
    """Return the problem a row was made with. Raises `ValueError` where it cannot be built again here."""
    options = {k: v for k, v in json.loads(row["problem_options"]).items() if v is not None}
    return problems.make(row["problem"], **options)


def calibrated(runs: pd.DataFrame) -> pd.DataFrame:
    """Return calibrated values against the truth: a row for each cell (`bench.statistics.cells`) and parameter.

    Columns: those of a cell, parameter, unit, true, start_value, printed (the paper's result for this problem and error
    function where it prints one), and ours: median, q1, q3 over the runs that have an answer, worst error, n of them.
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
        printed = _printed(str(names["problem"]), problem)
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
            "outside_box": int((~cell["inside_box"].astype(bool)).sum()),
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


def gauge_points(paper: str = _PAPER) -> pd.DataFrame:
    """Return the printed 12-parameter columns of Tables 4 and 7 on their gauge curve, a row for each parameter.

    phi is fitted over the cells that are printed right; columns: table, held, phi, scale, parameter, printed, read,
    curve, misfit_mm (angles times a link length), misprint.
    """
    from scipy.optimize import least_squares

    rows = []
    cases = (("table4.j3_12", problems.full12(gauge="ya2")), ("table7.de_j3", problems.full12(gauge="xa2")))
    for key, problem in cases:
        column = constants.column(paper, key)
        names = [p.name for p in problem.parameters]
        arms = np.array([244.0 if p.unit == "rad" else 1.0 for p in problem.parameters])
        read = np.array([column[name] for name in names])
        sound = np.array([not column.entries[name].is_misprint for name in names])
        fit = sound & np.array([p.unit == "mm" for p in problem.parameters])  # angles are printed to 1e-4 only
        curve = problem.gauge_curve

        def misfit(phi: Any, curve: Any = curve, read: Any = read, fit: Any = fit) -> Any:
            return (curve(float(phi[0])) - read)[fit]

        phi = float(least_squares(misfit, [0.0], method="lm", xtol=1e-15, ftol=1e-15).x[0])
        on_curve = curve(phi)
        scale = float(on_curve[names.index("lb1")] / curve(0.0)[names.index("lb1")])
        for i, name in enumerate(names):
            entry = column.entries[name]
            rows.append(
                {
                    "table": key, "held": problem.options["gauge"], "phi": phi, "scale": scale, "parameter": name,
                    "printed": entry.printed, "read": entry.value, "curve": float(on_curve[i]),
                    "misfit_mm": float((read[i] - on_curve[i]) * arms[i]), "misprint": entry.is_misprint,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def _printed(name: str, problem: Any) -> dict[str, float]:
    """Return the paper's calibrated values for this problem and error function, corrected for misprints."""
    options = getattr(problem, "options", {})  # a user's own has none, and no printed values
    error = str(options.get("error", "")).lower()
    section3 = options.get("gauge") == "ya2" or options.get("paper_section") == 3
    if name == "sensor_zero":
        key = f"table2.{error}_n{options['n']}"
    elif name == "link_length":
        key = f"table3.{error}"
    elif name in ("full11", "full12") and section3:
        key = f"table4.{error}_{name[-2:]}"
    elif name == "full12":
        key = f"table7.de_{error}"
    else:
        return {}
    try:
        column = constants.column(_PAPER, key)
    except KeyError:
        return {}
    return {quantity: column[quantity] for quantity in column}
