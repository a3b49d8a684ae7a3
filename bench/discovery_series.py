"""What the drawings of a search are made of: the series behind a report, in plain arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import pandas as pd

from problems.base import Array


@final
@dataclass(frozen=True, eq=False)
class Residuals:
    """Whitened residuals, (n,), without and with the effects, over the covariate that `effect` depends on."""

    effect: str
    label: str
    values: Array
    before: Array
    after: Array


@final
@dataclass(frozen=True, eq=False)
class Workspace:
    """Where the tool stood [mm] and the whitened residual without an effect, (n,) each."""

    x: Array
    y: Array
    residual: Array


@final
@dataclass(frozen=True, eq=False)
class Series:
    """`candidates`: effect, family, target, gain, in_set, chosen. `workspace` is None where there is none to draw."""

    candidates: pd.DataFrame
    residuals: tuple[Residuals, ...] = ()
    workspace: Workspace | None = None
