"""The 12-parameter columns of Tables 4 and 7 of Cong et al. 2008 are points of a curve along which no reading changes.

Each printed value is computed from the others: the gauge angle is fitted to all other sound lengths of the column, and
the curve through the true machine then says what must stand in the cell. So a misprint shows, and so does that "all 12
parameters" are eleven and a free choice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from calibench import problems
from calibench.bench.papers.cong2008.section3 import columns as cong2008_columns
from calibench.bench.papers.cong2008.section3.local import twelve
from calibench.bench.papers.evidence import Array, Evidence, found, solved_for
from calibench.bench.papers.evidence import problem as make_problem
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Ours, Row, Tolerance, judge_at_least, judge_limit
from calibench.problems.planar.gpm2002 import home, makers_machine

_OFF = 7e-4  # mm: how far the sound lengths of both columns are from the curve, at most (measured)
_METHOD = "the gauge curve through the actual machine, its angle fitted to the column's other lengths"


@final
@dataclass(frozen=True, eq=False)
class Column:
    """A printed 12-parameter column beside its gauge curve."""

    key: str
    problem: Any
    names: tuple[str, ...]
    read: Array
    fit: Array

    @staticmethod
    def of(printed: Printed, key: str, problem: Any) -> Column:
        """Return `key` beside the curve of `problem`; lengths printed right are what is fitted."""
        names = tuple(p.name for p in problem.parameters)
        column = printed.column(key)
        sound = [not column.entries[n].is_misprint and n[0] != "z" for n in names]
        return Column(key, problem, names, np.array([column[n] for n in names]), np.array(sound))

    def angle(self, without: str = "") -> float:
        """Return phi [rad], fitted to the sound lengths but that of `without`."""
        kept = self.fit & np.array([n != without for n in self.names])
        curve = self.problem.gauge_curve
        return solved_for(lambda phi: np.asarray((curve(phi) - self.read)[kept]), 0.0)[0]

    def predicted(self, name: str) -> float:
        """Return what the curve says for `name`, from the others."""
        return float(self.problem.gauge_curve(self.angle(name))[self.names.index(name)])

    def tolerance(self, name: str, digit: float) -> Tolerance:
        """Return how far the cell may be from what the others say: its own misfit, and theirs at its leverage."""
        slope = (self.problem.gauge_curve(1e-6) - self.problem.gauge_curve(-1e-6)) / 2e-6
        others = np.abs(slope[self.fit & np.array([n != name for n in self.names])])
        carried = abs(slope[self.names.index(name)]) * others.sum() / (others**2).sum()
        own = _OFF / 244.0 if name[0] == "z" else _OFF
        return Tolerance(
            float(own + carried * _OFF + digit),
            f"a search stops near the curve, not on it: {_OFF:g} mm for each length (an offset: over a link), as far "
            "as the fitted angle carries it, and a printed digit, as digits are cut off and not rounded in places",
        )

    @property
    def similarity(self) -> float:
        """Return by how much of its distance from A_1 the turn and scale move a point."""
        phi = self.angle()
        at = self.names.index("lb1")
        scale = self.problem.gauge_curve(phi)[at] / self.problem.gauge_curve(0.0)[at]
        return float(abs(scale * np.exp(1j * phi) - 1))


def columns(printed: Printed) -> tuple[Column, Column]:
    """Return Table 4's and Table 7's columns."""
    return (
        Column.of(printed, "table4.j3_12", make_problem("full12", gauge="ya2")),
        Column.of(printed, "table7.de_j3", make_problem("full12", gauge="xa2")),
    )


def kmrmse_row(printed: Printed, cell: str, column: Column) -> Row:
    """Return the row of a printed kmrmse: a similarity about A_1 moves samples in proportion to their distance."""
    distance = np.hypot(*(home() - makers_machine()[:2]))
    # rms distance from A_1 of a disc about the home point, radius 0 to 150 mm: what an unknown plan may be
    low, high = column.similarity * distance, column.similarity * np.hypot(distance, 150 / np.sqrt(2))
    points = column.problem.true_positions - makers_machine()[:2]
    ours = column.similarity * float(np.sqrt((points**2).sum(axis=1).mean()))
    tolerance = Tolerance(
        max(ours - low, high - ours),
        "the plan is not printed: discs of radius 0 to 150 mm about the home point give this range",
    )
    reason = f"the whole kmrmse is the gauge: phi = {column.angle():.6f}, seen by no reading"
    return printed.cell(
        cell, ours, tolerance, "displacement of the default plan by the column's similarity", reason, of_print=True
    )


def rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield Table 4's 12 values, Table 7, its echo in the text, and the claims about 12 parameters."""
    four, seven = columns(printed)
    for column in (four, seven):
        for name in printed.column(column.key):
            cell = f"{column.key}.{name}"
            if name == "kmrmse":
                yield kmrmse_row(printed, cell, column)
            elif name == "iterations":
                yield cong2008_columns.row(printed, column.key, name)
            else:
                tolerance = column.tolerance(name, printed.digit(cell))
                yield printed.cell(cell, column.predicted(name), tolerance, _METHOD, of_print=True)
    for name in printed.column("table7.actual"):
        other = printed.column("table5.actual")[name]
        yield printed.cell(f"table7.actual.{name}", other, Tolerance(0.0, "a given number"), "Table 5, actual values")
    yield from _text(printed, seven)
    yield from _claims(printed, evidence, four, seven)


def _text(printed: Printed, seven: Column) -> Iterator[Row]:
    column, actual = printed.column("table7.de_j3"), printed.column("table7.actual")
    gaps = {n: abs(column[n] - actual[n]) for n in actual}
    lengths = {n: g for n, g in gaps.items() if n[0] != "z"}
    worst = max(lengths, key=lambda n: lengths[n])
    yield printed.cell(
        "text.largest_error", lengths[worst], Tolerance(5e-5, "half a printed digit"),
        "largest difference of Table 7's columns, misprint corrected", f"it is that of {worst}", of_print=True,
    )  # fmt: skip
    limit = printed.column("text")["most_errors_below"]
    below = float(np.mean([g < limit for g in gaps.values()]))
    yield printed.cell(
        "text.most_errors_below", float(np.median(list(gaps.values()))),
        Tolerance(limit, "the claim is that most lie between 0 and the limit"),
        "median difference of Table 7's columns",
        f"{below:.0%} of the errors are below", judge_at_least(below, 0.5), of_print=True,
    )  # fmt: skip
    limit = printed.column("text")["z_errors_below"]
    angles = [g for n, g in gaps.items() if n[0] == "z"]
    yield printed.cell(
        "text.z_errors_below", angles, Tolerance(limit, "the claim is that all lie between 0 and the limit"),
        "differences of Table 7's offsets", f"the largest is {max(angles):.2g}", judge_limit(max(angles), limit),
        of_print=True,
    )  # fmt: skip
    yield kmrmse_row(printed, "text.kmrmse", seven)


def _several(printed: Printed, four: Column) -> Row:
    """Return the row of 'several millimeter errors' in Table 4, misprints corrected by the curve."""
    actual = printed.column("table4.actual")
    errors = [abs(four.read[i] - actual[n]) for i, n in enumerate(four.names) if n[0] != "z"]
    return printed.claim(
        "table4_several_millimetres", "Section 3.3 C and Table 4, 12 values",
        "there are several millimetre errors between the calibrated results and the actual values", Ours.of(errors),
        judge_at_least(float(np.median(errors)), 2.0, 1.0),
        "true where the median error of the nine lengths is 2 mm or more, in kind 1 mm",
        "errors of the printed lengths, misprints corrected",
        f"they are {min(errors):.1f} to {max(errors):.1f} mm, all of them the gauge's: how many is arbitrary",
        "mm",
    )  # fmt: skip


def _claims(printed: Printed, evidence: Evidence, four: Column, seven: Column) -> Iterator[Row]:
    for column, table in ((four, "Table 4, 12 values"), (seven, "Table 7")):
        off = np.abs((column.problem.gauge_curve(column.angle()) - column.read)[column.fit])
        yield printed.claim(
            f"on_the_gauge_{column.key.partition('.')[0]}", table,
            "the printed result is one point of the gauge curve, not another machine", Ours.of(off),
            judge_limit(float(off.max()), _OFF),
            "true where the lengths printed right lie within 7e-4 mm of the curve",
            "distance of the printed lengths from the curve through the actual machine",
            f"phi = {column.angle():.6f} rad, where no reading differs from those of the actual machine",
            "mm", printed=0.0,
        )  # fmt: skip
    yield _several(printed, four)
    found_rank = problems.identify(seven.problem)
    yield printed.claim(
        "de_calibrates_all_12", "abstract, sections 4.4 and 5", "DE calibrates all 12 parameters", found_rank.rank,
        judge_at_least(found_rank.rank, 12.0), "true where the readings see 12 parameters",
        "rank of the Jacobian of full12 (gauge=xa2)",
        f"readings see 11; Table 7 is the point phi = {seven.angle():.6f} rad of a curve on which all are equally good",
        printed=12.0, about="section43.parameters",
        differs="twelve is what DE is given; how many of them the readings see is asked here",
    )  # fmt: skip
    reached = evidence.runs[
        (evidence.runs["study"] == "cong2008") & (evidence.runs["problem"] == "full12")
        & (evidence.runs["kmrmse_aligned"] < 1e-6) & (evidence.runs["start"] == "random")
        & (evidence.runs["optimizer"] != "lm")
    ]  # fmt: skip
    raw, aligned = found(reached, "kmrmse"), found(reached, "kmrmse_aligned")
    yield printed.claim(
        "global_search_helps", "section 5", "global optimisation finds what local optimisation could not: all 12",
        Ours.of(raw), judge_limit(float(np.median(raw)) if len(raw) else float("nan"), 1e-3),
        "true where runs that reach the floor end at the actual machine, kmrmse below 1e-3 mm",
        "kmrmse of every bounded run on full12 that is exact modulo the gauge",
        f"{len(raw)} such runs end anywhere on the curve in the box; modulo the gauge they are within "
        f"{np.max(aligned) if len(aligned) else float('nan'):.1g} mm", "mm",
        printed=printed.column("table7.de_j3").entries["kmrmse"].printed, about="table7.de_j3.kmrmse",
        differs="the cell is a misprint; that so small a kmrmse shows the actual machine is asked here",
    )  # fmt: skip
    spread = found(twelve(evidence), "gauge_phi")
    yield printed.claim(
        "twelve_depends_on_plan", "Table 4, 12 values", "where on the gauge curve a search ends is told by the data",
        float(np.ptp(spread)) if len(spread) else float("nan"),
        judge_limit(float(np.ptp(spread)) if len(spread) else float("nan"), 1e-6),
        "true where searches from one start agree to 1e-6 rad", "range of phi over 5 plans, fmincon, one start",
        unit="rad", printed=0.0,
    )  # fmt: skip
