"""`EffectFamily`: one physical cause on one kind of machine, as data with a function that builds its candidates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from calibench.discrepancy.model.effect import Catalogue, Effect, HeldBack, NotTestable, Untestable
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured.complete import told_gaps
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.registries import effects


@final
@dataclass(frozen=True)
class EffectFamily:
    """A cause of error, with what the page of the catalogue says of it.

    `build` returns the candidates for one target, or `HeldBack`; for what cannot be tested it raises `NotTestable` (see
    `needs`). `columns` may hold `{i}` for the number of the target, and `metadata.NAME`. `twins` is a sentence for
    readers; those of a candidate are names. `label` and `label_of_all` are the words for it, on a target and on `all`;
    `code` is what a label that explains itself comes down to where it was told before.
    `parted_by` says what parts its declared twins, `resolved_by` what would tell families with the same sentence apart
    (`{target}` is filled in). `period` returns the period of its argument in the unit of its column, 0 for none, from
    the metadata and the target. `targets_in` returns the targets of a family that finds them in what a formulation is
    made of (`Roles`); `targets` are then words for them. `never_negative` is what no machine has less than none of.
    """

    name: str
    machine: str
    cause: str
    formula: str
    channel: str
    columns: tuple[str, ...]
    unit: str
    targets: tuple[str, ...]
    build: Callable[[Formulation, str], tuple[Effect, ...] | HeldBack]
    twins: str = ""
    label: str = ""
    label_of_all: str = ""
    parted_by: str = ""
    resolved_by: str = ""
    period: Callable[[Mapping[str, Any], str], float] | None = None
    targets_in: Callable[[Formulation], tuple[str, ...]] | None = None
    code: str = ""
    never_negative: str = ""

    def names_in(self, formulation: Formulation) -> tuple[str, ...]:
        """Return the targets that there are in a formulation."""
        return self.targets if self.targets_in is None else self.targets_in(formulation)

    def candidates(self, formulation: Formulation) -> Catalogue:
        """Return the candidates of all targets, and the targets that the data cannot test."""
        found = Catalogue()
        for target in self.names_in(formulation):
            try:
                built = self.build(formulation, target)
            except NotTestable as why:
                found += Catalogue(
                    untestable=(Untestable(self.name, target, str(why), why.columns, why.missing),),
                )
                continue
            if isinstance(built, HeldBack):
                found += Catalogue(
                    alternatives=built.alternatives, untestable=(Untestable(self.name, target, built.reason),)
                )
            else:
                found += Catalogue(candidates=built)
        return found

    def enter(self) -> EffectFamily:
        """Put the family into the registry, under `machine/name`, and return it."""
        effects.register(f"{self.machine}/{self.name}")(lambda: self)
        return self


def needs(data: MeasuredData, *columns: str) -> None:
    """Raise `NotTestable` unless all `columns` are there and vary.

    Calibration absorbs the effect of a constant column.
    """
    needs_there(data, *columns)
    for column in columns:
        if why := told_gaps(data[column]):
            raise NotTestable(f"column {column} {why}", (column,))
    still = tuple(column for column in columns if not np.ptp(data[column]) > 1e-12 * np.max(np.abs(data[column])))
    if still:
        raise NotTestable(f"column {', '.join(still)} is constant", still)


def needs_there(data: MeasuredData, *columns: str) -> None:
    """Raise `NotTestable` unless all `columns` are there, constant or not."""
    missing = tuple(column for column in columns if column not in data)
    if missing:
        raise NotTestable(f"needs column{'s' * (len(missing) > 1)} {', '.join(missing)}", missing, missing=True)


def number(target: str) -> int:
    """Return the number in a target: 2 for `joint 2`."""
    return int(target.rpartition(" ")[2])


Cause = EffectFamily  # the name it had first, kept for scripts
