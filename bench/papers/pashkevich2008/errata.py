"""The errata of Pashkevich et al. 2008, each with the computation that shows it.

For a formula, `printed` is the number that the printed formula gives, `read` the number it must give, and ours what the
corrected formula gives. A new erratum in the data file without its computation here is an error.

Misprinted formulas of Pashkevich et al. 2008: what each gives as printed, and as it must be.

Misprinted numbers of Pashkevich et al. 2008, in its tables and its text, each recomputed from the printed data.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import nan

import numpy as np

from calibench.bench.papers.pashkevich2008.machine import (
    Fit,
    accuracy,
    closure,
    direct_roots,
    fitted,
    rms,
    rms_tolerance,
    table1,
    table2,
    table2_differences,
)
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import NOTHING, Array, Row, Tolerance
from calibench.bench.papers.row import problem as make_problem
from calibench.problems.orthoglide.kinematics import calibration_matrix, direct_kinematics, geometry, inverse_kinematics

_ROUNDED = Tolerance(0.015, "half a digit of three printed numbers")


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


_COUNT = Tolerance(0.0, "a count")
_ROUNDING = Tolerance(1e-9, "rounding")


def equation_1(printed: Printed, number: int) -> Row:
    """Return the row of (1), which counts the leg twice."""
    length = geometry().length
    ours = float(np.abs(direct_kinematics(np.full((1, 3), length))[0]).max())
    return printed.erratum(
        number, "p_x at Zero, less e", "mm", length + length, 0.0, ours, _ROUNDING,
        "(1) as printed, rho = L and zero angles, and direct kinematics by (2)",
    )  # fmt: skip


def root(printed: Printed, number: int) -> Row:
    """Return the row of the root of (4)."""
    rho = np.full(3, geometry().length)
    values = [float(direct_roots(rho, sign)[0]) for sign in (1.0, -1.0)]
    return printed.erratum(
        number, "p_x at Zero by (4)", "mm", values[0], 0.0, values[1], _ROUNDING, "(4) with either root at rho = L"
    )


def first_row(printed: Printed, number: int) -> Row:
    """Return the row of the first right-hand side of (11)."""
    exact = make_problem("orthoglide6", data="exp2", free="full", model="exact")
    labels = [r.label for r in exact.plan]
    slopes = exact.jacobian(np.zeros(6))
    off = [float(np.abs(slopes[labels.index(name)] - calibration_matrix()[0]).max()) for name in ("x_y-", "x_y+")]
    return printed.erratum(
        number, "largest distance of row 1 of (11) from the exact model's derivative of its right-hand side", "1",
        off[0], 0.0, off[1], _ROUNDING, "Jacobian of the exact model for x_y^- and for x_y^+",
    )  # fmt: skip


def angles(printed: Printed, number: int) -> Row:
    """Return the row of the angles at the ends of the strokes."""
    said = printed.column("text.section34").entries["alpha_1"].printed
    length = geometry().length
    solved = float(length * np.sin(geometry().alpha_plus))
    return printed.erratum(
        number, "stroke that the larger angle belongs to", "mm", float(length * np.sin(np.radians(said))),
        printed.column("geometry")["stroke_plus"], solved, _ROUNDING, "L sin(alpha) at 11.0 and at 11.151 degrees",
    )  # fmt: skip


def limits(printed: Printed, number: int) -> Row:
    """Return the row of the joint limits, which are displacements."""
    column, length = printed.column("text.section23"), geometry().length
    return printed.erratum(
        number, "distance of Zero, rho = L, from the upper limit of the joints", "mm", column["rho_max"] - length,
        column["rho_max"], column["rho_max"] - (length - length), _ROUNDING,
        "rho_max - rho as printed and rho_max - (rho - L); below 0 is outside",
    )  # fmt: skip


def signs(printed: Printed, number: int) -> Row:
    """Return the row of the signs s of (3)."""
    position = np.array([[20.0, -30.0, 10.0]])
    rho = inverse_kinematics(position)[0]
    ours = np.sign(rho - position[0])
    return printed.erratum(
        number, "s at a pose of the workspace", "1", float(np.sign(position[0] - position[0])[0]), 1.0, ours, _COUNT,
        "sign of p - p and of rho - p at (20, -30, 10) mm",
    )  # fmt: skip


def pairs(printed: Printed, number: int) -> Row:
    """Return the row of the sums of A, B and C."""
    rho = np.full(3, geometry().length)
    wrong = float(direct_roots(rho, -1.0, pairs=2)[0])
    ordinary = inverse_kinematics(np.array([[20.0, -30.0, 10.0]]))[0]
    right = closure(direct_roots(ordinary, -1.0), ordinary)
    return printed.erratum(
        number, "error of the pose by (4): p_x at Zero with every ordered pair, else by how much (2) fails", "mm",
        wrong, 0.0, right, _ROUNDING, "(4) with A over ordered pairs at Zero, and over i < j at (20, -30, 10) mm",
    )  # fmt: skip


def alpha(printed: Printed, number: int) -> Row:
    """Return the row of what alpha is the angle to."""
    length, stroke = geometry().length, geometry().stroke_plus
    joint = inverse_kinematics(np.array([[stroke, 0.0, 0.0]]))[0][1]
    leg = np.array([stroke, -joint, 0.0]) / length
    to_x, to_own = (float(np.degrees(np.arccos(c))) for c in (abs(leg[0]), abs(leg[1])))
    alpha = float(np.degrees(geometry().alpha_plus))
    return printed.erratum(
        number, "angle of the y-leg at XMax to the X-axis (printed) and to its own", "deg", to_x, alpha, to_own,
        _ROUNDING, "direction of the y-leg by (2)",
    )  # fmt: skip


def which_model(printed: Printed, number: int) -> Row:
    """Return the row of the model that (11) comes from."""
    length = geometry().length
    rho = np.full(3, length)
    as_printed = np.full(3, 2 * length)
    at_zero = direct_kinematics(rho[None])[0]
    return printed.erratum(
        number, "by how much the legs do not close at Zero", "mm", closure(as_printed, rho), 0.0,
        closure(at_zero, rho), _ROUNDING, "legs of the tool centre point of (1), as printed, and of (2)",
    )  # fmt: skip


Shown = Callable[[Printed, int], Row]


def rows(printed: Printed) -> Iterator[Row]:
    """Yield a row for each erratum of the data file. Raises `ValueError` for one without a computation."""
    for (number, place), (where, show) in zip(printed.errata(), _SHOWN, strict=True):
        if place != where:
            raise ValueError(f"erratum {number + 1} is at {place!r}: its computation is for {where!r}")
        yield show(printed, number)


_SHOWN: tuple[tuple[str, Shown], ...] = (
    ("equation (1)", equation_1),
    ("section 2.4, after equation (4)", root),
    ("equation (11), first right-hand side", first_row),
    ("section 3.4, after equation (14), angles", angles),
    ("section 3.4, after equation (14), errors of the parameters", parameter_error),
    ("Table 1, Measurements #1, x_z", slip("exp1", "rho", expected1)),
    ("Table 2, Experiment 2, {Delta rho, Delta L}, z_y_plus", sign("exp2", "full", "exp2_full", "z_y_plus")),
    ("Table 2, Experiment 2, {Delta rho}, y_z_minus", sign("exp2", "rho", "exp2_rho", "y_z_minus")),
    ("Table 2, Experiment 2, {Delta L}, z_x_plus", sign("exp2", "L", "exp2_L", "z_x_plus")),
    ("Table 2, Experiment 3, {Delta L}, z_x_plus", sign("exp3_t2", "L", "exp3_L", "z_x_plus")),
    ("Table 2, Experiment 3, 'Average' of {Delta rho, Delta L}", average3),
    ("Tables 1 and 2, Experiment 3", two_sets("exp3", "exp3_t2", "z_y")),
    ("Tables 1 and 2, Experiment 2", two_sets("exp2", "exp2", "x_y")),
    ("Table 2, heads 'Residuals' and 'Expected improvement'", heads),
    ("section 4.2, Experiment #2", less_than),
    ("section 4.2, Experiment #3", maximum),
    ("Table 2, Experiment 3, 'Exper. data', x_z_minus", slip("exp3_t2", "full", expected3)),
    ("Tables 2 and 3 and section 4.2, residual of the full set in Experiment 2", full_residual),
    ("section 2.3, after (2)", limits),
    ("section 2.4, after (3)", signs),
    ("section 2.4, after (4), A, B and C", pairs),
    ("section 2.4 (second), before (8)", alpha),
    ("section 3.2, after (11)", which_model),
    ("section 4.2, Experiment #1", resolution),
    ("section numbers", section_numbers),
)
