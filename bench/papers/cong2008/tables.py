"""Tables 2, 3, 4, 6 and 7 of Cong et al. 2008: each printed number beside ours, at whatever budget the runs had.

A row is a printed cell and a method: true, printed (as it stands), read (corrected where the print is wrong, and why),
and ours: median and quartiles over n runs, how many failed, restarted, reached the rounding floor and at what cost.
The sampling plans are not published, so values agree in kind (ranking, decades), not in digits.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from calibench.bench.provenance.run_id import canonical, options_of
from calibench.bench.statistics.cells import CELL
from calibench.bench.statistics.summary import QUARTILES, goal_hits, median_of_reached, quantiles
from calibench.problems import constants

_PAPER = "cong2008"
_SCALE = 4 * 244.0**2  # near zero J1 is J2 / (4 l_b^2) where all l_b are 244 mm


def table2(runs: pd.DataFrame) -> pd.DataFrame:
    """Return Table 2, sensor offsets: J1 and J2, three and nine samples, by every method that ran them."""
    cells = [
        (f"table2.{error.lower()}_n{n}", "sensor_zero", {"error": error, "n": n})
        for error in ("J1", "J2")
        for n in (3, 9)
    ]
    return _calibrations(runs, cells)


def table3(runs: pd.DataFrame) -> pd.DataFrame:
    """Return Table 3, offsets and link lengths: J1, J2, J3, by every method that ran them."""
    return _calibrations(runs, [(f"table3.{e.lower()}", "link_length", {"error": e}) for e in ("J1", "J2", "J3")])


def table4(runs: pd.DataFrame) -> pd.DataFrame:
    """Return Table 4, 12 and 11 parameters with J3: the 12 end millimetres off, on the gauge curve; the 11 precise."""
    cells: list[tuple[str, str, dict[str, Any]]] = [
        ("table4.j3_12", "full12", {"error": "J3", "gauge": "ya2"}),
        ("table4.j3_11", "full11", {"error": "J3", "paper_section": 3}),
    ]
    return _calibrations(runs, cells)


def table6(runs: pd.DataFrame) -> pd.DataFrame:
    """Return Table 6: the best J1, J2, J3 that GA, PSO and DE reach, and J1 brought to the scale of J2."""
    rows = []
    for method in ("ga", "pso", "de"):
        column = constants.column(_PAPER, f"table6.{method}")
        for error in ("J1", "J2", "J3"):
            mine = runs_of(runs[runs["optimizer"] == method], "full12", {"error": error, "gauge": "xa2"})
            printed = column.entries[error.lower()]
            for key, cell in mine.groupby(CELL, sort=False, dropna=False):
                line = dict(zip(CELL, key, strict=True))
                for scale, quantity, unit in ((1.0, error, printed.unit), (_SCALE, "J1 x 4 l_b^2", "mm^4")):
                    if scale == 1.0 or error == "J1":
                        rows.append(
                            {
                                "table": column.key, **_of(line), "quantity": quantity,
                                "unit": unit, "printed": printed.printed * scale, "read": printed.value * scale,
                                "why": printed.why or printed.doubt, **_spread(scale * cell["best_value"]),
                                **_course(cell),
                            }
                        )  # fmt: skip
    return pd.DataFrame(rows)


def table7(runs: pd.DataFrame) -> pd.DataFrame:
    """Return Table 7: DE's 12 parameters under J3, ours raw and moved along the gauge onto the truth."""
    chosen = runs[runs["optimizer"] == "de"]
    return _calibrations(chosen, [("table7.de_j3", "full12", {"error": "J3", "gauge": "xa2"})])


TABLES = {"table2": table2, "table3": table3, "table4": table4, "table6": table6, "table7": table7}


def _calibrations(runs: pd.DataFrame, cells: list[tuple[str, str, dict[str, Any]]]) -> pd.DataFrame:
    rows = []
    for key, problem, options in cells:
        column = constants.column(_PAPER, key)
        actual = constants.column(_PAPER, f"{key.partition('.')[0]}.actual")
        mine = runs_of(runs, problem, options)
        for names, cell in mine.groupby(CELL, sort=False, dropna=False):
            line = dict(zip(CELL, names, strict=True))
            course, ours = _course(cell), _ours(cell)
            for quantity, entry in column.entries.items():
                if quantity not in ours:
                    continue
                rows.append(
                    {
                        "table": key, **_of(line), "quantity": quantity, "unit": entry.unit,
                        "true": actual.get(quantity), "printed": entry.printed, "read": entry.value,
                        "why": entry.why or entry.doubt, **_spread(ours[quantity]), **course,
                    }
                )  # fmt: skip
            scale = _SCALE if options["error"] == "J1" else 1.0
            extra = {"best J as mm^4": (scale * cell["best_value"], "mm^4", "not in print: J1 as J1 x 4 l_b^2")}
            if problem == "full12":
                why = "not in print: what is left after the gauge is taken out"
                extra |= {"kmrmse_aligned": (cell["kmrmse_aligned"], "mm", why)}
                extra |= {"gauge_phi": (cell["gauge_phi"], "rad", "not in print: where on the gauge curve it ended")}
            for quantity, (values, unit, why) in extra.items():
                rows.append(
                    {
                        "table": key, **_of(line), "quantity": quantity, "unit": unit,
                        "true": 0.0, "printed": np.nan, "read": np.nan, "why": why, **_spread(values), **course,
                    }
                )  # fmt: skip
    return pd.DataFrame(rows)


def _ours(cell: pd.DataFrame) -> dict[str, pd.Series]:
    """Return our values of the quantities that print may have; a row holds no such thing as iterations."""
    known = {"kmrmse": cell["kmrmse"]}
    answered = cell[cell["parameter_values"].notna()]
    if answered.empty:
        return known
    values = pd.DataFrame(
        [list(each) for each in answered["parameter_values"]], columns=answered["parameter_names"].iloc[0]
    )
    return {str(name): values[name] for name in values} | known


def runs_of(runs: pd.DataFrame, problem: str, options: Mapping[str, Any]) -> pd.DataFrame:
    """Return the runs of `problem` with these options and all others as they are by default: no noise, its own plan."""
    from calibench import problems

    wanted = json.loads(canonical(options_of(problems.make(problem, **options))))

    def fits(row: str) -> bool:
        have = json.loads(row)
        return all(have.get(key, value) == value for key, value in wanted.items())

    mine = runs[runs["problem"] == problem]
    return mine[mine["problem_options"].map(fits).astype(bool)]


def _of(line: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the columns that say which runs a row is of; `_course` has the budget."""
    return {
        "method": line["optimizer"], "options": line["optimizer_options"], "start": line["start"],
        "target": line["target"],
    }  # fmt: skip


def _spread(values: pd.Series) -> dict[str, float]:
    """Return median and quartiles over the runs that have the quantity; a best value that was not found is infinite."""
    numbers = values.to_numpy(dtype=float)
    numbers = numbers[~np.isnan(numbers)]
    if not numbers.size:
        return {"median": np.nan, "q1": np.nan, "q3": np.nan, "n": 0}
    q1, median, q3 = quantiles(numbers, QUARTILES)
    return {"median": float(median), "q1": float(q1), "q3": float(q3), "n": int(numbers.size)}


def _course(cell: pd.DataFrame) -> dict[str, Any]:
    reached = goal_hits(cell)
    return {
        "budget": int(cell["budget"].iloc[0]),
        "failed": int((cell["status"] == "failed").sum()),
        "restarts": int(cell["restarts"].sum()),
        "reached": int(np.isfinite(reached).sum()),
        "charged_to_target": median_of_reached(reached),
    }
