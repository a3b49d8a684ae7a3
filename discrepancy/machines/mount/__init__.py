"""A telescope mount, equatorial or altazimuth: two axes, and the pointing terms of the field by their names and signs.

`geometry` points the telescope and lists the field's terms, `formulation` checks observations and states what is
measured and predicted, `effects` makes the terms findable, `description` declares columns, units and words, makes up
stars, reads the field's files and writes a pointing model.
"""

from calibench.discrepancy.machines.mount import description as description, effects as effects
from calibench.discrepancy.machines.mount.formulation import Mount

__all__ = ["Mount"]
