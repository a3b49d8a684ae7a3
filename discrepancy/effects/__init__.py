"""The catalogue: what the families of a machine can test in its data."""

from dataclasses import replace

from calibench.discrepancy.effects import general as general
from calibench.discrepancy.model.effect import Catalogue
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.registries import families as families, family_of as family_of

__all__ = ["catalogue", "families", "family_of"]


def catalogue(formulation: Formulation) -> Catalogue:
    """Return what the data can test of every family of their machine, and what they cannot."""
    known = families(formulation.data.machine)
    parts = [family.candidates(formulation) for family in known]
    names = {f"{family.name} {target}" for family in known for target in family.names_in(formulation)}
    kept = []
    for effect in (effect for part in parts for effect in part.candidates):
        twins = tuple(twin for twin in effect.twins if twin in names)
        kept.append(effect if twins == effect.twins else replace(effect, twins=twins))  # type: ignore[type-var]
    alternatives = (one for part in parts for one in part.alternatives)
    return Catalogue(tuple(kept), tuple(alternatives), tuple(one for part in parts for one in part.untestable))
