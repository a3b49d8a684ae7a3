"""The errata of Pashkevich et al. 2008, each with the computation that shows it, beside its place in the data file.

For a formula, `printed` is the number that the printed formula gives, `read` the number it must give, and ours what the
corrected formula gives. A new erratum in the data file without its computation here is an error.
"""

from collections.abc import Callable, Iterator
from math import nan

import numpy as np

from calibench.bench.papers.pashkevich2008 import machine
from calibench.bench.papers.pashkevich2008.machine import fitted, rms, rms_tolerance, table1, table2
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import NO_TOLERANCE, Array, Row, Tolerance, problem as make_problem
from calibench.problems import constants
from calibench.problems.orthoglide.kinematics import calibration_matrix, direct_kinematics, geometry, inverse_kinematics

_COUNT = Tolerance(0.0, "a count")
_ROUNDING = Tolerance(1e-9, "rounding")
_READING = "the cell is a reading; what the printed fits need it to be is asked here"


def rows(printed: Printed) -> Iterator[Row]:
    """Yield a row for each erratum of the data file. Raises `KeyError` for one without a computation."""
    shown = [slip(printed, "exp1", "rho", table1, "exp1_expected")]
    shown += [slip(printed, "exp3_t2", "full", table2, "exp3_full")]
    shown += [two_sets(printed, "exp3", "exp3_t2", "z_y"), two_sets(printed, "exp2", "exp2", "x_y")]
    return printed.in_order([*shown, *_numbers(printed), *_equations(printed)])


def slip(printed: Printed, data: str, free: str, table: Callable[[Printed, str], Array], key: str) -> Row:
    """Return what shows a datum that is found from what is printed of the fit to it."""
    as_printed, repaired = fitted(data, free), fitted(data, free, repaired=True)
    at = int(np.flatnonzero(as_printed.slip)[0])
    label = as_printed.labels[at]
    datum, digit = as_printed.datum_behind(label, table(printed, key), as_printed.data)
    return printed.erratum(
        machine.SLIPS[data][1], f"the datum {label}", unit="mm", printed=float(as_printed.data[at]),
        read=float(repaired.data[at]), ours=datum,
        tolerance=Tolerance(min(digit, abs(float(as_printed.slip[at])) / 2), "half the way between the two readings"),
        method=f"solved from the printed results of the {free} fit, all other data as printed", differs=_READING,
    )  # fmt: skip


def two_sets(printed: Printed, key: str, data: str, name: str) -> Row:
    """Return what asks Table 1's own fit which difference `name` it was made of."""
    six, as_printed = fitted("exp1", "rho"), table1(printed, key)
    datum, within = six.datum_behind(name, table1(printed, f"{key}_expected"), as_printed)
    return printed.erratum(
        f"Tables 1 and 2, Experiment {key[-1]}",
        f"{name}, Max minus Min: printed in Table 1; read off Table 2; ours from Table 1's residuals", unit="mm",
        printed=float(as_printed[six.labels.index(name)]), read=machine.table2_differences()[data][name], ours=datum,
        tolerance=Tolerance(
            within, "half a printed digit of each residual and of each other datum, as the fit carries it"
        ),
        method="solved from the printed residuals of the rho fit, all other differences as printed in Table 1",
        differs=_READING,
    )  # fmt: skip


def _numbers(printed: Printed) -> Iterator[Row]:
    # the cells of Table 2 whose sign is lost in print, then the other errata of Tables 2 and 3, then those of the text
    for experiment, free, parameters, name in (
        (2, "full", "Delta rho, Delta L", "z_y_plus"), (2, "rho", "Delta rho", "y_z_minus"),
        (2, "L", "Delta L", "z_x_plus"), (3, "L", "Delta L", "z_x_plus"),
    ):  # fmt: skip
        fit = fitted("exp2" if experiment == 2 else "exp3_t2", free)
        entry = printed.column(f"table2.exp{experiment}_{free}").entries[name]
        row = fit.predictor[fit.labels.index(name)]
        yield printed.erratum(
            f"Table 2, Experiment {experiment}, {{{parameters}}}, {name}", name, unit="mm", printed=entry.printed,
            read=entry.value, ours=float(row @ fit.data), tolerance=fit.tolerance(row, "the cell"),
            method="prediction of the linear model fitted to the data as printed",
        )  # fmt: skip
    entry = printed.column("table2.exp3_full").entries["average"]
    residuals = fitted("exp3_t2", "full", repaired=True).residuals
    yield printed.erratum(
        "Table 2, Experiment 3, 'Average' of {Delta rho, Delta L}",
        "rms left by the full fit if the datum x_z_minus is -.13", unit="mm", printed=entry.printed, read=entry.value,
        ours=rms(residuals), tolerance=rms_tolerance(residuals), method="linear fit of the repaired data",
        differs="here the datum is read as -.13, in the cell's row as printed",
    )  # fmt: skip
    column, fit = table2(printed, "exp2_full"), fitted("exp2", "full")
    yield printed.erratum(
        "Table 2, heads 'Residuals' and 'Expected improvement'",
        "largest distance of the column from residuals (printed) and from predictions", unit="mm",
        printed=float(np.abs(column - fit.residuals).max()), read=0.0,
        ours=float(np.abs(column - fit.predictor @ fit.data).max()),
        tolerance=Tolerance(0.015, "half a digit of three printed numbers"),
        method="Table 2, Experiment 2, full set, beside the linear fit",
    )  # fmt: skip
    as_printed = printed.column("table3.exp2_full")["residual"]
    yield printed.erratum(
        "Tables 2 and 3 and section 4.2, residual of the full set in Experiment 2",
        "least rms that six parameters leave in Experiment 2", unit="mm", printed=as_printed, read=as_printed,
        ours=rms(fit.residuals), tolerance=rms_tolerance(fit.residuals), method="linear fit of the full set",
    )  # fmt: skip
    place = "section 3.4, after equation (14), errors of the parameters"
    errata = constants.document("pashkevich2008")["erratum"]
    yield printed.erratum(
        place, "standard error of the offsets", unit="mm",
        printed=printed.column("text.section34").entries["parameter_error"].printed,
        read=float(next(entry["value"] for entry in errata if entry["place"] == place)),
        ours=machine.accuracy(printed, True), tolerance=Tolerance(0.005, "half a digit of what to read"),
        method="(12) with (14) at the printed angles",
    )  # fmt: skip
    values = table1(printed, "exp2")
    yield printed.erratum(
        "section 4.2, Experiment #2", "largest deviation of Table 1, Measurements #2", unit="mm",
        printed=printed.column("text.experiment2").entries["deviations_below"].printed,
        read=abs(printed.column("table1.exp2")["z_x"]), ours=float(np.abs(values).max()), tolerance=_ROUNDING,
        method=f"largest of the six; their rms is {rms(values):.2f}",
    )  # fmt: skip
    yield printed.erratum(
        "section 4.2, Experiment #3", "largest deviation of Experiment 3", unit="mm",
        printed=printed.column("text.experiment3").entries["largest_after"].printed,
        read=abs(printed.column("table2.exp3")["z_y_minus"]), ours=float(np.abs(table2(printed, "exp3")).max()),
        tolerance=_ROUNDING, method="largest of the twelve, Table 2",
    )  # fmt: skip
    as_printed = printed.column("text.experiment1")["encoder_resolution"]
    yield printed.erratum(
        "section 4.2, Experiment #1", "resolution of the indicators; that of the encoders is not given", unit="mm",
        printed=as_printed, read=as_printed, ours=printed.column("text.section41")["indicator_resolution"] / 1000,
        tolerance=Tolerance(1e-12, "a given number"), method="section 4.1",
    )  # fmt: skip
    yield printed.erratum(
        "section numbers", "section numbers: notation only", unit="1", printed=nan, read=nan, ours=nan,
        tolerance=NO_TOLERANCE, method="none: no quantity depends on it",
    )  # fmt: skip


def _equations(printed: Printed) -> Iterator[Row]:
    """Yield the errata of the model: its equations at Zero, rho = L, and at a pose of the workspace."""
    length, at_zero = geometry().length, np.full(3, geometry().length)
    zero = direct_kinematics(at_zero[None])[0]
    pose = np.array([20.0, -30.0, 10.0])
    rho = inverse_kinematics(pose[None])[0]
    yield printed.erratum(
        "equation (1)", "p_x at Zero, less e", unit="mm", printed=length + length, read=0.0,
        ours=float(np.abs(zero).max()), tolerance=_ROUNDING,
        method="(1) as printed, rho = L and zero angles, and direct kinematics by (2)",
    )  # fmt: skip
    yield printed.erratum(
        "section 2.4, after equation (4)", "p_x at Zero by (4)", unit="mm",
        printed=float(machine.direct_roots(at_zero, 1.0)[0]), read=0.0,
        ours=float(machine.direct_roots(at_zero, -1.0)[0]), tolerance=_ROUNDING,
        method="(4) with either root at rho = L",
    )  # fmt: skip
    exact = make_problem("orthoglide6", data="exp2", free="full", model="exact")
    labels, slopes = [r.label for r in exact.plan], exact.jacobian(np.zeros(6))
    off = [float(np.abs(slopes[labels.index(name)] - calibration_matrix()[0]).max()) for name in ("x_y-", "x_y+")]
    yield printed.erratum(
        "equation (11), first right-hand side",
        "largest distance of row 1 of (11) from the exact model's derivative of its right-hand side", unit="1",
        printed=off[0], read=0.0, ours=off[1], tolerance=_ROUNDING,
        method="Jacobian of the exact model for x_y^- and for x_y^+",
    )  # fmt: skip
    as_printed = printed.column("text.section34").entries["alpha_1"].printed
    yield printed.erratum(
        "section 3.4, after equation (14), angles", "stroke that the larger angle belongs to", unit="mm",
        printed=float(length * np.sin(np.radians(as_printed))), read=printed.column("geometry")["stroke_plus"],
        ours=float(length * np.sin(geometry().alpha_plus)), tolerance=_ROUNDING,
        method="L sin(alpha) at 11.0 and at 11.151 degrees",
    )  # fmt: skip
    upper = printed.column("text.section23")["rho_max"]
    yield printed.erratum(
        "section 2.3, after (2)", "distance of Zero, rho = L, from the upper limit of the joints", unit="mm",
        printed=upper - length, read=upper, ours=upper - (length - length), tolerance=_ROUNDING,
        method="rho_max - rho as printed and rho_max - (rho - L); below 0 is outside",
    )  # fmt: skip
    yield printed.erratum(
        "section 2.4, after (3)", "s at a pose of the workspace", unit="1", printed=float(np.sign(pose - pose)[0]),
        read=1.0, ours=np.sign(rho - pose), tolerance=_COUNT, method="sign of p - p and of rho - p at (20, -30, 10) mm",
    )  # fmt: skip
    yield printed.erratum(
        "section 2.4, after (4), A, B and C",
        "error of the pose by (4): p_x at Zero with every ordered pair, else by how much (2) fails", unit="mm",
        printed=float(machine.direct_roots(at_zero, -1.0, pairs=2)[0]), read=0.0,
        ours=machine.closure(machine.direct_roots(rho, -1.0), rho), tolerance=_ROUNDING,
        method="(4) with A over ordered pairs at Zero, and over i < j at (20, -30, 10) mm",
    )  # fmt: skip
    stroke = geometry().stroke_plus
    leg = np.array([stroke, -inverse_kinematics(np.array([[stroke, 0.0, 0.0]]))[0][1], 0.0]) / length
    to_x, to_own = (float(np.degrees(np.arccos(c))) for c in (abs(leg[0]), abs(leg[1])))
    yield printed.erratum(
        "section 2.4 (second), before (8)", "angle of the y-leg at XMax to the X-axis (printed) and to its own",
        unit="deg", printed=to_x, read=float(np.degrees(geometry().alpha_plus)), ours=to_own, tolerance=_ROUNDING,
        method="direction of the y-leg by (2)",
    )  # fmt: skip
    yield printed.erratum(
        "section 3.2, after (11)", "by how much the legs do not close at Zero", unit="mm",
        printed=machine.closure(np.full(3, 2 * length), at_zero), read=0.0, ours=machine.closure(zero, at_zero),
        tolerance=_ROUNDING, method="legs of the tool centre point of (1), as printed, and of (2)",
    )  # fmt: skip
