"""Choose the parameters of an arm that are calibrated: of similar ones a preferred one is free, the others are held.

Base and tool come first, then zeros, shifts and turns of the joints from the floor on. A number is held if the kept
ones leave less than `_LEAST` of its signature: for parallel axes one shift along them (Hayati), of a placement the turn
about its own axis. A parameter that is dependent on the nominal arm, and is seen only because the real arm differs from
it, is held as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calibench.problems.arm.gauge import told_apart
from calibench.problems.base import Array

_LEAST = 5e-3  # part of a signature: an error of .5 mm, or .5 mrad at a metre, then moves nothing by more than 3 um


def determined_names(slopes: Mapping[str, Array], order: Sequence[str]) -> tuple[str, ...]:
    """Return the names of `order` that are kept; `slopes` has name -> (n, m)."""
    columns = np.column_stack([np.asarray(slopes[name], dtype=float).ravel() for name in order])
    return tuple(order[k] for k in told_apart(columns, _LEAST))
