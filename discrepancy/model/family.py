"""`Cause`: a family of effects written down as data, with one function that builds its candidates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from discrepancy.model.data import MeasuredData
from discrepancy.model.effect import Beside, Effect, NotTestable
from discrepancy.model.machine import Formulation
from discrepancy.registries import effects


@final
@dataclass(frozen=True)
class Cause:
    """A `Family`: `build` returns the candidates for one target, or raises `NotTestable` (see `needs`)."""

    name: str
    machine: str
    cause: str
    formula: str
    channel: str
    columns: tuple[str, ...]
    unit: str
    targets: tuple[str, ...]
    build: Callable[[Formulation, str], tuple[Effect, ...]]
    twins: str = ""

    def candidates(self, formulation: Formulation) -> tuple[Effect, ...]:
        """Return the candidates of all targets; raise `NotTestable` where one or more cannot be tested."""
        found: list[Effect] = []
        reasons: dict[str, str] = {}
        beside: list[Beside] = []
        for target in self.targets:
            try:
                found += self.build(formulation, target)
            except NotTestable as gap:
                reasons[target] = str(gap)
                beside += gap.beside
        if reasons:
            why = "; ".join(dict.fromkeys(reasons.values()))
            raise NotTestable(why, reasons, tuple(found), tuple(beside))
        return tuple(found)

    def enter(self) -> Cause:
        """Put the family into the registry, under `machine/name`, and return it."""
        effects.register(f"{self.machine}/{self.name}")(lambda: self)
        return self


def needs(data: MeasuredData, *columns: str) -> None:
    """Raise `NotTestable` unless all `columns` are there and vary: what is constant, the calibration absorbs."""
    missing = [column for column in columns if column not in data]
    if missing:
        raise NotTestable(f"needs column{'s' * (len(missing) > 1)} {', '.join(missing)}")
    still = [column for column in columns if not np.ptp(data[column]) > 1e-12 * np.max(np.abs(data[column]))]
    if still:
        raise NotTestable(f"column {', '.join(still)} is constant")


def number(target: str) -> int:
    """Return the number in a target: 2 for `joint 2`."""
    return int(target.rpartition(" ")[2])
