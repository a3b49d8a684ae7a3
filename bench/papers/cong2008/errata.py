"""The errata of Cong et al. 2008, each with the computation that shows it, beside its place in the data file.

For a formula, `printed` is the number that the printed formula gives, `read` the number it must give, and ours what the
corrected formula gives. A new erratum in the data file without its computation here is an error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import nan
from statistics import NormalDist
from typing import Any

import numpy as np

from calibench import bench, optimizers
from calibench.bench.papers.cong2008.machine import columns, implied
from calibench.bench.papers.cong2008.tracking import nine_point_rounds
from calibench.bench.papers.published import Printed, Shown
from calibench.bench.papers.row import Array, Evidence, Row, Ruling, Tolerance, judge_near, values_of
from calibench.bench.papers.row import problem as make_problem
from calibench.problems.planar.gpm2002 import NAMES, home, inverse_kinematics, makers_machine, to_cartesian, to_polar

_COUNT = Tolerance(0.0, "a count")
_ROUNDING = Tolerance(1e-9, "rounding")
Show = Callable[[Printed, Evidence], Shown]
_SHOWN: dict[str, Show] = {}


def rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield a row for each erratum of the data file. Raises `KeyError` for one without a computation."""
    for place in printed.errata():
        yield printed.erratum(place, _SHOWN[place](printed, evidence))


def _shows(place: str) -> Callable[[Show], Show]:
    def enter(show: Show) -> Show:
        _SHOWN[place] = show
        return show

    return enter


@_shows("Table 3, three columns, and Table 4, last column, row la3")
def la3(printed: Printed, _: Evidence) -> Shown:
    entry = printed.column("table3.j3").entries["la3"]
    values = [implied(printed, table, "la3") for table in ("table3", "table4")]
    tolerance = Tolerance(max(worth for _, worth in values), "what 1e-5 rad of the printed initial z3 is worth")
    return Shown(
        quantity="l_a3", unit="mm", printed=entry.printed, read=entry.value,
        ours=[value for value, _ in values], tolerance=tolerance,
        method="solved from the initial offsets of Tables 3 and 4",
    )  # fmt: skip


@_shows("Table 4, column '12 values', rows la1 la2 la3")
def la_from_curve(printed: Printed, _: Evidence) -> Shown:
    return _from_curve(printed, "la1", "la2", "la3")


@_shows("Table 4, column '12 values', rows lb2 lb3")
def lb_from_curve(printed: Printed, _: Evidence) -> Shown:
    return _from_curve(printed, "lb2", "lb3")


def _from_curve(printed: Printed, *cells: str) -> Shown:
    column = columns(printed)[0]
    entries = printed.column(column.key).entries
    curve = {n: column.predicted(n) for n in cells}
    wrong = max(abs(entries[n].printed - curve[n]) for n in cells)
    right = [abs(entries[n].value - curve[n]) for n in cells]
    return Shown(
        quantity="largest distance of these cells from the gauge curve", unit="mm", printed=wrong, read=0.0,
        ours=right, tolerance=Tolerance(1e-3, "the sound cells lie within 7e-4 mm of it"),
        method="the curve, fitted to the other lengths",
    )  # fmt: skip


@_shows("Tables 3 and 4 against Tables 5 to 7, lb3")
def two_machines(printed: Printed, _: Evidence) -> Shown:
    values = [implied(printed, table, "lb3") for table in ("table3", "table4")]
    lb3 = printed.column("table3.actual")["lb3"]
    tolerance = Tolerance(max(worth for _, worth in values), "what 1e-5 rad of the printed initial z3 is worth")
    return Shown(
        quantity="l_b3 of Tables 3 and 4", unit="mm", printed=lb3, read=lb3,
        ours=[value for value, _ in values], tolerance=tolerance,
        method="solved from their initial offsets; Table 7's curve needs "
        f"{columns(printed)[1].problem.gauge_curve(0.0)[8]:g}",
    )  # fmt: skip


@_shows("Table 6, GA under J1, against section 4.4")
def undecidable(printed: Printed, evidence: Evidence) -> Shown:
    table, text = printed.column("table6.ga")["j1"], printed.column("text")["ga_j1"]
    runs = values_of(evidence.of("cong2008", "full12", "ga", {"error": "J1", "gauge": "xa2"}), "best_value")
    spread = float(np.std(np.log10(runs))) if len(runs) > 1 else nan
    apart = float(abs(np.log10(text / table)))
    decided = apart > 2 * spread
    return Shown(
        quantity="difference of the two prints, in decades; ours: spread of repetitions", unit="1", printed=apart,
        read=apart,
        ours=spread,
        tolerance=Tolerance(apart / 2, "decided where two deviations of repetitions are less than the difference"),
        method="standard deviation of log10 J1 of ga",
        ruling=Ruling("not reproduced" if decided else "not checkable", spread, "at most", apart / 2),
        differs="it asks which of two digits is right, the cells whether the level is reached",
    )  # fmt: skip


@_shows("section 4.4, end of the text on the figures")
def figure(printed: Printed, _: Evidence) -> Shown:
    level = printed.column("text")["de_j3"]
    column = printed.column("table6.de")
    ours = 3 + [column[name] for name in column].index(level)
    how = "place of the number in Table 6's column: J1 is Fig. 3, J2 Fig. 4, J3 Fig. 5"
    return Shown(
        quantity="figure that shows 3.5946e-20", unit="1", printed=4, read=5,
        ours=ours, tolerance=_COUNT, method=how,
    )  # fmt: skip


@_shows("Table 7, row ya2")
def ya2(printed: Printed, _: Evidence) -> Shown:
    column = columns(printed)[1]
    entry = printed.column(column.key).entries["ya2"]
    return Shown(
        quantity="y_a2", unit="mm", printed=entry.printed, read=entry.value,
        ours=column.predicted("ya2"),
        tolerance=Tolerance(1e-3, "the sound lengths of the column lie within 2e-4 mm of the curve"),
        method="gauge curve of Table 7",
    )  # fmt: skip


@_shows("Table 7, kmrmse, and the text below it")
def mean_square(printed: Printed, _: Evidence) -> Shown:
    column = columns(printed)[1]
    entry = printed.column(column.key).entries["kmrmse"]
    reach = [s / column.similarity for s in (entry.printed, entry.value)]
    distance = float(np.hypot(*(home() - makers_machine()[:2])))
    return Shown(
        quantity="rms distance of the samples from A_1 that this kmrmse needs", unit="mm", printed=reach[0],
        read=reach[1],
        ours=distance,
        tolerance=Tolerance(25.0, "samples within a disc of up to 150 mm about the home point, 216.5 mm from A_1"),
        method="kmrmse over the displacement of a point 1 mm from A_1; ours: the home point",
    )  # fmt: skip


@_shows("section 2.5, initial value of d")
def first_d(printed: Printed, _: Evidence) -> Shown:
    ends = []
    for step in (1.0, 2.0, 4.0, 8.0, 16.0):
        run = bench.execute(make_problem("tracking_zero"), optimizers.make("nine_point", step=step), budget=2000)
        ends.append(nan if run.best_x is None else float(np.abs(run.best_x).max()))
    return Shown(
        quantity="where the procedure ends from d = 1, 2, 4, 8, 16 mm; the number itself is lost", unit="mm",
        printed=nan, read=nan,
        ours=ends, tolerance=Tolerance(nan, "not checkable: nothing legible to compare with"),
        method="worst coordinate of nine_point's answer", ruling=judge_near(nan, nan, nan, _COUNT),
    )  # fmt: skip


@_shows("Table 5, nominal z2")
def empty_cell(printed: Printed, _: Evidence) -> Shown:
    other = printed.column("table8.nominal")["z2"]
    read = printed.column("table5.nominal")["z2"]
    return Shown(
        quantity="nominal z2", unit="rad", printed=nan, read=read,
        ours=other, tolerance=_COUNT, method="Table 8, nominal values",
        differs="the cell's row takes the empty cell for the 0 that Table 8 prints",
    )  # fmt: skip


@_shows("section 4.4, below Table 7")
def largest(printed: Printed, _: Evidence) -> Shown:
    column, actual = printed.column("table7.de_j3"), printed.column("table7.actual")
    lengths = [n for n in actual if n[0] != "z"]
    as_printed = max(abs(column.entries[n].printed - actual[n]) for n in lengths)
    as_read = max(abs(column[n] - actual[n]) for n in lengths)
    problem = columns(printed)[1]
    curve = max(abs(problem.predicted(n) - actual[n]) for n in lengths)
    return Shown(
        quantity="largest error of Table 7", unit="mm", printed=as_printed, read=as_read,
        ours=curve, tolerance=Tolerance(1e-3, "the sound lengths of the column lie within 2e-4 mm of the curve"),
        method="gauge curve of Table 7",
    )  # fmt: skip


@_shows("equation (15)")
def projector(printed: Printed, _: Evidence) -> Shown:
    identity, tracking = np.eye(3), make_problem("tracking_zero")
    as_printed = identity - identity @ np.linalg.inv(identity.T) @ identity.T
    ours = np.trace(tracking.projectors, axis1=1, axis2=2)
    return Shown(
        quantity="rank of P: infeasible directions of three joints with two degrees of freedom", unit="1",
        printed=float(np.trace(as_printed)), read=3 - 2,
        ours=ours, tolerance=_ROUNDING, method="trace of P, as printed and as in tracking_zero",
    )  # fmt: skip


@_shows("section 2.4, step 5")
def grid(printed: Printed, _: Evidence) -> Shown:
    listed = {(0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, -1), (1, -1)}  # with R itself; (-1, 1) is listed twice
    compared = printed.column("section24")["estimates"]
    ours = len(nine_point_rounds()[-1]) + 1
    how = "different points in the printed list and in a round of our search"
    return Shown(
        quantity="estimates compared in step 6", unit="1", printed=len(listed), read=compared,
        ours=ours, tolerance=_COUNT, method=how,
    )  # fmt: skip


@_shows("equation (32)")
def squares(printed: Printed, _: Evidence) -> Shown:
    machine, points, angles = _poses()
    bx, by = _elbows(machine, angles)
    lb = machine[9:12]
    wrong, right = (_centres(bx, by, d) for d in (bx + by - lb, bx**2 + by**2 - lb**2))
    errors = [float(np.abs(centre - points).max()) for centre in (wrong, right)]
    return Shown(
        quantity="largest error of the position by (33)", unit="mm", printed=errors[0], read=0.0,
        ours=errors[1], tolerance=_ROUNDING,
        method="forward kinematics at 50 poses with d_i as printed and with squares",
    )  # fmt: skip


@_shows("equation (34)")
def passive_angle(printed: Printed, _: Evidence) -> Shown:
    machine, points, angles = _poses()
    bx, by = _elbows(machine, angles)
    dx, dy = points[:, :1] - bx, points[:, 1:] - by
    errors = [
        float(np.hypot(dx - machine[9:12] * np.cos(b), dy - machine[9:12] * np.sin(b)).max())
        for b in (np.arctan(dy / dx), np.arctan2(dy, dx))
    ]  # fmt: skip
    return Shown(
        quantity="largest closure error of (29) with the passive angle", unit="mm", printed=errors[0], read=0.0,
        ours=errors[1], tolerance=_ROUNDING, method="closure at 50 poses with arctan of the quotient and with atan2",
    )  # fmt: skip


@_shows("equation (35)")
def home_angles(printed: Printed, _: Evidence) -> Shown:
    at_home = inverse_kinematics(makers_machine(), home()[None])[0]
    offsets = makers_machine()[12:15]
    as_printed, as_read = at_home - offsets, at_home - at_home - offsets
    return Shown(
        quantity="largest reading at the home position, which is defined as zero, without offsets", unit="rad",
        printed=float(np.abs(as_printed).max()), read=0.0,
        ours=float(np.abs(as_read).max()), tolerance=_ROUNDING,
        method="reading at home by (35) as printed and with the home angles",
    )  # fmt: skip


@_shows("section 3.1, after (36)")
def equation_36(printed: Printed, _: Evidence) -> Shown:
    column = printed.column("section31")
    ours = column["equations_then"] / column["configurations_needed"]
    how = "equations over configurations of section 3.1; (34) has one a leg, (36) two"
    return Shown(
        quantity="equations a configuration", unit="1", printed=3, read=6,
        ours=ours, tolerance=_COUNT, method=how,
    )  # fmt: skip


@_shows("equation (38), row 1")
def first_leg(printed: Printed, _: Evidence) -> Shown:
    machine, points, angles = _poses()
    bx = _elbows(machine, angles)[0]
    values = []
    for ya in (machine[3], machine[1]):
        y = points[:, 1] - ya - machine[6] * np.sin(angles[:, 0])
        values.append(float(np.abs((points[:, 0] - bx[:, 0]) ** 2 + y**2 - machine[9] ** 2).max()))
    return Shown(
        quantity="row 1 of E2 at the actual machine", unit="mm^2", printed=values[0], read=0.0,
        ours=values[1], tolerance=_ROUNDING, method="largest value over 50 poses, with y_a2 and with y_a1",
    )  # fmt: skip


@_shows("equation (44)")
def decoupled(printed: Printed, _: Evidence) -> Shown:
    machine = _poses()[0]
    moved = to_cartesian(machine)
    as_printed = (moved[6:9] * 2 + moved[12:15] * 2) * 0.5
    as_read = to_polar(moved, machine[12:15])[6:9]
    errors = [float(np.abs(l_a - machine[6:9]).max()) for l_a in (as_printed, as_read)]
    return Shown(
        quantity="largest error of l_a recovered from (l_a cos, l_a sin)", unit="mm", printed=errors[0], read=0.0,
        ours=errors[1], tolerance=_ROUNDING, method="Table 5's machine there and back",
    )  # fmt: skip


@_shows("section 2.3, before (20)")
def components(printed: Printed, _: Evidence) -> Shown:
    ours = make_problem("tracking_zero").projectors.shape[-1]
    return Shown(
        quantity="components of delta_m", unit="1", printed=2, read=3,
        ours=ours, tolerance=_COUNT, method="order of P_j, which is applied to it",
    )  # fmt: skip


@_shows("section 4.4, first paragraph")
def indices(printed: Printed, _: Evidence) -> Shown:
    samples = printed.column("section44")["samples"]
    ours = make_problem("full12").readings.shape[1]
    return Shown(
        quantity="range of i, the joints", unit="1", printed=samples, read=3,
        ours=ours, tolerance=_COUNT, method="readings of one configuration",
    )  # fmt: skip


@_shows("section 4.3, after (47)")
def uniform(printed: Printed, _: Evidence) -> Shown:
    from calibench.optimizers.own._random_kernels import random_state, uniform

    with np.errstate(over="ignore"):
        state = random_state(np.random.default_rng(1))
        drawn = np.array([float(uniform(state)) for _ in range(2000)])
    normal = NormalDist()
    outside = 1 - (normal.cdf(1) - normal.cdf(0))
    return Shown(
        quantity="share of randb outside [0, 1]", unit="1", printed=outside, read=0.0,
        ours=float(((drawn < 0) | (drawn > 1)).mean()), tolerance=_COUNT,
        method="a standard normal number, and 2000 numbers of our generator",
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
