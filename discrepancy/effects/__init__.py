"""The catalogue of all machines: `catalogue` asks every family of a machine for its candidates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from discrepancy.model.effect import Beside, Effect, Family, NotTestable
from discrepancy.model.machine import Formulation
from discrepancy.registries import effects


@final
@dataclass(frozen=True)
class Gap:
    """A family, or one target of it, that these data cannot test, and why; `beside` is what names are held against."""

    family: str
    target: str
    reason: str
    beside: Beside | None = None


def families(machine: str) -> tuple[Family, ...]:
    """Return the families of effects of one machine, by name, those of other packages among them."""
    known = (effects.make(name) for name in effects.names())
    return tuple(family for family in known if family.machine == machine)


def catalogue(formulation: Formulation) -> tuple[tuple[Effect, ...], tuple[Gap, ...]]:
    """Return all candidates that the data can test, and what they cannot test."""
    found: list[Effect] = []
    gaps: list[Gap] = []
    for family in families(formulation.data.machine):
        try:
            found += family.candidates(formulation)
        except NotTestable as gap:
            found += gap.others
            reasons = gap.reasons or {"all": str(gap)}
            held = {b.effect.target: b for b in gap.beside}
            gaps += [Gap(family.name, target, reason, held.get(target)) for target, reason in reasons.items()]
    return tuple(found), tuple(gaps)
