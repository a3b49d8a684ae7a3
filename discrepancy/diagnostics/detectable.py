"""The smallest amplitude that a search would find: one rule, before a fit (`design`) and after it (`explain`).

A chi-square test of rank m at the level of one test in the whole search has the stated power at a noncentrality; an
effect reaches it at the amplitude whose visible part has that energy, in sigma squared. The energy of an effect of
several coefficients is a mean over their directions, each of the amplitude 1.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtri, chndtr

from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array


def smallest_amplitude(effect: Effect, energies: Array, rank: int, candidates: int) -> float:
    """Return the amplitude that a search over `candidates` finds with the stated power, in the effect's unit.

    `energies`, (k,), are those of what calibration leaves of a unit of each coefficient, in sigma squared; `rank` is
    the number of directions seen. Infinite where nothing is left.
    """
    sizes = [effect.amplitude(unit) for unit in np.eye(len(energies))]
    told = [float(energy) / abs(size) ** 2 for energy, size in zip(energies, sizes) if size]
    energy = float(np.mean(told)) if told else 0.0
    level = thresholds().detect_level / max(1, candidates)
    needed = noncentrality(max(1, rank), level, thresholds().detect_power)
    return float(np.sqrt(needed / energy)) if energy > 0 else np.inf


@cache
def noncentrality(degrees: int, level: float, power: float) -> float:
    """Return the noncentrality at which a chi-square test at `level` has such a `power`."""
    critical = chdtri(degrees, level)
    return float(brentq(lambda size: 1 - chndtr(critical, degrees, size) - power, 1e-3, 1e3))
