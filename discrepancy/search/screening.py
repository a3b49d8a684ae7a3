"""Screening: a part of very many readings shows which candidates can still win; only those are fitted to all readings.

Each candidate is fitted to the same part of the readings. The difference of two candidates' gains is a sum over
readings, so its value over all readings can be estimated, with a standard error. A candidate is left out if it is
behind by more than several standard errors, and by more than a fit to all readings could change.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from calibench.discrepancy.diagnostics.score import Scored
from calibench.discrepancy.fitting.fit import Fit, fit, part_of
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array


def screened(base: Fit, scored: Sequence[Scored], bearable: Callable[[Effect, Array], bool]) -> tuple[Scored, ...]:
    """Return which of `scored` are worth a fit to all the readings; all of them where readings are not very many.

    `bearable(effect, x)` says whether a fitted candidate may win.
    """
    n = len(base.at.misclosure)
    if n < thresholds().many_readings or len(scored) < 2:
        return tuple(scored)
    model, noise = part_of(base.model, base.noise)
    plain = fit(model, noise, base.x)
    fits = [fit(model.with_effects(s.effect), noise, np.concatenate([base.x, s.coefficients])) for s in scored]
    sound = [k for k, f in enumerate(fits) if f.cost <= plain.cost]
    able = [k for k in sound if bearable(scored[k].effect, fits[k].x)]
    if not able:
        return tuple(scored)
    best = min(able, key=lambda k: fits[k].cost)
    readings = len(model.formulation.data)
    grown, size = n / readings, len(scored[best].coefficients)
    top = grown * (plain.cost - fits[best].cost)

    def out(k: int) -> bool:
        behind = (noise.costs(fits[k].r) - noise.costs(fits[best].r)).reshape(readings, -1).sum(axis=1)
        fitted = grown * (size + len(scored[k].coefficients)) + size * np.log(len(base.r))  # as part of any gain
        spare = (
            thresholds().behind_share_placed if scored[k].effect.positions > 1 else thresholds().behind_share
        ) * top + fitted
        return bool(grown * (behind.sum() - thresholds().behind_errors * np.sqrt(readings) * behind.std()) > spare)

    return tuple(s for k, s in enumerate(scored) if k not in sound or not out(k))
