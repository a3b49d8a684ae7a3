"""Tables 1 to 3 of Pashkevich et al. 2008: what was measured cannot be checked, what follows from it is recomputed."""

from __future__ import annotations

from collections.abc import Iterator
from math import nan

import numpy as np

from calibench.bench.papers.pashkevich2008.fits import HALF, fitted, rms, rms_tolerance, table1, table2
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import NOTHING, Row, Tolerance
from calibench.problems.orthoglide.kinematics import NAMES

_SETS = {"exp1": "exp1", "exp2": "exp2_t1", "exp3": "exp3_t1"}
_FREE = ("full", "rho", "L")


def rows(printed: Printed) -> Iterator[Row]:
    """Yield a row for each cell of Tables 1, 2 and 3."""
    for key, data in _SETS.items():
        yield from _table1(printed, key, data)
    for key, data in (("exp2", "exp2"), ("exp3", "exp3_t2")):
        yield from _table2(printed, key, data)
    for free in _FREE:
        yield from _table3(printed, free)


def _measured(printed: Printed, key: str) -> Row:
    return printed.cell(
        key, NOTHING, Tolerance(nan, "nothing to compare with"), "none: read off a gauge of a real machine"
    )


def _table1(printed: Printed, key: str, data: str) -> Iterator[Row]:
    fit = fitted(data, "rho")
    for name in printed.column(f"table1.{key}"):
        if name != "rms":
            yield _measured(printed, f"table1.{key}.{name}")
            continue
        values = table1(printed, key)
        yield printed.cell(
            f"table1.{key}.rms", rms(values), rms_tolerance(values, 1, fit.slip), "rms of the six deviations above"
        )
    left = np.eye(len(fit.data)) - fit.predictor
    for name in printed.column(f"table1.{key}_expected"):
        cell = f"table1.{key}_expected.{name}"
        if name == "rms":
            values = left @ fit.data
            tolerance = rms_tolerance(values, 1, left @ fit.slip)
            yield printed.cell(cell, rms(values), tolerance, "rms left by the {rho} fit of the six deviations")
            continue
        row = left[fit.labels.index(name)]
        yield printed.cell(
            cell, float(row @ fit.data), fit.tolerance(row, "the cell"), "residual of the {rho} fit, data - model"
        )


def _table2(printed: Printed, key: str, data: str) -> Iterator[Row]:
    taken = table2(printed, key)
    slip = fitted(data, "full").slip
    for name in printed.column(f"table2.{key}"):
        if name != "average":
            yield _measured(printed, f"table2.{key}.{name}")
            continue
        yield printed.cell(
            f"table2.{key}.average", rms(taken), rms_tolerance(taken, 1, slip), "rms of the twelve deviations above"
        )
    for free in _FREE:
        fit = fitted(data, free)
        for name in printed.column(f"table2.{key}_{free}"):
            cell = f"table2.{key}_{free}.{name}"
            if name == "average":
                left = taken - table2(printed, f"{key}_{free}")
                reason = f"the fit itself leaves {rms(fit.data - fit.predictor @ fit.data):.4f}"
                yield printed.cell(
                    cell,
                    rms(left),
                    rms_tolerance(left, 2, fit.slip),
                    "rms of data - column, as read",
                    reason,
                    of_print=True,
                )
                continue
            row = fit.predictor[fit.labels.index(name)]
            yield printed.cell(
                cell, float(row @ fit.data), fit.tolerance(row, "the cell"),
                f"prediction of the linear model fitted to Experiment {key[-1]}",
            )  # fmt: skip


def _table3(printed: Printed, free: str) -> Iterator[Row]:
    fit = fitted("exp2", free)
    key = f"table3.exp2_{free}"
    names = {"full": NAMES, "rho": NAMES[:3], "L": NAMES[3:]}[free]
    column = printed.column(key)
    for name in column:
        if name == "residual":
            left = fit.data - fit.predictor @ fit.data
            yield printed.cell(f"{key}.residual", rms(left), rms_tolerance(left), "rms left by the linear fit")
            continue
        at = names.index(name)
        method, reason = "parameter of the linear fit to Experiment 2", ""
        if free != "full":
            tolerance = Tolerance(0.01, "printed digits are cut off or rounded: one unit of the last")
        else:
            # only rho - L is seen: each alone may be anywhere within what half a digit of the data does to it
            carried = HALF + HALF * float(np.abs(fit.solver[at]).sum())
            tolerance = Tolerance(
                HALF, "half a printed digit; in kind: and of each datum, as the fit carries it", carried
            )
            axis = name[-1]
            rho, long = (names.index(f"{n}_{axis}") for n in ("drho", "dL"))
            ours = float(fit.x[rho] - fit.x[long])
            said = column[f"drho_{axis}"] - column[f"dL_{axis}"]
            reason = f"only rho - L is determined: {said:.2f} printed, {ours:.3f} ours, {ours - said:+.3f} apart"
        yield printed.cell(f"{key}.{name}", float(fit.x[at]), tolerance, method, reason)
