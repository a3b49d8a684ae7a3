"""Amplitudes as an engineer writes them: a suitable prefix, as many digits as the interval allows, degrees beside."""

from __future__ import annotations

from math import degrees, floor, isfinite, log10

import numpy as np
from numpy.typing import NDArray

from calibench.core.counted import plain

_STEPS = {
    "rad": ((1e-3, "mrad"), (1e-6, "µrad")),
    "mm": ((1.0, "mm"), (1e-3, "µm")),
    "s": ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")),
    "1": ((1e-2, "%"), (1e-6, "ppm")),
    "1/K": ((1e-6, "ppm/K"),),
    "rad/K": ((1e-3, "mrad/K"), (1e-6, "µrad/K")),
    "mm/K": ((1e-3, "µm/K"),),
    "mm/N": ((1e-3, "µm/N"),),
    "rad/(N mm)": ((1e-6, "mrad/(N m)"), (1e-9, "µrad/(N m)")),
    "rad/s": ((1e-3, "mrad/s"), (1e-6, "µrad/s")),
    "mm/s": ((1.0, "mm/s"), (1e-3, "µm/s"), (1e-6, "nm/s")),
}
_DASH = "–"
_DRAWN = {  # units in which errors are drawn, the usual one first
    "rad": ((1e3, "mrad"), (1e6, "µrad"), (1e9, "nrad")),
    "mm": ((1e3, "µm"), (1e6, "nm"), (1e9, "pm")),
}


def amount(value: float, unit: str, interval: tuple[float, float] | None = None) -> str:
    """Return a value with its unit, and its 95 % interval where there is one.

    >>> amount(1.52e-4, "rad")
    '0.152 mrad (0.00871°)'
    >>> amount(1.52e-4, "rad", (1.31e-4, 1.73e-4))
    '0.152 mrad (95 %: 0.131 to 0.173 mrad; 0.0087°)'
    >>> amount(3.76e-5, "rad/K", (3.06e-5, 4.46e-5))
    '37.6 µrad/K (95 %: 30.6 to 44.6 µrad/K)'
    >>> amount(5.2e-5, "rad")
    '52.0 µrad (0.00298°)'
    >>> amount(2.4e-3, "mm", (1.9e-3, 2.9e-3))
    '2.40 µm (95 %: 1.90 to 2.90 µm)'
    """
    if value is None or not isfinite(value):
        return _DASH
    scale, name = _scaled(abs(value), unit)
    if interval is not None and not all(end is not None and isfinite(end) for end in interval):
        interval = None
    spread = None if interval is None else (interval[1] - interval[0]) / 2
    if spread is not None and spread < 1e-4 * abs(value):  # as good as exact
        spread = interval = None
    places = _places(value / scale, spread / scale if spread else None)
    shown = f"{value / scale:.{places}f} {name}".rstrip()
    turned = f"{degrees(value):.{_places(degrees(value), degrees(spread) if spread else None)}f}°"
    in_degrees = turned if unit == "rad" else ""
    if spread is None or interval is None:
        return shown + (f" ({in_degrees})" if in_degrees else "")
    low, high = (f"{end / scale:.{places}f}" for end in interval)
    return f"{shown} (95 %: {low} to {high} {name}".rstrip() + (f"; {in_degrees})" if in_degrees else ")")


def in_small_units(unit: str, size: float) -> tuple[float, str]:
    """Return the factor and the name of the unit in which errors are drawn whose largest is `size`.

    It is the usual one, or of smaller errors the first in which the largest has at least a tenth before the point.

    >>> in_small_units("rad", 2e-3), in_small_units("mm", 1e-5), in_small_units("mm", 0.0), in_small_units("K", 1e-9)
    ((1000.0, 'mrad'), (1000000.0, 'nm'), (1000.0, 'µm'), (1.0, 'K'))
    """
    steps = _DRAWN.get(unit, ((1.0, unit),))
    if not (isfinite(size) and size > 0):
        return steps[0]
    return next((step for step in steps if size * step[0] >= 0.1), steps[-1])


def largest(errors: NDArray[np.float64]) -> float:
    """Return the size of the largest finite error; 0 where there is none."""
    sizes = np.abs(np.asarray(errors, dtype=float))
    return float(np.max(sizes, where=np.isfinite(sizes), initial=0.0))


def share(fraction: float) -> str:
    """Return a part of one in per cent.

    An effect of several numbers can leave a little more than its parts by themselves; that is all of it, 100 %.

    >>> share(0.994), share(0.0216), share(4e-16), share(1.09)
    ('99 %', '2.2 %', '0 %', '100 %')
    """
    fraction = min(fraction, 1.0)
    return f"{100 * fraction:.0f} %" if fraction >= 0.0995 or fraction < 1e-6 else f"{plain(100 * fraction, 2)} %"


def _scaled(size: float, unit: str) -> tuple[float, str]:
    """Return the largest step of the unit that leaves at least a tenth before the point, and its name."""
    steps = _STEPS.get(unit, ((1.0, "" if unit == "1" else unit),))
    return next(((scale, name) for scale, name in steps if size >= 0.1 * scale), steps[-1])


def _places(value: float, spread: float | None) -> int:
    """Return how many decimals say two digits of the spread; without one, three of the value."""
    by, digits = (spread, 2) if spread else (abs(value), 3)
    return 0 if not by else min(8, max(0, digits - 1 - floor(log10(by))))
