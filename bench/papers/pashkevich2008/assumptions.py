"""What Pashkevich et al. 2008 conclude from residuals: of the noise, of the model's assumptions, of what is to blame.

The chapter holds the residuals of Experiment 1 against the .01 mm of its indicators, finds them unrealistic, and blames
the assumptions; it does not hold those of Experiment 2 against it. Here both are asked the same question.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.stats import chi2

from calibench.bench.papers.pashkevich2008.fits import fitted, rms
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Ours, Row, judge_at_least, judge_limit
from calibench.discrepancy import machines
from calibench.discrepancy.fitting.small_sample import Supported, linear, small_sample
from calibench.discrepancy.machines.orthoglide.experiments import ORIENTATION, PLAUSIBLE, effect_of
from calibench.discrepancy.machines.orthoglide.printed import printed as measured_set


def rows(printed: Printed) -> Iterator[Row]:
    """Yield the noise of Experiments 1 and 2, what is blamed for it, and how little Experiment 3 altered."""
    sigma = printed.column("text.section34")["sigma"]
    estimate, low = noise_of("exp1")
    yield printed.claim(
        "sigma_unrealistic", "Section 4.2, Experiment #1", "the noise estimated from the residuals is unrealistic "
        "beside .01 mm", low / sigma, judge_at_least(low / sigma, 1.0),
        "true where sigma is above .01 mm with 97.5 % confidence", "lower end of sigma's 95 % interval over .01 mm: "
        "residuals of the {rho} fit of Table 1, Measurements #1, each of two readings", f"sigma is {estimate:.2f} mm",
    )  # fmt: skip
    estimate, low = noise_of("exp2_t1")
    twelve, low_twelve = noise_of("exp2")
    yield printed.claim(
        "assumptions_valid", "Section 4.2, Experiment #2", "the expected residual of .20 mm justifies the modelling "
        "assumptions", low / sigma, judge_limit(low / sigma, 1.0),
        "true where sigma may be .01 mm: what refuted the assumptions in Experiment 1 must not refute them here",
        "lower end of sigma's 95 % interval over .01 mm: residuals of the {rho} fit of Table 1, Measurements #2",
        f"sigma is {estimate:.2f} mm; of the twelve deviations of Table 2 it is {twelve:.2f} mm, at least "
        f"{low_twelve:.2f}",
    )  # fmt: skip
    for number, data in ((1, "exp1"), (2, "exp2")):
        found = orientation(data)
        yield printed.claim(
            f"orientation_blamed_{number}", f"Section 4.2, Experiment #{'1' if number == 1 else '1 and Resume'}",
            f"the orientation of the linear axes is what the model lacks (Experiment {number})", found.p,
            judge_limit(found.p, 0.05), "true where leaning axes beside the joint offsets have p below .05",
            f"F test of {ORIENTATION}, about a common point, {'Table 1' if number == 1 else 'Table 2'}, least squares",
            f"F = {found.F:.2f}, p = {found.p:.2f}: they explain {found.share:.0%} of the misfit; axes that lean and "
            "still intersect in a point, as the model with angles alone would have them", "p",
        )  # fmt: skip
    yield _alteration(printed)


def noise_of(data: str) -> tuple[float, float]:
    """Return sigma [mm] of a reading from the residuals of the {rho} fit, and the lower end of its 95 % interval.

    Each deviation is a difference of two readings; that + and - readings share their Zero is left out of account.
    """
    fit = fitted(data, "rho")
    left = fit.data - fit.predictor @ fit.data
    squares, free = float(left @ left) / 2, len(left) - fit.matrix.shape[1]
    return float(np.sqrt(squares / free)), float(np.sqrt(squares / chi2.ppf(0.975, free)))


def orientation(data: str) -> Supported:
    """Return what a printed set says of axes that are not square to each other, beside its joint offsets."""
    formulation = machines.make("orthoglide").formulate(measured_set(data))
    about = linear(formulation, weighted=False)
    return small_sample(about, [effect_of(formulation, ORIENTATION)], PLAUSIBLE, draws=1)[ORIENTATION]


def _alteration(printed: Printed) -> Row:
    pairs = (("exp3_t2", "exp2"), ("exp3_t1", "exp2_t1"))
    shares = [rms(fitted(after, "rho").x) / rms(fitted(before, "rho").x) for after, before in pairs]
    moved = [float(np.abs(fitted(after, "rho").x).max()) for after, _ in pairs]
    return printed.claim(
        "small_alteration", "Section 4.2, Experiment #3", "a fit to the third data set alters the parameters very "
        "little", Ours.of(shares), judge_limit(max(shares), 0.1, 0.25),
        "true where in both prints of Experiment 3 the further offsets are a tenth of the first, in kind a quarter",
        "rms of the offsets fitted to Experiment 3 over that of the offsets fitted to Experiment 2",
        f"Table 2 {shares[0]:.2f} (up to {moved[0]:.2f} mm), Table 1 {shares[1]:.2f} (up to {moved[1]:.2f} mm)",
    )  # fmt: skip
