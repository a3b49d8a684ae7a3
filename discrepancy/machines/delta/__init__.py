"""A linear delta printer (three carriages on towers, three rods, one nozzle), measured by probe and caliper.

`formulation` checks measured data and predicts heights and distances, `description` declares columns and words,
`effects` is the catalogue.
"""

from calibench.discrepancy.machines.delta import description as description, effects as effects
from calibench.discrepancy.machines.delta.formulation import Delta

__all__ = ["Delta"]
