"""A simulator of the user's as a machine: `caller` runs it, `local` is what it says nearby, `formulation` the machine.

`effects` are those of parameters, and of what enters and leaves it; all others are the general ones.
"""

from calibench.discrepancy.machines.simulator import effects as effects
from calibench.discrepancy.machines.simulator.formulation import SimulatorMachine

__all__ = ["SimulatorMachine"]
