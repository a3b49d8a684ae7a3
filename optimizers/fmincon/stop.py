"""MATLAB's absolute stop of `fmincon`: the search direction d, or the change g d that it promises, is small.

It was the medium-scale algorithm's test (`nlconst`; `active-set` since) and is the only one that looks at d and not at
the step taken. Nothing in it is relative: in a unit that makes f smaller a search ends earlier. Its place in the loop
changed (years of revisions of `nlconst`: 1.20 of August 1998, 1.41 of February 2003, 1.1.4.25 of December 2009):

after_step     1998. The line search is over: g is the gradient at the old point, the new point is the answer.
next_gradient  by 2003. The gradient g at the new point is known; d is the direction that led there.
before_step    by the end of 2009. d is known, and no step taken: g d is that of the step to be tried, and the limit is
               FunctionTolerance, not twice that.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from calibench.optimizers.base import Array

StopRule = Literal["relative", "absolute"]
StopPlace = Literal["after_step", "next_gradient", "before_step"]


def absolute_stop(
    direction: Array, slope: float, step_tolerance: float, slope_limit: float
) -> tuple[Literal[4, 5], str] | None:
    """Return the exit flag and the words where the search is over at a feasible point, else None.

    `direction`, shape (n,), is d in the user's units; `slope` is g d; `slope_limit` what |g d| is compared with.

    >>> absolute_stop(np.array([1e-7, -3e-6]), -1.0, 2e-6, 2e-6)
    (4, 'Local minimum possible: the search direction 3.000e-06 is less than 2 StepTolerance, and feasible.')
    """
    longest = float(np.max(np.abs(direction), initial=0.0))
    if longest < 2.0 * step_tolerance:
        words = f"the search direction {longest:.3e} is less than 2 StepTolerance"
        return 4, f"Local minimum possible: {words}, and feasible."
    if abs(slope) < slope_limit:
        words = f"the directional derivative {abs(slope):.3e} is less than its limit {slope_limit:.1e}"
        return 5, f"Local minimum possible: {words} by FunctionTolerance, and feasible."
    return None
