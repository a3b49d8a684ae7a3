"""What Pashkevich et al. 2008 say: their equations, the numbers of the running text, and what they conclude.

Equations (5) to (9) and (11) stand against differences of the model (2). The chapter holds the residuals of Experiment
1 against the .01 mm of its indicators, and not those of Experiment 2; here both are asked the same question.
"""

from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import chi2

from calibench.bench.papers.pashkevich2008 import machine
from calibench.bench.papers.pashkevich2008.machine import fitted, rms, rms_tolerance, table1, table2
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import (
    Array,
    Row,
    Tolerance,
    judge_at_least,
    judge_either,
    judge_limit,
    judge_near,
    problem as make_problem,
)
from calibench.discrepancy import machines
from calibench.discrepancy.fitting.small_sample import Supported, linear, small_sample
from calibench.discrepancy.machines.orthoglide.experiments import ORIENTATION, PLAUSIBLE, effect_of
from calibench.discrepancy.machines.orthoglide.kinematics import printed as measured_set
from calibench.problems import constants
from calibench.problems.identifiability import estimate, f_test, f_test_of_sums
from calibench.problems.orthoglide import kinematics
from calibench.problems.orthoglide.kinematics import NAMES, geometry
from calibench.problems.orthoglide.plans import covariance, paper_plan

_EXACT = Tolerance(0.0, "a given number, or one of the table it is taken from")
_RESOLUTION = Tolerance(1e-12, "a given number")


def identification_rows(printed: Printed) -> Iterator[Row]:
    """Yield what can be identified, and how well."""
    matrix, given = kinematics.calibration_matrix(), printed.column("text.section34")
    weights_14, entry = covariance(paper_plan()), given.entries["parameter_error"]
    unknowns, rank = printed.column("equation11")["unknowns"], int(np.linalg.matrix_rank(matrix))
    yield printed.claim(
        "six_identifiable", "Section 3.2", "the twelve equations (11) determine all six parameters",
        ours=rank, ruling=judge_near(unknowns, unknowns, rank, Tolerance(0.0, "a count")),
        rule="true where the rank of (11) is 6", method="rank of the matrix of (11)",
        reason=f"its condition number is {np.linalg.cond(matrix):.1f}", printed=unknowns,
    )  # fmt: skip
    unit = matrix / np.linalg.norm(matrix, axis=0)
    cosine = min(float(unit[:, i] @ unit[:, 3 + i]) for i in range(3))  # of the columns drho and dL
    noise = given["sigma"] / np.linalg.svd(matrix, compute_uv=False)  # mm along each direction of the parameters
    small, large = (make_problem("orthoglide6", data="exp2", free=free) for free in ("rho", "full"))
    for key, spread, how in (
        ("identifies_simultaneously", None, "F test of dL on top of drho, Experiment 2, residuals independent"),
        ("identifies_simultaneously_weighted", weights_14, "the same F test, weighted by (14)"),
    ):
        test = f_test(small, large, covariance=spread)
        yield printed.claim(
            key, "Section 4.2, Experiment #2", "the method identifies both drho and dL simultaneously",
            ours=test.p_value, ruling=judge_limit(test.p_value, 0.05),
            rule="true where leg lengths on top of offsets have p below .05", method=how,
            reason=f"only rho - L is determined: {test.sentence()}; cosine of the columns {cosine:.5f}; gauges of "
            f".01 mm see {int((noise <= entry.printed).sum())} of six directions to the printed .07 mm", unit="p",
        )  # fmt: skip
    full = make_problem("orthoglide6", data="exp2", free="full", model="linear")
    estimated = estimate(full, sigma=given["sigma"], covariance=weights_14)
    digit = "what the printed angles, 11.0 and -18.7 degrees, are worth, and half a digit of what to read"
    mean = float(estimated.standard_errors.mean())
    yield printed.claim(
        "accuracy_full", "Section 3.4", "the parameters are identified to about .07 mm with gauges of .01 mm",
        ours=estimated.standard_errors, rule=digit,
        ruling=judge_near(entry.printed, entry.value, mean, Tolerance(0.02, digit)),
        method="(12) with (14) at asin of the strokes, mean of the six parameters",
        reason=f"{machine.accuracy(printed, True):.3f} mm at the printed angles", unit="mm", printed=entry.printed,
        about="text.section34.parameter_error", read=entry.value,
    )  # fmt: skip
    alone = [estimated.of({f"drho_{axis}": 1.0, f"dL_{axis}": -1.0})[1] for axis in "xyz"]
    yield printed.claim(
        "accuracy_difference", "Section 3.4", "rho - L is identified to .07 mm with gauges of .01 mm",
        ours=alone, ruling=judge_limit(max(alone), entry.printed),
        rule="true where no standard error of rho - L is above the printed one",
        method="(12) with (14) at asin of the strokes", unit="mm", printed=entry.printed,
        about="text.section34.parameter_error", read=entry.value,
        differs="of the differences rho - L the printed number holds, of the six parameters it does not",
    )  # fmt: skip
    fit, column = fitted("exp2", "full"), printed.column("table3.exp2_full")
    gaps = [float(fit.x[i] - fit.x[3 + i]) - (column[f"drho_{a}"] - column[f"dL_{a}"]) for i, a in enumerate("xyz")]
    within = 0.005 * (2 + max(float(np.abs(fit.solver[i] - fit.solver[3 + i]).sum()) for i in range(3)))
    yield printed.claim(
        "table3_differences", "Table 3, row '{Delta rho, Delta L}'",
        "the printed full set has the differences rho - L of the best fit",
        ours=np.abs(gaps), ruling=judge_limit(float(np.abs(gaps).max()), within),
        rule=f"true within {within:.3f} mm: half a digit of both numbers and of each datum, as the fit carries it",
        method="distance of rho - L from that of the linear fit", unit="mm", printed=0.0,
    )  # fmt: skip


def improvement_rows(printed: Printed) -> Iterator[Row]:
    """Yield how much better the machine became."""
    size = [rms(table1(printed, key)) for key in ("exp1", "exp2", "exp3")]
    worst = max(after / before for before, after in pairwise(size))
    yield printed.claim(
        "improves", "Section 4.2 and Table 1", "the deviations shrink from each experiment to the next",
        ours=worst, ruling=judge_limit(worst, 1.0), rule="true where each rms is below the one before",
        method="larger ratio of successive rms",
    )  # fmt: skip
    # nothing is left to gain: after the adjustment the offsets do not explain more than noise would
    twelve = fitted("exp3_t2", "rho")
    left = twelve.residuals
    p = f_test_of_sums(float(twelve.data @ twelve.data), 0, float(left @ left), 3, len(left)).p_value
    yield printed.claim(
        "nothing_left", "Section 4.2, Experiment #3", "a further calibration would improve little",
        ours=1 - p, ruling=judge_limit(1 - p, 0.95),
        rule="true where the offsets fitted to Experiment 3 have p above .05",
        method="1 - p of the F test of drho against no errors, Table 2, Experiment 3", unit="1 - p",
    )  # fmt: skip
    six, differences = printed.column("table1.exp3"), machine.table2_differences()["exp3_t2"]
    gap = max(abs(six[name] - value) for name, value in differences.items())
    yield printed.claim(
        "one_experiment3", "Tables 1 and 2", "Experiment 3 of Table 1 is Experiment 3 of Table 2",
        ours=gap, ruling=judge_limit(gap, 0.015), rule="true within .015 mm, half a digit of three numbers",
        method="largest distance of Table 1's differences from those of Table 2", unit="mm", printed=0.0,
        about="erratum.12",
        differs="each table prints what its own fit was made of; that both are one experiment does not hold",
    )  # fmt: skip


def assumption_rows(printed: Printed) -> Iterator[Row]:
    """Yield the noise of Experiments 1 and 2, what is blamed for it, and how little Experiment 3 altered."""
    sigma = printed.column("text.section34")["sigma"]
    noise, low = noise_of("exp1")
    yield printed.claim(
        "sigma_unrealistic", "Section 4.2, Experiment #1",
        "the noise estimated from the residuals is unrealistic beside .01 mm",
        ours=low / sigma, ruling=judge_at_least(low / sigma, 1.0),
        rule="true where sigma is above .01 mm with 97.5 % confidence",
        method="lower end of sigma's 95 % interval over .01 mm: residuals of the {rho} fit of Table 1, Measurements "
        "#1, each of two readings", reason=f"sigma is {noise:.2f} mm",
    )  # fmt: skip
    noise, low = noise_of("exp2_t1")
    twelve, low_twelve = noise_of("exp2")
    yield printed.claim(
        "assumptions_valid", "Section 4.2, Experiment #2",
        "the expected residual of .20 mm justifies the modelling assumptions",
        ours=low / sigma, ruling=judge_limit(low / sigma, 1.0),
        rule="true where sigma may be .01 mm: what refuted the assumptions in Experiment 1 must not refute them here",
        method="lower end of sigma's 95 % interval over .01 mm: residuals of the {rho} fit of Table 1, Measurements #2",
        reason=f"sigma is {noise:.2f} mm; of the twelve deviations of Table 2 it is {twelve:.2f} mm, at least "
        f"{low_twelve:.2f}",
    )  # fmt: skip
    for number, place in ((1, "1"), (2, "1 and Resume")):
        supported = orientation(f"exp{number}")
        yield printed.claim(
            f"orientation_blamed_{number}", f"Section 4.2, Experiment #{place}",
            f"the orientation of the linear axes is what the model lacks (Experiment {number})",
            ours=supported.p, ruling=judge_limit(supported.p, 0.05),
            rule="true where leaning axes beside the joint offsets have p below .05",
            method=f"F test of {ORIENTATION}, about a common point, Table {number}, least squares",
            reason=f"F = {supported.F:.2f}, p = {supported.p:.2f}: they explain {supported.share:.0%} of the misfit; "
            "axes that lean and still intersect in a point, as the model with angles alone would have them", unit="p",
        )  # fmt: skip
    third = [fitted(name, "rho").x for name in ("exp3_t2", "exp3_t1")]
    shares = [rms(x) / rms(fitted(before, "rho").x) for x, before in zip(third, ("exp2", "exp2_t1"), strict=True)]
    moved = [float(np.abs(x).max()) for x in third]
    yield printed.claim(
        "small_alteration", "Section 4.2, Experiment #3",
        "a fit to the third data set alters the parameters very little",
        ours=shares, ruling=judge_limit(max(shares), 0.1, 0.25),
        rule="true where in both prints of Experiment 3 the further offsets are a tenth of the first, in kind a "
        "quarter", method="rms of the offsets fitted to Experiment 3 over that of the offsets fitted to Experiment 2",
        reason=f"Table 2 {shares[0]:.2f} (up to {moved[0]:.2f} mm), Table 1 {shares[1]:.2f} (up to {moved[1]:.2f} mm)",
    )  # fmt: skip


def noise_of(data: str) -> tuple[float, float]:
    """Return sigma [mm] of a reading from the residuals of the {rho} fit, and the lower end of its 95 % interval."""
    fit = fitted(data, "rho")
    residuals = fit.residuals
    squares, free = float(residuals @ residuals) / 2, len(residuals) - len(fit.x)
    return float(np.sqrt(squares / free)), float(np.sqrt(squares / chi2.ppf(0.975, free)))


def orientation(data: str) -> Supported:
    """Return what a printed set says of axes that are not square to each other, beside its joint offsets."""
    formulation = machines.make("orthoglide").formulate(measured_set(data))
    about = linear(formulation, weighted=False)
    return small_sample(about, [effect_of(formulation, ORIENTATION)], PLAUSIBLE, draws=1)[ORIENTATION]


def text_rows(printed: Printed) -> Iterator[Row]:
    """Yield the rows of sections 3.4, 4.1, 4.2 and 5."""
    key = "text.section34"
    resolution = printed.column("text.section41")["indicator_resolution"] / 1000  # printed in um
    yield machine.angle_row(printed, f"{key}.alpha_1", "plus")
    yield machine.angle_row(printed, f"{key}.alpha_2", "minus")
    yield printed.cell(f"{key}.sigma", resolution, _RESOLUTION, "resolution of the indicators, section 4.1")
    yield printed.cell(
        f"{key}.parameter_error", machine.accuracy(printed, True), Tolerance(0.005, "half a printed digit"),
        "(12) with (14) at the printed angles, mean of the three offsets",
        reason=f"{machine.accuracy(printed, False):.3f} mm at asin of the strokes",
    )  # fmt: skip
    key = "text.section41"
    sigma = printed.column("text.section34")["sigma"] * 1000  # um
    yield printed.cell(f"{key}.indicator_resolution", sigma, _RESOLUTION, "sigma of section 3.4")
    yield printed.unknown(f"{key}.better_resolution", "a gauge that was not used")
    for name, stroke in (("rho_min", "stroke_minus"), ("rho_max", "stroke_plus")):
        yield printed.cell(f"{key}.{name}", printed.column("geometry")[stroke], _EXACT, "the strokes of section 2.3")
    yield printed.unknown(f"{key}.repeats", "the repeated readings are not published")
    yield printed.unknown(f"{key}.dissimilarity_below", "the repeated readings are not published")
    yield from _experiments(printed, resolution)
    # 'dividing the residual root-mean-square by three' does not say of which table
    pairs = [(table(printed, "exp2"), table(printed, "exp3")) for table in (table1, table2)]
    one, two = (rms(before) / rms(after) for before, after in pairs)
    half = Tolerance(0.5, "half a printed digit; in kind where one of the two tables gives it")
    ruling = judge_either(printed.column("text.section5")["rms_divided_by"], [one, two], half)
    yield printed.cell(
        "text.section5.rms_divided_by", ruling.judged, half,
        "rms of Experiment 2 over that of Experiment 3, six differences of Table 1 or twelve deviations of Table 2",
        reason=f"{one:.2f} in Table 1, {two:.2f} in Table 2: the sentence does not say which, and holds for the first",
        ruling=ruling,
    )  # fmt: skip


def _experiments(printed: Printed, resolution: float) -> Iterator[Row]:
    key, values, fit = "text.experiment1", table1(printed, "exp1"), fitted("exp1", "rho")
    yield printed.cell(f"{key}.largest", float(np.abs(values).max()), _EXACT, "largest deviation of Table 1")
    tolerance = rms_tolerance(values, 1, fit.slip)
    yield printed.cell(f"{key}.rms_before", rms(values), tolerance, "rms of Table 1, Measurements #1")
    residual_maker = np.eye(6) - fit.predictor
    left = residual_maker @ fit.data
    yield printed.cell(
        f"{key}.rms_after", rms(left), rms_tolerance(left, 1, residual_maker @ fit.slip),
        "rms left by the {rho} fit of Table 1, Measurements #1",
    )  # fmt: skip
    how = "resolution of the indicators, section 4.1"
    yield printed.cell(f"{key}.encoder_resolution", resolution, _RESOLUTION, how)
    key, six, twelve = "text.experiment2", table1(printed, "exp2"), table2(printed, "exp2")
    yield printed.cell(
        f"{key}.deviations_below", float(np.abs(six).max()), Tolerance(1e-9, "a number of the table"),
        "largest of the six deviations of Table 1, Measurements #2",
        reason=f"the largest of the twelve of Table 2 is {np.abs(twelve).max():.2f}",
    )  # fmt: skip
    ratio, half = rms(values) / rms(six), Tolerance(0.5, "half a printed digit")
    yield printed.cell(f"{key}.times_better", ratio, half, "rms of Table 1, Measurements #1 over #2")
    left = fitted("exp2_t1", "rho").residuals
    yield printed.cell(f"{key}.expected", rms(left), rms_tolerance(left), "rms left by the {rho} fit of Table 1")
    sets = len(constants.document("pashkevich2008")["table3"])
    yield printed.cell(f"{key}.parameter_sets", sets, _EXACT, "rows of Table 3")
    yield printed.cell(f"{key}.rms_before", rms(twelve), rms_tolerance(twelve), "rms of Table 2, Experiment 2")
    for name, frees in (("rms_one_set", ("rho", "L")), ("rms_full", ("full",))):
        kept = [fitted("exp2", free).residuals for free in frees]
        yield printed.cell(
            f"{key}.{name}", [rms(v) for v in kept], rms_tolerance(kept[0]),
            f"rms left by the fits of {' and of '.join(frees)} to Table 2, Experiment 2",
        )  # fmt: skip
    key, after, fit = "text.experiment3", table2(printed, "exp3"), fitted("exp3_t2", "rho")
    for name, values, number in (("before", twelve, 2), ("after", after, 3)):
        ordered = np.sort(np.abs(values))[::-1]
        yield printed.cell(
            f"{key}.largest_{name}", float(ordered[0]), Tolerance(1e-9, "a number of the table"),
            f"largest of the twelve deviations of Table 2, Experiment {number}",
            reason=f"the second is {ordered[1]:.2f}",
        )  # fmt: skip
    yield printed.cell(f"{key}.rms_before", rms(twelve), rms_tolerance(twelve), "rms of Table 2, Experiment 2")
    tolerance = rms_tolerance(after, 1, fit.slip)
    yield printed.cell(f"{key}.rms_after", rms(after), tolerance, "rms of Table 2, Experiment 3")
    residual_maker = np.eye(12) - fit.predictor
    left = residual_maker @ fit.data
    yield printed.cell(
        f"{key}.rms_expected", rms(left), rms_tolerance(left, 1, residual_maker @ fit.slip),
        "rms left by the {rho} fit of Table 2, Experiment 3",
    )  # fmt: skip


def equation_rows(printed: Printed) -> Iterator[Row]:
    """Yield equations (5) to (9), the eleven rows of (11) whose right-hand side is printed right, and its range."""
    pose, zero, ends = np.array([20.0, -30.0, 10.0]), np.zeros(3), np.eye(3)
    plus, minus = geometry().stroke_plus, geometry().stroke_minus
    at_ends = [(equation_8(axis, stroke), stroke * ends[axis]) for axis in range(3) for stroke in (plus, minus)]
    for number, sentence, pairs, where in (
        ("5", "the Jacobian of the tool centre point", [(equation_5(pose), pose)], "at (20, -30, 10) mm"),
        ("6", "the Jacobian at Zero", [(equation_6(), zero)], "at Zero"),
        ("7", "the displacement at Zero is drho - dL, leg by leg", [(equation_7(), zero)], "at Zero"),
        ("8", "the Jacobian at XMax, and likewise at the other ends", at_ends, "at the six ends"),
        ("9", "the displacement at XMax", [(equation_9(plus), plus * ends[0])], "at XMax"),
    ):
        gap = 0.0
        for matrix, position in pairs:
            joints = kinematics.inverse_kinematics(position[None])  # dp / d(drho, dL) by central differences of .01 mm
            sides = [[kinematics.direct_kinematics(joints, s * 0.01 * e)[0] for s in (1.0, -1.0)] for e in np.eye(6)]
            slopes = np.array([(above - below) / (2 * 0.01) for above, below in sides]).T
            gap = max(gap, float(np.abs(matrix - slopes).max()))
        yield printed.claim(
            f"equation{number}", f"equation ({number})", sentence, ours=gap,
            ruling=judge_limit(gap, 1e-6),  # what such differences leave of a derivative of the order of 1
            rule="true where no coefficient is off by more than 1e-6, the error of the differences",
            method="largest distance of the printed coefficients from central differences of direct kinematics by (2), "
            f"{where}", printed=0.0,
        )  # fmt: skip
    gap = equation_11_gap()
    yield printed.claim(
        "equation11_rest", "equation (11)", "eleven of the twelve rows are those of the legs' deviations",
        ours=gap, ruling=judge_limit(gap, 1e-9), rule="true where no coefficient is off by more than rounding",
        method="printed rows beside the exact model's Jacobian; the first right-hand side is an erratum", printed=0.0,
    )  # fmt: skip
    sigma = printed.column("text.section34")["sigma"]
    reach = linear_range(sigma)
    for free, words in (("rho", "offsets"), ("L", "leg lengths"), ("full", "full set")):
        column = printed.column(f"table3.exp2_{free}")
        x = np.array([column.entries[name].value if name in column else 0.0 for name in NAMES])
        off = linear_error(x)
        yield printed.claim(
            f"linearisation_{free}", "Section 3.2, below (11)",
            f"(11) is valid for small values: for the {words} identified in Experiment 2",
            ours=off, ruling=judge_limit(off, sigma / 2, sigma),
            rule="true within half a printed digit, .005 mm, in kind within sigma = .01 mm",
            method=f"largest distance of (11) from the exact model at row {words} of Table 3",
            reason=f"the largest value is {np.abs(x).max():.2f} mm; parameters up to {reach:.2f} mm, whatever their "
            "signs, are within sigma", unit="mm", printed=0.0,
        )  # fmt: skip


def equation_5(p: Array) -> Array:
    """Return [J_rho; J_L] of (5) as printed, shape (3, 6): two inverses."""
    rho, length = kinematics.inverse_kinematics(p[None])[0], geometry().length
    along = p - rho
    over_own = np.array([[1.0 if i == j else p[j] / along[i] for j in range(3)] for i in range(3)])
    over_length = np.array([[(along[i] if i == j else p[j]) / length for j in range(3)] for i in range(3)])
    return np.hstack([np.linalg.inv(over_own), np.linalg.inv(over_length)])


def equation_6() -> Array:
    """Return (6) as printed."""
    return np.array([[1.0, 0, 0, -1, 0, 0], [0, 1.0, 0, 0, -1, 0], [0, 0, 1.0, 0, 0, -1]])


def equation_7() -> Array:
    """Return the coefficients of (7): d p_i = d rho_i - d L_i."""
    return np.hstack([np.eye(3), -np.eye(3)])


def equation_8(axis: int, stroke: float) -> Array:
    """Return (8) as printed for X, its indices moved on for Y and Z; `stroke` below 0 is the Min posture."""
    alpha = np.arcsin(stroke / geometry().length)
    t, c = np.tan(alpha), np.cos(alpha)
    for_x = np.array([[1.0, 0, 0, -1, 0, 0], [t, 1, 0, -t, -1 / c, 0], [t, 0, 1, -t, 0, -1 / c]])
    order = [(k - axis) % 3 for k in range(3)]
    return for_x[np.ix_(order, order + [3 + k for k in order])]


def equation_9(stroke: float) -> Array:
    """Return the coefficients of the three lines of (9), XMax."""
    alpha = np.arcsin(stroke / geometry().length)
    t, c = np.tan(alpha), np.cos(alpha)
    d_px = {"drho_x": 1.0, "dL_x": -1.0}
    d_py = {"drho_x": t, "drho_y": 1.0, "dL_x": -t, "dL_y": -1 / c}
    d_pz = {"drho_x": t, "drho_z": 1.0, "dL_x": -t, "dL_z": -1 / c}
    return np.array([[line.get(name, 0.0) for name in NAMES] for line in (d_px, d_py, d_pz)])


def equation_11_gap() -> float:
    """Return how far (11) as printed is from the exact model's Jacobian, over all rows but the first."""
    exact = make_problem("orthoglide6", data="exp2", free="full", model="exact")
    slopes, labels = exact.jacobian(np.zeros(6)), [r.label for r in exact.plan]
    worst = 0.0
    for sign, alpha in (("+", geometry().alpha_plus), ("-", geometry().alpha_minus)):
        a, b = np.sin(alpha), (0.5 + np.sin(alpha)) * np.tan(alpha)
        c = (0.5 + np.sin(alpha)) / np.cos(alpha) - 0.5
        for along, leg in ("xy", "yx", "yz", "zy", "xz", "zx"):
            if (along, leg, sign) == ("x", "y", "+"):
                continue  # the row with the misprinted right-hand side
            line = {f"drho_{along}": a, f"drho_{leg}": b, f"dL_{along}": -c, f"dL_{leg}": -b}
            row = np.array([line.get(name, 0.0) for name in NAMES])
            worst = max(worst, float(np.abs(row - slopes[labels.index(f"{along}_{leg}{sign}")]).max()))
    return worst


@cache
def _exact_and_linear() -> tuple[Any, Any]:
    return (
        make_problem("orthoglide6", data="exp2", free="full", model="exact"),
        make_problem("orthoglide6", data="exp2", free="full", model="linear"),
    )


def linear_error(x: Array) -> float:
    """Return by how much (11) is off the exact model at most at the parameters x, shape (6,), mm."""
    exact, linear = (kind.residuals(x) - kind.residuals(np.zeros(6)) for kind in _exact_and_linear())
    return float(np.abs(exact - linear).max())


def linear_range(limit: float) -> float:
    """Return the size [mm] of all six parameters up to which (11) is within `limit` mm whatever their signs."""
    signs = [np.array([1.0 if n >> k & 1 else -1.0 for k in range(6)]) for n in range(64)]
    low, high = 0.0, 10.0
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if max(linear_error(middle * s) for s in signs) <= limit else (low, middle)
    return low
