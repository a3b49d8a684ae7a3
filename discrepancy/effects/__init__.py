"""The catalogue: what the families of a machine can test in its data. `table` prints it as a page."""

from __future__ import annotations

from dataclasses import replace

from calibench.discrepancy.effects import general as general
from calibench.discrepancy.model.effect import Catalogue, Effect
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.registries import families as families
from calibench.discrepancy.registries import family_of as family_of

__all__ = ["catalogue", "families", "family_of"]


def catalogue(formulation: Formulation) -> Catalogue:
    """Return what the data can test of every family of their machine, and what they cannot.

    A candidate keeps only those of its twins that this catalogue has, because only these are tested as its rivals.
    """
    known = families(formulation.data.machine)
    whole = sum((family.candidates(formulation) for family in known), Catalogue())
    names = {f"{family.name} {target}" for family in known for target in family.names_in(formulation)}
    return replace(whole, candidates=tuple(_among(effect, names) for effect in whole.candidates))


def _among(effect: Effect, names: set[str]) -> Effect:
    twins = tuple(twin for twin in effect.twins if twin in names)
    return effect if twins == effect.twins else replace(effect, twins=twins)  # type: ignore[type-var]
