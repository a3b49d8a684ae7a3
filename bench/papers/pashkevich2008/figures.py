"""Tables 1 to 3 of Pashkevich et al. 2008, and the figure of what calibration leaves of the measured deviations.

What was measured cannot be checked; what follows from it is recomputed.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from calibench import problems
from calibench.bench.papers.ledger import Printed, Row, Tolerance
from calibench.bench.papers.pashkevich2008.machine import HALF, fitted, rms, rms_row, rms_tolerance, table1, table2
from calibench.bench.report.shared.drawing import COLOURS, Drawing, new_figure
from calibench.bench.report.study.additions import AddedFigure, Addition
from calibench.bench.statistics.names import options_seen
from calibench.problems.orthoglide.kinematics import NAMES

DATA = {"exp2": "Experiment 2", "exp3_t2": "Experiment 3 (Table 2)"}
_FREE = ("full", "rho", "L")
_MEASURED = "none: read off a gauge of a real machine"


def orthoglide_residuals(runs: pd.DataFrame, _: pd.DataFrame) -> Drawing:
    """Draw the Orthoglide's deviations of Experiments 2 and 3 before and after calibration, a panel a parameter set."""
    seen = options_seen(runs, "orthoglide6", "data")
    data_sets = [name for name in DATA if name in seen]
    rows = []
    for data in data_sets:
        for free in _FREE:
            p: Any = problems.make("orthoglide6", data=data, free=free)
            before, residuals = p.deviations, -p.residuals(p.best)  # residuals are modelled minus measured
            for reading, old, new in zip(p.plan, before, residuals, strict=True):
                rows.append({"data": data, "free": free, "row": reading.label, "before": old, "left": new})
    table = pd.DataFrame(rows)
    with new_figure(10.4, 0.2 + 2.6 * len(data_sets)) as figure:
        for axes, data in zip(np.atleast_1d(figure.subplots(len(data_sets), 1)), data_sets, strict=True):
            mine = table[table["data"] == data]
            names = list(dict.fromkeys(mine["row"]))
            place = np.arange(len(names))
            bars = [("before", mine.loc[mine["free"] == "full", "before"], "0.75", "")]
            for colour, hatch, free in zip(COLOURS, ("", "////", "...."), _FREE, strict=False):
                bars.append((f"after {free}", mine.loc[mine["free"] == free, "left"], colour, hatch))
            for k, (label, values, colour, hatch) in enumerate(bars):
                axes.bar(
                    place + 0.2 * (k - 1.5), values, 0.2, color=colour, hatch=hatch, edgecolor="white", linewidth=0,
                    label=f"{label}: rms {float(np.sqrt((values**2).mean())):.3f} mm",
                )  # fmt: skip
            axes.axhline(0, color="0.3", lw=0.6)
            axes.set_xticks(place, names, fontsize=8)
            axes.set(ylabel="deviation [mm]", title=DATA[data])
            axes.legend(fontsize=7.5, ncols=4, loc="lower center", bbox_to_anchor=(0.5, -0.28))
    return figure, table


def rows(printed: Printed) -> Iterator[Row]:
    """Yield a row for each cell of Tables 1, 2 and 3."""
    for key, data in (("exp1", "exp1"), ("exp2", "exp2_t1"), ("exp3", "exp3_t1")):
        fit = fitted(data, "rho")
        for name in printed.column(f"table1.{key}"):
            if name != "rms":
                yield printed.unknown(f"table1.{key}.{name}", method=_MEASURED)
                continue
            how = "rms of the six deviations above"
            yield rms_row(printed, f"table1.{key}.rms", table1(printed, key), how, fit.slip)
        maker = fit.residual_maker
        for name in printed.column(f"table1.{key}_expected"):
            cell = f"table1.{key}_expected.{name}"
            if name == "rms":
                how = "rms left by the {rho} fit of the six deviations"
                yield rms_row(printed, cell, maker @ fit.data, how, maker @ fit.slip)
                continue
            row, how = maker[fit.labels.index(name)], "residual of the {rho} fit, data - model"
            yield printed.cell(cell, float(row @ fit.data), fit.tolerance(row, "the cell"), how)
    for key, data in (("exp2", "exp2"), ("exp3", "exp3_t2")):
        yield from _table2(printed, key, data)
    for free in _FREE:
        fit, key = fitted("exp2", free), f"table3.exp2_{free}"
        names = {"full": NAMES, "rho": NAMES[:3], "L": NAMES[3:]}[free]
        column = printed.column(key)
        for name in column:
            if name == "residual":
                yield rms_row(printed, f"{key}.residual", fit.residuals, "rms left by the linear fit")
                continue
            at, reason = names.index(name), ""
            tolerance = Tolerance(0.01, "printed digits are cut off or rounded: one unit of the last")
            if free == "full":
                # only rho - L is seen: each alone may be anywhere within what half a digit of the data does to it
                tolerance = Tolerance(
                    HALF, "half a printed digit; in kind: and of each datum, as the fit carries it",
                    HALF + HALF * float(np.abs(fit.solver[at]).sum()),
                )  # fmt: skip
                rho, long = f"drho_{name[-1]}", f"dL_{name[-1]}"
                ours, difference = float(fit.x[names.index(rho)] - fit.x[names.index(long)]), column[rho] - column[long]
                apart = ours - difference
                reason = f"only rho - L is determined: {difference:.2f} printed, {ours:.3f} ours, {apart:+.3f} apart"
            method = "parameter of the linear fit to Experiment 2"
            yield printed.cell(f"{key}.{name}", float(fit.x[at]), tolerance, method, reason=reason)


def _table2(printed: Printed, key: str, data: str) -> Iterator[Row]:
    taken = table2(printed, key)
    for name in printed.column(f"table2.{key}"):
        if name != "average":
            yield printed.unknown(f"table2.{key}.{name}", method=_MEASURED)
            continue
        slip = fitted(data, "full").slip
        yield rms_row(printed, f"table2.{key}.average", taken, "rms of the twelve deviations above", slip)
    for free in _FREE:
        fit = fitted(data, free)
        for name in printed.column(f"table2.{key}_{free}"):
            cell = f"table2.{key}_{free}.{name}"
            if name == "average":
                residuals = taken - table2(printed, f"{key}_{free}")
                yield printed.cell(
                    cell, rms(residuals), rms_tolerance(residuals, 2, fit.slip), "rms of data - column, as read",
                    reason=f"the fit itself leaves {rms(fit.residuals):.4f}", of_print=True,
                )  # fmt: skip
                continue
            row = fit.predictor[fit.labels.index(name)]
            yield printed.cell(
                cell, float(row @ fit.data), fit.tolerance(row, "the cell"),
                f"prediction of the linear model fitted to Experiment {key[-1]}",
            )  # fmt: skip


ADDITION = Addition(
    figures=(
        AddedFigure(
            "orthoglide_residuals", "The Orthoglide's measured deviations before and after calibration",
            lambda runs: not options_seen(runs, "orthoglide6", "data").isdisjoint(DATA), orthoglide_residuals,
        ),
    )
)  # fmt: skip
