"""Names that were found from few equations, which had to show the noise as well.

From 30 random poses of a measured arm, 87 equations for 25 parameters, 21 searches told names, and 8 of these made the
error of the other poses larger; from 45 poses and more it was 3 of 41 (`docs/arm-rates.md`).
"""

from __future__ import annotations

from calibench.core.counted import counted
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.model.measured.data import UNSTATED
from calibench.discrepancy.thresholds import thresholds

FEW_EQUATIONS = "names found from so few equations"  # in a note, by which a page knows it


def few_equations(base: Fit) -> tuple[str, ...]:
    """Return a note where a fit without effects has few equations for each parameter, and nobody stated the noise."""
    equations, calibrated = base.J.shape
    unstated = any(note.startswith(UNSTATED) for note in base.model.formulation.data.notes)
    if not unstated or equations >= thresholds().equations_each * calibrated:
        return ()
    return (
        f"{counted(equations, 'equation')} for {counted(calibrated, 'calibrated parameter')}, and the noise is not "
        f"stated: {FEW_EQUATIONS} often do not hold for other readings; take more, and keep some of them out of the "
        "fit (split=hold) to test the names",
    )
