"""The Orthoglide itself (Pashkevich et al. 2008): geometry, inverse and direct kinematics, Jacobians, system (11).

Three orthogonal linear drives, three legs, a tool centre point that only translates. The origin is the intersection of
the drives' axes; at the Zero posture the tool is there, all joints read L and each leg lies on its axis. The six errors
of a machine are drho_x drho_y drho_z dL_x dL_y dL_z, mm: offsets of the encoders and of the leg lengths.

Equation (1) cannot be used as printed; all follows from (2): (p_i - rho_i - drho_i)^2 + p_j^2 + p_k^2 = (L + dL_i)^2.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from calibench.problems import constants
from calibench.problems.base import Array

PAPER = "pashkevich2008"
NAMES = ("drho_x", "drho_y", "drho_z", "dL_x", "dL_y", "dL_z")
AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Geometry:
    """The nominal machine, mm: leg length, and how far a joint goes from Zero, up (above 0) and down (below 0)."""

    length: float
    stroke_plus: float
    stroke_minus: float

    @property
    def alpha_plus(self) -> float:
        """Return the angle [rad] by which the other legs turn at the Max posture; the paper prints it as 11.0 deg."""
        return float(np.arcsin(self.stroke_plus / self.length))

    @property
    def alpha_minus(self) -> float:
        """Return the angle [rad] by which the other legs turn at the Min posture; the paper prints it as -18.7 deg."""
        return float(np.arcsin(self.stroke_minus / self.length))


@cache
def geometry() -> Geometry:
    """Return the nominal prototype of sections 2.1 and 2.3."""
    printed = constants.column(PAPER, "geometry")
    return Geometry(printed["L"], abs(printed["stroke_plus"]), -abs(printed["stroke_minus"]))


def inverse_kinematics(positions: Array, errors: Array | None = None) -> Array:
    """Return the joints, shape (n, 3), mm, at tool centre points of shape (n, 3): all legs with s = +1.

    `errors`, shape (6,), mm, are those of the machine; the nominal one has none. Out of reach gives NaN.
    """
    e = np.zeros(6) if errors is None else np.asarray(errors, dtype=float)
    p = np.asarray(positions, dtype=float)
    squares = p**2
    across = squares.sum(axis=1, keepdims=True) - squares
    with np.errstate(invalid="ignore"):
        return np.asarray(p + np.sqrt((geometry().length + e[3:]) ** 2 - across) - e[:3])  # eq. (3), s = +1


def direct_kinematics(joints: Array, errors: Array | None = None) -> Array:
    """Return the tool centre points, shape (n, 3), mm, at joints of shape (n, 3); NaN where no posture closes."""
    from calibench.problems.orthoglide import _kernels  # here, as listing the names must not load the compiler

    e = np.zeros(6) if errors is None else np.array(errors, dtype=float)
    places: Array = _kernels.direct(np.array(joints, dtype=float, order="C"), e, geometry().length)
    return places


def posture_jacobian(axis: int | None = None, alpha: float = 0.0) -> Array:
    """Return the nominal Jacobian, shape (3, 6), at Zero, eq. (6), or with the tool moved along `axis`, eq. (8).

    `alpha` [rad] is the angle by which the other legs turn: asin of the move over L.
    """
    if axis is None:
        return np.hstack([np.eye(3), -np.eye(3)])  # eq. (6)
    result = np.hstack([np.eye(3), -np.eye(3) / np.cos(alpha)])
    result[:, axis], result[:, 3 + axis] = np.tan(alpha), -np.tan(alpha)
    result[axis, axis], result[axis, 3 + axis] = 1.0, -1.0
    return result  # eq. (8)


def calibration_matrix(alpha_plus: float | None = None, alpha_minus: float | None = None) -> Array:
    """Return the matrix of the twelve linear equations, shape (12, 6), eq. (11).

    The angles [rad] default to asin(stroke / L), 11.151 and -18.803 deg; the paper computes with 11.0 and -18.7 deg.
    Rows: x_y+ y_x+ x_y- y_x-, then y_z z_y, then x_z z_x in the same way. d_y^+ is the deviation along d of the leg y
    at its Max posture. (The first right-hand side is printed x_y^-: read x_y^+.)
    """
    alphas = (
        geometry().alpha_plus if alpha_plus is None else alpha_plus,
        geometry().alpha_minus if alpha_minus is None else alpha_minus,
    )
    matrix = []
    for first, second in ((0, 1), (1, 2), (0, 2)):
        for alpha in alphas:
            a = np.sin(alpha)
            b = (0.5 + np.sin(alpha)) * np.tan(alpha)
            c = (0.5 + np.sin(alpha)) / np.cos(alpha) - 0.5
            for along, leg in ((first, second), (second, first)):
                row = np.zeros(6)
                row[along], row[leg], row[3 + along], row[3 + leg] = a, b, -c, -b
                matrix.append(row)
    return np.array(matrix)  # eq. (11)
