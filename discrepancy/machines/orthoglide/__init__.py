"""The Orthoglide (Pashkevich et al. 2008): three legs that must move parallel to themselves, read by dial gauges.

`formulation` states the constraints, `kinematics` is the exact machine with its imperfections and checks measured data,
`experiments` asks what the chapter's tables support, `description` declares columns and words, `effects` is the
catalogue.
"""

from calibench.discrepancy.machines.orthoglide import description as description, effects as effects
from calibench.discrepancy.machines.orthoglide.formulation import Orthoglide

__all__ = ["Orthoglide"]
