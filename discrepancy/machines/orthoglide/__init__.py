"""The Orthoglide (Pashkevich et al. 2008): three legs that must move parallel to themselves, read by dial gauges.

`formulation` states the constraints, `kinematics` the exact machine with its imperfections, `validate` checks measured
data, `plan` makes up readings that were not measured yet, `printed` holds the chapter's tables, `experiments` asks what
they support, `description` declares columns and words, `effects` is the catalogue.
"""

from __future__ import annotations

from calibench.discrepancy.machines.orthoglide import description as description
from calibench.discrepancy.machines.orthoglide import effects as effects
from calibench.discrepancy.machines.orthoglide.formulation import Orthoglide

__all__ = ["Orthoglide"]
