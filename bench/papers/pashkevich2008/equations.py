"""Equations (5) to (9) and (11) of Pashkevich et al. 2008, written as printed, against differences of the model (2).

Each is a row: how far the printed coefficients are from what the closed legs do when an offset or a leg length moves a
little. Equation (11) is linear; how far its range goes is asked of the parameters that were identified with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from calibench.bench.papers.evidence import Array
from calibench.bench.papers.evidence import problem as make_problem
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row, judge_limit
from calibench.problems.orthoglide.kinematics import NAMES, direct_kinematics, geometry, inverse_kinematics

_CLOSE = 1e-6  # what central differences of .01 mm leave of a derivative of the order of 1
_RULE = "true where no coefficient is off by more than 1e-6, the error of the differences"
_HOW = "largest distance of the printed coefficients from central differences of direct kinematics by (2)"


def rows(printed: Printed) -> Iterator[Row]:
    """Yield equations (5) to (9), the eleven rows of (11) whose right-hand side is printed right, and its range."""
    pose = np.array([20.0, -30.0, 10.0])
    zero = np.zeros(3)
    ends = [(axis, stroke) for axis in range(3) for stroke in (geometry().stroke_plus, geometry().stroke_minus)]
    cases = (
        ("5", "the Jacobian of the tool centre point", [(equation_5(pose), pose)], "at (20, -30, 10) mm"),
        ("6", "the Jacobian at Zero", [(equation_6(), zero)], "at Zero"),
        ("7", "the displacement at Zero is drho - dL, leg by leg", [(equation_7(), zero)], "at Zero"),
        ("8", "the Jacobian at XMax, and likewise at the other ends",
         [(equation_8(axis, stroke), stroke * np.eye(3)[axis]) for axis, stroke in ends], "at the six ends"),
        ("9", "the displacement at XMax",
         [(equation_9(geometry().stroke_plus), geometry().stroke_plus * np.eye(3)[0])], "at XMax"),
    )  # fmt: skip
    for number, sentence, pairs, where in cases:
        gap = max(float(np.abs(matrix - differences(position)).max()) for matrix, position in pairs)
        yield printed.claim(
            f"equation{number}", f"equation ({number})", sentence, gap, judge_limit(gap, _CLOSE), _RULE,
            f"{_HOW}, {where}", printed=0.0,
        )  # fmt: skip
    gap = equation_11_gap()
    yield printed.claim(
        "equation11_rest", "equation (11)", "eleven of the twelve rows are those of the legs' deviations", gap,
        judge_limit(gap, 1e-9), "true where no coefficient is off by more than rounding",
        "printed rows beside the exact model's Jacobian; the first right-hand side is an erratum", printed=0.0,
    )  # fmt: skip
    yield from _range(printed)


def differences(position: Array, step: float = 0.01) -> Array:
    """Return dp / d(drho, dL), shape (3, 6), by central differences of `step` mm at a tool centre point."""
    joints = inverse_kinematics(position[None])
    sides = [[direct_kinematics(joints, s * step * e)[0] for s in (1.0, -1.0)] for e in np.eye(6)]
    return np.array([(above - below) / (2 * step) for above, below in sides]).T


def equation_5(p: Array) -> Array:
    """Return [J_rho; J_L] of (5) as printed, shape (3, 6): two inverses."""
    rho, length = inverse_kinematics(p[None])[0], geometry().length
    own = p - rho
    over_own = np.array([[1.0 if i == j else p[j] / own[i] for j in range(3)] for i in range(3)])
    over_length = np.array([[(own[i] if i == j else p[j]) / length for j in range(3)] for i in range(3)])
    return np.hstack([np.linalg.inv(over_own), np.linalg.inv(over_length)])


def equation_6() -> Array:
    """Return (6) as printed."""
    return np.array([[1.0, 0, 0, -1, 0, 0], [0, 1.0, 0, 0, -1, 0], [0, 0, 1.0, 0, 0, -1]])


def equation_7() -> Array:
    """Return the coefficients of (7): d p_i = d rho_i - d L_i."""
    rows_ = np.zeros((3, 6))
    for i in range(3):
        rows_[i, i], rows_[i, 3 + i] = 1.0, -1.0
    return rows_


def equation_8(axis: int, stroke: float) -> Array:
    """Return (8) as printed for X, its indices moved on for Y and Z; `stroke` below 0 is the Min posture."""
    alpha = np.arcsin(stroke / geometry().length)
    t, c = np.tan(alpha), np.cos(alpha)
    for_x = np.array([[1.0, 0, 0, -1, 0, 0], [t, 1, 0, -t, -1 / c, 0], [t, 0, 1, -t, 0, -1 / c]])
    order = [(k - axis) % 3 for k in range(3)]
    return for_x[np.ix_(order, order + [3 + k for k in order])]


def equation_9(stroke: float) -> Array:
    """Return the coefficients of the three lines of (9), XMax."""
    alpha = np.arcsin(stroke / geometry().length)
    t, c = np.tan(alpha), np.cos(alpha)
    d_px = {"drho_x": 1.0, "dL_x": -1.0}
    d_py = {"drho_x": t, "drho_y": 1.0, "dL_x": -t, "dL_y": -1 / c}
    d_pz = {"drho_x": t, "drho_z": 1.0, "dL_x": -t, "dL_z": -1 / c}
    return np.array([[line.get(name, 0.0) for name in NAMES] for line in (d_px, d_py, d_pz)])


def equation_11_gap() -> float:
    """Return how far (11) as printed is from the exact model's Jacobian, over all rows but the first."""
    exact = make_problem("orthoglide6", data="exp2", free="full", model="exact")
    slopes, labels = exact.jacobian(np.zeros(6)), [r.label for r in exact.plan]
    a, b, c = {}, {}, {}
    for i, alpha in ((1, geometry().alpha_plus), (2, geometry().alpha_minus)):
        a[i], b[i] = np.sin(alpha), (0.5 + np.sin(alpha)) * np.tan(alpha)
        c[i] = (0.5 + np.sin(alpha)) / np.cos(alpha) - 0.5
    worst = 0.0
    for first, second in ("xy", "yz", "xz"):
        for i, sign in ((1, "+"), (2, "-")):
            for along, leg in ((first, second), (second, first)):
                if (along, leg, sign) == ("x", "y", "+"):
                    continue  # the row with the misprinted right-hand side
                line = {f"drho_{along}": a[i], f"drho_{leg}": b[i], f"dL_{along}": -c[i], f"dL_{leg}": -b[i]}
                row = np.array([line.get(name, 0.0) for name in NAMES])
                worst = max(worst, float(np.abs(row - slopes[labels.index(f"{along}_{leg}{sign}")]).max()))
    return worst


def linear_error(x: Array) -> float:
    """Return by how much (11) is off the exact model at most at the parameters x, shape (6,), mm."""
    exact, linear = (kind.residuals(x) - kind.residuals(np.zeros(6)) for kind in _exact_and_linear())
    return float(np.abs(exact - linear).max())


@cache
def _exact_and_linear() -> tuple[Any, Any]:
    exact, linear = (
        make_problem("orthoglide6", data="exp2", free="full", model=model) for model in ("exact", "linear")
    )
    return exact, linear


def linear_range(limit: float) -> float:
    """Return the size [mm] of all six parameters up to which (11) is within `limit` mm whatever their signs."""
    signs = [np.array([1.0 if n >> k & 1 else -1.0 for k in range(6)]) for n in range(64)]
    low, high = 0.0, 10.0
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if max(linear_error(middle * s) for s in signs) <= limit else (low, middle)
    return low


def _range(printed: Printed) -> Iterator[Row]:
    sigma = printed.column("text.section34")["sigma"]
    reach = linear_range(sigma)
    for free, words in (("rho", "offsets"), ("L", "leg lengths"), ("full", "full set")):
        column = printed.column(f"table3.exp2_{free}")
        x = np.array([column.entries[name].value if name in column else 0.0 for name in NAMES])
        off = linear_error(x)
        yield printed.claim(
            f"linearisation_{free}", "Section 3.2, below (11)",
            f"(11) is valid for small values: for the {words} identified in Experiment 2", off,
            judge_limit(off, sigma / 2, sigma),
            "true within half a printed digit, .005 mm, in kind within sigma = .01 mm",
            f"largest distance of (11) from the exact model at row {words} of Table 3",
            f"the largest value is {np.abs(x).max():.2f} mm; parameters up to {reach:.2f} mm, whatever their signs, "
            "are within sigma", "mm", printed=0.0,
        )  # fmt: skip
