"""The Orthoglide (Pashkevich et al. 2008): legs that must move parallel to themselves, read by dial gauges."""

from calibench.discrepancy.machines.orthoglide import effects as effects
from calibench.discrepancy.machines.orthoglide.formulation import Orthoglide

__all__ = ["Orthoglide"]
