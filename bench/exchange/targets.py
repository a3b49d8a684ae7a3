"""Levels of a value and how far they stand above a minimum, free of the rounding that adding the minimum brings.

A level is stored as the number nearest to minimum + gap. Where the minimum is large that sum has lost digits of the
gap: 394.48 + 1e-8 is a level 1.00044e-8 above 394.48. A reader who works with gaps, as COCO does, must be told the gap
that was meant, or a run that just reaches the level misses the gap.
"""

from __future__ import annotations

from math import isfinite, log10
from math import ulp as spacing

_PER_DECADE = 5


def gap_of_level(level: float, minimum: float) -> float:
    """Return how far `level` stands above `minimum`: the gap of COCO's grid that gives this level, if there is one.

    >>> gap_of_level(394.48 + 1e-8, 394.48), 394.48 + 1e-8 - 394.48 == 1e-8
    (1e-08, False)
    """
    gap = level - minimum
    if gap > 0 and isfinite(gap):
        k = round(_PER_DECADE * log10(gap))
        for exponent in (k - 1, k, k + 1):  # below the rounding of the minimum several gaps give one level: the least
            meant: float = 10 ** (exponent / _PER_DECADE)
            if abs(minimum + meant - level) <= spacing(max(abs(minimum), abs(level))):  # who summed may round powers
                return meant
    return gap


def gap_of_value(value: float, minimum: float, reached: float | None) -> float:
    """Return how far `value` stands above `minimum`; at most the gap of the level that it has just `reached`."""
    gap = value - minimum
    return gap if reached is None else min(gap, gap_of_level(reached, minimum))
