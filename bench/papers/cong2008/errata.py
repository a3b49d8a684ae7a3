"""The errata of Cong et al. 2008, each with the computation that shows it, beside its place in the data file.

For a formula, `printed` is the number that the printed formula gives, `read` the number it must give, and ours what the
corrected formula gives. A new erratum in the data file without its computation here is an error.
"""

from collections.abc import Iterator
from math import nan
from statistics import NormalDist
from typing import Any

import numpy as np

from calibench import bench, optimizers
from calibench.bench.papers.cong2008.machine import columns, implied
from calibench.bench.papers.cong2008.search import drawn_by_pso
from calibench.bench.papers.cong2008.tracking import nine_point_rounds
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import (
    Array,
    Evidence,
    Row,
    Ruling,
    Tolerance,
    judge_near,
    problem as make_problem,
    values_of,
)
from calibench.problems.planar.gpm2002 import NAMES, home, inverse_kinematics, makers_machine, to_cartesian, to_polar

_COUNT = Tolerance(0.0, "a count")
_ROUNDING = Tolerance(1e-9, "rounding")
_CURVE = Tolerance(1e-3, "the sound lengths of the column lie within 2e-4 mm of the curve")


def rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield a row for each erratum of the data file. Raises `KeyError` for one without a computation."""
    shown = [*_tables(printed), *_searches(printed, evidence), *_tracking(printed), *_kinematics(printed)]
    return printed.in_order(shown)


def _tables(printed: Printed) -> Iterator[Row]:
    four, seven = columns(printed)
    entry = printed.column("table3.j3").entries["la3"]
    lb3 = printed.column("table3.actual")["lb3"]
    needed = f"solved from their initial offsets; Table 7's curve needs {seven.problem.gauge_curve(0.0)[8]:g}"
    for place, name, quantity, wrong, right, method in (
        ("Table 3, three columns, and Table 4, last column, row la3", "la3", "l_a3", entry.printed, entry.value,
         "solved from the initial offsets of Tables 3 and 4"),
        ("Tables 3 and 4 against Tables 5 to 7, lb3", "lb3", "l_b3 of Tables 3 and 4", lb3, lb3, needed),
    ):  # fmt: skip
        values = [implied(printed, table, name) for table in ("table3", "table4")]
        yield printed.erratum(
            place, quantity, unit="mm", printed=wrong, read=right, ours=[value for value, _ in values], method=method,
            tolerance=Tolerance(max(worth for _, worth in values), "what 1e-5 rad of the printed initial z3 is worth"),
        )  # fmt: skip
    entries = printed.column(four.key).entries
    for cells in (("la1", "la2", "la3"), ("lb2", "lb3")):
        curve = {n: four.predicted(n) for n in cells}
        yield printed.erratum(
            f"Table 4, column '12 values', rows {' '.join(cells)}",
            "largest distance of these cells from the gauge curve", unit="mm",
            printed=max(abs(entries[n].printed - curve[n]) for n in cells), read=0.0,
            ours=[abs(entries[n].value - curve[n]) for n in cells],
            tolerance=Tolerance(1e-3, "the sound cells lie within 7e-4 mm of it"),
            method="the curve, fitted to the other lengths",
        )  # fmt: skip
    column, actual = printed.column(seven.key), printed.column("table7.actual")
    entry, kmrmse = column.entries["ya2"], column.entries["kmrmse"]
    yield printed.erratum(
        "Table 7, row ya2", "y_a2", unit="mm", printed=entry.printed, read=entry.value, ours=seven.predicted("ya2"),
        tolerance=_CURVE, method="gauge curve of Table 7",
    )  # fmt: skip
    yield printed.erratum(
        "Table 7, kmrmse, and the text below it", "rms distance of the samples from A_1 that this kmrmse needs",
        unit="mm", printed=kmrmse.printed / seven.similarity, read=kmrmse.value / seven.similarity,
        ours=float(np.hypot(*(home() - makers_machine()[:2]))),
        tolerance=Tolerance(25.0, "samples within a disc of up to 150 mm about the home point, 216.5 mm from A_1"),
        method="kmrmse over the displacement of a point 1 mm from A_1; ours: the home point",
    )  # fmt: skip
    lengths = [n for n in actual if n[0] != "z"]
    yield printed.erratum(
        "section 4.4, below Table 7", "largest error of Table 7", unit="mm",
        printed=max(abs(column.entries[n].printed - actual[n]) for n in lengths),
        read=max(abs(column[n] - actual[n]) for n in lengths),
        ours=max(abs(seven.predicted(n) - actual[n]) for n in lengths), tolerance=_CURVE,
        method="gauge curve of Table 7",
    )  # fmt: skip


def _searches(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    table, text = printed.column("table6.ga")["j1"], printed.column("text")["ga_j1"]
    runs = values_of(evidence.of("cong2008", "full12", "ga", {"error": "J1", "gauge": "xa2"}), "best_value")
    spread = float(np.std(np.log10(runs))) if len(runs) > 1 else nan
    apart = float(abs(np.log10(text / table)))
    yield printed.erratum(
        "Table 6, GA under J1, against section 4.4",
        "difference of the two prints, in decades; ours: spread of repetitions", unit="1", printed=apart, read=apart,
        ours=spread,
        tolerance=Tolerance(apart / 2, "decided where two deviations of repetitions are less than the difference"),
        method="standard deviation of log10 J1 of ga",
        ruling=Ruling("not reproduced" if apart > 2 * spread else "not checkable", spread, "at most", apart / 2),
        differs="it asks which of two digits is right, the cells whether the level is reached",
    )  # fmt: skip
    column = printed.column("table6.de")
    yield printed.erratum(
        "section 4.4, end of the text on the figures", "figure that shows 3.5946e-20", unit="1", printed=4, read=5,
        ours=3 + [column[name] for name in column].index(printed.column("text")["de_j3"]), tolerance=_COUNT,
        method="place of the number in Table 6's column: J1 is Fig. 3, J2 Fig. 4, J3 Fig. 5",
    )  # fmt: skip
    yield printed.erratum(
        "Table 5, nominal z2", "nominal z2", unit="rad", printed=nan, read=printed.column("table5.nominal")["z2"],
        ours=printed.column("table8.nominal")["z2"], tolerance=_COUNT, method="Table 8, nominal values",
        differs="the cell's row takes the empty cell for the 0 that Table 8 prints",
    )  # fmt: skip
    yield printed.erratum(
        "section 4.4, first paragraph", "range of i, the joints", unit="1",
        printed=printed.column("section44")["samples"], read=3, ours=make_problem("full12").readings.shape[1],
        tolerance=_COUNT, method="readings of one configuration",
    )  # fmt: skip
    drawn = np.array(drawn_by_pso(1))
    normal = NormalDist()
    yield printed.erratum(
        "section 4.3, after (47)", "share of randb outside [0, 1]", unit="1",
        printed=1 - (normal.cdf(1) - normal.cdf(0)), read=0.0, ours=float(((drawn < 0) | (drawn > 1)).mean()),
        tolerance=_COUNT, method="a standard normal number, and 2000 numbers of our generator",
    )  # fmt: skip


def _tracking(printed: Printed) -> Iterator[Row]:
    tracking, identity = make_problem("tracking_zero"), np.eye(3)
    ends = []
    for step in (1.0, 2.0, 4.0, 8.0, 16.0):
        best = bench.execute(tracking, optimizers.make("nine_point", step=step), budget=2000).best_x
        ends.append(nan if best is None else float(np.abs(best).max()))
    yield printed.erratum(
        "section 2.5, initial value of d",
        "where the procedure ends from d = 1, 2, 4, 8, 16 mm; the number itself is lost", unit="mm", printed=nan,
        read=nan, ours=ends, tolerance=Tolerance(nan, "not checkable: nothing legible to compare with"),
        method="worst coordinate of nine_point's answer", ruling=judge_near(nan, nan, nan, _COUNT),
    )  # fmt: skip
    yield printed.erratum(
        "equation (15)", "rank of P: infeasible directions of three joints with two degrees of freedom", unit="1",
        printed=float(np.trace(identity - identity @ np.linalg.inv(identity.T) @ identity.T)), read=3 - 2,
        ours=np.trace(tracking.projectors, axis1=1, axis2=2), tolerance=_ROUNDING,
        method="trace of P, as printed and as in tracking_zero",
    )  # fmt: skip
    listed = {(0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, -1), (1, -1)}  # with R itself; (-1, 1) is listed twice
    yield printed.erratum(
        "section 2.4, step 5", "estimates compared in step 6", unit="1", printed=len(listed),
        read=printed.column("section24")["estimates"], ours=len(nine_point_rounds()[-1]) + 1, tolerance=_COUNT,
        method="different points in the printed list and in a round of our search",
    )  # fmt: skip
    yield printed.erratum(
        "section 2.3, before (20)", "components of delta_m", unit="1", printed=2, read=3,
        ours=tracking.projectors.shape[-1], tolerance=_COUNT, method="order of P_j, which is applied to it",
    )  # fmt: skip


def _kinematics(printed: Printed) -> Iterator[Row]:
    """Yield the errata of the machine's equations, at Table 5's actual machine and positions in its workspace."""
    column = printed.column("section31")
    yield printed.erratum(
        "section 3.1, after (36)", "equations a configuration", unit="1", printed=3, read=6,
        ours=column["equations_then"] / column["configurations_needed"], tolerance=_COUNT,
        method="equations over configurations of section 3.1; (34) has one a leg, (36) two",
    )  # fmt: skip
    problem: Any = make_problem("full12")
    machine = makers_machine()
    for p in problem.parameters:
        machine[NAMES.index(p.name)] = p.true
    points: Array = problem.true_positions
    angles = inverse_kinematics(machine, points)
    la, lb = machine[6:9], machine[9:12]
    # the passive joints, shapes (n, 3) each, eq. (30)
    bx, by = machine[0:6:2] + la * np.cos(angles), machine[1:6:2] + la * np.sin(angles)
    errors = []
    ring = [(0, 1, 2), (1, 2, 0), (2, 0, 1)]
    below = 2 * sum(bx[:, i] * (by[:, j] - by[:, k]) for i, j, k in ring)
    for d in (bx + by - lb, bx**2 + by**2 - lb**2):
        x = sum(d[:, i] * (by[:, j] - by[:, k]) for i, j, k in ring) / below  # eq. (33)
        y = sum(d[:, i] * (bx[:, k] - bx[:, j]) for i, j, k in ring) / below
        errors.append(float(np.abs(np.column_stack([x, y]) - points).max()))
    yield printed.erratum(
        "equation (32)", "largest error of the position by (33)", unit="mm", printed=errors[0], read=0.0,
        ours=errors[1], tolerance=_ROUNDING,
        method="forward kinematics at 50 poses with d_i as printed and with squares",
    )  # fmt: skip
    dx, dy = points[:, :1] - bx, points[:, 1:] - by
    errors = [float(np.hypot(dx - lb * np.cos(b), dy - lb * np.sin(b)).max())
              for b in (np.arctan(dy / dx), np.arctan2(dy, dx))]  # fmt: skip
    yield printed.erratum(
        "equation (34)", "largest closure error of (29) with the passive angle", unit="mm", printed=errors[0],
        read=0.0, ours=errors[1], tolerance=_ROUNDING,
        method="closure at 50 poses with arctan of the quotient and with atan2",
    )  # fmt: skip
    at_home, offsets = inverse_kinematics(makers_machine(), home()[None])[0], makers_machine()[12:15]
    yield printed.erratum(
        "equation (35)", "largest reading at the home position, which is defined as zero, without offsets", unit="rad",
        printed=float(np.abs(at_home - offsets).max()), read=0.0,
        ours=float(np.abs(at_home - at_home - offsets).max()), tolerance=_ROUNDING,
        method="reading at home by (35) as printed and with the home angles",
    )  # fmt: skip
    errors = []
    for ya in (machine[3], machine[1]):
        y = points[:, 1] - ya - machine[6] * np.sin(angles[:, 0])
        errors.append(float(np.abs((points[:, 0] - bx[:, 0]) ** 2 + y**2 - machine[9] ** 2).max()))
    yield printed.erratum(
        "equation (38), row 1", "row 1 of E2 at the actual machine", unit="mm^2", printed=errors[0], read=0.0,
        ours=errors[1], tolerance=_ROUNDING, method="largest value over 50 poses, with y_a2 and with y_a1",
    )  # fmt: skip
    moved = to_cartesian(machine)
    as_printed, as_read = (moved[6:9] * 2 + moved[12:15] * 2) * 0.5, to_polar(moved, machine[12:15])[6:9]
    yield printed.erratum(
        "equation (44)", "largest error of l_a recovered from (l_a cos, l_a sin)", unit="mm",
        printed=float(np.abs(as_printed - la).max()), read=0.0, ours=float(np.abs(as_read - la).max()),
        tolerance=_ROUNDING, method="Table 5's machine there and back",
    )  # fmt: skip
