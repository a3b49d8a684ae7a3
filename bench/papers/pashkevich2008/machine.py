"""Geometry, counts and equations of Pashkevich et al. 2008: given numbers from other prints, counts from models.

The leg length follows from the workspace: it is what makes a cube of 200 mm the one in which the transmission factors
stay between 1/2 and 2.

What the rows of Pashkevich et al. 2008 are computed from: the linear fits (11) of the printed data, and their slack.

All printed data are rounded to .01 mm. What half a digit of each datum may do to a fitted number is its row of the
fit's matrix, so a tolerance here is not chosen but carried through the fit; so is a slip of one datum.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any, final

import numpy as np

from calibench import problems
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Array, Row, Tolerance
from calibench.bench.papers.row import problem as make_problem
from calibench.problems import constants
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
    legs = np.tile(position, (3, 1)) - np.diag(joints)
    return np.asarray(np.linalg.svd(np.linalg.solve(legs, np.diag(position - joints)), compute_uv=False))


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
    workspace = printed.column("text.section21")["workspace_x"]
    yield printed.cell(
        "geometry.L", length * workspace / side,
        Tolerance(0.5 * length / workspace, "what half of the last digit, 1 mm, of the printed workspace is worth"),
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
    yield printed.cell(
        "equation11.unknowns", rank, _EXACT, "rank of the matrix of (11)", reason=f"of {len(NAMES)} columns"
    )
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
        "equation14.blocks",
        pairs,
        _EXACT,
        "pairs of a leg and a direction",
        reason=f"the {gauges} gauges are independent",
    )
    yield printed.cell("equation14.g_diagonal", np.diag(spread), _EXACT, how)
    yield printed.cell("equation14.g_same_gauge", same, _EXACT, how)
    yield printed.cell("equation14.g_other", other, _EXACT, how)


HALF = 0.005  # mm: half a printed digit of every deviation
# the two data that all printed results contradict: label of the reading, and the erratum that says what to read
SLIPS = {
    "exp1": ("x_z", "Table 1, Measurements #1, x_z"),
    "exp3_t2": ("x_z-", "Table 2, Experiment 3, 'Exper. data', x_z_minus"),
}


@final
@dataclass(frozen=True, eq=False)
class Fit:
    """A linear least squares fit of printed data; `slip` is what the datum believed misprinted would change, mm."""

    problem: Any
    matrix: Array
    data: Array
    slip: Array

    @property
    def labels(self) -> list[str]:
        """Return the cells' names of the readings: x_y_plus or x_y."""
        return [r.label.replace("+", "_plus").replace("-", "_minus") for r in self.problem.plan]

    @property
    def solver(self) -> Array:
        """Return the pseudo-inverse, shape (dim, m)."""
        return np.asarray(np.linalg.pinv(self.matrix))

    @property
    def x(self) -> Array:
        """Return the parameters, mm."""
        return np.asarray(self.solver @ self.data)

    @property
    def predictor(self) -> Array:
        """Return the matrix that turns data into predictions, shape (m, m)."""
        return np.asarray(self.matrix @ self.solver)

    def datum_behind(self, label: str, cells: Array, data: Array) -> tuple[float, float]:
        """Return the datum `label` that gives the printed `cells` with all other `data` as they are, and its slack, mm.

        Six cells are residuals (Table 1), twelve are predictions (Table 2); least squares over all of them. The slack
        is what half a digit of each cell, and of each other datum, is worth.
        """
        matrix = np.eye(6) - self.predictor if len(cells) == 6 else self.predictor
        at = self.labels.index(label)
        weights = matrix[:, at] / (matrix[:, at] @ matrix[:, at])
        others = np.delete(weights @ matrix, at)
        slack = HALF * float(np.abs(weights).sum() + np.abs(others).sum())
        return float(data[at] + weights @ (cells - matrix @ data)), slack

    def tolerance(self, rows: Array, what: str) -> Tolerance:
        """Return the tolerance of ``rows @ data``, rows of shape (m,): its own rounding and that of the data."""
        exact = HALF + HALF * float(np.abs(rows).sum()) + 1e-9
        slipped = float(abs(rows @ self.slip))
        why = f"half a printed digit of {what} and of each datum, as far as the fit carries it"
        if not self.slip.any():
            return Tolerance(exact, why)
        return Tolerance(exact, why + "; in kind: and the datum believed misprinted", exact + slipped)


@cache
def fitted(data: str, free: str, repaired: bool = False) -> Fit:
    """Return the fit of a printed set; `repaired` reads the datum believed misprinted as it must be."""
    problem: Any = make_problem("orthoglide6", data=data, free=free, model="linear")
    values = np.array(problem.deviations)
    slip = np.zeros_like(values)
    if data in SLIPS:
        label, place = SLIPS[data]
        read = next(e["value"] for e in constants.document("pashkevich2008")["erratum"] if e["place"] == place)
        at = [r.label for r in problem.plan].index(label)
        slip[at] = read - values[at]
        if repaired:
            values, slip = values + slip, 0 * slip
            problem = problems.orthoglide6.from_readings(values, plan=problem.plan, free=free, model="linear")
    return Fit(problem, np.asarray(problem.jacobian(problem.start)), values, slip)


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.asarray(values) ** 2)))


def rms_tolerance(values: Array, rounded: int = 1, slip: Array | None = None) -> Tolerance:
    """Return the tolerance of a printed rms of `values`, each the sum of `rounded` printed numbers."""
    slope = np.asarray(values) / (len(values) * rms(values))
    in_kind = HALF + rounded * HALF * float(np.abs(slope).sum()) + (abs(float(slope @ slip)) if slip is not None else 0)
    why = "half a printed digit; in kind: and half a digit of each number it is computed from"
    if slip is not None and slip.any():
        why += ", and the datum believed misprinted"
    return Tolerance(HALF + 1e-9, why, in_kind)


def table1(printed: Printed, key: str) -> Array:
    """Return the six deviations of a row of Table 1, as printed, in the order of the fits."""
    entries = printed.column(f"table1.{key}").entries
    return np.array([entries[label].printed for label in fitted("exp1", "rho").labels])


def table2(printed: Printed, key: str) -> Array:
    """Return the twelve deviations of a column of Table 2, as read, in the order of the fits."""
    entries = printed.column(f"table2.{key}").entries
    return np.array([entries[label].value for label in fitted("exp2", "full").labels])


def table2_differences() -> dict[str, dict[str, float]]:
    """Return the six differences, Max minus Min, of Table 2's experiments by x_y and so on."""
    differences = {}
    for name in ("exp2", "exp3_t2"):
        fit = fitted(name, "full")
        by = {r.label: float(v) for r, v in zip(fit.problem.plan, fit.data, strict=True)}
        differences[name] = {label[:-1]: by[label] - by[f"{label[:-1]}-"] for label in by if label.endswith("+")}
    return differences


def accuracy(printed: Printed, printed_angles: bool) -> float:
    """Return the mean standard error of drho [mm] by (12) and (14), at the printed or at the exact angles."""
    column = printed.column("geometry")
    angles = (geometry().alpha_plus, geometry().alpha_minus)
    if printed_angles:
        entries = column.entries
        angles = (float(np.radians(entries["alpha_plus"].printed)), float(np.radians(entries["alpha_minus"].printed)))
    inverse = np.linalg.pinv(calibration_matrix(*angles))
    spread = inverse @ covariance_of_plan() @ inverse.T
    return float(printed.column("text.section34")["sigma"] * np.sqrt(np.diag(spread))[:3].mean())


def covariance_of_plan() -> Array:
    """Return E(ds ds^T) / sigma^2 of the paper's plan, counted from the readings its deviations share."""
    from calibench.problems.orthoglide.plans import covariance, paper_plan

    return covariance(paper_plan())
