"""Geometry, counts and equations of Pashkevich et al. 2008: given numbers from other prints, counts from models.

The leg length follows from the workspace: it is what makes a cube of 200 mm the one in which the transmission factors
stay between 1/2 and 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from calibench.bench.papers.evidence import Array
from calibench.bench.papers.evidence import problem as make_problem
from calibench.bench.papers.pashkevich2008.fits import covariance_of_plan
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row, Tolerance
from calibench.problems.orthoglide.kinematics import (
    AXES,
    NAMES,
    calibration_matrix,
    direct_kinematics,
    geometry,
    inverse_kinematics,
    posture_jacobian,
)
from calibench.problems.orthoglide.plans import paper_plan

_EXACT = Tolerance(0.0, "a given or counted number")
_CLOSES = Tolerance(1e-9, "rounding")


def rows(printed: Printed) -> Iterator[Row]:
    """Yield geometry, sections 2.1 to 3.1, equations (11) and (14)."""
    yield from _geometry(printed)
    yield from _section21(printed)
    yield printed.unknown("text.section22.leg_dof", "how a leg's joints are made does not enter the model")
    yield from _section23(printed)
    yield from _section24(printed)
    plan = paper_plan()
    directions = len({r.direction for r in plan if r.leg == "x"})
    yield printed.cell("text.section31.gauges", directions, _EXACT, "directions read on a leg in the plan of 12")
    yield from _equation11(printed)
    yield from _equation14(printed)


def workspace_side() -> float:
    """Return the side [mm] of the cube on whose diagonal the transmission factors are within the printed 1/2 and 2."""
    lower, upper = _bounds()
    ends = []
    for direction in (-1.0, 1.0):
        near, far = 0.0, direction * geometry().length / np.sqrt(5)
        for _ in range(60):
            middle = (near + far) / 2
            factors = transmission(np.full(3, middle))
            near, far = (middle, far) if lower <= factors.min() and factors.max() <= upper else (near, middle)
        ends.append(near)
    return ends[1] - ends[0]


def transmission(position: Array) -> Array:
    """Return the velocity transmission factors, shape (3,): singular values of dp / drho."""
    joints = inverse_kinematics(position[None])[0]
    left = np.tile(position, (3, 1)) - np.diag(joints)
    return np.asarray(np.linalg.svd(np.linalg.solve(left, np.diag(position - joints)), compute_uv=False))


def _bounds() -> tuple[float, float]:
    column = Printed("pashkevich2008").column("text.section21")
    return column["transmission_lower"], column["transmission_upper"]


def direct_roots(rho: Array, sign: float, pairs: int = 1) -> Array:
    """Return the tool centre point by (4), shape (3,), for the root of `sign`; `pairs` is how often A counts a pair."""
    squares, length = rho**2, geometry().length
    a = pairs * (squares[0] * squares[1] + squares[1] * squares[2] + squares[0] * squares[2])
    b = float(np.prod(squares))
    c = b * (squares.sum() / 4 - length**2)
    t = (-b + sign * np.sqrt(b**2 - 4 * a * c)) / (2 * a)
    return np.asarray(rho / 2 + t / rho)  # eq. (4)


def closure(position: Array, rho: Array) -> float:
    """Return by how much (2) fails at most, mm."""
    legs = np.linalg.norm(np.tile(position, (3, 1)) - np.diag(rho), axis=1)
    return float(np.abs(legs - geometry().length).max())


def _geometry(printed: Printed) -> Iterator[Row]:
    length, side = printed.column("geometry")["L"], workspace_side()
    said = printed.column("text.section21")["workspace_x"]
    yield printed.cell(
        "geometry.L", length * said / side,
        Tolerance(0.5 * length / said, "what half of the last digit, 1 mm, of the printed workspace is worth"),
        "solved from the workspace: the length that gives a cube of 200 mm for factors between 1/2 and 2",
    )  # fmt: skip
    for name in ("d", "r"):
        yield printed.unknown(f"geometry.{name}", "it does not enter the model (2)")
    for end, limit in (("plus", "rho_max"), ("minus", "rho_min")):
        other = printed.column("text.section41")[limit]
        yield printed.cell(f"geometry.stroke_{end}", other, _EXACT, "the same limit in section 4.1")
    for end in ("plus", "minus"):
        yield angle_row(printed, f"geometry.alpha_{end}", end)


def angle_row(printed: Printed, key: str, end: str) -> Row:
    """Return the row of a printed posture angle."""
    alpha = geometry().alpha_plus if end == "plus" else geometry().alpha_minus
    millimetre = float(np.degrees(1 / (geometry().length * np.cos(alpha))))
    tolerance = Tolerance(0.05, "half a printed digit; in kind: what 1 mm of the stroke is worth", millimetre)
    return printed.cell(key, float(np.degrees(alpha)), tolerance, "asin(stroke / L)")


def _section21(printed: Printed) -> Iterator[Row]:
    at_zero = posture_jacobian()[:, :3]
    key = "text.section21"
    dof = int(np.linalg.matrix_rank(at_zero))
    yield printed.cell(f"{key}.dof", dof, _EXACT, "rank of dp / drho at Zero")
    yield printed.cell(f"{key}.legs", len(AXES), _EXACT, "legs of the model")
    factors = transmission(np.zeros(3))
    yield printed.cell(f"{key}.transmission_isotropic", factors, _CLOSES, "singular values of dp / drho at Zero")
    side = workspace_side()
    for axis in AXES:
        yield printed.cell(
            f"{key}.workspace_{axis}", side, Tolerance(0.5, "half a printed digit"),
            "side of the cube along whose diagonal the transmission factors are within 1/2 and 2",
        )  # fmt: skip
    # the cube of the printed side that fits the bounds best: both of its ends are at a bound
    low, high = _cube_ends(printed.column(key)["workspace_x"])
    both = np.concatenate([transmission(np.full(3, low)), transmission(np.full(3, high))])
    for name, value in (("lower", both.min()), ("upper", both.max())):
        yield printed.cell(
            f"{key}.transmission_{name}", float(value),
            Tolerance(0.02, "what half a digit of the printed workspace, .5 mm at an end, is worth at most"),
            "extreme singular value of dp / drho at the two ends of the diagonal of a cube of the printed side",
        )  # fmt: skip


def _cube_ends(side: float) -> tuple[float, float]:
    """Return the ends of the cube of this side that has the same largest factor, or inverse factor, at both."""

    def worst(q: float) -> float:
        factors = transmission(np.full(3, q))
        return float(max(factors.max(), 1 / factors.min()))

    near, far = 0.0, side / 2
    for _ in range(60):
        middle = (near + far) / 2
        near, far = (middle, far) if worst(middle) < worst(middle - side) else (near, middle)
    return near - side, near


def _section23(printed: Printed) -> Iterator[Row]:
    key = "text.section23"
    matrix = posture_jacobian()
    yield printed.cell(f"{key}.equations", matrix.shape[0], _EXACT, "rows of the Jacobian of (2)")
    for name, value in (("rho_min", "stroke_minus"), ("rho_max", "stroke_plus")):
        stroke = printed.column("geometry")[value]
        yield printed.cell(f"{key}.{name}", stroke, _EXACT, "the strokes from Zero")
    at_zero = direct_kinematics(np.full((1, 3), geometry().length))[0]
    for axis, value in zip(AXES, at_zero, strict=True):
        yield printed.cell(f"{key}.zero_{axis}", float(value), _CLOSES, "direct kinematics at rho = (L, L, L)")
    yield printed.cell(f"{key}.parameters", matrix.shape[1], _EXACT, "columns of the Jacobian of (2)")


def _section24(printed: Printed) -> Iterator[Row]:
    key = "text.section24"
    position = np.array([20.0, -30.0, 10.0])
    rest = inverse_kinematics(position[None])[0] - position
    closed = [s for s in product((1.0, -1.0), repeat=3) if closure(position, position + np.array(s) * rest) < 1e-9]
    yield printed.cell(f"{key}.solutions", len(closed), _EXACT, "signs (s_x, s_y, s_z) of (3) for which (2) closes")
    rho = inverse_kinematics(position[None])[0]
    roots = [s for s in (1.0, -1.0) if closure(direct_roots(rho, s), rho) < 1e-9]
    yield printed.cell(f"{key}.direct_solutions", len(roots), _EXACT, "roots of (4) for which (2) closes")
    joints = direct_kinematics(np.full((1, 3), geometry().length))[0]
    for axis, value in zip(AXES, np.sign(geometry().length - joints), strict=True):
        yield printed.cell(f"{key}.s_{axis}", float(value), _EXACT, "sign of rho - p at Zero")


def _equation11(printed: Printed) -> Iterator[Row]:
    matrix = calibration_matrix()
    yield printed.cell("equation11.equations", matrix.shape[0], _EXACT, "rows of the matrix of (11)")
    rank = int(np.linalg.matrix_rank(matrix))
    yield printed.cell("equation11.unknowns", rank, _EXACT, "rank of the matrix of (11)", f"of {len(NAMES)} columns")
    alpha = geometry().alpha_plus
    exact = make_problem("orthoglide6", data="exp2", free="full", model="exact")
    slope = float(exact.jacobian(np.zeros(6))[0, NAMES.index("drho_y")])  # x_y+, b_1 = (mu + sin) tan
    yield printed.cell(
        "equation11.gauge_fraction", slope / np.tan(alpha) - np.sin(alpha), _CLOSES,
        "solved from b_1 of (11), taken from the exact model's Jacobian",
    )  # fmt: skip


def _equation14(printed: Printed) -> Iterator[Row]:
    spread, plan = covariance_of_plan(), paper_plan()
    linked = np.linalg.matrix_power((spread > 0).astype(float), len(plan)) > 0
    gauges = len({tuple(row) for row in linked.tolist()})
    same = [
        float(spread[i, j])
        for i, a in enumerate(plan) for j, b in enumerate(plan)
        if i != j and (a.leg, a.direction) == (b.leg, b.direction)
    ]  # fmt: skip
    other = [
        float(spread[i, j])
        for i, a in enumerate(plan) for j, b in enumerate(plan)
        if (a.leg, a.direction) != (b.leg, b.direction)
    ]  # fmt: skip
    how = "covariance counted from the gauge readings that the plan's deviations share"
    yield printed.cell("equation14.size", len(spread), _EXACT, how)
    pairs = len({frozenset((r.leg, r.direction)) for r in plan})
    yield printed.cell(
        "equation14.blocks", pairs, _EXACT, "pairs of a leg and a direction", f"the {gauges} gauges are independent"
    )
    yield printed.cell("equation14.g_diagonal", np.diag(spread), _EXACT, how)
    yield printed.cell("equation14.g_same_gauge", same, _EXACT, how)
    yield printed.cell("equation14.g_other", other, _EXACT, how)
