"""The findings as a pointing model: the field's terms with their coefficients in arcsec, a term a line.

The layout is that of a TPOINT model: a caption, a line with the method (T: the terms turn recorded into true
directions), the number of stars and the rms on the sky [arcsec], then term, coefficient and its standard deviation, and
END. A finding that is no term of the field (a drift, a slip, a difference between the sides of the pier) is written as
a comment, because a mount's control software does not know it.
"""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.machines.mount.terms import TERMS
from calibench.discrepancy.model.description import Correction
from calibench.discrepancy.report import Report

ENDING = ".mod"


def pointing_model(report: Report) -> Correction | None:
    """Return the pointing model of a finished search; None for a report without its model."""
    if report.fitted is None:
        return None
    model, x = report.model.model, report.model.best
    sd = np.sqrt(np.diag(report.model.fit.covariance()))
    known = {term.name for term in TERMS if not term.name.startswith("pier_")}
    names = [p.name for p in model.formulation.parameters]
    names += [name for effect in model.effects for name in effect.coefficients]
    own = len(model.formulation.parameters)
    told = [effect.family for effect in model.effects for _ in effect.coefficients]
    lines, beside = [], []
    for k, (name, value, wide) in enumerate(zip(names, x, sd)):
        if k < own or name in known:
            lines.append(f"  {name:<8}{value:+12.2f}{wide:10.3f}")
        else:
            beside.append(f"! not a term of the field: {told[k - own]} {name} {value:+.6g}")
    errors = model.residuals(x).real
    rms = float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
    head = [f"{report.case}: {report.verdict}", f"T {len(errors)} {rms:.4f}"]
    return Correction(ENDING, "\n".join([*head, *lines, *beside, "END", ""]))
