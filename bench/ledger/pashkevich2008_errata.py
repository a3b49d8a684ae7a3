"""The errata of Pashkevich et al. 2008, each with the computation that shows it.

For a formula, `printed` is the number that the printed formula gives, `read` the number it must give, and ours what the
corrected formula gives. A new erratum in the data file without its computation here is an error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import nan

import numpy as np

from bench.ledger.evidence import problem as make_problem
from bench.ledger.pashkevich2008_claims import column_cosines
from bench.ledger.pashkevich2008_fits import (
    Fit,
    accuracy,
    fitted,
    rms,
    rms_tolerance,
    table1,
    table2,
    table2_differences,
)
from bench.ledger.pashkevich2008_machine import closure, direct_roots
from bench.ledger.printed import Printed
from bench.ledger.row import NOTHING, Row, Tolerance
from problems.orthoglide_kinematics import calibration_matrix, direct_kinematics, geometry, inverse_kinematics

_COUNT = Tolerance(0.0, "a count")
_ROUNDING = Tolerance(1e-9, "rounding")
_ROUNDED = Tolerance(0.015, "half a digit of three printed numbers")
Shown = Callable[[Printed, int], Row]


def rows(printed: Printed) -> Iterator[Row]:
    """Yield a row for each erratum of the data file. Raises `ValueError` for one without a computation."""
    for (number, place), (where, show) in zip(printed.errata(), _SHOWN, strict=True):
        if place != where:
            raise ValueError(f"erratum {number + 1} is at {place!r}: its computation is for {where!r}")
        yield show(printed, number)


def _equation1(printed: Printed, number: int) -> Row:
    length = geometry().length
    ours = float(np.abs(direct_kinematics(np.full((1, 3), length))[0]).max())
    return printed.erratum(
        number, "p_x at Zero, less e", "mm", length + length, 0.0, ours, _ROUNDING,
        "(1) as printed, rho = L and zero angles, and direct kinematics by (2)",
    )  # fmt: skip


def _root(printed: Printed, number: int) -> Row:
    rho = np.full(3, geometry().length)
    values = [float(direct_roots(rho, sign)[0]) for sign in (1.0, -1.0)]
    return printed.erratum(
        number, "p_x at Zero by (4)", "mm", values[0], 0.0, values[1], _ROUNDING, "(4) with either root at rho = L"
    )


def _first_row(printed: Printed, number: int) -> Row:
    exact = make_problem("orthoglide6", data="exp2", free="full", model="exact")
    labels = [r.label for r in exact.plan]
    slopes = exact.jacobian(np.zeros(6))
    off = [float(np.abs(slopes[labels.index(name)] - calibration_matrix()[0]).max()) for name in ("x_y-", "x_y+")]
    return printed.erratum(
        number, "largest distance of row 1 of (11) from the exact model's derivative of its right-hand side", "1",
        off[0], 0.0, off[1], _ROUNDING, "Jacobian of the exact model for x_y^- and for x_y^+",
    )  # fmt: skip


def _angles(printed: Printed, number: int) -> Row:
    said = printed.column("text.section34")["alpha_1"]
    length = geometry().length
    solved = float(length * np.sin(geometry().alpha_plus))
    return printed.erratum(
        number, "stroke that the larger angle belongs to", "mm", float(length * np.sin(np.radians(said))),
        printed.column("geometry")["stroke_plus"], solved, _ROUNDING, "L sin(alpha) at 11.0 and at 11.151 degrees",
    )  # fmt: skip


def _error(printed: Printed, number: int) -> Row:
    said, read = printed.column("text.section34")["parameter_error"], 0.74
    return printed.erratum(
        number, "standard error of the offsets", "mm", said, read, accuracy(printed, True),
        Tolerance(0.005, "half a digit of what to read"), "(12) with (14) at the printed angles",
    )  # fmt: skip


def _slip(data: str, free: str, column: Callable[[Printed], tuple[list[str], list[float]]]) -> Shown:
    """Return the row of a datum that is found from what is printed of the fit to it."""

    def show(printed: Printed, number: int) -> Row:
        as_printed, repaired = fitted(data, free), fitted(data, free, repaired=True)
        at = int(np.flatnonzero(as_printed.slip)[0])
        _, cells = column(printed)
        kept = len(cells) == 6  # Table 1 has residuals, Table 2 predictions
        matrix = np.eye(6) - as_printed.predictor if kept else as_printed.predictor
        column_ = matrix[:, at]
        found = as_printed.data[at] + float(
            column_ @ (np.array(cells) - matrix @ as_printed.data) / (column_ @ column_)
        )
        digit = 0.01 * float(np.abs(column_).sum() / (column_ @ column_))
        return printed.erratum(
            number, f"the datum {as_printed.labels[at]}", "mm", float(as_printed.data[at]), float(repaired.data[at]),
            found, Tolerance(min(digit, abs(float(as_printed.slip[at])) / 2), "half the way between the two readings"),
            f"solved from the printed results of the {free} fit, all other data as printed",
        )  # fmt: skip

    return show


def _expected1(printed: Printed) -> tuple[list[str], list[float]]:
    return fitted("exp1", "rho").labels, table1(printed, "exp1_expected").tolist()


def _expected3(printed: Printed) -> tuple[list[str], list[float]]:
    return fitted("exp3_t2", "full").labels, table2(printed, "exp3_full").tolist()


def _sign(data: str, free: str, key: str, name: str) -> Shown:
    def show(printed: Printed, number: int) -> Row:
        fit: Fit = fitted(data, free)
        entry = printed.column(f"table2.{key}").entries[name]
        row = fit.predictor[fit.labels.index(name)]
        return printed.erratum(
            number, name, "mm", entry.printed, entry.value, float(row @ fit.data), fit.tolerance(row, "the cell"),
            "prediction of the linear model fitted to the data as printed",
        )  # fmt: skip

    return show


def _average3(printed: Printed, number: int) -> Row:
    entry = printed.column("table2.exp3_full").entries["average"]
    fit = fitted("exp3_t2", "full", repaired=True)
    left = fit.data - fit.predictor @ fit.data
    return printed.erratum(
        number, "rms left by the full fit if the datum x_z_minus is -.13", "mm", entry.printed, entry.value, rms(left),
        rms_tolerance(left), "linear fit of the repaired data",
    )  # fmt: skip


def _two_sets(key: str, data: str, name: str) -> Shown:
    """Return the row that compares Table 1's difference `name` with that of Table 2."""

    def show(printed: Printed, number: int) -> Row:
        said = printed.column(f"table1.{key}")[name]
        differences = table2_differences()[data]
        return printed.erratum(
            number, f"{name}, Max minus Min: Table 1 printed, Table 2 to read", "mm",
            said, round(differences[name], 2), differences[name], _ROUNDED, "Table 2, plus less minus",
        )  # fmt: skip

    return show


def _heads(printed: Printed, number: int) -> Row:
    column, fit = table2(printed, "exp2_full"), fitted("exp2", "full")
    residuals = fit.data - fit.predictor @ fit.data
    wrong, right = (float(np.abs(column - v).max()) for v in (residuals, fit.predictor @ fit.data))
    return printed.erratum(
        number, "largest distance of the column from residuals (printed) and from predictions", "mm", wrong, 0.0, right,
        _ROUNDED, "Table 2, Experiment 2, full set, beside the linear fit",
    )  # fmt: skip


def _less_than(printed: Printed, number: int) -> Row:
    values = table1(printed, "exp2")
    said, read = printed.column("text.experiment2")["deviations_below"], abs(printed.column("table1.exp2")["z_x"])
    return printed.erratum(
        number, "largest deviation of Table 1, Measurements #2", "mm", said, read, float(np.abs(values).max()),
        _ROUNDING, f"largest of the six; their rms is {rms(values):.2f}",
    )  # fmt: skip


def _simultaneously(printed: Printed, number: int) -> Row:
    matrix, unknowns = calibration_matrix(), printed.column("equation11")["unknowns"]
    s = np.linalg.svd(matrix, compute_uv=False)
    noise = printed.column("text.section34")["sigma"] / s  # mm: standard deviation along each direction
    limit = printed.column("text.section34")["parameter_error"]
    seen = int((noise <= limit).sum())
    return printed.erratum(
        number, "directions of the six parameters that gauges of .01 mm see to the printed .07 mm", "1", unknowns, 3,
        seen, _COUNT, f"singular values of (11); cosine of the columns drho and dL {min(column_cosines()):.5f}",
    )  # fmt: skip


def _maximum(printed: Printed, number: int) -> Row:
    ours = float(np.abs(table2(printed, "exp3")).max())
    said = printed.column("text.experiment3")["largest_after"]
    return printed.erratum(
        number, "largest deviation of Experiment 3", "mm", said, abs(printed.column("table2.exp3")["z_y_minus"]), ours,
        _ROUNDING, "largest of the twelve, Table 2",
    )  # fmt: skip


def _factor(printed: Printed, number: int) -> Row:
    said = printed.column("text.section5")["rms_divided_by"]
    ours = rms(table2(printed, "exp2")) / rms(table2(printed, "exp3"))
    one = rms(table1(printed, "exp2")) / rms(table1(printed, "exp3"))
    return printed.erratum(
        number, "rms before over rms after", "1", said, 2.1, ours, Tolerance(0.05, "half a digit of what to read"),
        f"Table 2, twelve deviations; Table 1 has {one:.2f}",
    )  # fmt: skip


def _full_residual(printed: Printed, number: int) -> Row:
    fit = fitted("exp2", "full")
    left = fit.data - fit.predictor @ fit.data
    said = printed.column("table3.exp2_full")["residual"]
    return printed.erratum(
        number, "least rms that six parameters leave in Experiment 2", "mm", said, 0.13, rms(left),
        Tolerance(0.005, "half a printed digit"), "linear fit of the full set",
    )  # fmt: skip


def _limits(printed: Printed, number: int) -> Row:
    column, length = printed.column("text.section23"), geometry().length
    return printed.erratum(
        number, "distance of Zero, rho = L, from the upper limit of the joints", "mm", column["rho_max"] - length,
        column["rho_max"], column["rho_max"] - (length - length), _ROUNDING,
        "rho_max - rho as printed and rho_max - (rho - L); below 0 is outside",
    )  # fmt: skip


def _signs(printed: Printed, number: int) -> Row:
    position = np.array([[20.0, -30.0, 10.0]])
    rho = inverse_kinematics(position)[0]
    ours = np.sign(rho - position[0])
    return printed.erratum(
        number, "s at a pose of the workspace", "1", float(np.sign(position[0] - position[0])[0]), 1.0, ours, _COUNT,
        "sign of p - p and of rho - p at (20, -30, 10) mm",
    )  # fmt: skip


def _pairs(printed: Printed, number: int) -> Row:
    rho = np.full(3, geometry().length)
    wrong = float(direct_roots(rho, -1.0, pairs=2)[0])
    ordinary = inverse_kinematics(np.array([[20.0, -30.0, 10.0]]))[0]
    right = closure(direct_roots(ordinary, -1.0), ordinary)
    return printed.erratum(
        number, "error of the pose by (4): p_x at Zero with every ordered pair, else by how much (2) fails", "mm",
        wrong, 0.0, right, _ROUNDING, "(4) with A over ordered pairs at Zero, and over i < j at (20, -30, 10) mm",
    )  # fmt: skip


def _alpha(printed: Printed, number: int) -> Row:
    length, stroke = geometry().length, geometry().stroke_plus
    joint = inverse_kinematics(np.array([[stroke, 0.0, 0.0]]))[0][1]
    leg = np.array([stroke, -joint, 0.0]) / length
    to_x, to_own = (float(np.degrees(np.arccos(c))) for c in (abs(leg[0]), abs(leg[1])))
    alpha = float(np.degrees(geometry().alpha_plus))
    return printed.erratum(
        number, "angle of the y-leg at XMax to the X-axis (printed) and to its own", "deg", to_x, alpha, to_own,
        _ROUNDING, "direction of the y-leg by (2)",
    )  # fmt: skip


def _which_model(printed: Printed, number: int) -> Row:
    length = geometry().length
    rho = np.full(3, length)
    as_printed = np.full(3, 2 * length)
    at_zero = direct_kinematics(rho[None])[0]
    return printed.erratum(
        number, "by how much the legs do not close at Zero", "mm", closure(as_printed, rho), 0.0,
        closure(at_zero, rho), _ROUNDING, "legs of the tool centre point of (1), as printed, and of (2)",
    )  # fmt: skip


def _resolution(printed: Printed, number: int) -> Row:
    said = printed.column("text.experiment1")["encoder_resolution"]
    ours = printed.column("text.section41")["indicator_resolution"] / 1000
    return printed.erratum(
        number, "resolution of the indicators; that of the encoders is not given", "mm", said, said, ours,
        Tolerance(1e-12, "a given number"), "section 4.1",
    )  # fmt: skip


def _numbers(printed: Printed, number: int) -> Row:
    return printed.erratum(
        number, "section numbers: notation only", "1", nan, nan, NOTHING,
        Tolerance(nan, "nothing to compare with"), "none: no quantity depends on it",
    )  # fmt: skip


_SHOWN: tuple[tuple[str, Shown], ...] = (
    ("equation (1)", _equation1),
    ("section 2.4, after equation (4)", _root),
    ("equation (11), first right-hand side", _first_row),
    ("section 3.4, after equation (14), angles", _angles),
    ("section 3.4, after equation (14), errors of the parameters", _error),
    ("Table 1, Measurements #1, x_z", _slip("exp1", "rho", _expected1)),
    ("Table 2, Experiment 2, {Delta rho, Delta L}, z_y_plus", _sign("exp2", "full", "exp2_full", "z_y_plus")),
    ("Table 2, Experiment 2, {Delta rho}, y_z_minus", _sign("exp2", "rho", "exp2_rho", "y_z_minus")),
    ("Table 2, Experiment 2, {Delta L}, z_x_plus", _sign("exp2", "L", "exp2_L", "z_x_plus")),
    ("Table 2, Experiment 3, {Delta L}, z_x_plus", _sign("exp3_t2", "L", "exp3_L", "z_x_plus")),
    ("Table 2, Experiment 3, 'Average' of {Delta rho, Delta L}", _average3),
    ("Tables 1 and 2, Experiment 3", _two_sets("exp3", "exp3_t2", "z_y")),
    ("Tables 1 and 2, Experiment 2", _two_sets("exp2", "exp2", "x_y")),
    ("Table 2, heads 'Residuals' and 'Expected improvement'", _heads),
    ("section 4.2, Experiment #2", _less_than),
    ("section 4.2, Experiment #2", _simultaneously),
    ("section 4.2, Experiment #3", _maximum),
    ("section 5", _factor),
    ("Table 2, Experiment 3, 'Exper. data', x_z_minus", _slip("exp3_t2", "full", _expected3)),
    ("Tables 2 and 3 and section 4.2, residual of the full set in Experiment 2", _full_residual),
    ("section 2.3, after (2)", _limits),
    ("section 2.4, after (3)", _signs),
    ("section 2.4, after (4), A, B and C", _pairs),
    ("section 2.4 (second), before (8)", _alpha),
    ("section 3.2, after (11)", _which_model),
    ("section 4.2, Experiment #1", _resolution),
    ("section numbers", _numbers),
)
