"""Section 3.3 of Cong et al. 2008: what fmincon finds in Tables 2 to 4, and the sentences about it.

Sampling plans and stopping rule are not printed. Ours is `fmincon` over the default plan and four random ones:
parameters where it goes on to rounding, kmrmse and iterations where MATLAB's tolerances and differences stop it. What
digits cannot say, distances to the truth can. Which J is more precise than which is judged over the releases of
fmincon, in `cong2008_stopping_claims`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from calibench import problems
from calibench.bench.papers.cong2008.section3.stopping import plan as _plan
from calibench.bench.papers.evidence import Evidence, found
from calibench.bench.papers.evidence import problem as make_problem
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Ours, Row, judge_at_least, judge_limit

_MATLAB = {"OptimalityTolerance": 1e-6, "SpecifyObjectiveGradient": False}
_TWELVE: tuple[str, dict[str, Any]] = ("full12", {"error": "J3", "gauge": "ya2"})


def rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield the claims of section 3.3; the printed columns are those of `cong2008_columns`."""
    yield from _claims(printed, evidence)


def twelve(evidence: Evidence) -> Any:
    """Return the runs of Table 4's 12 parameters."""
    return _runs(evidence, *_TWELVE)


def _runs(evidence: Evidence, problem: str, options: dict[str, Any], stopping: dict[str, Any] = _MATLAB) -> Any:
    import pandas as pd

    studies = ("cong2008", "cong2008_plans")
    both = [evidence.of(study, problem, "fmincon", options, stopping) for study in studies]
    return pd.concat(both).drop_duplicates("run_id")


def _claims(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    errors = [
        [
            problems.identify(make_problem("sensor_zero", n=n, **_plan("sensor_zero", k))).standard_errors
            for k in range(4)
        ]
        for n in (3, 9)
    ]
    gain = (np.max(errors[1], axis=1) / np.max(errors[0], axis=1)).tolist()
    yield printed.claim(
        "more_samples_noise", "Section 3.3 A", "more samples are more precise, with noise in the readings",
        Ours.of(gain), judge_limit(float(np.median(gain)), 0.75, 1.0), "true below 3/4, in kind below 1",
        "worst standard error at nine samples over three, four random plans",
        "without noise only the stopping rule limits the precision, and more samples need not help",
    )  # fmt: skip
    yield _artefact(printed)
    precise = found(_runs(evidence, "full11", {"error": "J3", "paper_section": 3}), "parameter_error_mm")
    raw = found(twelve(evidence), "parameter_error_mm")
    exact = found(evidence.of("cong2008", "full11", "lm", {"error": "J3", "paper_section": 3}), "parameter_error_mm")
    yield printed.claim(
        "eleven_precise", "Section 3.3 C", "11 parameters are calibrated accurately", Ours.of(exact),
        judge_limit(float(np.median(exact)) if len(exact) else float("nan"), 1e-3),
        "true where the worst length is within 1e-3 mm", "worst length of lm on full11 (section 3), no noise",
        f"fmincon with tolerances of 1e-6 stops {np.median(precise) if len(precise) else float('nan'):.2g} mm away",
        "mm", printed=_worst(printed, "table4.j3_11"),
    )  # fmt: skip
    methods = [
        found(evidence.of("cong2008", "full12", name, _TWELVE[1]), "parameter_error_mm") for name in ("lm", "trf")
    ]
    every = np.concatenate([raw, *methods])
    aligned = found(twelve(evidence), "kmrmse_aligned")
    yield printed.claim(
        "twelve_off", "Section 3.3 C", "12 parameters end several millimetres off", Ours.of(every),
        judge_at_least(float(np.max(every)) if len(every) else float("nan"), 1.0, 0.1),
        "true where the worst run is 1 mm off or more, in kind .1 mm; how far is arbitrary, as no reading tells",
        "worst length on full12 (gauge=ya2) by fmincon over 5 plans, lm and trf",
        f"a search ends anywhere on the gauge curve; modulo the gauge fmincon is "
        f"{np.median(aligned) if len(aligned) else float('nan'):.2g} mm off in kmrmse", "mm",
        printed=_worst(printed, "table4.j3_12"),
    )  # fmt: skip


def _artefact(printed: Printed) -> Row:
    """Return what J1 times 4 l_b^2 is beside J2, from the same points near the truth."""
    j1, j2 = (make_problem("link_length", error=e) for e in ("J1", "J2"))
    rng, scale = np.random.default_rng(0), 4.0 * printed.column("geometry")["link"] ** 2
    near = j2.truth + rng.normal(size=(200, 9)) * np.where([p.unit == "rad" for p in j2.parameters], 1e-5, 1e-3)
    ratios = scale * j1.batch(near) / j2.batch(near)
    return printed.claim(
        "j1_is_j2_scaled", "equations (37) and (39)", "near zero J1 x 4 l_b^2 behaves as J2", Ours.of(ratios),
        judge_limit(float(np.abs(ratios - 1).max()), 0.02), "true where all ratios lie within 2 % of 1",
        "J1 x 238144 / J2 at 200 points near the truth of link_length",
        "so neither is more precise: they have the same minimum and the same shape about it", printed=1.0,
    )  # fmt: skip


def _worst(printed: Printed, key: str) -> float:
    column, actual = printed.column(key), printed.column("table4.actual")
    return max(abs(column[n] - actual[n]) for n in column if n in actual and column.entries[n].unit == "mm")
