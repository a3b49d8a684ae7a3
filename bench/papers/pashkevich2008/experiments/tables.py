"""The tables of the page on the Orthoglide's experiments: candidates of a set, and errors of a prediction."""

from __future__ import annotations

import numpy as np

from calibench.bench.report.shared.markdown import table
from calibench.discrepancy.fitting.small_sample import SmallSample, Supported
from calibench.discrepancy.machines.orthoglide.experiments import MODELS, ORIENTATION, WHOLE, Prediction

SETS = ("exp1", "exp2", "exp2_t1", "exp3_t1", "exp3_t2")
WEIGHTING = {False: "least squares", True: "weighted, eq. (14)"}
LEAN, LONE = "guide_lean cyclic", "guide_lean axis z"
_SHOWN = 3  # candidates of a set in the table


def candidates_table(own: SmallSample) -> str:
    """Return the best candidates of a set, and those that are discussed."""
    chosen = list(own.candidates[:_SHOWN])
    chosen += [c for c in own.candidates[_SHOWN:] if c.name in (ORIENTATION, "axis_intersection all", LEAN)]
    rows = []
    for c in chosen:
        numbers = (f"{c.share:.0%}", f"{c.F:.2f}", f"{c.p:.4f}", f"{c.p_tried:.2f}")
        aicc, loo = "" if c.aicc is None else f"{c.aicc:+.1f}", f"{c.loo:.3f}" if np.isfinite(c.loo) else ""
        rows.append((c.name, str(c.rank), *numbers, aicc, loo, size_of(c) + ("" if c.plausible else " *impossible*")))
    return table(("candidate", "rank", "explains", "F", "p", "p of all", "AICc", "loo", "size"), rows)


def errors_table(own: Prediction) -> str:
    """Return the rms errors of each model's prediction, in all and by direction."""
    rows = []
    for model in (*MODELS, WHOLE):
        rms = (f"{own.rms(model, where):.3f}" for where in ("", "xy", "z"))
        like = own.like.get(model)
        rows.append((model, *rms, f"{like.p:.4f}" if like else "", str(len(own.refusing(model))) if like else ""))
    return table(
        ("model of Experiment 2", "rms [mm]", "along x, y", "along z", "p, one-sided", "rows that refuse"), rows
    )


def size_of(candidate: Supported, scale: float = 1.0) -> str:
    """Return the coefficients with standard errors, at most two of them."""
    if len(candidate.coefficients) > 2:
        return f"{len(candidate.coefficients)} numbers"
    pairs = [(scale * c, scale * s) for c, s in zip(candidate.coefficients, candidate.standard_errors)]
    digits = [max(0, 1 - int(np.floor(np.log10(s)))) for _, s in pairs]
    return ", ".join(f"{c:+.{d}f} ± {s:.{d}f}" for (c, s), d in zip(pairs, digits))
