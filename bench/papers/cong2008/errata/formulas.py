"""Misprinted formulas and steps of Cong et al. 2008: what each gives as printed, and as it must be."""

from __future__ import annotations

from statistics import NormalDist
from typing import Any

import numpy as np

from calibench.bench.papers.cong2008.tracking import nine_point_rounds
from calibench.bench.papers.evidence import Array, Evidence
from calibench.bench.papers.evidence import problem as make_problem
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row, Tolerance
from calibench.problems.planar.gpm2002 import NAMES, home, inverse_kinematics, makers_machine, to_cartesian, to_polar

_COUNT = Tolerance(0.0, "a count")
_ROUNDING = Tolerance(1e-9, "rounding")


def projector(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of P of (15)."""
    identity, tracking = np.eye(3), make_problem("tracking_zero")
    as_printed = identity - identity @ np.linalg.inv(identity.T) @ identity.T
    ours = np.trace(tracking.projectors, axis1=1, axis2=2)
    return printed.erratum(
        number, "rank of P: infeasible directions of three joints with two degrees of freedom", "1",
        float(np.trace(as_printed)), 3 - 2, ours, _ROUNDING, "trace of P, as printed and as in tracking_zero",
    )  # fmt: skip


def grid(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of the nine points of step 5."""
    listed = {(0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, -1), (1, -1)}  # with R itself; (-1, 1) is listed twice
    compared = printed.column("section24")["estimates"]
    ours = len(nine_point_rounds()[-1]) + 1
    how = "different points in the printed list and in a round of our search"
    return printed.erratum(number, "estimates compared in step 6", "1", len(listed), compared, ours, _COUNT, how)


def squares(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of d of (32)."""
    machine, points, angles = _poses()
    bx, by = _elbows(machine, angles)
    lb = machine[9:12]
    wrong, right = (_centres(bx, by, d) for d in (bx + by - lb, bx**2 + by**2 - lb**2))
    errors = [float(np.abs(centre - points).max()) for centre in (wrong, right)]
    return printed.erratum(
        number, "largest error of the position by (33)", "mm", errors[0], 0.0, errors[1], _ROUNDING,
        "forward kinematics at 50 poses with d_i as printed and with squares",
    )  # fmt: skip


def passive_angle(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of the passive angles (34)."""
    machine, points, angles = _poses()
    bx, by = _elbows(machine, angles)
    dx, dy = points[:, :1] - bx, points[:, 1:] - by
    errors = [
        float(np.hypot(dx - machine[9:12] * np.cos(b), dy - machine[9:12] * np.sin(b)).max())
        for b in (np.arctan(dy / dx), np.arctan2(dy, dx))
    ]  # fmt: skip
    return printed.erratum(
        number, "largest closure error of (29) with the passive angle", "mm", errors[0], 0.0, errors[1], _ROUNDING,
        "closure at 50 poses with arctan of the quotient and with atan2",
    )  # fmt: skip


def home_angles(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of the home angles that (35) lacks."""
    at_home = inverse_kinematics(makers_machine(), home()[None])[0]
    offsets = makers_machine()[12:15]
    as_printed, as_read = at_home - offsets, at_home - at_home - offsets
    return printed.erratum(
        number, "largest reading at the home position, which is defined as zero, without offsets", "rad",
        float(np.abs(as_printed).max()), 0.0, float(np.abs(as_read).max()), _ROUNDING,
        "reading at home by (35) as printed and with the home angles",
    )  # fmt: skip


def equation_36(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of the equation that section 3.1 counts by."""
    column = printed.column("section31")
    ours = column["equations_then"] / column["configurations_needed"]
    how = "equations over configurations of section 3.1; (34) has one a leg, (36) two"
    return printed.erratum(number, "equations a configuration", "1", 3, 6, ours, _COUNT, how)


def first_leg(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of row 1 of (38)."""
    machine, points, angles = _poses()
    bx = _elbows(machine, angles)[0]
    values = []
    for ya in (machine[3], machine[1]):
        y = points[:, 1] - ya - machine[6] * np.sin(angles[:, 0])
        values.append(float(np.abs((points[:, 0] - bx[:, 0]) ** 2 + y**2 - machine[9] ** 2).max()))
    return printed.erratum(
        number, "row 1 of E2 at the actual machine", "mm^2", values[0], 0.0, values[1], _ROUNDING,
        "largest value over 50 poses, with y_a2 and with y_a1",
    )  # fmt: skip


def decoupled(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of (44)."""
    machine = _poses()[0]
    moved = to_cartesian(machine)
    as_printed = (moved[6:9] * 2 + moved[12:15] * 2) * 0.5
    as_read = to_polar(moved, machine[12:15])[6:9]
    errors = [float(np.abs(found_ - machine[6:9]).max()) for found_ in (as_printed, as_read)]
    return printed.erratum(
        number, "largest error of l_a recovered from (l_a cos, l_a sin)", "mm", errors[0], 0.0, errors[1], _ROUNDING,
        "Table 5's machine there and back",
    )  # fmt: skip


def components(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of the components of delta_m."""
    ours = make_problem("tracking_zero").projectors.shape[-1]
    return printed.erratum(
        number, "components of delta_m", "1", 2, 3, ours, _COUNT, "order of P_j, which is applied to it"
    )


def indices(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of the range of i."""
    samples = printed.column("section44")["samples"]
    ours = make_problem("full12").readings.shape[1]
    return printed.erratum(
        number, "range of i, the joints", "1", samples, 3, ours, _COUNT, "readings of one configuration"
    )


def uniform(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of the random numbers of (47)."""
    from calibench.optimizers.own._random_kernels import random_state, uniform

    with np.errstate(over="ignore"):
        state = random_state(np.random.default_rng(1))
        drawn = np.array([float(uniform(state)) for _ in range(2000)])
    normal = NormalDist()
    outside = 1 - (normal.cdf(1) - normal.cdf(0))
    return printed.erratum(
        number, "share of randb outside [0, 1]", "1", outside, 0.0, float(((drawn < 0) | (drawn > 1)).mean()), _COUNT,
        "a standard normal number, and 2000 numbers of our generator",
    )  # fmt: skip


def _poses() -> tuple[Array, Array, Array]:
    """Return Table 5's actual machine, positions in its workspace, and its joint angles there."""
    problem: Any = make_problem("full12")
    machine = makers_machine()
    for p in problem.parameters:
        machine[NAMES.index(p.name)] = p.true
    return machine, problem.true_positions, inverse_kinematics(machine, problem.true_positions)


def _elbows(machine: Array, angles: Array) -> tuple[Array, Array]:
    """Return the passive joints, shapes (n, 3) each, eq. (30)."""
    return machine[0:6:2] + machine[6:9] * np.cos(angles), machine[1:6:2] + machine[6:9] * np.sin(angles)


def _centres(bx: Array, by: Array, d: Array) -> Array:
    """Return the positions of eq. (33), shape (n, 2)."""
    ring = [(0, 1, 2), (1, 2, 0), (2, 0, 1)]
    below = 2 * sum(bx[:, i] * (by[:, j] - by[:, k]) for i, j, k in ring)
    x = sum(d[:, i] * (by[:, j] - by[:, k]) for i, j, k in ring) / below
    y = sum(d[:, i] * (bx[:, k] - bx[:, j]) for i, j, k in ring) / below
    return np.column_stack([x, y])
