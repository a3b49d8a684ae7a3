"""What may be wrong with a linear delta beside its endstops: towers, rods, belts, effector, bed, and the caliper."""

from __future__ import annotations

from calibench.discrepancy.machines.delta.effects import measuring as measuring
from calibench.discrepancy.machines.delta.effects import structure as structure
