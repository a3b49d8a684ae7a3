"""What Pashkevich et al. 2008 say: what can be identified, how well, and how much better the machine became."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from calibench.bench.papers.evidence import problem as make_problem
from calibench.bench.papers.pashkevich2008.fits import (
    accuracy,
    covariance_of_plan,
    fitted,
    rms,
    table1,
    table2_differences,
)
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Ours, Row, Tolerance, judge_limit, judge_near
from calibench.problems.covariance import estimate, f_test, f_test_of_sums
from calibench.problems.orthoglide.kinematics import calibration_matrix


def column_cosines() -> list[float]:
    """Return the cosines of the angles between the columns drho and dL of (11), x y z."""
    unit = calibration_matrix() / np.linalg.norm(calibration_matrix(), axis=0)
    return [float(unit[:, i] @ unit[:, 3 + i]) for i in range(3)]


def rows(printed: Printed) -> Iterator[Row]:
    """Yield the paper's findings."""
    yield from _identification(printed)
    yield from _improvement(printed)


def _identification(printed: Printed) -> Iterator[Row]:
    matrix = calibration_matrix()
    unknowns = printed.column("equation11")["unknowns"]
    rank = int(np.linalg.matrix_rank(matrix))
    yield printed.claim(
        "six_identifiable", "Section 3.2", "the twelve equations (11) determine all six parameters", rank,
        judge_near(unknowns, unknowns, rank, Tolerance(0.0, "a count")), "true where the rank of (11) is 6",
        "rank of the matrix of (11)", f"its condition number is {np.linalg.cond(matrix):.1f}", printed=unknowns,
    )  # fmt: skip
    small, large = (make_problem("orthoglide6", data="exp2", free=free) for free in ("rho", "full"))
    for key, spread, how in (
        ("identifies_simultaneously", None, "F test of dL on top of drho, Experiment 2, residuals independent"),
        ("identifies_simultaneously_weighted", covariance_of_plan(), "the same F test, weighted by (14)"),
    ):
        test = f_test(small, large, covariance=spread)
        yield printed.claim(
            key, "Section 4.2, Experiment #2", "the method identifies both drho and dL simultaneously", test.p_value,
            judge_limit(test.p_value, 0.05), "true where leg lengths on top of offsets have p below .05", how,
            f"only rho - L is determined: {test.sentence()}; cosine of the columns {min(column_cosines()):.5f}; gauges "
            f"of .01 mm see {_seen(printed)} of six directions to the printed .07 mm", "p",
        )  # fmt: skip
    full = make_problem("orthoglide6", data="exp2", free="full", model="linear")
    found = estimate(full, sigma=printed.column("text.section34")["sigma"], covariance=covariance_of_plan())
    alone = [found.of({f"drho_{axis}": 1.0, f"dL_{axis}": -1.0})[1] for axis in "xyz"]
    said = printed.column("text.section34").entries["parameter_error"]
    digit = Tolerance(
        0.02, "what the printed angles, 11.0 and -18.7 degrees, are worth, and half a digit of what to read"
    )
    yield printed.claim(
        "accuracy_full", "Section 3.4", "the parameters are identified to about .07 mm with gauges of .01 mm",
        Ours.of(found.standard_errors),
        judge_near(said.printed, said.value, float(found.standard_errors.mean()), digit),
        digit.why, "(12) with (14) at asin of the strokes, mean of the six parameters",
        f"{accuracy(printed, True):.3f} mm at the printed angles", "mm", printed=said.printed,
        about="text.section34.parameter_error", read=said.value,
    )  # fmt: skip
    yield printed.claim(
        "accuracy_difference", "Section 3.4", "rho - L is identified to .07 mm with gauges of .01 mm", Ours.of(alone),
        judge_limit(max(alone), said.printed), "true where no standard error of rho - L is above the printed one",
        "(12) with (14) at asin of the strokes", unit="mm", printed=said.printed,
        about="text.section34.parameter_error", read=said.value,
        differs="of the differences rho - L the printed number holds, of the six parameters it does not",
    )  # fmt: skip
    fit, column = fitted("exp2", "full"), printed.column("table3.exp2_full")
    gaps = [
        float(fit.x[i] - fit.x[3 + i]) - (column[f"drho_{axis}"] - column[f"dL_{axis}"]) for i, axis in enumerate("xyz")
    ]
    weights = [float(np.abs(fit.solver[i] - fit.solver[3 + i]).sum()) for i in range(3)]
    within = 0.005 * (2 + max(weights))
    yield printed.claim(
        "table3_differences", "Table 3, row '{Delta rho, Delta L}'", "the printed full set has the differences rho - L "
        "of the best fit", Ours.of(np.abs(gaps)), judge_limit(float(np.abs(gaps).max()), within),
        f"true within {within:.3f} mm: half a digit of both numbers and of each datum, as the fit carries it",
        "distance of rho - L from that of the linear fit", unit="mm", printed=0.0,
    )  # fmt: skip


def _seen(printed: Printed) -> int:
    """Return how many directions of the six parameters the gauges see to the accuracy that is printed."""
    column = printed.column("text.section34")
    noise = column["sigma"] / np.linalg.svd(calibration_matrix(), compute_uv=False)  # mm along each direction
    return int((noise <= column.entries["parameter_error"].printed).sum())


def _improvement(printed: Printed) -> Iterator[Row]:
    size = [rms(table1(printed, key)) for key in ("exp1", "exp2", "exp3")]
    worst = max(after / before for before, after in pairwise(size))
    yield printed.claim(
        "improves", "Section 4.2 and Table 1", "the deviations shrink from each experiment to the next", worst,
        judge_limit(worst, 1.0), "true where each rms is below the one before", "larger ratio of successive rms",
    )  # fmt: skip
    # nothing is left to gain: after the adjustment the offsets do not explain more than noise would
    twelve = fitted("exp3_t2", "rho")
    left = twelve.data - twelve.predictor @ twelve.data
    p = f_test_of_sums(float(twelve.data @ twelve.data), 0, float(left @ left), 3, len(left)).p_value
    yield printed.claim(
        "nothing_left", "Section 4.2, Experiment #3", "a further calibration would improve little", 1 - p,
        judge_limit(1 - p, 0.95), "true where the offsets fitted to Experiment 3 have p above .05",
        "1 - p of the F test of drho against no errors, Table 2, Experiment 3", unit="1 - p",
    )  # fmt: skip
    six, own = printed.column("table1.exp3"), table2_differences()["exp3_t2"]
    gap = max(abs(six[name] - value) for name, value in own.items())
    yield printed.claim(
        "one_experiment3", "Tables 1 and 2", "Experiment 3 of Table 1 is Experiment 3 of Table 2", gap,
        judge_limit(gap, 0.015), "true within .015 mm, half a digit of three numbers",
        "largest distance of Table 1's differences from those of Table 2", unit="mm", printed=0.0, about="erratum.12",
        differs="each table prints what its own fit was made of; that both are one experiment does not hold",
    )  # fmt: skip
