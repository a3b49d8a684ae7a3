"""Confounded parameters: each alone has a wide standard error, but one combination of two has a narrow one.

Calibration returns a value for each of them all the same, and its fit is as good as any other. The covariance shows,
before anything is measured, how uncertain these values are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import final

import numpy as np

from calibench.core.words import plain
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_WHOLE = 0.05  # a factor nearer to 1 is taken for 1


@final
@dataclass(frozen=True)
class Confounded:
    """Two parameters with their standard deviations, and that of the well-known `first - factor * second`."""

    first: str
    second: str
    sd: tuple[float, float]
    factor: float
    known: float

    def __str__(self) -> str:
        size = "" if abs(self.factor) == 1 else f"{plain(abs(self.factor), 3)} "
        sign = "-" if self.factor > 0 else "+"
        alone = f"{self.first} ± {plain(self.sd[0], 2)}, {self.second} ± {plain(self.sd[1], 2)}"
        return f"{alone}, {self.first} {sign} {size}{self.second} ± {plain(self.known, 2)}"


def confounded(names: Sequence[str], J: Array, sigma: float) -> tuple[Confounded, ...]:
    """Return the confounded pairs, given slopes J, (n, p), of readings with standard deviation `sigma`.

    Each parameter is listed once, with the partner it is tied to most closely. J must have full rank.
    """
    C = np.linalg.inv(J.T @ J) * sigma**2
    sd = np.sqrt(np.diag(C))
    tied = np.abs(C / np.outer(sd, sd) - np.eye(len(sd)))
    found: list[Confounded] = []
    for i, j in sorted(combinations(range(len(sd)), 2), key=lambda pair: -tied[pair]):
        if any(names[k] in (e.first, e.second) for k in (i, j) for e in found):
            continue
        factor = float(C[i, j] / C[j, j])
        if abs(abs(factor) - 1) < _WHOLE:
            factor = float(np.sign(factor))
        known = float(np.sqrt(max(C[i, i] - 2 * factor * C[i, j] + factor**2 * C[j, j], 0.0)))
        if known * thresholds().confounded_times < min(sd[i], abs(factor) * sd[j]):
            found.append(Confounded(names[i], names[j], (float(sd[i]), float(sd[j])), factor, known))
    return tuple(sorted(found, key=lambda e: list(names).index(e.first)))
