"""Misprinted formulas of Pashkevich et al. 2008: what each gives as printed, and as it must be."""

from __future__ import annotations

import numpy as np

from calibench.bench.papers.evidence import problem as make_problem
from calibench.bench.papers.pashkevich2008.machine import closure, direct_roots
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row, Tolerance
from calibench.problems.orthoglide.kinematics import calibration_matrix, direct_kinematics, geometry, inverse_kinematics

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
