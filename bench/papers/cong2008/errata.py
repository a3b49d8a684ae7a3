"""The errata of Cong et al. 2008, each with the computation that shows it.

For a formula, `printed` is the number that the printed formula gives, `read` the number it must give, and ours what the
corrected formula gives. A new erratum in the data file without its computation here is an error.

Misprinted formulas and steps of Cong et al. 2008: what each gives as printed, and as it must be.

Misprinted and doubtful numbers of Cong et al. 2008, each compared with other prints or with a computation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from math import nan
from statistics import NormalDist
from typing import Any

import numpy as np

from calibench import bench, optimizers
from calibench.bench.papers.cong2008.machine import Column, columns, implied
from calibench.bench.papers.cong2008.tracking import nine_point_rounds
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Array, Evidence, Row, Ruling, Tolerance, found, judge_near
from calibench.bench.papers.row import problem as make_problem
from calibench.problems.planar.gpm2002 import NAMES, home, inverse_kinematics, makers_machine, to_cartesian, to_polar


def la3(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of l_a3 of Tables 3 and 4."""
    entry = printed.column("table3.j3").entries["la3"]
    values = [implied(printed, table, "la3") for table in ("table3", "table4")]
    tolerance = Tolerance(max(worth for _, worth in values), "what 1e-5 rad of the printed initial z3 is worth")
    return printed.erratum(
        number, "l_a3", "mm", entry.printed, entry.value, [value for value, _ in values], tolerance,
        "solved from the initial offsets of Tables 3 and 4",
    )  # fmt: skip


def from_curve(cells: tuple[str, ...]) -> Shown:
    def show(printed: Printed, _: Evidence, number: int) -> Row:
        column: Column = columns(printed)[0]
        entries = printed.column(column.key).entries
        curve = {n: column.predicted(n) for n in cells}
        wrong = max(abs(entries[n].printed - curve[n]) for n in cells)
        right = [abs(entries[n].value - curve[n]) for n in cells]
        return printed.erratum(
            number, "largest distance of these cells from the gauge curve", "mm", wrong, 0.0, right,
            Tolerance(1e-3, "the sound cells lie within 7e-4 mm of it"), "the curve, fitted to the other lengths",
        )  # fmt: skip

    return show


def two_machines(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of l_b3, which changes between tables."""
    values = [implied(printed, table, "lb3") for table in ("table3", "table4")]
    said = printed.column("table3.actual")["lb3"]
    tolerance = Tolerance(max(worth for _, worth in values), "what 1e-5 rad of the printed initial z3 is worth")
    return printed.erratum(
        number, "l_b3 of Tables 3 and 4", "mm", said, said, [value for value, _ in values], tolerance,
        f"solved from their initial offsets; Table 7's curve needs {columns(printed)[1].problem.gauge_curve(0.0)[8]:g}",
    )  # fmt: skip


def undecidable(printed: Printed, evidence: Evidence, number: int) -> Row:
    """Return the row of GA under J1, printed twice."""
    table, text = printed.column("table6.ga")["j1"], printed.column("text")["ga_j1"]
    runs = found(evidence.of("cong2008", "full12", "ga", {"error": "J1", "gauge": "xa2"}), "best_value")
    spread = float(np.std(np.log10(runs))) if len(runs) > 1 else nan
    apart = float(abs(np.log10(text / table)))
    decided = apart > 2 * spread
    return printed.erratum(
        number, "difference of the two prints, in decades; ours: spread of repetitions", "1",
        apart, apart, spread,
        Tolerance(apart / 2, "decided where two deviations of repetitions are less than the difference"),
        "standard deviation of log10 J1 of ga",
        Ruling("not reproduced" if decided else "not checkable", spread, "at most", apart / 2),
        differs="it asks which of two digits is right, the cells whether the level is reached",
    )  # fmt: skip


def figure(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of the figure that a level is said to be in."""
    level = printed.column("text")["de_j3"]
    column = printed.column("table6.de")
    ours = 3 + [column[name] for name in column].index(level)
    how = "place of the number in Table 6's column: J1 is Fig. 3, J2 Fig. 4, J3 Fig. 5"
    return printed.erratum(number, "figure that shows 3.5946e-20", "1", 4, 5, ours, _COUNT, how)


def ya2(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of y_a2 of Table 7."""
    column = columns(printed)[1]
    entry = printed.column(column.key).entries["ya2"]
    return printed.erratum(
        number, "y_a2", "mm", entry.printed, entry.value, column.predicted("ya2"),
        Tolerance(1e-3, "the sound lengths of the column lie within 2e-4 mm of the curve"), "gauge curve of Table 7",
    )  # fmt: skip


def mean_square(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of the kmrmse that is a mean square."""
    column = columns(printed)[1]
    entry = printed.column(column.key).entries["kmrmse"]
    reach = [s / column.similarity for s in (entry.printed, entry.value)]
    distance = float(np.hypot(*(home() - makers_machine()[:2])))
    return printed.erratum(
        number, "rms distance of the samples from A_1 that this kmrmse needs", "mm", reach[0], reach[1], distance,
        Tolerance(25.0, "samples within a disc of up to 150 mm about the home point, 216.5 mm from A_1"),
        "kmrmse over the displacement of a point 1 mm from A_1; ours: the home point",
    )  # fmt: skip


def first_d(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of the lost first d."""
    ends = []
    for step in (1.0, 2.0, 4.0, 8.0, 16.0):
        run = bench.execute(make_problem("tracking_zero"), optimizers.make("nine_point", step=step), budget=2000)
        ends.append(nan if run.best_x is None else float(np.abs(run.best_x).max()))
    return printed.erratum(
        number, "where the procedure ends from d = 1, 2, 4, 8, 16 mm; the number itself is lost", "mm", nan, nan, ends,
        Tolerance(nan, "not checkable: nothing legible to compare with"), "worst coordinate of nine_point's answer",
        judge_near(nan, nan, nan, _COUNT),
    )  # fmt: skip


def empty_cell(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of the empty cell of Table 5."""
    other = printed.column("table8.nominal")["z2"]
    read = printed.column("table5.nominal")["z2"]
    return printed.erratum(
        number,
        "nominal z2",
        "rad",
        nan,
        read,
        other,
        _COUNT,
        "Table 8, nominal values",
        differs="the cell's row takes the empty cell for the 0 that Table 8 prints",
    )


def largest(printed: Printed, _: Evidence, number: int) -> Row:
    """Return the row of the largest error of Table 7."""
    column, actual = printed.column("table7.de_j3"), printed.column("table7.actual")
    lengths = [n for n in actual if n[0] != "z"]
    as_printed = max(abs(column.entries[n].printed - actual[n]) for n in lengths)
    as_read = max(abs(column[n] - actual[n]) for n in lengths)
    problem = columns(printed)[1]
    curve = max(abs(problem.predicted(n) - actual[n]) for n in lengths)
    return printed.erratum(
        number, "largest error of Table 7", "mm", as_printed, as_read, curve,
        Tolerance(1e-3, "the sound lengths of the column lie within 2e-4 mm of the curve"), "gauge curve of Table 7",
    )  # fmt: skip


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


Shown = Callable[[Printed, Evidence, int], Row]


def rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield a row for each erratum of the data file. Raises `KeyError` for one without a computation."""
    for number, place in printed.errata():
        yield _SHOWN[place](printed, evidence, number)


_SHOWN: Mapping[str, Shown] = {
    "equation (15)": projector,
    "section 2.4, step 5": grid,
    "equation (32)": squares,
    "equation (34)": passive_angle,
    "equation (35)": home_angles,
    "section 3.1, after (36)": equation_36,
    "equation (38), row 1": first_leg,
    "equation (44)": decoupled,
    "Table 3, three columns, and Table 4, last column, row la3": la3,
    "Table 4, column '12 values', rows la1 la2 la3": from_curve(("la1", "la2", "la3")),
    "Table 4, column '12 values', rows lb2 lb3": from_curve(("lb2", "lb3")),
    "Tables 3 and 4 against Tables 5 to 7, lb3": two_machines,
    "Table 6, GA under J1, against section 4.4": undecidable,
    "section 4.4, end of the text on the figures": figure,
    "Table 7, row ya2": ya2,
    "Table 7, kmrmse, and the text below it": mean_square,
    "section 2.5, initial value of d": first_d,
    "Table 5, nominal z2": empty_cell,
    "section 4.4, below Table 7": largest,
    "section 2.3, before (20)": components,
    "section 4.4, first paragraph": indices,
    "section 4.3, after (47)": uniform,
}
