"""The size of a noise effect: a value with its 95 % interval, separate from the test whether it exists.

That test uses a coarse grid of sizes, which is enough to decide, but too coarse to report. Here the size is fitted.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from calibench.problems.base import Array

Size = tuple[float, float, float]  # value, and the ends of its interval

_ROUNDS = 200
_DRAWN = 200
_MOST = 20_000  # numbers that a drawn sample holds
_Z = 1.959964


def outlying_size(energy: Array, share: Array, epsilon: float, tau: float) -> Size:
    """Return tau, the extra noise of the outlying readings in stated deviations, from `energy` and `share`, (n,).

    The mixture of `discrepancy.noise.mixture` is fitted from `epsilon` and `tau` until it converges. The interval is
    that of a variance estimated from as many readings as are outlying.
    """
    epsilon, some = max(epsilon, 1e-6), share > 1e-12
    energy, share = energy[some], share[some]
    weights = np.zeros(len(energy))
    for _ in range(_ROUNDS):
        grown = 1.0 + tau**2 * share
        ratio = np.log(epsilon / (1 - epsilon)) - 0.5 * np.log(grown) + 0.5 * energy * (1 - 1 / grown)
        weights = 1 / (1 + np.exp(-np.clip(ratio, -500, 500)))
        whole = float(weights.sum())
        if whole < 1e-9:
            break
        told = float(np.sqrt(max((weights * (energy - 1) / share).sum() / whole, 0.0)))
        epsilon = float(np.clip(whole / len(weights), 1e-6, 1 - 1e-6))
        if abs(told - tau) < 1e-6 * tau:
            break
        tau = told
    degrees = max(float(weights.sum()), 1.0)
    ends = [np.sqrt(degrees / chdtri(degrees, above)) for above in (0.025, 0.975)]
    return tau, tau * float(ends[0]), tau * float(ends[1])


def kurtosis_size(r: Array) -> Size:
    """Return the excess kurtosis of residuals, (n,) or (n, c), with its interval over samples drawn from its rows."""
    rng, rows = np.random.default_rng(0), r.reshape(len(r), -1)
    value = _kurtosis(rows)
    most = min(len(rows), _MOST)
    drawn = [_kurtosis(rows[rng.integers(0, len(rows), most)]) for _ in range(_DRAWN)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    narrower = np.sqrt(most / len(rows))  # samples as large as the data scatter less
    return value, value - narrower * max(value - float(low), 0.0), value + narrower * max(float(high) - value, 0.0)


def step_size(values: Array, step: float) -> Size:
    """Return the step of the lattice on which `values` lie, with its interval: narrow where they span many steps."""
    distinct = np.unique(values)
    cells = np.round((distinct - distinct[0]) / step)
    cells, at = cells - cells.mean(), distinct - distinct.mean()
    off = at - step * cells
    error = _Z * float(np.sqrt((off**2).mean() / max((cells**2).sum(), 1.0)))
    return step, step - error, step + error


def _kurtosis(r: Array) -> float:
    variance = float((r**2).mean())
    return float((r**4).mean()) / variance**2 - 3.0 if variance else 0.0
