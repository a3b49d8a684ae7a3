"""Restarts that are simulated: what a method would pay that begins again, by its runs, until it is there.

Runs of a cell are drawn with replacement until one reached the target; the cost is what all of them spent. It supposes
that a run that did not arrive may be begun again from where another run began; a cell none of whose runs arrived never
does. Source: Hansen et al., COCO: Performance Assessment, 2016, section 5.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_SEED = (2008, 0x524553)


def restarted(time: Array, spent: Array, draws: int) -> Array:
    """Return `draws` costs of reaching each target, shape (draws, targets), in no order; infinite where no run did.

    `time`, shape (runs, targets), is infinite where a run did not reach the target, and `spent`, shape (runs,), what it
    was charged then. The draws are the same for any runs of that number.
    """
    runs, targets = time.shape
    cost = np.full((draws, targets), np.inf)
    rng = np.random.default_rng(np.random.SeedSequence([*_SEED, runs]))
    reached = np.isfinite(time)
    open_ = np.broadcast_to(reached.any(axis=0), cost.shape).copy()
    cost[open_] = 0.0
    while open_.any():
        run = rng.integers(runs, size=draws)
        hit = reached[run]
        paid = np.where(hit, time[run], spent[run, None])
        cost[open_] += paid[open_]
        open_ &= ~hit
    return cost
