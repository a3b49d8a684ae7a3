"""`Step`: a quantity that changes once during the run, at a time that is searched for.

A family returns one candidate for each of at most `_PLACES` times between visits; the procedure keeps the best of them,
charges it `positions`, and may then look between its neighbours (`finer`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.linear import size
from calibench.discrepancy.model.machine import Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

IN_ROWS = "row"  # the clock where none was read; it counts from 0


@final
@dataclass(frozen=True, eq=False)
class ChangePoint:
    """An `Effect`: each of `quantities` is larger by its coefficient from time `at` [s] of the column `clock` on.

    `one` is a coefficient of 1 in the unit of the quantities. For quantities of several kinds, `kinds` are the unit of
    each coefficient and the value of 1 of it; then `unit` is that of the first kind, and the amplitude is of that kind
    alone.
    """

    family: str
    target: str
    formula: str
    channel: str
    quantities: tuple[str, ...]
    coefficients: tuple[str, ...]
    unit: str
    at: float
    positions: int
    columns: tuple[str, ...] = ("t_s",)
    twins: tuple[str, ...] = ()
    largest: float = math.inf
    clock: str = "t_s"
    one: float = 1.0
    kinds: tuple[tuple[str, float], ...] = ()

    @property
    def units(self) -> tuple[str, ...]:
        """Return the unit of each coefficient."""
        return tuple(unit for unit, _ in self.kinds) or (self.unit,) * len(self.coefficients)

    @property
    def begins(self) -> float:
        """Return the time from which the quantities are larger."""
        return self.at

    @property
    def begins_unit(self) -> str:
        """Return the unit of that time, `IN_ROWS` for the order of the rows; "" for a clock that may run in any."""
        return {"t_s": "s", IN_ROWS: IN_ROWS}.get(self.clock, "")

    @property
    def ones(self) -> Array:
        """Return what a coefficient of 1 is, in the unit of its quantity, (k,)."""
        return np.array([one for _, one in self.kinds] or [self.one] * len(self.coefficients))

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n,): zero before `at`, the coefficient after."""
        after = data[self.clock] >= self.at
        return {name: one * after * c[k] for k, (name, one) in enumerate(zip(self.quantities, self.ones, strict=True))}

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return the derivative of `shift`: the step itself in the coefficient's own column."""
        after = data[self.clock] >= self.at
        units = np.diag(self.ones)
        return {name: after[:, None] * units[k] for k, name in enumerate(self.quantities)}

    def amplitude(self, c: Array) -> float:
        """Return the step, of two the length."""
        return size(np.asarray(c)[[unit == self.unit for unit in self.units]])


def change_times(t: Array) -> Array:
    """Return the times, at most `_PLACES`, between readings taken at `t`, (n,), s, at which a step is looked for."""
    return _thinned(_gaps(t))


def finer(effect: Effect, data: MeasuredData) -> tuple[Effect, ...]:
    """Return `effect` at every time between its neighbouring places, at most `_PLACES`; () if it has no place.

    An effect with places of another kind has a method for those between them (`nearer`).
    """
    if not isinstance(effect, ChangePoint):
        nearer = getattr(effect, "nearer", None)
        return tuple(nearer(data)) if nearer else ()
    gaps = _gaps(data[effect.clock])
    coarse = _thinned(gaps)
    k = int(np.argmin(np.abs(coarse - effect.at)))
    low = coarse[k - 1] if k else -np.inf
    high = coarse[k + 1] if k + 1 < len(coarse) else np.inf
    near = _thinned(gaps[(gaps > low) & (gaps < high)])
    return tuple(replace(effect, at=float(at)) for at in near)


def _gaps(t: Array) -> Array:
    """Return the middle of every gap between two different times, without those near the ends of the run."""
    ordered = np.sort(t)
    edge = int(thresholds().change_edge * len(t))
    times = np.unique(ordered[edge : len(t) - edge])
    return np.asarray((times[1:] + times[:-1]) / 2)


def _thinned(gaps: Array) -> Array:
    if len(gaps) <= thresholds().change_places:
        return gaps
    return np.asarray(gaps[np.unique(np.linspace(0, len(gaps) - 1, thresholds().change_places).round().astype(int))])
