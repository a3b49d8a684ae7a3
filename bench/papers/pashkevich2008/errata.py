"""The errata of Pashkevich et al. 2008, each with the computation that shows it, beside its place in the data file.

For a formula, `printed` is the number that the printed formula gives, `read` the number it must give, and ours what the
corrected formula gives. A new erratum in the data file without its computation here is an error.
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
from calibench.bench.papers.published import Printed, Shown
from calibench.bench.papers.row import Array, Row, Tolerance
from calibench.bench.papers.row import problem as make_problem
from calibench.problems.orthoglide.kinematics import calibration_matrix, direct_kinematics, geometry, inverse_kinematics

_ROUNDED = Tolerance(0.015, "half a digit of three printed numbers")
_COUNT = Tolerance(0.0, "a count")
_ROUNDING = Tolerance(1e-9, "rounding")
Show = Callable[[Printed], Shown]
_SHOWN: dict[str, Show] = {}


def rows(printed: Printed) -> Iterator[Row]:
    """Yield a row for each erratum of the data file. Raises `KeyError` for one without a computation."""
    for place in printed.errata():
        yield printed.erratum(place, _SHOWN[place](printed))


def _shows(place: str) -> Callable[[Show], Show]:
    def enter(show: Show) -> Show:
        _SHOWN[place] = show
        return show

    return enter


@_shows("section 3.4, after equation (14), errors of the parameters")
def parameter_error(printed: Printed) -> Shown:
    as_printed, read = (
        printed.column("text.section34").entries["parameter_error"].printed,
        printed.to_read("section 3.4, after equation (14), errors of the parameters"),
    )
    return Shown(
        quantity="standard error of the offsets", unit="mm", printed=as_printed, read=read,
        ours=accuracy(printed, True), tolerance=Tolerance(0.005, "half a digit of what to read"),
        method="(12) with (14) at the printed angles",
    )  # fmt: skip


def slip(printed: Printed, data: str, free: str, table: Callable[[Printed, str], Array], key: str) -> Shown:
    """Return what shows a datum that is found from what is printed of the fit to it."""
    as_printed, repaired = fitted(data, free), fitted(data, free, repaired=True)
    at = int(np.flatnonzero(as_printed.slip)[0])
    label = as_printed.labels[at]
    datum, digit = as_printed.datum_behind(label, table(printed, key), as_printed.data)
    return Shown(
        quantity=f"the datum {label}", unit="mm", printed=float(as_printed.data[at]), read=float(repaired.data[at]),
        ours=datum,
        tolerance=Tolerance(min(digit, abs(float(as_printed.slip[at])) / 2), "half the way between the two readings"),
        method=f"solved from the printed results of the {free} fit, all other data as printed",
        differs="the cell is a reading; what the printed fits need it to be is asked here",
    )  # fmt: skip


def sign(printed: Printed, data: str, free: str, key: str, name: str) -> Shown:
    """Return what shows a sign that is lost in print."""
    fit: Fit = fitted(data, free)
    entry = printed.column(f"table2.{key}").entries[name]
    row = fit.predictor[fit.labels.index(name)]
    return Shown(
        quantity=name, unit="mm", printed=entry.printed, read=entry.value,
        ours=float(row @ fit.data), tolerance=fit.tolerance(row, "the cell"),
        method="prediction of the linear model fitted to the data as printed",
    )  # fmt: skip


@_shows("Table 2, Experiment 3, 'Average' of {Delta rho, Delta L}")
def average3(printed: Printed) -> Shown:
    entry = printed.column("table2.exp3_full").entries["average"]
    fit = fitted("exp3_t2", "full", repaired=True)
    residuals = fit.data - fit.predictor @ fit.data
    return Shown(
        quantity="rms left by the full fit if the datum x_z_minus is -.13", unit="mm", printed=entry.printed,
        read=entry.value,
        ours=rms(residuals), tolerance=rms_tolerance(residuals), method="linear fit of the repaired data",
        differs="here the datum is read as -.13, in the cell's row as printed",
    )  # fmt: skip


def two_sets(printed: Printed, key: str, data: str, name: str) -> Shown:
    """Return what asks Table 1's own fit which difference `name` it was made of.

    Its printed residuals know: had they come from Table 2's readings, ours would be what Table 2 has.
    """
    six, as_printed = fitted("exp1", "rho"), table1(printed, key)
    datum, within = six.datum_behind(name, table1(printed, f"{key}_expected"), as_printed)
    other = table2_differences()[data][name]
    return Shown(
        quantity=f"{name}, Max minus Min: printed in Table 1; read off Table 2; ours from Table 1's residuals",
        unit="mm", printed=float(as_printed[six.labels.index(name)]), read=other,
        ours=datum,
        tolerance=Tolerance(
        within, "half a printed digit of each residual and of each other datum, as the fit carries it"
        ), method="solved from the printed residuals of the rho fit, all other differences as printed in Table 1",
        differs="the cell is a reading; what the printed fits need it to be is asked here",
    )  # fmt: skip


@_shows("Table 2, heads 'Residuals' and 'Expected improvement'")
def heads(printed: Printed) -> Shown:
    column, fit = table2(printed, "exp2_full"), fitted("exp2", "full")
    residuals = fit.data - fit.predictor @ fit.data
    wrong, right = (float(np.abs(column - v).max()) for v in (residuals, fit.predictor @ fit.data))
    return Shown(
        quantity="largest distance of the column from residuals (printed) and from predictions", unit="mm",
        printed=wrong, read=0.0,
        ours=right, tolerance=_ROUNDED, method="Table 2, Experiment 2, full set, beside the linear fit",
    )  # fmt: skip


@_shows("section 4.2, Experiment #2")
def less_than(printed: Printed) -> Shown:
    values = table1(printed, "exp2")
    as_printed, read = (
        printed.column("text.experiment2").entries["deviations_below"].printed,
        abs(printed.column("table1.exp2")["z_x"]),
    )
    return Shown(
        quantity="largest deviation of Table 1, Measurements #2", unit="mm", printed=as_printed, read=read,
        ours=float(np.abs(values).max()), tolerance=_ROUNDING,
        method=f"largest of the six; their rms is {rms(values):.2f}",
    )  # fmt: skip


@_shows("section 4.2, Experiment #3")
def maximum(printed: Printed) -> Shown:
    ours = float(np.abs(table2(printed, "exp3")).max())
    as_printed = printed.column("text.experiment3").entries["largest_after"].printed
    return Shown(
        quantity="largest deviation of Experiment 3", unit="mm", printed=as_printed,
        read=abs(printed.column("table2.exp3")["z_y_minus"]),
        ours=ours, tolerance=_ROUNDING, method="largest of the twelve, Table 2",
    )  # fmt: skip


@_shows("Tables 2 and 3 and section 4.2, residual of the full set in Experiment 2")
def full_residual(printed: Printed) -> Shown:
    fit = fitted("exp2", "full")
    residuals = fit.data - fit.predictor @ fit.data
    as_printed = printed.column("table3.exp2_full")["residual"]
    return Shown(
        quantity="least rms that six parameters leave in Experiment 2", unit="mm", printed=as_printed, read=as_printed,
        ours=rms(residuals), tolerance=rms_tolerance(residuals), method="linear fit of the full set",
    )  # fmt: skip


@_shows("section 4.2, Experiment #1")
def resolution(printed: Printed) -> Shown:
    as_printed = printed.column("text.experiment1")["encoder_resolution"]
    ours = printed.column("text.section41")["indicator_resolution"] / 1000
    return Shown(
        quantity="resolution of the indicators; that of the encoders is not given", unit="mm", printed=as_printed,
        read=as_printed,
        ours=ours, tolerance=Tolerance(1e-12, "a given number"), method="section 4.1",
    )  # fmt: skip


@_shows("section numbers")
def section_numbers(printed: Printed) -> Shown:
    return Shown(
        quantity="section numbers: notation only", unit="1", printed=nan, read=nan,
        ours=nan, tolerance=Tolerance(nan, "nothing to compare with"), method="none: no quantity depends on it",
    )  # fmt: skip


@_shows("equation (1)")
def equation_1(printed: Printed) -> Shown:
    length = geometry().length
    ours = float(np.abs(direct_kinematics(np.full((1, 3), length))[0]).max())
    return Shown(
        quantity="p_x at Zero, less e", unit="mm", printed=length + length, read=0.0,
        ours=ours, tolerance=_ROUNDING, method="(1) as printed, rho = L and zero angles, and direct kinematics by (2)",
    )  # fmt: skip


@_shows("section 2.4, after equation (4)")
def root(printed: Printed) -> Shown:
    rho = np.full(3, geometry().length)
    values = [float(direct_roots(rho, sign)[0]) for sign in (1.0, -1.0)]
    return Shown(
        quantity="p_x at Zero by (4)", unit="mm", printed=values[0], read=0.0,
        ours=values[1], tolerance=_ROUNDING, method="(4) with either root at rho = L",
    )  # fmt: skip


@_shows("equation (11), first right-hand side")
def first_row(printed: Printed) -> Shown:
    exact = make_problem("orthoglide6", data="exp2", free="full", model="exact")
    labels = [r.label for r in exact.plan]
    slopes = exact.jacobian(np.zeros(6))
    off = [float(np.abs(slopes[labels.index(name)] - calibration_matrix()[0]).max()) for name in ("x_y-", "x_y+")]
    return Shown(
        quantity="largest distance of row 1 of (11) from the exact model's derivative of its right-hand side", unit="1",
        printed=off[0], read=0.0,
        ours=off[1], tolerance=_ROUNDING, method="Jacobian of the exact model for x_y^- and for x_y^+",
    )  # fmt: skip


@_shows("section 3.4, after equation (14), angles")
def angles(printed: Printed) -> Shown:
    as_printed = printed.column("text.section34").entries["alpha_1"].printed
    length = geometry().length
    solved = float(length * np.sin(geometry().alpha_plus))
    return Shown(
        quantity="stroke that the larger angle belongs to", unit="mm",
        printed=float(length * np.sin(np.radians(as_printed))), read=printed.column("geometry")["stroke_plus"],
        ours=solved, tolerance=_ROUNDING, method="L sin(alpha) at 11.0 and at 11.151 degrees",
    )  # fmt: skip


@_shows("section 2.3, after (2)")
def limits(printed: Printed) -> Shown:
    column, length = printed.column("text.section23"), geometry().length
    return Shown(
        quantity="distance of Zero, rho = L, from the upper limit of the joints", unit="mm",
        printed=column["rho_max"] - length, read=column["rho_max"],
        ours=column["rho_max"] - (length - length), tolerance=_ROUNDING,
        method="rho_max - rho as printed and rho_max - (rho - L); below 0 is outside",
    )  # fmt: skip


@_shows("section 2.4, after (3)")
def signs(printed: Printed) -> Shown:
    position = np.array([[20.0, -30.0, 10.0]])
    rho = inverse_kinematics(position)[0]
    ours = np.sign(rho - position[0])
    return Shown(
        quantity="s at a pose of the workspace", unit="1", printed=float(np.sign(position[0] - position[0])[0]),
        read=1.0,
        ours=ours, tolerance=_COUNT, method="sign of p - p and of rho - p at (20, -30, 10) mm",
    )  # fmt: skip


@_shows("section 2.4, after (4), A, B and C")
def pairs(printed: Printed) -> Shown:
    rho = np.full(3, geometry().length)
    wrong = float(direct_roots(rho, -1.0, pairs=2)[0])
    ordinary = inverse_kinematics(np.array([[20.0, -30.0, 10.0]]))[0]
    right = closure(direct_roots(ordinary, -1.0), ordinary)
    return Shown(
        quantity="error of the pose by (4): p_x at Zero with every ordered pair, else by how much (2) fails", unit="mm",
        printed=wrong, read=0.0,
        ours=right, tolerance=_ROUNDING,
        method="(4) with A over ordered pairs at Zero, and over i < j at (20, -30, 10) mm",
    )  # fmt: skip


@_shows("section 2.4 (second), before (8)")
def alpha(printed: Printed) -> Shown:
    length, stroke = geometry().length, geometry().stroke_plus
    joint = inverse_kinematics(np.array([[stroke, 0.0, 0.0]]))[0][1]
    leg = np.array([stroke, -joint, 0.0]) / length
    to_x, to_own = (float(np.degrees(np.arccos(c))) for c in (abs(leg[0]), abs(leg[1])))
    alpha = float(np.degrees(geometry().alpha_plus))
    return Shown(
        quantity="angle of the y-leg at XMax to the X-axis (printed) and to its own", unit="deg", printed=to_x,
        read=alpha,
        ours=to_own, tolerance=_ROUNDING, method="direction of the y-leg by (2)",
    )  # fmt: skip


@_shows("section 3.2, after (11)")
def which_model(printed: Printed) -> Shown:
    length = geometry().length
    rho = np.full(3, length)
    as_printed = np.full(3, 2 * length)
    at_zero = direct_kinematics(rho[None])[0]
    return Shown(
        quantity="by how much the legs do not close at Zero", unit="mm", printed=closure(as_printed, rho), read=0.0,
        ours=closure(at_zero, rho), tolerance=_ROUNDING,
        method="legs of the tool centre point of (1), as printed, and of (2)",
    )  # fmt: skip


_SHOWN |= {
    "Table 1, Measurements #1, x_z": lambda printed: slip(printed, "exp1", "rho", table1, "exp1_expected"),
    "Table 2, Experiment 2, {Delta rho, Delta L}, z_y_plus": lambda printed: sign(
        printed, "exp2", "full", "exp2_full", "z_y_plus"
    ),
    "Table 2, Experiment 2, {Delta rho}, y_z_minus": lambda printed: sign(
        printed, "exp2", "rho", "exp2_rho", "y_z_minus"
    ),
    "Table 2, Experiment 2, {Delta L}, z_x_plus": lambda printed: sign(printed, "exp2", "L", "exp2_L", "z_x_plus"),
    "Table 2, Experiment 3, {Delta L}, z_x_plus": lambda printed: sign(printed, "exp3_t2", "L", "exp3_L", "z_x_plus"),
    "Tables 1 and 2, Experiment 3": lambda printed: two_sets(printed, "exp3", "exp3_t2", "z_y"),
    "Tables 1 and 2, Experiment 2": lambda printed: two_sets(printed, "exp2", "exp2", "x_y"),
    "Table 2, Experiment 3, 'Exper. data', x_z_minus": lambda printed: slip(
        printed, "exp3_t2", "full", table2, "exp3_full"
    ),
}
