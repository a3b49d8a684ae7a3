"""A simulator of the user's as a machine."""

from calibench.discrepancy.machines.simulator import effects as effects
from calibench.discrepancy.machines.simulator.formulation import SimulatorMachine

__all__ = ["SimulatorMachine"]
