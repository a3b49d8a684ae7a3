"""The Orthoglide (Pashkevich et al. 2008): three legs that must move parallel to themselves, read by dial gauges.

`formulation` states the constraints and declares columns, words and plans, `kinematics` is the exact machine with its
imperfections and checks measured data, `experiments` asks what the chapter's tables support; `effects` is the list.
"""

from calibench.discrepancy.machines.orthoglide import effects as effects
from calibench.discrepancy.machines.orthoglide.formulation import Orthoglide

__all__ = ["Orthoglide"]
