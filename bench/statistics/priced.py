"""The second currency: the seconds that the objective takes in a run, from its counts of calls and measured costs.

Costs are records of `bench.sweep.costs`, one for each problem: the columns of `PROBLEM`, and of `KINDS` in seconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from calibench.bench.statistics.cells import PROBLEM

if TYPE_CHECKING:
    import pandas as pd

KINDS = ("value_s", "batch_s", "residuals_s", "jacobian_s", "gradient_s", "joint_s")


def priced(runs: pd.DataFrame, costs: Iterable[Mapping[str, Any]]) -> pd.Series:
    """Return for each run the seconds that its calls of the objective take: counts by kind times `costs`.

    NaN where a kind that it called has no known cost, and for rows from before the kinds were counted.
    """
    import pandas as pd

    known = {key_of_costs(record): record for record in costs}
    told = [known.get(key, {}) for key in zip(*(runs[column] for column in PROBLEM), strict=True)]
    batched, residuals = runs["batch_evaluations"], runs["residual_evaluations"]
    gradients, joint = (
        runs[name].fillna(0) if name in runs else 0 for name in ("gradient_evaluations", "joint_evaluations")
    )  # no run from before these columns had any
    singles, slopes = runs["evaluations"] - batched - residuals - joint, runs["jacobian_evaluations"] - gradients
    alone = gradients - joint + 0 * slopes
    counts = (singles, batched, residuals, slopes, alone, joint + 0 * slopes)
    total = pd.Series(0.0, index=runs.index)
    for kind, column in zip(KINDS, counts, strict=True):
        count = column.astype(float)
        seconds = pd.Series([record.get(kind) for record in told], index=runs.index, dtype=float)
        total += (count * seconds).mask(count == 0, 0.0)
    total[[not record for record in told]] = np.nan
    return total


def key_of_costs(record: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the problem that a record of costs is of."""
    return tuple(record.get(column) for column in PROBLEM)
