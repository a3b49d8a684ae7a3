"""A telescope mount: two axes, and the pointing terms of the field by their names and signs."""

from calibench.discrepancy.machines.mount import description as description, effects as effects
from calibench.discrepancy.machines.mount.formulation import Mount

__all__ = ["Mount"]
