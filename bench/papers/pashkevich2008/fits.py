"""What the rows of Pashkevich et al. 2008 are computed from: the linear fits (11) of the printed data, and their slack.

All printed data are rounded to .01 mm. What half a digit of each datum may do to a fitted number is its row of the
fit's matrix, so a tolerance here is not chosen but carried through the fit; so is a slip of one datum.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, final

import numpy as np

from calibench import problems
from calibench.bench.papers.evidence import Array
from calibench.bench.papers.evidence import problem as make_problem
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Tolerance
from calibench.problems import constants
from calibench.problems.orthoglide.kinematics import calibration_matrix, geometry

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
    found = {}
    for name in ("exp2", "exp3_t2"):
        fit = fitted(name, "full")
        by = {r.label: float(v) for r, v in zip(fit.problem.plan, fit.data, strict=True)}
        found[name] = {label[:-1]: by[label] - by[f"{label[:-1]}-"] for label in by if label.endswith("+")}
    return found


def accuracy(printed: Printed, printed_angles: bool) -> float:
    """Return the mean standard error of drho [mm] by (12) and (14), at the printed or at the exact angles."""
    column = printed.column("geometry")
    angles = (geometry().alpha_plus, geometry().alpha_minus)
    if printed_angles:
        said = column.entries
        angles = (float(np.radians(said["alpha_plus"].printed)), float(np.radians(said["alpha_minus"].printed)))
    inverse = np.linalg.pinv(calibration_matrix(*angles))
    spread = inverse @ covariance_of_plan() @ inverse.T
    return float(printed.column("text.section34")["sigma"] * np.sqrt(np.diag(spread))[:3].mean())


def covariance_of_plan() -> Array:
    """Return E(ds ds^T) / sigma^2 of the paper's plan, counted from the readings its deviations share."""
    from calibench.problems.orthoglide.plans import covariance, paper_plan

    return covariance(paper_plan())
