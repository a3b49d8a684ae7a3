"""The numbers in the running text of Pashkevich et al. 2008, sections 3.4 to 5, from its tables and from (12)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calibench.bench.papers.pashkevich2008.fits import accuracy, fitted, rms, rms_tolerance, table1, table2
from calibench.bench.papers.pashkevich2008.machine import angle_row
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row, Tolerance, judge_either
from calibench.problems import constants

_EXACT = Tolerance(0.0, "a given number, or one of the table it is taken from")
_RESOLUTION = Tolerance(1e-12, "a given number")


def rows(printed: Printed) -> Iterator[Row]:
    """Yield the rows of sections 3.4, 4.1, 4.2 and 5."""
    yield from _section34(printed)
    yield from _section41(printed)
    yield from _experiment1(printed)
    yield from _experiment2(printed)
    yield from _experiment3(printed)
    yield _divided(printed)


def _divided(printed: Printed) -> Row:
    """Return the row of 'dividing the residual root-mean-square by three', which does not say of which table."""
    pairs = [(table(printed, "exp2"), table(printed, "exp3")) for table in (table1, table2)]
    one, two = (rms(before) / rms(after) for before, after in pairs)
    said = printed.column("text.section5")["rms_divided_by"]
    half = Tolerance(0.5, "half a printed digit; in kind where one of the two tables gives it")
    ruling = judge_either(said, [one, two], half)
    return printed.cell(
        "text.section5.rms_divided_by", ruling.judged, half,
        "rms of Experiment 2 over that of Experiment 3, six differences of Table 1 or twelve deviations of Table 2",
        f"{one:.2f} in Table 1, {two:.2f} in Table 2: the sentence does not say which, and holds for the first",
        ruling,
    )  # fmt: skip


def _section34(printed: Printed) -> Iterator[Row]:
    yield angle_row(printed, "text.section34.alpha_1", "plus")
    yield angle_row(printed, "text.section34.alpha_2", "minus")
    resolution = printed.column("text.section41")["indicator_resolution"] / 1000  # printed in um
    yield printed.cell("text.section34.sigma", resolution, _RESOLUTION, "resolution of the indicators, section 4.1")
    yield printed.cell(
        "text.section34.parameter_error", accuracy(printed, True), Tolerance(0.005, "half a printed digit"),
        "(12) with (14) at the printed angles, mean of the three offsets",
        f"{accuracy(printed, False):.3f} mm at asin of the strokes",
    )  # fmt: skip


def _section41(printed: Printed) -> Iterator[Row]:
    key = "text.section41"
    sigma = printed.column("text.section34")["sigma"] * 1000  # um
    yield printed.cell(f"{key}.indicator_resolution", sigma, _RESOLUTION, "sigma of section 3.4")
    yield printed.unknown(f"{key}.better_resolution", "a gauge that was not used")
    for name, stroke in (("rho_min", "stroke_minus"), ("rho_max", "stroke_plus")):
        yield printed.cell(f"{key}.{name}", printed.column("geometry")[stroke], _EXACT, "the strokes of section 2.3")
    yield printed.unknown(f"{key}.repeats", "the repeated readings are not published")
    yield printed.unknown(f"{key}.dissimilarity_below", "the repeated readings are not published")


def _experiment1(printed: Printed) -> Iterator[Row]:
    key, values, fit = "text.experiment1", table1(printed, "exp1"), fitted("exp1", "rho")
    yield printed.cell(f"{key}.largest", float(np.abs(values).max()), _EXACT, "largest deviation of Table 1")
    yield printed.cell(
        f"{key}.rms_before", rms(values), rms_tolerance(values, 1, fit.slip), "rms of Table 1, Measurements #1"
    )
    left = np.eye(6) - fit.predictor
    yield printed.cell(
        f"{key}.rms_after", rms(left @ fit.data), rms_tolerance(left @ fit.data, 1, left @ fit.slip),
        "rms left by the {rho} fit of Table 1, Measurements #1",
    )  # fmt: skip
    resolution = printed.column("text.section41")["indicator_resolution"] / 1000
    yield printed.cell(
        f"{key}.encoder_resolution", resolution, _RESOLUTION, "resolution of the indicators, section 4.1"
    )


def _experiment2(printed: Printed) -> Iterator[Row]:
    key, six, twelve = "text.experiment2", table1(printed, "exp2"), table2(printed, "exp2")
    largest = float(np.abs(six).max())
    yield printed.cell(
        f"{key}.deviations_below", largest, Tolerance(1e-9, "a number of the table"),
        "largest of the six deviations of Table 1, Measurements #2",
        f"the largest of the twelve of Table 2 is {np.abs(twelve).max():.2f}",
    )  # fmt: skip
    ratio = rms(table1(printed, "exp1")) / rms(six)
    yield printed.cell(
        f"{key}.times_better", ratio, Tolerance(0.5, "half a printed digit"),
        "rms of Table 1, Measurements #1 over #2",
    )  # fmt: skip
    fit = fitted("exp2_t1", "rho")
    left = fit.data - fit.predictor @ fit.data
    yield printed.cell(f"{key}.expected", rms(left), rms_tolerance(left), "rms left by the {rho} fit of Table 1")
    table = constants.document("pashkevich2008")["table3"]
    yield printed.cell(f"{key}.parameter_sets", len(table), _EXACT, "rows of Table 3")
    yield printed.cell(f"{key}.rms_before", rms(twelve), rms_tolerance(twelve), "rms of Table 2, Experiment 2")
    for name, frees in (("rms_one_set", ("rho", "L")), ("rms_full", ("full",))):
        kept = [f.data - f.predictor @ f.data for f in (fitted("exp2", free) for free in frees)]
        yield printed.cell(
            f"{key}.{name}", [rms(v) for v in kept], rms_tolerance(kept[0]),
            f"rms left by the fits of {' and of '.join(frees)} to Table 2, Experiment 2",
        )  # fmt: skip


def _experiment3(printed: Printed) -> Iterator[Row]:
    key, before, after = "text.experiment3", table2(printed, "exp2"), table2(printed, "exp3")
    for name, values, number in (("before", before, 2), ("after", after, 3)):
        ordered = np.sort(np.abs(values))[::-1]
        yield printed.cell(
            f"{key}.largest_{name}", float(ordered[0]), Tolerance(1e-9, "a number of the table"),
            f"largest of the twelve deviations of Table 2, Experiment {number}", f"the second is {ordered[1]:.2f}",
        )  # fmt: skip
    yield printed.cell(f"{key}.rms_before", rms(before), rms_tolerance(before), "rms of Table 2, Experiment 2")
    fit = fitted("exp3_t2", "rho")
    yield printed.cell(
        f"{key}.rms_after", rms(after), rms_tolerance(after, 1, fit.slip), "rms of Table 2, Experiment 3"
    )
    left = np.eye(12) - fit.predictor
    yield printed.cell(
        f"{key}.rms_expected", rms(left @ fit.data), rms_tolerance(left @ fit.data, 1, left @ fit.slip),
        "rms left by the {rho} fit of Table 2, Experiment 3",
    )  # fmt: skip
