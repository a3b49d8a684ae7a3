"""Geometry, counts and equations of Pashkevich et al. 2008, and the linear fits (11) of the printed data.

The leg length follows from the workspace, a cube of 200 mm in which the transmission factors stay between 1/2 and 2.
A tolerance is what half a digit of each datum does to a fitted number, carried through the fit; so is a slip.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any, final

import numpy as np

from calibench import problems
from calibench.bench.papers.ledger import Array, Printed, Row, Tolerance, problem as make_problem
from calibench.problems import constants
from calibench.problems.orthoglide import kinematics
from calibench.problems.orthoglide.kinematics import AXES, geometry
from calibench.problems.orthoglide.plans import covariance, paper_plan

HALF = 0.005  # mm: half a printed digit of every deviation
# the two data that all printed results contradict: label of the reading, and the erratum that says what to read
SLIPS = {
    "exp1": ("x_z", "Table 1, Measurements #1, x_z"),
    "exp3_t2": ("x_z-", "Table 2, Experiment 3, 'Exper. data', x_z_minus"),
}
_EXACT = Tolerance(0.0, "a given or counted number")
_CLOSES = Tolerance(1e-9, "rounding")


def rows(printed: Printed) -> Iterator[Row]:
    """Yield geometry, sections 2.1 to 3.1, equations (11) and (14)."""
    yield from _geometry(printed)
    yield printed.unknown("text.section22.leg_dof", "how a leg's joints are made does not enter the model")
    key, matrix = "text.section23", kinematics.posture_jacobian()
    yield printed.cell(f"{key}.equations", matrix.shape[0], _EXACT, "rows of the Jacobian of (2)")
    for name, value in (("rho_min", "stroke_minus"), ("rho_max", "stroke_plus")):
        yield printed.cell(f"{key}.{name}", printed.column("geometry")[value], _EXACT, "the strokes from Zero")
    at_zero = kinematics.direct_kinematics(np.full((1, 3), geometry().length))[0]
    for axis, value in zip(AXES, at_zero, strict=True):
        yield printed.cell(f"{key}.zero_{axis}", float(value), _CLOSES, "direct kinematics at rho = (L, L, L)")
    yield printed.cell(f"{key}.parameters", matrix.shape[1], _EXACT, "columns of the Jacobian of (2)")
    key, position = "text.section24", np.array([20.0, -30.0, 10.0])
    rho = kinematics.inverse_kinematics(position[None])[0]
    signs = product((1.0, -1.0), repeat=3)
    closed = [s for s in signs if closure(position, position + np.array(s) * (rho - position)) < 1e-9]
    yield printed.cell(f"{key}.solutions", len(closed), _EXACT, "signs (s_x, s_y, s_z) of (3) for which (2) closes")
    roots = [s for s in (1.0, -1.0) if closure(direct_roots(rho, s), rho) < 1e-9]
    yield printed.cell(f"{key}.direct_solutions", len(roots), _EXACT, "roots of (4) for which (2) closes")
    for axis, value in zip(AXES, np.sign(geometry().length - at_zero), strict=True):
        yield printed.cell(f"{key}.s_{axis}", float(value), _EXACT, "sign of rho - p at Zero")
    plan = paper_plan()
    directions = len({r.direction for r in plan if r.leg == "x"})
    yield printed.cell("text.section31.gauges", directions, _EXACT, "directions read on a leg in the plan of 12")
    matrix = kinematics.calibration_matrix()  # equations (11) and (14)
    yield printed.cell("equation11.equations", matrix.shape[0], _EXACT, "rows of the matrix of (11)")
    rank, columns = int(np.linalg.matrix_rank(matrix)), f"of {len(kinematics.NAMES)} columns"
    yield printed.cell("equation11.unknowns", rank, _EXACT, "rank of the matrix of (11)", reason=columns)
    alpha = geometry().alpha_plus
    exact = make_problem("orthoglide6", data="exp2", free="full", model="exact")
    slope = float(exact.jacobian(np.zeros(6))[0, kinematics.NAMES.index("drho_y")])  # x_y+, b_1 = (mu + sin) tan
    yield printed.cell(
        "equation11.gauge_fraction", slope / np.tan(alpha) - np.sin(alpha), _CLOSES,
        "solved from b_1 of (11), taken from the exact model's Jacobian",
    )  # fmt: skip
    spread = covariance(plan)  # E(ds ds^T) / sigma^2
    linked = np.linalg.matrix_power((spread > 0).astype(float), len(plan)) > 0
    gauges = len({tuple(row) for row in linked.tolist()})
    same, other = [], []
    for (i, a), (j, b) in product(enumerate(plan), repeat=2):
        if (a.leg, a.direction) != (b.leg, b.direction):
            other.append(float(spread[i, j]))
        elif i != j:
            same.append(float(spread[i, j]))
    how = "covariance counted from the gauge readings that the plan's deviations share"
    yield printed.cell("equation14.size", len(spread), _EXACT, how)
    pairs, independent = len({frozenset((r.leg, r.direction)) for r in plan}), f"the {gauges} gauges are independent"
    yield printed.cell("equation14.blocks", pairs, _EXACT, "pairs of a leg and a direction", reason=independent)
    for name, values in (("diagonal", np.diag(spread)), ("same_gauge", same), ("other", other)):
        yield printed.cell(f"equation14.g_{name}", values, _EXACT, how)


def _geometry(printed: Printed) -> Iterator[Row]:
    key, section, ends = "text.section21", printed.column("text.section21"), []
    # the cube on whose diagonal the transmission factors are within the printed 1/2 and 2
    for direction in (-1.0, 1.0):
        near, far = 0.0, direction * geometry().length / np.sqrt(5)
        for _ in range(60):
            middle = (near + far) / 2
            factors = transmission(np.full(3, middle))
            within = section["transmission_lower"] <= factors.min() and factors.max() <= section["transmission_upper"]
            near, far = (middle, far) if within else (near, middle)
        ends.append(near)
    side = ends[1] - ends[0]
    length, workspace = printed.column("geometry")["L"], section["workspace_x"]
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
    dof = int(np.linalg.matrix_rank(kinematics.posture_jacobian()[:, :3]))
    yield printed.cell(f"{key}.dof", dof, _EXACT, "rank of dp / drho at Zero")
    yield printed.cell(f"{key}.legs", len(AXES), _EXACT, "legs of the model")
    factors = transmission(np.zeros(3))
    yield printed.cell(f"{key}.transmission_isotropic", factors, _CLOSES, "singular values of dp / drho at Zero")
    for axis in AXES:
        yield printed.cell(
            f"{key}.workspace_{axis}", side, Tolerance(0.5, "half a printed digit"),
            "side of the cube along whose diagonal the transmission factors are within 1/2 and 2",
        )  # fmt: skip

    # the cube of the printed side that fits best: the largest factor, or inverse factor, is alike at both of its ends
    def worst(q: float) -> float:
        factors = transmission(np.full(3, q))
        return float(max(factors.max(), 1 / factors.min()))

    near, far = 0.0, workspace / 2
    for _ in range(60):
        middle = (near + far) / 2
        near, far = (middle, far) if worst(middle) < worst(middle - workspace) else (near, middle)
    both = np.concatenate([transmission(np.full(3, near - workspace)), transmission(np.full(3, near))])
    for name, value in (("lower", both.min()), ("upper", both.max())):
        yield printed.cell(
            f"{key}.transmission_{name}", float(value),
            Tolerance(0.02, "what half a digit of the printed workspace, .5 mm at an end, is worth at most"),
            "extreme singular value of dp / drho at the two ends of the diagonal of a cube of the printed side",
        )  # fmt: skip


def transmission(position: Array) -> Array:
    """Return the velocity transmission factors, shape (3,): singular values of dp / drho."""
    joints = kinematics.inverse_kinematics(position[None])[0]
    legs = np.tile(position, (3, 1)) - np.diag(joints)
    return np.asarray(np.linalg.svd(np.linalg.solve(legs, np.diag(position - joints)), compute_uv=False))


def angle_row(printed: Printed, key: str, end: str) -> Row:
    """Return the row of a printed posture angle."""
    alpha = geometry().alpha_plus if end == "plus" else geometry().alpha_minus
    millimetre = float(np.degrees(1 / (geometry().length * np.cos(alpha))))
    tolerance = Tolerance(0.05, "half a printed digit; in kind: what 1 mm of the stroke is worth", millimetre)
    return printed.cell(key, float(np.degrees(alpha)), tolerance, "asin(stroke / L)")


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


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """A linear least squares fit of printed data, mm; `slip` is what the datum believed misprinted would change.

    `labels` are the cells' names of the readings, x_y_plus or x_y; `solver` is the pseudo-inverse, shape (dim, m), `x`
    the parameters, `predictor` turns data into predictions, shape (m, m), `residuals` is what the fit leaves.
    """

    problem: Any
    data: Array
    slip: Array
    labels: list[str]
    solver: Array
    x: Array
    predictor: Array
    residuals: Array

    @property
    def residual_maker(self) -> Array:
        return np.eye(len(self.data)) - self.predictor

    def datum_behind(self, label: str, cells: Array, data: Array) -> tuple[float, float]:
        """Return the datum `label` that gives the printed `cells` (six residuals or twelve predictions), and its slack,
        mm: what half a digit of each cell and of each other datum is worth."""
        matrix = self.residual_maker if len(cells) == 6 else self.predictor
        at = self.labels.index(label)
        weights = matrix[:, at] / (matrix[:, at] @ matrix[:, at])
        others = np.delete(weights @ matrix, at)
        slack = HALF * float(np.abs(weights).sum() + np.abs(others).sum())
        return float(data[at] + weights @ (cells - matrix @ data)), slack

    def tolerance(self, rows: Array, what: str) -> Tolerance:
        """Return the tolerance of ``rows @ data``, rows of shape (m,): its own rounding and that of the data."""
        exact = HALF + HALF * float(np.abs(rows).sum()) + 1e-9
        why = f"half a printed digit of {what} and of each datum, as far as the fit carries it"
        if not self.slip.any():
            return Tolerance(exact, why)
        slipped = float(abs(rows @ self.slip))
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
    matrix = np.asarray(problem.jacobian(problem.start))
    solver = np.linalg.pinv(matrix)
    predictor = matrix @ solver
    return Fit(
        problem=problem, data=values, slip=slip, solver=solver, x=solver @ values, predictor=predictor,
        labels=[r.label.replace("+", "_plus").replace("-", "_minus") for r in problem.plan],
        residuals=values - predictor @ values,
    )  # fmt: skip


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


def rms_row(printed: Printed, key: str, values: Array, method: str, slip: Array | None = None) -> Row:
    """Return the row of a printed rms of `values`; `slip` is what the datum believed misprinted changes in them."""
    return printed.cell(key, rms(values), rms_tolerance(values, 1, slip), method)


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
    entries = printed.column("geometry").entries
    angles = (geometry().alpha_plus, geometry().alpha_minus)
    if printed_angles:
        angles = (float(np.radians(entries["alpha_plus"].printed)), float(np.radians(entries["alpha_minus"].printed)))
    inverse = np.linalg.pinv(kinematics.calibration_matrix(*angles))
    spread = inverse @ covariance(paper_plan()) @ inverse.T
    return float(printed.column("text.section34")["sigma"] * np.sqrt(np.diag(spread))[:3].mean())
