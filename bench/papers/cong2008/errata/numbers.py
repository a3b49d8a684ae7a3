"""Misprinted and doubtful numbers of Cong et al. 2008, each compared with other prints or with a computation."""

from __future__ import annotations

from collections.abc import Callable
from math import nan

import numpy as np

from calibench import bench, optimizers
from calibench.bench.papers.cong2008.gauge import Column, columns
from calibench.bench.papers.cong2008.machine import implied
from calibench.bench.papers.evidence import Evidence, found
from calibench.bench.papers.evidence import problem as make_problem
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row, Ruling, Tolerance, judge_near
from calibench.problems.planar.gpm2002 import home, makers_machine

_COUNT = Tolerance(0.0, "a count")
Shown = Callable[[Printed, Evidence, int], Row]


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
