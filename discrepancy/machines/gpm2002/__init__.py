"""The GPM2002 (Cong et al. 2008): three legs that meet in one point, read by encoders and perhaps by a tracker.

`formulation` checks measured data, finds the encoder offsets to begin from and states the constraints, `description`
declares columns, words and plans, `effects` is the catalogue.
"""

from calibench.discrepancy.machines.gpm2002 import description as description, effects as effects
from calibench.discrepancy.machines.gpm2002.formulation import Gpm2002

__all__ = ["Gpm2002"]
