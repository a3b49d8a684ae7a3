"""The catalogue: what the families of a machine can test in its data. `table` prints it as a page."""

from __future__ import annotations

from calibench.discrepancy.model.effect import Catalogue
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.registries import families as families
from calibench.discrepancy.registries import family_of as family_of

__all__ = ["catalogue", "families", "family_of"]


def catalogue(formulation: Formulation) -> Catalogue:
    """Return what the data can test of every family of their machine, and what they cannot."""
    return sum((family.candidates(formulation) for family in families(formulation.data.machine)), Catalogue())
