"""A linear delta printer (three carriages on towers, three rods, one nozzle), measured by probe and caliper."""

from calibench.discrepancy.machines.delta import description as description, effects as effects
from calibench.discrepancy.machines.delta.formulation import Delta

__all__ = ["Delta"]
