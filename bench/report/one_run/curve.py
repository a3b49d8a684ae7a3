"""A convergence curve in a terminal: one line of blocks over the logarithm of the cost, and a table below it.

The height is the logarithm of the value above the least that is possible: the declared minimum, or zero where no value
is below it. Where neither holds it is the value itself. A run that has come down to rounding ends at the bottom.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench.core.counted import plain

Array = NDArray[np.float64]
_BLOCKS = "█▇▆▅▄▃▂▁"  # the worst value first
_WIDTH = 60
_ROWS = 9


@final
@dataclass(frozen=True)
class Curve:
    """The best values of a run over its charged evaluations, shape (n,) each, and how often it had begun again."""

    charged: Array
    values: Array
    restarts: Array


def curve_of(trace: pd.DataFrame) -> Curve | None:
    """Return the curve of a run's trace, from its first finite value on; None where it has none."""
    finite = trace[np.isfinite(trace["best_value"].to_numpy(dtype=float))]
    if finite.empty:
        return None
    charged, values, restarts = (finite[name].to_numpy(dtype=float) for name in ("charged", "best_value", "restart"))
    return Curve(charged, values, np.nan_to_num(restarts))


def curve_lines(curve: Curve, minimum: float | None, unit: str) -> list[str]:
    """Return the curve as lines of text."""
    first, last = curve.charged[0], curve.charged[-1]
    lines = [f"  {plain(curve.values[0], 4)}{unit} {sparkline(curve, minimum)} {plain(curve.values[-1], 4)}{unit}"]
    again = bool(curve.restarts.any())
    lines.append(f"  {'charged':>9s}  {'best value':>12s}" + ("  restarts" if again else ""))
    marks: Array = np.unique(np.round(np.geomspace(max(first, 1.0), max(last, 1.0), _ROWS)))
    for at, i in zip(marks, _steps(curve, marks), strict=True):
        told = f"  {at:9.0f}  {curve.values[i]:12.6g}"
        lines.append(told + (f"  {curve.restarts[i]:8.0f}" if again else ""))
    return lines


def sparkline(curve: Curve, minimum: float | None) -> str:
    """Return a block for each of some counts, a constant factor apart.

    >>> sparkline(Curve(np.array([1.0, 10.0, 100.0]), np.array([100.0, 1.0, 0.01]), np.zeros(3)), None)[::10]
    '███▄▄▄'
    """
    marks: Array = np.geomspace(max(curve.charged[0], 1.0), max(curve.charged[-1], 1.0), _WIDTH)
    heights = _heights(curve.values, minimum)
    top, bottom = heights.max(), heights.min()
    share = (top - heights) / (top - bottom) if top > bottom else np.zeros(len(heights))
    blocks = np.round(share * (len(_BLOCKS) - 1)).astype(int)
    return "".join(_BLOCKS[blocks[i]] for i in _steps(curve, marks))


def _steps(curve: Curve, marks: Array) -> NDArray[np.int64]:
    """Return which point holds at each count: the last that is not later."""
    found: NDArray[np.int64] = np.maximum(np.searchsorted(curve.charged, marks * (1 + 1e-12), side="right") - 1, 0)
    return found


def _heights(values: Array, minimum: float | None) -> Array:
    gaps: Array = values - (0.0 if minimum is None else minimum)
    if (gaps < 0).any() or not (gaps > 0).any():
        return values
    heights: Array = np.log10(np.maximum(gaps, gaps[gaps > 0].min() / 10))
    return heights
