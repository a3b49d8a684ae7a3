"""A telescope mount, equatorial or altazimuth: two axes, and the pointing terms of the field by their names and signs.

`geometry` points the telescope, `terms` lists the field's terms, `tpoint` reads its files, `validate` checks
observations, `formulation` states what is measured and predicted, `effects` makes the terms findable, `plan` makes up
stars that were not observed yet, `coefficients` writes what was found as a pointing model, `description` declares
columns, units and words.
"""

from __future__ import annotations

from calibench.discrepancy.machines.mount import description as description
from calibench.discrepancy.machines.mount import effects as effects
from calibench.discrepancy.machines.mount.formulation import Mount

__all__ = ["Mount"]
