"""`LinearEffect`: an effect whose change of the quantities is linear in its coefficients, as most physics here is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.discrepancy.model.effect import Along, Effect
from calibench.discrepancy.model.machine import Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.problems.base import Array


def size(c: Array) -> float:
    """Return a single coefficient with its sign, or the length of several."""
    return float(c[0]) if len(c) == 1 else float(np.linalg.norm(c))


@final
@dataclass(frozen=True, eq=False)
class LinearEffect:
    """An `Effect` with `shift = changes @ c`; `changes(q, data)` returns quantity -> (n, k).

    No machine has an amplitude above `largest`, in the effect's unit. `begins` is the value of its column from which on
    the effect acts, in `begins_unit`, where that was searched for. `along(data)` returns covariate -> the moments at
    which it acts: its size may depend on the position at each of them.

    `over` are the columns that together are the place on which its size may depend where its formula is off. `whole` is
    the cause of which it is one term: the sine or the cosine of a wave whose phase is any.
    """

    family: str
    target: str
    formula: str
    channel: str
    columns: tuple[str, ...]
    coefficients: tuple[str, ...]
    units: tuple[str, ...]
    unit: str
    changes: Callable[[Quantities, MeasuredData], dict[str, Array]]
    twins: tuple[str, ...] = ()
    measure: Callable[[Array], float] = size
    positions: int = 1
    largest: float = math.inf
    along: Along | None = None
    begins: float = math.nan
    begins_unit: str = ""
    over: tuple[str, ...] = ()
    whole: Effect | None = None

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n,): the change at coefficients c, (k,)."""
        return {name: change @ c for name, change in self.changes(q, data).items()}

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return the derivative of `shift`, the same at every c."""
        return self.changes(q, data)

    def amplitude(self, c: Array) -> float:
        """Return the size an engineer quotes, in `unit`."""
        return self.measure(c)


Linear = LinearEffect  # the name it had first, kept for scripts
