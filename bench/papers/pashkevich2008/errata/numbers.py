"""Misprinted numbers of Pashkevich et al. 2008, in its tables and its text, each recomputed from the printed data."""

from __future__ import annotations

from collections.abc import Callable
from math import nan

import numpy as np

from calibench.bench.papers.evidence import Array
from calibench.bench.papers.pashkevich2008.fits import (
    Fit,
    accuracy,
    fitted,
    rms,
    rms_tolerance,
    table1,
    table2,
    table2_differences,
)
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import NOTHING, Row, Tolerance

_ROUNDING = Tolerance(1e-9, "rounding")
_ROUNDED = Tolerance(0.015, "half a digit of three printed numbers")
Shown = Callable[[Printed, int], Row]


def parameter_error(printed: Printed, number: int) -> Row:
    """Return the row of the factor of ten in the accuracy."""
    said, read = printed.column("text.section34").entries["parameter_error"].printed, printed.read(number)
    return printed.erratum(
        number, "standard error of the offsets", "mm", said, read, accuracy(printed, True),
        Tolerance(0.005, "half a digit of what to read"), "(12) with (14) at the printed angles",
    )  # fmt: skip


def slip(data: str, free: str, column: Callable[[Printed], Array]) -> Shown:
    """Return the row of a datum that is found from what is printed of the fit to it."""

    def show(printed: Printed, number: int) -> Row:
        as_printed, repaired = fitted(data, free), fitted(data, free, repaired=True)
        at = int(np.flatnonzero(as_printed.slip)[0])
        label = as_printed.labels[at]
        found, digit = as_printed.datum_behind(label, column(printed), as_printed.data)
        return printed.erratum(
            number, f"the datum {label}", "mm", float(as_printed.data[at]), float(repaired.data[at]),
            found, Tolerance(min(digit, abs(float(as_printed.slip[at])) / 2), "half the way between the two readings"),
            f"solved from the printed results of the {free} fit, all other data as printed",
            differs="the cell is a reading; what the printed fits need it to be is asked here",
        )  # fmt: skip

    return show


def expected1(printed: Printed) -> Array:
    """Return the residuals printed of Experiment 1 in Table 1."""
    return table1(printed, "exp1_expected")


def expected3(printed: Printed) -> Array:
    """Return the predictions of the full set printed of Experiment 3 in Table 2."""
    return table2(printed, "exp3_full")


def sign(data: str, free: str, key: str, name: str) -> Shown:
    """Return how to make the row of a sign that is lost in print."""

    def show(printed: Printed, number: int) -> Row:
        fit: Fit = fitted(data, free)
        entry = printed.column(f"table2.{key}").entries[name]
        row = fit.predictor[fit.labels.index(name)]
        return printed.erratum(
            number, name, "mm", entry.printed, entry.value, float(row @ fit.data), fit.tolerance(row, "the cell"),
            "prediction of the linear model fitted to the data as printed",
        )  # fmt: skip

    return show


def average3(printed: Printed, number: int) -> Row:
    """Return the row of the Average that is none."""
    entry = printed.column("table2.exp3_full").entries["average"]
    fit = fitted("exp3_t2", "full", repaired=True)
    left = fit.data - fit.predictor @ fit.data
    return printed.erratum(
        number, "rms left by the full fit if the datum x_z_minus is -.13", "mm", entry.printed, entry.value, rms(left),
        rms_tolerance(left), "linear fit of the repaired data",
        differs="here the datum is read as -.13, in the cell's row as printed",
    )  # fmt: skip


def two_sets(key: str, data: str, name: str) -> Shown:
    """Return how to make the row that asks Table 1's own fit which difference `name` it was made of.

    Its printed residuals know: had they come from Table 2's readings, ours would be what Table 2 has.
    """

    def show(printed: Printed, number: int) -> Row:
        six, said = fitted("exp1", "rho"), table1(printed, key)
        found, within = six.datum_behind(name, table1(printed, f"{key}_expected"), said)
        other = table2_differences()[data][name]
        return printed.erratum(
            number, f"{name}, Max minus Min: printed in Table 1; read off Table 2; ours from Table 1's residuals", "mm",
            float(said[six.labels.index(name)]), other, found,
            Tolerance(within, "half a printed digit of each residual and of each other datum, as the fit carries it"),
            "solved from the printed residuals of the rho fit, all other differences as printed in Table 1",
            differs="the cell is a reading; what the printed fits need it to be is asked here",
        )  # fmt: skip

    return show


def heads(printed: Printed, number: int) -> Row:
    """Return the row of the heads of Table 2."""
    column, fit = table2(printed, "exp2_full"), fitted("exp2", "full")
    residuals = fit.data - fit.predictor @ fit.data
    wrong, right = (float(np.abs(column - v).max()) for v in (residuals, fit.predictor @ fit.data))
    return printed.erratum(
        number, "largest distance of the column from residuals (printed) and from predictions", "mm", wrong, 0.0, right,
        _ROUNDED, "Table 2, Experiment 2, full set, beside the linear fit",
    )  # fmt: skip


def less_than(printed: Printed, number: int) -> Row:
    """Return the row of 'less than 0.62 mm'."""
    values = table1(printed, "exp2")
    said, read = (
        printed.column("text.experiment2").entries["deviations_below"].printed,
        abs(printed.column("table1.exp2")["z_x"]),
    )
    return printed.erratum(
        number, "largest deviation of Table 1, Measurements #2", "mm", said, read, float(np.abs(values).max()),
        _ROUNDING, f"largest of the six; their rms is {rms(values):.2f}",
    )  # fmt: skip


def maximum(printed: Printed, number: int) -> Row:
    """Return the row of the largest deviation after the adjustment."""
    ours = float(np.abs(table2(printed, "exp3")).max())
    said = printed.column("text.experiment3").entries["largest_after"].printed
    return printed.erratum(
        number, "largest deviation of Experiment 3", "mm", said, abs(printed.column("table2.exp3")["z_y_minus"]), ours,
        _ROUNDING, "largest of the twelve, Table 2",
    )  # fmt: skip


def full_residual(printed: Printed, number: int) -> Row:
    """Return the row of a residual below the least possible."""
    fit = fitted("exp2", "full")
    left = fit.data - fit.predictor @ fit.data
    said = printed.column("table3.exp2_full")["residual"]
    return printed.erratum(
        number, "least rms that six parameters leave in Experiment 2", "mm", said, said, rms(left), rms_tolerance(left),
        "linear fit of the full set",
    )  # fmt: skip


def resolution(printed: Printed, number: int) -> Row:
    """Return the row of whose resolution .01 mm is."""
    said = printed.column("text.experiment1")["encoder_resolution"]
    ours = printed.column("text.section41")["indicator_resolution"] / 1000
    return printed.erratum(
        number, "resolution of the indicators; that of the encoders is not given", "mm", said, said, ours,
        Tolerance(1e-12, "a given number"), "section 4.1",
    )  # fmt: skip


def section_numbers(printed: Printed, number: int) -> Row:
    """Return the row of numbers of which no quantity depends."""
    return printed.erratum(
        number, "section numbers: notation only", "1", nan, nan, NOTHING,
        Tolerance(nan, "nothing to compare with"), "none: no quantity depends on it",
    )  # fmt: skip
