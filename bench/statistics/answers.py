"""The values of the answers of runs: as they were seen, or as they were judged afterwards where values are noisy.

`bench.execution.stochastic` judges an answer.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from calibench.bench.store.columns import Array, Columns, Flags, floats, known, plain


def answers(runs: Columns) -> Array:
    """Return the value of each run's answer: as it was seen, or where values are noisy as it was judged."""
    seen = floats(runs["best_value"])
    return np.where(judged(runs), floats(runs["judged_value"]), seen) if "judged_value" in runs else seen


def judged(runs: Columns) -> Flags:
    """Tell of which runs the answer was judged apart, because values are noisy."""
    if "judged_value" not in runs:
        return np.zeros(len(runs["best_value"]), dtype=bool)
    return known(runs["judged_evaluations"])


def said_by_the_problem(cell: Columns) -> dict[str, Any]:
    """Return `unit`, `minimum` (NaN where none is declared) and `noisy` of the runs of one cell."""
    unit, minimum = (plain(cell[name])[-1] if name in cell else None for name in ("unit", "minimum"))
    return {
        "unit": unit if isinstance(unit, str) else "",
        "minimum": float("nan") if minimum is None else float(minimum),
        "noisy": bool(judged(cell).any()),
    }
