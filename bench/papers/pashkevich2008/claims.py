"""What Pashkevich et al. 2008 say: their equations, the numbers of the text, what they conclude; and the errata.

Equations (5) to (9) and (11) stand against differences of the model (2). The chapter holds the residuals of Experiment
1 against the .01 mm of its indicators, and not those of Experiment 2; here both are asked the same question. Errata as
in `cong2008.search`.
"""

from collections.abc import Callable, Iterator
from itertools import pairwise
from math import nan

import numpy as np
from scipy.stats import chi2

from calibench.bench.papers import ledger
from calibench.bench.papers.ledger import Array, Printed, Row, Tolerance
from calibench.bench.papers.pashkevich2008 import machine
from calibench.bench.papers.pashkevich2008.machine import fitted, rms, rms_row, rms_tolerance, table1, table2
from calibench.discrepancy import machines
from calibench.discrepancy.fitting.small_sample import Supported, linear, small_sample
from calibench.discrepancy.machines.orthoglide.experiments import ORIENTATION, PLAUSIBLE, effect_of
from calibench.discrepancy.machines.orthoglide.kinematics import printed as measured_set
from calibench.problems import constants
from calibench.problems.identifiability import estimate, f_test, f_test_of_sums
from calibench.problems.orthoglide import kinematics
from calibench.problems.orthoglide.plans import covariance, paper_plan

_EXACT = Tolerance(0.0, "a given number, or one of the table it is taken from")
_RESOLUTION = Tolerance(1e-12, "a given number")


def identification_rows(printed: Printed) -> Iterator[Row]:
    matrix, given = kinematics.calibration_matrix(), printed.column("text.section34")
    weights_14, entry = covariance(paper_plan()), given.entries["parameter_error"]
    unknowns, rank = printed.column("equation11")["unknowns"], int(np.linalg.matrix_rank(matrix))
    yield printed.claim(
        "six_identifiable", "Section 3.2", "the twelve equations (11) determine all six parameters",
        ours=rank, ruling=ledger.judge_near(unknowns, unknowns, rank, Tolerance(0.0, "a count")),
        rule="true where the rank of (11) is 6", method="rank of the matrix of (11)",
        reason=f"its condition number is {np.linalg.cond(matrix):.1f}", printed=unknowns,
    )  # fmt: skip
    unit = matrix / np.linalg.norm(matrix, axis=0)
    cosine = min(float(unit[:, i] @ unit[:, 3 + i]) for i in range(3))  # of the columns drho and dL
    noise = given["sigma"] / np.linalg.svd(matrix, compute_uv=False)  # mm along each direction of the parameters
    small, large = (ledger.problem("orthoglide6", data="exp2", free=free) for free in ("rho", "full"))
    for key, spread, how in (
        ("identifies_simultaneously", None, "F test of dL on top of drho, Experiment 2, residuals independent"),
        ("identifies_simultaneously_weighted", weights_14, "the same F test, weighted by (14)"),
    ):
        test = f_test(small, large, covariance=spread)
        yield printed.claim(
            key, "Section 4.2, Experiment #2", "the method identifies both drho and dL simultaneously",
            ours=test.p_value, ruling=ledger.judge_limit(test.p_value, 0.05),
            rule="true where leg lengths on top of offsets have p below .05", method=how,
            reason=f"only rho - L is determined: {test.sentence()}; cosine of the columns {cosine:.5f}; gauges of "
            f".01 mm see {int((noise <= entry.printed).sum())} of six directions to the printed .07 mm", unit="p",
        )  # fmt: skip
    full = ledger.problem("orthoglide6", data="exp2", free="full", model="linear")
    estimated = estimate(full, sigma=given["sigma"], covariance=weights_14)
    digit = "what the printed angles, 11.0 and -18.7 degrees, are worth, and half a digit of what to read"
    mean = float(estimated.standard_errors.mean())
    yield printed.claim(
        "accuracy_full", "Section 3.4", "the parameters are identified to about .07 mm with gauges of .01 mm",
        ours=estimated.standard_errors, rule=digit,
        ruling=ledger.judge_near(entry.printed, entry.value, mean, Tolerance(0.02, digit)),
        method="(12) with (14) at asin of the strokes, mean of the six parameters",
        reason=f"{machine.accuracy(printed, True):.3f} mm at the printed angles", unit="mm", printed=entry.printed,
        about="text.section34.parameter_error", read=entry.value,
    )  # fmt: skip
    alone = [estimated.of({f"drho_{axis}": 1.0, f"dL_{axis}": -1.0})[1] for axis in "xyz"]
    yield printed.claim(
        "accuracy_difference", "Section 3.4", "rho - L is identified to .07 mm with gauges of .01 mm",
        ours=alone, ruling=ledger.judge_limit(max(alone), entry.printed),
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
        ours=np.abs(gaps), ruling=ledger.judge_limit(float(np.abs(gaps).max()), within),
        rule=f"true within {within:.3f} mm: half a digit of both numbers and of each datum, as the fit carries it",
        method="distance of rho - L from that of the linear fit", unit="mm", printed=0.0,
    )  # fmt: skip


def improvement_rows(printed: Printed) -> Iterator[Row]:
    size = [rms(table1(printed, key)) for key in ("exp1", "exp2", "exp3")]
    worst = max(after / before for before, after in pairwise(size))
    yield printed.claim(
        "improves", "Section 4.2 and Table 1", "the deviations shrink from each experiment to the next",
        ours=worst, ruling=ledger.judge_limit(worst, 1.0), rule="true where each rms is below the one before",
        method="larger ratio of successive rms",
    )  # fmt: skip
    # nothing is left to gain: after the adjustment the offsets do not explain more than noise would
    twelve = fitted("exp3_t2", "rho")
    left = twelve.residuals
    p = f_test_of_sums(float(twelve.data @ twelve.data), 0, float(left @ left), 3, len(left)).p_value
    yield printed.claim(
        "nothing_left", "Section 4.2, Experiment #3", "a further calibration would improve little",
        ours=1 - p, ruling=ledger.judge_limit(1 - p, 0.95),
        rule="true where the offsets fitted to Experiment 3 have p above .05",
        method="1 - p of the F test of drho against no errors, Table 2, Experiment 3", unit="1 - p",
    )  # fmt: skip
    six, differences = printed.column("table1.exp3"), machine.table2_differences()["exp3_t2"]
    gap = max(abs(six[name] - value) for name, value in differences.items())
    yield printed.claim(
        "one_experiment3", "Tables 1 and 2", "Experiment 3 of Table 1 is Experiment 3 of Table 2",
        ours=gap, ruling=ledger.judge_limit(gap, 0.015), rule="true within .015 mm, half a digit of three numbers",
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
        ours=low / sigma, ruling=ledger.judge_at_least(low / sigma, 1.0),
        rule="true where sigma is above .01 mm with 97.5 % confidence",
        method="lower end of sigma's 95 % interval over .01 mm: residuals of the {rho} fit of Table 1, Measurements "
        "#1, each of two readings", reason=f"sigma is {noise:.2f} mm",
    )  # fmt: skip
    noise, low = noise_of("exp2_t1")
    twelve, low_twelve = noise_of("exp2")
    yield printed.claim(
        "assumptions_valid", "Section 4.2, Experiment #2",
        "the expected residual of .20 mm justifies the modelling assumptions",
        ours=low / sigma, ruling=ledger.judge_limit(low / sigma, 1.0),
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
            ours=supported.p, ruling=ledger.judge_limit(supported.p, 0.05),
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
        ours=shares, ruling=ledger.judge_limit(max(shares), 0.1, 0.25),
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
    for name in ("repeats", "dissimilarity_below"):
        yield printed.unknown(f"{key}.{name}", "the repeated readings are not published")
    yield from _experiments(printed, resolution)
    # 'dividing the residual root-mean-square by three' does not say of which table
    pairs = [(table(printed, "exp2"), table(printed, "exp3")) for table in (table1, table2)]
    one, two = (rms(before) / rms(after) for before, after in pairs)
    half = Tolerance(0.5, "half a printed digit; in kind where one of the two tables gives it")
    ruling = ledger.judge_either(printed.column("text.section5")["rms_divided_by"], [one, two], half)
    yield printed.cell(
        "text.section5.rms_divided_by", ruling.judged, half,
        "rms of Experiment 2 over that of Experiment 3, six differences of Table 1 or twelve deviations of Table 2",
        reason=f"{one:.2f} in Table 1, {two:.2f} in Table 2: the sentence does not say which, and holds for the first",
        ruling=ruling,
    )  # fmt: skip


def _experiments(printed: Printed, resolution: float) -> Iterator[Row]:
    key, values, fit = "text.experiment1", table1(printed, "exp1"), fitted("exp1", "rho")
    yield printed.cell(f"{key}.largest", float(np.abs(values).max()), _EXACT, "largest deviation of Table 1")
    yield rms_row(printed, f"{key}.rms_before", values, "rms of Table 1, Measurements #1", fit.slip)
    left, how = fit.residual_maker @ fit.data, "rms left by the {rho} fit of Table 1, Measurements #1"
    yield rms_row(printed, f"{key}.rms_after", left, how, fit.residual_maker @ fit.slip)
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
    yield rms_row(
        printed, f"{key}.expected", fitted("exp2_t1", "rho").residuals, "rms left by the {rho} fit of Table 1"
    )
    sets = len(constants.document("pashkevich2008")["table3"])
    yield printed.cell(f"{key}.parameter_sets", sets, _EXACT, "rows of Table 3")
    yield rms_row(printed, f"{key}.rms_before", twelve, "rms of Table 2, Experiment 2")
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
    yield rms_row(printed, f"{key}.rms_before", twelve, "rms of Table 2, Experiment 2")
    yield rms_row(printed, f"{key}.rms_after", after, "rms of Table 2, Experiment 3", fit.slip)
    left, how = fit.residual_maker @ fit.data, "rms left by the {rho} fit of Table 2, Experiment 3"
    yield rms_row(printed, f"{key}.rms_expected", left, how, fit.residual_maker @ fit.slip)


def equation_rows(printed: Printed) -> Iterator[Row]:
    """Yield equations (5) to (9), the eleven rows of (11) whose right-hand side is printed right, and its range."""
    pose, zero, ends = np.array([20.0, -30.0, 10.0]), np.zeros(3), np.eye(3)
    plus, minus = kinematics.geometry().stroke_plus, kinematics.geometry().stroke_minus
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
            ruling=ledger.judge_limit(gap, 1e-6),  # what such differences leave of a derivative of the order of 1
            rule="true where no coefficient is off by more than 1e-6, the error of the differences",
            method="largest distance of the printed coefficients from central differences of direct kinematics by (2), "
            f"{where}", printed=0.0,
        )  # fmt: skip
    gap = equation_11_gap()
    yield printed.claim(
        "equation11_rest", "equation (11)", "eleven of the twelve rows are those of the legs' deviations",
        ours=gap, ruling=ledger.judge_limit(gap, 1e-9), rule="true where no coefficient is off by more than rounding",
        method="printed rows beside the exact model's Jacobian; the first right-hand side is an erratum", printed=0.0,
    )  # fmt: skip
    sigma = printed.column("text.section34")["sigma"]
    reach = linear_range(sigma)
    for free, words in (("rho", "offsets"), ("L", "leg lengths"), ("full", "full set")):
        column = printed.column(f"table3.exp2_{free}")
        x = np.array([column.entries[name].value if name in column else 0.0 for name in kinematics.NAMES])
        off = linear_error(x)
        yield printed.claim(
            f"linearisation_{free}", "Section 3.2, below (11)",
            f"(11) is valid for small values: for the {words} identified in Experiment 2",
            ours=off, ruling=ledger.judge_limit(off, sigma / 2, sigma),
            rule="true within half a printed digit, .005 mm, in kind within sigma = .01 mm",
            method=f"largest distance of (11) from the exact model at row {words} of Table 3",
            reason=f"the largest value is {np.abs(x).max():.2f} mm; parameters up to {reach:.2f} mm, whatever their "
            "signs, are within sigma", unit="mm", printed=0.0,
        )  # fmt: skip


def equation_5(p: Array) -> Array:
    """Return [J_rho; J_L] of (5) as printed, shape (3, 6): two inverses."""
    rho, length = kinematics.inverse_kinematics(p[None])[0], kinematics.geometry().length
    along = p - rho
    over_own = np.array([[1.0 if i == j else p[j] / along[i] for j in range(3)] for i in range(3)])
    over_length = np.array([[(along[i] if i == j else p[j]) / length for j in range(3)] for i in range(3)])
    return np.hstack([np.linalg.inv(over_own), np.linalg.inv(over_length)])


def equation_6() -> Array:
    return np.array([[1.0, 0, 0, -1, 0, 0], [0, 1.0, 0, 0, -1, 0], [0, 0, 1.0, 0, 0, -1]])


equation_7 = equation_6  # which it says leg by leg


def equation_8(axis: int, stroke: float) -> Array:
    """Return (8) as printed for X, its indices moved on for Y and Z; `stroke` below 0 is the Min posture."""
    alpha = np.arcsin(stroke / kinematics.geometry().length)
    t, c = np.tan(alpha), np.cos(alpha)
    for_x = np.array([[1.0, 0, 0, -1, 0, 0], [t, 1, 0, -t, -1 / c, 0], [t, 0, 1, -t, 0, -1 / c]])
    order = [(k - axis) % 3 for k in range(3)]
    return for_x[np.ix_(order, order + [3 + k for k in order])]


def equation_9(stroke: float) -> Array:
    """Return the coefficients of the three lines of (9), XMax."""
    alpha = np.arcsin(stroke / kinematics.geometry().length)
    t, c = np.tan(alpha), np.cos(alpha)
    d_px = {"drho_x": 1.0, "dL_x": -1.0}
    d_py = {"drho_x": t, "drho_y": 1.0, "dL_x": -t, "dL_y": -1 / c}
    d_pz = {"drho_x": t, "drho_z": 1.0, "dL_x": -t, "dL_z": -1 / c}
    return np.array([[line.get(name, 0.0) for name in kinematics.NAMES] for line in (d_px, d_py, d_pz)])


def equation_11_gap() -> float:
    """Return how far (11) as printed is from the exact model's Jacobian, over all rows but the first."""
    exact = ledger.problem("orthoglide6", data="exp2", free="full", model="exact")
    slopes, labels = exact.jacobian(np.zeros(6)), [r.label for r in exact.plan]
    worst = 0.0
    for sign, alpha in (("+", kinematics.geometry().alpha_plus), ("-", kinematics.geometry().alpha_minus)):
        a, b = np.sin(alpha), (0.5 + np.sin(alpha)) * np.tan(alpha)
        c = (0.5 + np.sin(alpha)) / np.cos(alpha) - 0.5
        for along, leg in ("xy", "yx", "yz", "zy", "xz", "zx"):
            if (along, leg, sign) == ("x", "y", "+"):
                continue  # the row with the misprinted right-hand side
            line = {f"drho_{along}": a, f"drho_{leg}": b, f"dL_{along}": -c, f"dL_{leg}": -b}
            row = np.array([line.get(name, 0.0) for name in kinematics.NAMES])
            worst = max(worst, float(np.abs(row - slopes[labels.index(f"{along}_{leg}{sign}")]).max()))
    return worst


def linear_error(x: Array) -> float:
    """Return by how much (11) is off the exact model at most at the parameters x, shape (6,), mm."""
    both = [ledger.problem("orthoglide6", data="exp2", free="full", model=model) for model in ("exact", "linear")]
    exact, linear = (p.residuals(x) - p.residuals(np.zeros(6)) for p in both)
    return float(np.abs(exact - linear).max())


def linear_range(limit: float) -> float:
    """Return the size [mm] of all six parameters up to which (11) is within `limit` mm whatever their signs."""
    signs = [np.array([1.0 if n >> k & 1 else -1.0 for k in range(6)]) for n in range(64)]
    low, high = 0.0, 10.0
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if max(linear_error(middle * s) for s in signs) <= limit else (low, middle)
    return low


_COUNT = Tolerance(0.0, "a count")
_ROUNDING = Tolerance(1e-9, "rounding")
_READING = "the cell is a reading; what the printed fits need it to be is asked here"


def erratum_rows(printed: Printed) -> Iterator[Row]:
    """Yield a row for each erratum of the data file. Raises `KeyError` for one without a computation."""
    shown = [slip(printed, "exp1", "rho", table1, "exp1_expected")]
    shown += [slip(printed, "exp3_t2", "full", table2, "exp3_full")]
    shown += [two_sets(printed, "exp3", "exp3_t2", "z_y"), two_sets(printed, "exp2", "exp2", "x_y")]
    return printed.in_order([*shown, *_numbers(printed), *_equations(printed)])


def slip(printed: Printed, data: str, free: str, table: Callable[[Printed, str], Array], key: str) -> Row:
    """Return what shows a datum that is found from what is printed of the fit to it."""
    as_printed, repaired = fitted(data, free), fitted(data, free, repaired=True)
    at = int(np.flatnonzero(as_printed.slip)[0])
    label = as_printed.labels[at]
    datum, digit = as_printed.datum_behind(label, table(printed, key), as_printed.data)
    return printed.erratum(
        machine.SLIPS[data][1], f"the datum {label}", unit="mm", printed=float(as_printed.data[at]),
        read=float(repaired.data[at]), ours=datum,
        tolerance=Tolerance(min(digit, abs(float(as_printed.slip[at])) / 2), "half the way between the two readings"),
        method=f"solved from the printed results of the {free} fit, all other data as printed", differs=_READING,
    )  # fmt: skip


def two_sets(printed: Printed, key: str, data: str, name: str) -> Row:
    """Return what asks Table 1's own fit which difference `name` it was made of."""
    six, as_printed = fitted("exp1", "rho"), table1(printed, key)
    datum, within = six.datum_behind(name, table1(printed, f"{key}_expected"), as_printed)
    return printed.erratum(
        f"Tables 1 and 2, Experiment {key[-1]}",
        f"{name}, Max minus Min: printed in Table 1; read off Table 2; ours from Table 1's residuals", unit="mm",
        printed=float(as_printed[six.labels.index(name)]), read=machine.table2_differences()[data][name], ours=datum,
        tolerance=Tolerance(
            within, "half a printed digit of each residual and of each other datum, as the fit carries it"
        ),
        method="solved from the printed residuals of the rho fit, all other differences as printed in Table 1",
        differs=_READING,
    )  # fmt: skip


def _numbers(printed: Printed) -> Iterator[Row]:
    # the cells of Table 2 whose sign is lost in print, then the other errata of Tables 2 and 3, then those of the text
    for experiment, free, parameters, name in (
        (2, "full", "Delta rho, Delta L", "z_y_plus"), (2, "rho", "Delta rho", "y_z_minus"),
        (2, "L", "Delta L", "z_x_plus"), (3, "L", "Delta L", "z_x_plus"),
    ):  # fmt: skip
        fit = fitted("exp2" if experiment == 2 else "exp3_t2", free)
        entry = printed.column(f"table2.exp{experiment}_{free}").entries[name]
        row = fit.predictor[fit.labels.index(name)]
        yield printed.erratum(
            f"Table 2, Experiment {experiment}, {{{parameters}}}, {name}", name, unit="mm", printed=entry.printed,
            read=entry.value, ours=float(row @ fit.data), tolerance=fit.tolerance(row, "the cell"),
            method="prediction of the linear model fitted to the data as printed",
        )  # fmt: skip
    entry = printed.column("table2.exp3_full").entries["average"]
    residuals = fitted("exp3_t2", "full", repaired=True).residuals
    yield printed.erratum(
        "Table 2, Experiment 3, 'Average' of {Delta rho, Delta L}",
        "rms left by the full fit if the datum x_z_minus is -.13", unit="mm", printed=entry.printed, read=entry.value,
        ours=rms(residuals), tolerance=rms_tolerance(residuals), method="linear fit of the repaired data",
        differs="here the datum is read as -.13, in the cell's row as printed",
    )  # fmt: skip
    column, fit = table2(printed, "exp2_full"), fitted("exp2", "full")
    yield printed.erratum(
        "Table 2, heads 'Residuals' and 'Expected improvement'",
        "largest distance of the column from residuals (printed) and from predictions", unit="mm",
        printed=float(np.abs(column - fit.residuals).max()), read=0.0,
        ours=float(np.abs(column - fit.predictor @ fit.data).max()),
        tolerance=Tolerance(0.015, "half a digit of three printed numbers"),
        method="Table 2, Experiment 2, full set, beside the linear fit",
    )  # fmt: skip
    as_printed = printed.column("table3.exp2_full")["residual"]
    yield printed.erratum(
        "Tables 2 and 3 and section 4.2, residual of the full set in Experiment 2",
        "least rms that six parameters leave in Experiment 2", unit="mm", printed=as_printed, read=as_printed,
        ours=rms(fit.residuals), tolerance=rms_tolerance(fit.residuals), method="linear fit of the full set",
    )  # fmt: skip
    place = "section 3.4, after equation (14), errors of the parameters"
    errata = constants.document("pashkevich2008")["erratum"]
    yield printed.erratum(
        place, "standard error of the offsets", unit="mm",
        printed=printed.column("text.section34").entries["parameter_error"].printed,
        read=float(next(entry["value"] for entry in errata if entry["place"] == place)),
        ours=machine.accuracy(printed, True), tolerance=Tolerance(0.005, "half a digit of what to read"),
        method="(12) with (14) at the printed angles",
    )  # fmt: skip
    values = table1(printed, "exp2")
    yield printed.erratum(
        "section 4.2, Experiment #2", "largest deviation of Table 1, Measurements #2", unit="mm",
        printed=printed.column("text.experiment2").entries["deviations_below"].printed,
        read=abs(printed.column("table1.exp2")["z_x"]), ours=float(np.abs(values).max()), tolerance=_ROUNDING,
        method=f"largest of the six; their rms is {rms(values):.2f}",
    )  # fmt: skip
    yield printed.erratum(
        "section 4.2, Experiment #3", "largest deviation of Experiment 3", unit="mm",
        printed=printed.column("text.experiment3").entries["largest_after"].printed,
        read=abs(printed.column("table2.exp3")["z_y_minus"]), ours=float(np.abs(table2(printed, "exp3")).max()),
        tolerance=_ROUNDING, method="largest of the twelve, Table 2",
    )  # fmt: skip
    as_printed = printed.column("text.experiment1")["encoder_resolution"]
    yield printed.erratum(
        "section 4.2, Experiment #1", "resolution of the indicators; that of the encoders is not given", unit="mm",
        printed=as_printed, read=as_printed, ours=printed.column("text.section41")["indicator_resolution"] / 1000,
        tolerance=Tolerance(1e-12, "a given number"), method="section 4.1",
    )  # fmt: skip
    yield printed.erratum(
        "section numbers", "section numbers: notation only", unit="1", printed=nan, read=nan, ours=nan,
        tolerance=ledger.NO_TOLERANCE, method="none: no quantity depends on it",
    )  # fmt: skip


def _equations(printed: Printed) -> Iterator[Row]:
    """Yield the errata of the model: its equations at Zero, rho = L, and at a pose of the workspace."""
    length, at_zero = kinematics.geometry().length, np.full(3, kinematics.geometry().length)
    zero = kinematics.direct_kinematics(at_zero[None])[0]
    pose = np.array([20.0, -30.0, 10.0])
    rho = kinematics.inverse_kinematics(pose[None])[0]
    yield printed.erratum(
        "equation (1)", "p_x at Zero, less e", unit="mm", printed=length + length, read=0.0,
        ours=float(np.abs(zero).max()), tolerance=_ROUNDING,
        method="(1) as printed, rho = L and zero angles, and direct kinematics by (2)",
    )  # fmt: skip
    yield printed.erratum(
        "section 2.4, after equation (4)", "p_x at Zero by (4)", unit="mm",
        printed=float(machine.direct_roots(at_zero, 1.0)[0]), read=0.0,
        ours=float(machine.direct_roots(at_zero, -1.0)[0]), tolerance=_ROUNDING,
        method="(4) with either root at rho = L",
    )  # fmt: skip
    exact = ledger.problem("orthoglide6", data="exp2", free="full", model="exact")
    labels, slopes = [r.label for r in exact.plan], exact.jacobian(np.zeros(6))
    off = [
        float(np.abs(slopes[labels.index(name)] - kinematics.calibration_matrix()[0]).max())
        for name in ("x_y-", "x_y+")
    ]
    yield printed.erratum(
        "equation (11), first right-hand side",
        "largest distance of row 1 of (11) from the exact model's derivative of its right-hand side", unit="1",
        printed=off[0], read=0.0, ours=off[1], tolerance=_ROUNDING,
        method="Jacobian of the exact model for x_y^- and for x_y^+",
    )  # fmt: skip
    as_printed = printed.column("text.section34").entries["alpha_1"].printed
    yield printed.erratum(
        "section 3.4, after equation (14), angles", "stroke that the larger angle belongs to", unit="mm",
        printed=float(length * np.sin(np.radians(as_printed))), read=printed.column("geometry")["stroke_plus"],
        ours=float(length * np.sin(kinematics.geometry().alpha_plus)), tolerance=_ROUNDING,
        method="L sin(alpha) at 11.0 and at 11.151 degrees",
    )  # fmt: skip
    upper = printed.column("text.section23")["rho_max"]
    yield printed.erratum(
        "section 2.3, after (2)", "distance of Zero, rho = L, from the upper limit of the joints", unit="mm",
        printed=upper - length, read=upper, ours=upper - (length - length), tolerance=_ROUNDING,
        method="rho_max - rho as printed and rho_max - (rho - L); below 0 is outside",
    )  # fmt: skip
    yield printed.erratum(
        "section 2.4, after (3)", "s at a pose of the workspace", unit="1", printed=float(np.sign(pose - pose)[0]),
        read=1.0, ours=np.sign(rho - pose), tolerance=_COUNT, method="sign of p - p and of rho - p at (20, -30, 10) mm",
    )  # fmt: skip
    yield printed.erratum(
        "section 2.4, after (4), A, B and C",
        "error of the pose by (4): p_x at Zero with every ordered pair, else by how much (2) fails", unit="mm",
        printed=float(machine.direct_roots(at_zero, -1.0, pairs=2)[0]), read=0.0,
        ours=machine.closure(machine.direct_roots(rho, -1.0), rho), tolerance=_ROUNDING,
        method="(4) with A over ordered pairs at Zero, and over i < j at (20, -30, 10) mm",
    )  # fmt: skip
    stroke = kinematics.geometry().stroke_plus
    leg = np.array([stroke, -kinematics.inverse_kinematics(np.array([[stroke, 0.0, 0.0]]))[0][1], 0.0]) / length
    to_x, to_own = (float(np.degrees(np.arccos(c))) for c in (abs(leg[0]), abs(leg[1])))
    yield printed.erratum(
        "section 2.4 (second), before (8)", "angle of the y-leg at XMax to the X-axis (printed) and to its own",
        unit="deg", printed=to_x, read=float(np.degrees(kinematics.geometry().alpha_plus)), ours=to_own,
        tolerance=_ROUNDING, method="direction of the y-leg by (2)",
    )  # fmt: skip
    yield printed.erratum(
        "section 3.2, after (11)", "by how much the legs do not close at Zero", unit="mm",
        printed=machine.closure(np.full(3, 2 * length), at_zero), read=0.0, ours=machine.closure(zero, at_zero),
        tolerance=_ROUNDING, method="legs of the tool centre point of (1), as printed, and of (2)",
    )  # fmt: skip
